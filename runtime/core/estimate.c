/* Samples in, estimates with their deviation and quality out: gate, filters, observer, network. As `estimator.Estimator`. */
#include <math.h>
#include <string.h>

#include "arithmetic.h"

void motorlens_start(const motorlens_sensor *sensor, motorlens_state *state, int64_t period_ns)
{
    volatile unsigned char *byte = (volatile unsigned char *)state; /* volatile: no library is called for it */
    for (size_t k = 0; k < sizeof *state; k++)
        byte[k] = 0;
    state->gate.bridged_until_ns = INT64_MIN;
    state->gate.first_move = MOTORLENS_NEVER;
    state->gate.ambient_C = sensor->gate.needs_ambient ? 0 : (motorlens_real)NAN;
#if !MOTORLENS_SINGLE
    state->bank.dt_s = -1.0; /* no step has been taken: no decay is known */
    for (int k = 0; k < sensor->features.filters; k++)
        state->bank.reach[k] = 1.0;
#endif
    state->period_ns = period_ns;
}

uint32_t motorlens_update(const motorlens_sensor *sensor, motorlens_state *state, motorlens_sample *sample)
{
    int64_t dt_ns;
    int used;
#if !MOTORLENS_SINGLE
    motorlens_signal signals[MOTORLENS_SIGNALS];
#endif
    const uint32_t quality =
        motorlens_gate_inspect(&sensor->gate, &state->gate, state->period_ns, sample, &dt_ns, &used);
    if (quality == MOTORLENS_BACKWARDS)
        return quality;
#if MOTORLENS_SINGLE
    motorlens_signals(&sensor->features, sample, state->bank.value + sensor->features.filters);
    motorlens_bank_advance(&sensor->features, &state->bank, dt_ns);
#else
    motorlens_signals(&sensor->features, sample, signals);
    motorlens_bank_advance(&sensor->features, &state->bank, dt_ns, signals);
#endif
    state->failed = 0;
#if MOTORLENS_OPERATIONS
    if (sensor->observer.size > 0 && used)
        state->failed = motorlens_observer_advance(&sensor->observer, state->observer, sample, (double)dt_ns * 1e-9);
#endif
    return quality;
}

/* The outputs of the observer after the sample that was taken last; NaN where it has failed. */
static void observe(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample, double *observed)
{
#if MOTORLENS_OPERATIONS
    const motorlens_observer *observer = &sensor->observer;
    if (observer->size > 0 &&
        (state->failed || motorlens_observer_read(observer, state->observer, (double)sample->ambient_C, observed)))
        for (int k = 0; k < observer->outputs; k++)
            observed[k] = (double)NAN;
#else
    (void)sensor, (void)state, (void)sample, (void)observed;
#endif
}

#if MOTORLENS_SINGLE

uint32_t motorlens_evaluate(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample,
                            uint32_t quality, motorlens_real *estimate, motorlens_real *sigma)
{
    const motorlens_features *map = &sensor->features;
    const motorlens_envelope *envelope = &sensor->envelope;
    const int first = map->filters + map->signals;
    double observed[MOTORLENS_OBSERVER] = {0};
    int32_t wholes[MOTORLENS_COLUMNS];
    float reals[MOTORLENS_REALS], squares;
    if (MOTORLENS_OPERATIONS) { /* what has no observer brings nothing for it */
        int failed = 0;
        observe(sensor, state, sample, observed);
        for (int k = 0; k < sensor->observer.outputs; k++)
            failed |= !isfinite(observed[k]);
        for (int k = 0; failed && k < sensor->network.outputs; k++)
            estimate[k] = sigma[k] = (motorlens_real)NAN;
        if (failed)
            return quality | MOTORLENS_QUALITY_NOT_FINITE;
    }
    motorlens_whitened(sensor, state, observed, wholes, reals, &squares);
    motorlens_network_evaluate(sensor, wholes, reals, estimate, sigma);
    if (squares > envelope->limit)
        quality |= MOTORLENS_QUALITY_OUTSIDE_ENVELOPE;
    if (MOTORLENS_OPERATIONS && envelope->distrust >= 0 && observed[map->plus[envelope->distrust] - first] > 0.0)
        quality |= MOTORLENS_QUALITY_UNFORETOLD;
    for (int k = 0; k < sensor->network.outputs; k++)
        if (!(isfinite(estimate[k]) && isfinite(sigma[k])))
            quality |= MOTORLENS_QUALITY_NOT_FINITE;
    return quality;
}

#else

/* What the features after the sample that was taken last are made of, into one lane of `known`. */
static void look(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample, motorlens_lanes *known,
                 int lane)
{
    const motorlens_features *map = &sensor->features;
    const int count = map->filters + map->signals + sensor->observer.outputs;
    double here[MOTORLENS_KNOWN];
    motorlens_bank_values(map, &state->bank, here);
    motorlens_signals(map, sample, here + map->filters);
    observe(sensor, state, sample, here + map->filters + map->signals);
    for (int k = 0; k < count; k++)
        known[k][lane] = here[k];
}

/* So many rows are evaluated side by side that all lanes are to hold numbers: those of the first row. */
static void fill_lanes(motorlens_lanes *known, int count, int rows)
{
    for (int k = 0; k < count; k++)
        for (int lane = rows; lane < MOTORLENS_LANES; lane++)
            known[k][lane] = known[k][0];
}

void motorlens_evaluate_rows(const motorlens_sensor *sensor, const motorlens_lanes *features, int rows, int64_t stride,
                             double *estimate, double *sigma, uint32_t *quality)
{
    const int outputs = sensor->network.outputs, distrust = sensor->envelope.distrust;
    motorlens_lanes columns[MOTORLENS_COLUMNS];
    motorlens_lanes values[MOTORLENS_OUTPUTS], deviations[MOTORLENS_OUTPUTS], squares, finite = {0};
    if (distrust >= 0)
        for (int row = 0; row < rows; row++)
            if (features[distrust][row] > 0.0)
                quality[row] |= MOTORLENS_QUALITY_UNFORETOLD;
    motorlens_whitened(&sensor->envelope, sensor->features.features, features, columns, squares);
    motorlens_network_evaluate(&sensor->network, sensor->features.features, columns, values, deviations);
    for (int k = 0; k < outputs; k++) {
        memcpy(estimate + k * stride, values[k], (size_t)rows * sizeof *estimate);
        memcpy(sigma + k * stride, deviations[k], (size_t)rows * sizeof *sigma);
        for (int lane = 0; lane < MOTORLENS_LANES; lane++) /* 0, or NaN once there is one that is not finite */
            finite[lane] += (values[k][lane] - values[k][lane]) + (deviations[k][lane] - deviations[k][lane]);
    }
    for (int row = 0; row < rows; row++) {
        if (squares[row] > sensor->envelope.limit)
            quality[row] |= MOTORLENS_QUALITY_OUTSIDE_ENVELOPE;
        if (isnan(finite[row]))
            quality[row] |= MOTORLENS_QUALITY_NOT_FINITE;
    }
}

uint32_t motorlens_evaluate(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample,
                            uint32_t quality, double *estimate, double *sigma)
{
    const int count = sensor->features.filters + sensor->features.signals + sensor->observer.outputs;
    motorlens_lanes known[MOTORLENS_KNOWN], features[MOTORLENS_FEATURES];
    look(sensor, state, sample, known, 0);
    fill_lanes(known, count, 1);
    motorlens_features_of(&sensor->features, (const motorlens_lanes *)known, features);
    motorlens_evaluate_rows(sensor, (const motorlens_lanes *)features, 1, 1, estimate, sigma, &quality);
    return quality;
}

/* The features of rows with these numbers since the start, as far as they are to be looked at. */
static void show_features(const motorlens_sensor *sensor, motorlens_block *block, motorlens_lanes *features,
                          const int64_t *numbers, int rows)
{
    for (int row = 0; row < rows; row++)
        if (numbers[row] % block->look_every < block->look_length) {
            double *place = block->features + block->looked++ * sensor->features.features;
            for (int k = 0; k < sensor->features.features; k++)
                place[k] = features[k][row];
        }
}

int64_t motorlens_push(const motorlens_sensor *sensor, motorlens_state *state, motorlens_block *block)
{
    motorlens_state next = *state;
    const int count = sensor->features.filters + sensor->features.signals + sensor->observer.outputs;
    motorlens_lanes known[MOTORLENS_KNOWN], features[MOTORLENS_FEATURES];
    int64_t asked = 0, numbers[MOTORLENS_LANES];
    int rows = 0;
    block->looked = 0;
    for (int64_t k = 0; k < block->n; k++) {
        motorlens_sample sample;
        uint32_t word;
        sample.time_ns = block->time_ns[k];
        sample.voltage_V = block->voltage_V[k];
        sample.current_A = block->current_A[k];
        sample.ambient_C = block->ambient_C == NULL ? (double)NAN : block->ambient_C[k];
        sample.flags = block->flags == NULL ? 0 : block->flags[k];
        word = motorlens_update(sensor, &next, &sample);
        if (word == MOTORLENS_BACKWARDS)
            return k + 1;
        if (asked == block->m || (block->rows != NULL && block->rows[asked] != k))
            continue;
        look(sensor, &next, &sample, known, rows);
        numbers[rows] = next.bank.count - 1;
        block->quality[asked++] = word;
        if (++rows == MOTORLENS_LANES || asked == block->m) {
            const int64_t first = asked - rows;
            fill_lanes(known, count, rows);
            motorlens_features_of(&sensor->features, (const motorlens_lanes *)known, features);
            if (block->look_every > 0)
                show_features(sensor, block, features, numbers, rows);
            motorlens_evaluate_rows(sensor, (const motorlens_lanes *)features, rows, block->m, block->estimate + first,
                                    block->sigma + first, block->quality + first);
            rows = 0;
        }
    }
    *state = next;
    return 0;
}

#endif
