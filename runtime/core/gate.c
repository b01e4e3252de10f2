/* What of a sample is believed: nothing that is not finite or physically absurd reaches the state. As `gate.Gate`. */
#include "arithmetic.h"

static void judge_stuck(const motorlens_gate *gate, motorlens_gate_state *state, motorlens_real voltage_V,
                        motorlens_real current_A, uint32_t *quality)
{
    const int64_t now = state->count;
    if (current_A != state->current_A) {
        state->current_since = now;
        state->first_move = MOTORLENS_NEVER;
    } else if (state->first_move == MOTORLENS_NEVER && real_abs(voltage_V - state->voltage_V) > gate->move_V) {
        state->first_move = now;
    }
    if (voltage_V != 0 || real_abs(current_A) < gate->flowing_A)
        state->dead_since = now;
    if (now - state->first_move >= gate->repeats || now - state->dead_since >= gate->repeats)
        *quality |= MOTORLENS_QUALITY_STUCK;
}

uint32_t motorlens_gate_inspect(const motorlens_gate *gate, motorlens_gate_state *state, int64_t period_ns,
                                motorlens_sample *sample, int64_t *dt_ns, int *used)
{
    const int64_t time_ns = sample->time_ns;
    uint32_t quality = sample->flags;
    const int finite = isfinite(sample->voltage_V) && isfinite(sample->current_A) &&
                       (!gate->needs_ambient || isfinite(sample->ambient_C));
    *used = finite && real_abs(sample->voltage_V) <= gate->absurd_V && real_abs(sample->current_A) <= gate->absurd_A;
    *dt_ns = 0;
    if (*used) {
        if (state->begun && time_ns < state->last_ns)
            return MOTORLENS_BACKWARDS;
        *dt_ns = state->begun ? time_ns - state->last_ns : gate->first_dt_ns;
        if (*dt_ns > gate->slowest_ns || *dt_ns < gate->fastest_ns)
            quality |= MOTORLENS_QUALITY_OUTSIDE_ENVELOPE;
        if (!(sample->voltage_V >= gate->least_V && sample->voltage_V <= gate->most_V &&
              sample->current_A >= gate->least_A && sample->current_A <= gate->most_A))
            quality |= MOTORLENS_QUALITY_OUTSIDE_ENVELOPE;
        /* L di/dt cannot exceed the supply and an equal back-EMF; half as much again and 2 % of the range for noise. */
        if (state->begun && *dt_ns > 0 &&
            real_abs(sample->current_A - state->current_A) > gate->slew_A_ns * real_of(*dt_ns) + gate->noise_A)
            quality |= MOTORLENS_QUALITY_JUMP;
        if (state->begun && *dt_ns > 3 * period_ns / 2) {
            const int64_t doubted_ns = *dt_ns < gate->warm_up_ns ? *dt_ns : gate->warm_up_ns;
            quality |= MOTORLENS_QUALITY_BRIDGED;
            if (time_ns + doubted_ns > state->bridged_until_ns)
                state->bridged_until_ns = time_ns + doubted_ns;
        }
        if (!state->begun)
            state->first_ns = time_ns;
    } else {
        quality |= MOTORLENS_QUALITY_BRIDGED;
        quality |= finite ? MOTORLENS_QUALITY_OUTSIDE_ENVELOPE : MOTORLENS_QUALITY_NOT_FINITE;
        sample->voltage_V = state->voltage_V;
        sample->current_A = state->current_A;
        sample->ambient_C = state->ambient_C;
    }
    if (time_ns < state->bridged_until_ns)
        quality |= MOTORLENS_QUALITY_BRIDGED;
    if (!(state->begun || *used)) {
        quality |= MOTORLENS_QUALITY_WARM_UP;
        if (gate->cold_ns && !state->remembered)
            quality |= MOTORLENS_QUALITY_ASSUMED_COLD;
    } else {
        if (time_ns - state->first_ns < gate->warm_up_ns)
            quality |= MOTORLENS_QUALITY_WARM_UP;
        if (!state->remembered && time_ns - state->first_ns < gate->cold_ns)
            quality |= MOTORLENS_QUALITY_ASSUMED_COLD;
    }
    judge_stuck(gate, state, sample->voltage_V, sample->current_A, &quality);
    if (*used) {
        state->begun = 1;
        state->last_ns = time_ns;
        state->voltage_V = sample->voltage_V;
        state->current_A = sample->current_A;
        state->ambient_C = sample->ambient_C;
    }
    state->count++;
    return quality;
}
