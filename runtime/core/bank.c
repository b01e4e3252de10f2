/* First-order low-passes of the signals, exact over any step, in double: s' = u + (s - u) exp(-dt / tau). As `bank.FilterBank`.
 *
 * In single precision a filter of 900 s stalls 5 % short at 1 kHz. Samples are taken in blocks of 64: within one the response
 * y' = a y + (1 - a) u starts from zero and the reach r' = a r from one, and the value is y + r s with s the value before. That
 * is how Python computes many blocks side by side; the same operations here give the same bits.
 */
#include "motorlens.h"

#define BLOCK 64

void motorlens_bank_values(const motorlens_features *map, const motorlens_bank_state *state, double *values)
{
    for (int k = 0; k < map->filters; k++)
        values[k] = state->inside[k] + state->reach[k] * state->before[k];
}

void motorlens_bank_advance(const motorlens_features *map, motorlens_bank_state *state, double dt_s, const double *signals)
{
    const int filters = map->filters;
    if (dt_s != state->dt_s) { /* a live line keeps its step */
        for (int k = 0; k < filters; k++)
            state->decay[k] = motorlens_decay(-dt_s / map->tau_s[k]);
        for (int k = 0; k < filters; k++)
            state->gain[k] = 1.0 - state->decay[k];
        state->dt_s = dt_s;
    }
    if (state->count % BLOCK) {
        for (int k = 0; k < filters; k++) {
            state->inside[k] = state->decay[k] * state->inside[k] + state->gain[k] * signals[map->filter_signal[k]];
            state->reach[k] = state->decay[k] * state->reach[k];
        }
    } else {
        for (int k = 0; k < filters; k++) {
            state->inside[k] = state->gain[k] * signals[map->filter_signal[k]];
            state->reach[k] = state->decay[k];
        }
    }
    if (++state->count % BLOCK == 0) {
        motorlens_bank_values(map, state, state->before);
        for (int k = 0; k < filters; k++) {
            state->inside[k] = 0.0;
            state->reach[k] = 1.0;
        }
    }
}
