/* First-order low-passes of the signals, exact over any step: s' = u + (s - u) exp(-dt / tau). As `bank.FilterBank`.
 *
 * In single precision a filter of 900 s stalls 5 % short at 1 kHz. In double, samples are taken in blocks of 64: within one the
 * response y' = a y + (1 - a) u starts from zero and the reach r' = a r from one, and the value is y + r s with s the value
 * before. That is how Python computes many blocks side by side; the same operations here give the same bits.
 *
 * A core without double computes s' = s + (1 - a) (u - s) in whole numbers of 64 bits. The unit is a power of two that leaves
 * room for 16 times the largest signal, 2^-60 of that; rounding a thousand million times is 1e-9 of it.
 */
#include "arithmetic.h"

#if MOTORLENS_SINGLE

/* 1 - exp(-x) of x >= 0, to a few parts in 10^7 of itself: a time constant that much off. Below one, for the multiplier. */
static float loss_over(float x)
{
    float sum = 1.0f, loss;
    if (x > 0.5f) {
        loss = x < 16.0f ? 1.0f - motorlens_expf_between(-x) : 1.0f;
    } else {
        for (int k = 9; k > 1; k--) /* x - x^2/2! + x^3/3! ... */
            sum = 1.0f - x / (float)k * sum;
        loss = x * sum;
    }
    return loss < 0.99999994f ? loss : 0.99999994f;
}

/* A whole number without its last places, of which there are at most 31: fewer instructions than a shift by any number. */
static int64_t without_last(int64_t number, int places)
{
    const int32_t high = (int32_t)(number >> 32);
    const uint32_t low = (uint32_t)number >> places | (uint32_t)high << 1 << (31 - places);
    return (int64_t)((uint64_t)(uint32_t)(high >> places) << 32 | low);
}

void motorlens_bank_advance(const motorlens_features *map, motorlens_bank_state *state, int64_t dt_ns)
{
    const int filters = map->filters;
    const motorlens_signal *signals = state->value + filters;
    if (dt_ns == 0)
        return;
    if (dt_ns != state->dt_ns) { /* a live line keeps its step */
        const float step = real_of(dt_ns);
        for (int k = 0; k < filters; k++) {
            float loss = loss_over(step * map->per_ns[k]);
            uint8_t shift = 0;
            while (loss < 0.5f && shift < 31) { /* from a step of tau / 2^31 on, the gain has fewer bits */
                loss *= 2.0f;
                shift++;
            }
            state->gain[k] = (int32_t)(loss * 2147483648.0f);
            state->shift[k] = shift;
        }
        state->dt_ns = dt_ns;
    }
    for (int k = 0; k < filters; k++) {
        const int64_t apart = 2 * (signals[map->filter_signal[k]] - state->value[k]);
        const int32_t upper = (int32_t)((uint64_t)apart >> 32), gain = state->gain[k];
        const uint64_t low = (uint64_t)(uint32_t)apart * (uint32_t)gain;
        state->value[k] += without_last((int64_t)upper * gain + (int64_t)(low >> 32), state->shift[k]);
    }
}

#else

#define BLOCK 64

void motorlens_bank_values(const motorlens_features *map, const motorlens_bank_state *state, double *values)
{
    for (int k = 0; k < map->filters; k++)
        values[k] = state->inside[k] + state->reach[k] * state->before[k];
}

void motorlens_bank_advance(const motorlens_features *map, motorlens_bank_state *state, int64_t dt_ns, const double *signals)
{
    const int filters = map->filters;
    const double dt_s = (double)dt_ns * 1e-9;
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

#endif
