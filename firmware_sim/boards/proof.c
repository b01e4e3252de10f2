/* proof.c - the exported sensor on a board, and on the PC to compare with: the same samples, the same bits, and what they cost.
 *
 * Prints a line for each 50th sample with the quality word and the bits of estimates and deviations, then one with a hash over
 * all of them and the whole state; on a board also the instructions of a sample and of an evaluation,
 * and the memory that was used. Samples come from a counter in integers, so that they are the same everywhere.
 */
#include <math.h>
#include <string.h>

#include "sensor.h"

#ifdef BOARD
#include "board.h"
#else
#include <stdio.h>
static void board_print(const char *text) { fputs(text, stdout); }
static void board_print_hex(uint64_t value, int digits)
{
    while (digits--)
        putchar("0123456789abcdef"[value >> 4 * digits & 15u]);
}
#endif

#define SAMPLES 2000
#define EVALUATE_EVERY 10
#define PRINT_EVERY 50

static motorlens_state state;

static uint32_t random_bits(uint32_t *seed)
{
    *seed = *seed * 1664525u + 1013904223u;
    return *seed >> 16;
}

/* A voltage in steps with some noise, and the current of a motor that follows it slowly; a gap, a NaN and a repeated stamp. */
static motorlens_sample sample_of(int32_t k, uint32_t *seed, int32_t *speed)
{
    motorlens_sample sample;
    const int32_t level = (k / 400) % 3 * 4000 - 2000, noise = (int32_t)(random_bits(seed) % 101u) - 50;
    const int32_t voltage = level + noise, current = (voltage - *speed) / 8 + (int32_t)(random_bits(seed) % 11u) - 5;
    *speed += current / 8;
    sample.time_ns = (int64_t)k * 1000000 + (k >= 900 ? 250000000 : 0);
    sample.voltage_V = (motorlens_real)voltage / 16;
    sample.current_A = (motorlens_real)current / 32;
    sample.ambient_C = 20;
    sample.flags = 0;
    if (k == 700) {
        sample.current_A = (motorlens_real)NAN;
    }
    return sample;
}

static void mix(uint32_t *hash, const void *data, size_t size)
{
    const uint8_t *bytes = data;
    while (size--)
        *hash = (*hash ^ *bytes++) * 16777619u;
}

static void print_bits(const motorlens_real *values, int count)
{
    for (int k = 0; k < count; k++) {
        uint64_t bits = 0;
        memcpy(&bits, values + k, sizeof *values);
        board_print(" ");
        board_print_hex(bits, 16);
    }
}

int main(void)
{
    motorlens_real estimate[MOTORLENS_OUTPUTS], sigma[MOTORLENS_OUTPUTS];
    const int outputs = motor_sensor.network.outputs;
    uint32_t hash = 2166136261u, seed = 1;
    int32_t speed = 0;
#ifdef BOARD
    uint32_t updating = 0, evaluating = 0, most = 0, evaluations = 0;
    board_ticks_start();
    board_stack_mark();
#endif
    motorlens_start(&motor_sensor, &state, 1000000);
    for (int32_t k = 0; k < SAMPLES; k++) {
        motorlens_sample sample = sample_of(k, &seed, &speed);
        uint32_t quality;
#ifdef BOARD
        const uint32_t first = board_ticks();
        uint32_t taken;
        quality = motorlens_update(&motor_sensor, &state, &sample);
        taken = board_ticks_between(first, board_ticks());
        updating += taken;
        most = k > 0 && taken > most ? taken : most;
#else
        quality = motorlens_update(&motor_sensor, &state, &sample);
#endif
        mix(&hash, &quality, sizeof quality);
        if (k % EVALUATE_EVERY == 0) {
#ifdef BOARD
            const uint32_t start = board_ticks();
            quality = motorlens_evaluate(&motor_sensor, &state, &sample, quality, estimate, sigma);
            evaluating += board_ticks_between(start, board_ticks());
            evaluations++;
#else
            quality = motorlens_evaluate(&motor_sensor, &state, &sample, quality, estimate, sigma);
#endif
            mix(&hash, estimate, (size_t)outputs * sizeof *estimate);
            mix(&hash, sigma, (size_t)outputs * sizeof *sigma);
            if (k % PRINT_EVERY == 0) {
                board_print("row ");
                board_print_hex(quality, 8);
                print_bits(estimate, outputs);
                print_bits(sigma, outputs);
                board_print("\n");
            }
        }
    }
    mix(&hash, &state, sizeof state);
    board_print("hash ");
    board_print_hex(hash, 8);
    board_print("\n");
#ifdef BOARD
    board_print("update ");
    board_print_number(updating / (SAMPLES / BOARD_INSTRUCTIONS_PER_TICK));
    board_print("\nupdate_most ");
    board_print_number(most * BOARD_INSTRUCTIONS_PER_TICK);
    board_print("\nevaluate ");
    board_print_number(evaluating * BOARD_INSTRUCTIONS_PER_TICK / evaluations);
    board_print("\nstack ");
    board_print_number(board_stack_used());
    board_print("\nstate ");
    board_print_number(sizeof state);
    board_print("\n");
#endif
    return 0;
}
