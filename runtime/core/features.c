/* Signals of a sample, and features of signals, filters and observer. As `features.FeatureMap`. */
#include <string.h>

#include "arithmetic.h"

/* What signals are products of. */
static void measure(const motorlens_features *map, const motorlens_sample *sample, motorlens_real *measured)
{
    measured[0] = 1;
    measured[1] = sample->voltage_V;
    measured[2] = sample->current_A;
    measured[3] = sample->voltage_V - map->resistance_ohm * sample->current_A;
    measured[4] = sample->ambient_C;
}

#if MOTORLENS_SINGLE

#define LARGEST_HIGH 268435456.0f /* 2^28: sums and differences of three stay below 2^63 */

void motorlens_signals(const motorlens_features *map, const motorlens_sample *sample, motorlens_signal *signals)
{
    float measured[5];
    measure(map, sample, measured);
    for (int k = 0; k < map->signals; k++) {
        const float x = measured[map->first[k]] * measured[map->second[k]] * map->units[k];
        const float bounded = x > LARGEST_HIGH ? LARGEST_HIGH : x < -LARGEST_HIGH ? -LARGEST_HIGH : x;
        const int32_t high = (int32_t)bounded;
        /* Both parts are exact: a float has 24 bits. */
        signals[k] = (int64_t)high * INT64_C(4294967296) + 2 * (int64_t)(int32_t)((bounded - (float)high) * 2147483648.0f);
    }
}

/* A whole number without its last places, from 1 to 31 of them, in 32 bits; at the end of their range where it does not fit. */
static int32_t without(int64_t number, int places)
{
    const int32_t high = (int32_t)(number >> 32), most = INT32_C(1) << (places - 1);
    if (high >= most)
        return INT32_MAX;
    if (high < -most)
        return -INT32_MAX;
    return (int32_t)((uint32_t)high << (32 - places) | (uint32_t)number >> places);
}

/* The distance of a feature from its mean in 32 bits, or, without whitening, in single precision. */
static int32_t look_at(const motorlens_sensor *sensor, const motorlens_state *state, const double *observed, int feature,
                       float *plain)
{
    const motorlens_features *map = &sensor->features;
    const motorlens_envelope *envelope = &sensor->envelope;
    const int plus = map->plus[feature], minus = map->minus[feature], shift = envelope->shift[feature];
    int64_t distance;
#if MOTORLENS_OPERATIONS
    const int first = map->filters + map->signals;
    if (plus >= first) {
        const double far = observed[plus - first] - envelope->observed_mean[plus - first];
        const double scaled = far * envelope->observed_scale[plus - first];
        *plain = (float)far;
        return scaled > 2147483647.0 ? INT32_MAX : scaled < -2147483647.0 ? -INT32_MAX : (int32_t)scaled;
    }
#else
    (void)observed;
#endif
    distance = state->bank.value[plus] - envelope->mean[feature];
    if (minus != UINT16_MAX)
        distance -= state->bank.value[minus];
    if (!MOTORLENS_WHITENED)
        *plain = real_of(distance) * float_two_to(envelope->unit[feature]);
    return without(distance, shift); /* the mean has half a place in it, so that this rounds */
}

/* Where the features stand among those trained on, into `wholes`; without an envelope, their distance from the mean into `reals`.
 * In whole numbers, so that small differences of large products lose nothing, and in few instructions. */
void motorlens_whitened(const motorlens_sensor *sensor, const motorlens_state *state, const double *observed, int32_t *wholes,
                        float *reals, float *squares)
{
    const motorlens_envelope *envelope = &sensor->envelope;
    const int count = sensor->features.features;
    const int32_t *weight = envelope->whitening;
    int32_t apart[MOTORLENS_FEATURES];
    float length = 0.0f;
    for (int k = 0; k < count; k++)
        apart[k] = look_at(sensor, state, observed, k, reals + k);
    for (int k = 0; MOTORLENS_WHITENED && k < count; k += MOTORLENS_SUMS) {
        const int wanted = count - k < MOTORLENS_SUMS ? count - k : MOTORLENS_SUMS;
        int64_t sums[MOTORLENS_SUMS];
        motorlens_wide_sums(weight, apart + k, count - k, sums, wanted);
        weight += wanted * (count - k);
        for (int m = 0; m < wanted; m++) {
            const int32_t place = without(sums[m], envelope->places[k + m]);
            const float z = (float)place * float_two_to(envelope->unit[k + m]);
            wholes[k + m] = place;
            length += z * z;
        }
    }
    *squares = length;
}

#else

void motorlens_signals(const motorlens_features *map, const motorlens_sample *sample, motorlens_signal *signals)
{
    double measured[5];
    measure(map, sample, measured);
    for (int k = 0; k < map->signals; k++)
        signals[k] = measured[map->first[k]] * measured[map->second[k]];
}

void motorlens_features_of(const motorlens_features *map, const motorlens_lanes *known, motorlens_lanes *features)
{
    for (int k = 0; k < map->features; k++) {
        memcpy(features[k], known[map->plus[k]], sizeof *features);
        if (map->minus[k] != UINT16_MAX)
            for (int lane = 0; lane < MOTORLENS_LANES; lane++)
                features[k][lane] -= known[map->minus[k]][lane];
    }
}

static void add_square(const motorlens_real *x, double *squares)
{
    for (int lane = 0; lane < MOTORLENS_LANES; lane++)
        squares[lane] += x[lane] * x[lane];
}

void motorlens_whitened(const motorlens_envelope *envelope, int count, const motorlens_lanes *features,
                        motorlens_lanes *columns, double *squares)
{
    const motorlens_real *weights = envelope->whitening;
    for (int lane = 0; lane < MOTORLENS_LANES; lane++)
        squares[lane] = 0.0;
    for (int j = 0; j < count; j++)
        for (int lane = 0; lane < MOTORLENS_LANES; lane++)
            columns[j][lane] = features[j][lane] - envelope->mean[j];
    for (int j = 0; weights == NULL && j < count; j++)
        add_square(columns[j], squares);
    for (int k = 0; weights != NULL && k < count; k += MOTORLENS_SUMS) {
        const int length = count - k, wanted = length < MOTORLENS_SUMS ? length : MOTORLENS_SUMS;
        const motorlens_real *of[MOTORLENS_SUMS];
        motorlens_lanes sums[MOTORLENS_SUMS];
        for (int m = 0; m < MOTORLENS_SUMS; m++)
            of[m] = weights + (k + m < count ? m : 0) * length;
        weights += wanted * length;
        sums_of(of, (const motorlens_lanes *)columns + k, length, sums, wanted);
        for (int m = 0; m < wanted; m++)
            add_square(sums[m], squares);
    }
}

#endif
