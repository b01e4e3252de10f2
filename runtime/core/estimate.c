/* Samples in, estimates with their deviation and quality out: gate, filters, observer, network. As `estimator.Estimator`. */
#include <math.h>
#include <string.h>

#include "arithmetic.h"

void motorlens_start(const motorlens_sensor *sensor, motorlens_state *state, int64_t period_ns)
{
    memset(state, 0, sizeof *state);
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
    motorlens_signal signals[MOTORLENS_SIGNALS];
    int64_t dt_ns;
    int used;
    const uint32_t quality =
        motorlens_gate_inspect(&sensor->gate, &state->gate, state->period_ns, sample, &dt_ns, &used);
    if (quality == MOTORLENS_BACKWARDS)
        return quality;
    motorlens_signals(&sensor->features, sample, signals);
    motorlens_bank_advance(&sensor->features, &state->bank, dt_ns, signals);
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
    motorlens_signal signals[MOTORLENS_SIGNALS];
    double observed[MOTORLENS_OBSERVER] = {0};
    int failed = 0;
    motorlens_lanes columns[MOTORLENS_COLUMNS];
    motorlens_real squares;
    observe(sensor, state, sample, observed);
    for (int k = 0; k < sensor->observer.outputs; k++)
        failed |= !isfinite(observed[k]);
    if (failed) {
        for (int k = 0; k < sensor->network.outputs; k++)
            estimate[k] = sigma[k] = (motorlens_real)NAN;
        return quality | MOTORLENS_QUALITY_NOT_FINITE;
    }
    motorlens_signals(map, sample, signals);
    motorlens_whitened(sensor, state, signals, observed, columns, &squares);
    motorlens_network_evaluate(&sensor->network, map->features, columns, (motorlens_lanes *)estimate,
                               (motorlens_lanes *)sigma);
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

/* The features after the sample that was taken last. */
static void look(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample, double *features)
{
    const motorlens_features *map = &sensor->features;
    double known[MOTORLENS_FILTERS + MOTORLENS_SIGNALS + MOTORLENS_OBSERVER];
    motorlens_bank_values(map, &state->bank, known);
    motorlens_signals(map, sample, known + map->filters);
    observe(sensor, state, sample, known + map->filters + map->signals);
    motorlens_features_of(map, known, features);
}

void motorlens_batch_start(motorlens_batch *batch)
{
    memset(batch, 0, sizeof *batch);
}

int motorlens_batch_add(const motorlens_sensor *sensor, motorlens_batch *batch, const double *features, uint32_t quality)
{
    for (int k = 0; k < sensor->features.features; k++)
        batch->features[k][batch->rows] = features[k];
    if (sensor->envelope.distrust >= 0 && features[sensor->envelope.distrust] > 0.0)
        quality |= MOTORLENS_QUALITY_UNFORETOLD;
    batch->quality[batch->rows++] = quality;
    return batch->rows == MOTORLENS_LANES;
}

void motorlens_batch_finish(const motorlens_sensor *sensor, motorlens_batch *batch, double *estimate, double *sigma,
                            uint32_t *quality)
{
    const int outputs = sensor->network.outputs;
    motorlens_lanes columns[MOTORLENS_COLUMNS];
    motorlens_lanes values[MOTORLENS_OUTPUTS], deviations[MOTORLENS_OUTPUTS], squares;
    motorlens_whitened(&sensor->envelope, sensor->features.features, batch->features, columns, squares);
    motorlens_network_evaluate(&sensor->network, sensor->features.features, columns, values, deviations);
    for (int row = 0; row < batch->rows; row++) {
        uint32_t word = batch->quality[row];
        if (squares[row] > sensor->envelope.limit)
            word |= MOTORLENS_QUALITY_OUTSIDE_ENVELOPE;
        for (int k = 0; k < outputs; k++) {
            if (!(isfinite(values[k][row]) && isfinite(deviations[k][row])))
                word |= MOTORLENS_QUALITY_NOT_FINITE;
            *estimate++ = values[k][row];
            *sigma++ = deviations[k][row];
        }
        *quality++ = word;
    }
    batch->rows = 0;
}

uint32_t motorlens_evaluate(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_sample *sample,
                            uint32_t quality, double *estimate, double *sigma)
{
    double features[MOTORLENS_FEATURES];
    motorlens_batch batch;
    motorlens_batch_start(&batch);
    look(sensor, state, sample, features);
    motorlens_batch_add(sensor, &batch, features, quality);
    motorlens_batch_finish(sensor, &batch, estimate, sigma, &quality);
    return quality;
}

int64_t motorlens_push(const motorlens_sensor *sensor, motorlens_state *state, int64_t n, const int64_t *time_ns,
                       const double *voltage_V, const double *current_A, const double *ambient_C, const uint32_t *flags,
                       int64_t m, const int64_t *rows, double *estimate, double *sigma, uint32_t *quality,
                       double *features)
{
    motorlens_state next = *state;
    const int64_t outputs = sensor->network.outputs, width = sensor->features.features;
    int64_t asked = 0, done = 0;
    double made[MOTORLENS_FEATURES];
    motorlens_batch batch;
    motorlens_batch_start(&batch);
    for (int64_t k = 0; k < n; k++) {
        motorlens_sample sample;
        uint32_t word;
        sample.time_ns = time_ns[k];
        sample.voltage_V = voltage_V[k];
        sample.current_A = current_A[k];
        sample.ambient_C = ambient_C == NULL ? (double)NAN : ambient_C[k];
        sample.flags = flags == NULL ? 0 : flags[k];
        word = motorlens_update(sensor, &next, &sample);
        if (word == MOTORLENS_BACKWARDS)
            return k + 1;
        if (asked < m && (rows == NULL || rows[asked] == k)) {
            double *place = features == NULL ? made : features + asked * width;
            look(sensor, &next, &sample, place);
            asked++;
            if (motorlens_batch_add(sensor, &batch, place, word) || asked == m) {
                motorlens_batch_finish(sensor, &batch, estimate + done * outputs, sigma + done * outputs, quality + done);
                done = asked;
            }
        }
    }
    *state = next;
    return 0;
}

#endif
