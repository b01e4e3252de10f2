/* drive.c - a drive with the sensor on board: converter codes come in over one serial line, frames with what was measured and
 * what the sensor makes of it go out over the other.
 *
 * "drive.h" is written for one sensor and one bench: DRIVE_HELLO, the text of HELLO; DRIVE_PERIOD_US; DRIVE_VOLTAGE_STEP and
 * DRIVE_CURRENT_STEP, the worth of a code. A sample is two int16, low byte first. A frame holds ROWS samples as float32: voltage,
 * current, then the estimates, which are made once a frame. The drive works with the numbers that it sends.
 */
#include <string.h>

#include "board.h"
#include "drive.h"
#include "motorlens_frame.h"
#include "sensor.h"

#define ROWS 8
#define HELLO_EVERY 128 /* frames */
#define CHANNELS (2 + MOTORLENS_OUTPUTS)

static motorlens_state state;
static motorlens_sender sender;
static uint8_t wire[MOTORLENS_WIRE_MAX];

static void send(size_t size)
{
    for (size_t k = 0; k < size; k++)
        board_put(wire[k]);
}

static void greet(uint32_t now_us)
{
    static const char hello[] = DRIVE_HELLO;
    size_t size;
    for (uint8_t piece = 0; (size = motorlens_hello(&sender, wire, now_us, hello, sizeof hello - 1, piece)) != 0; piece++)
        send(size);
}

static int16_t next_code(void)
{
    int low, high;
    while ((low = board_get_input()) < 0)
        ;
    while ((high = board_get_input()) < 0)
        ;
    return (int16_t)(uint16_t)(low | high << 8);
}

int main(void)
{
    motorlens_real estimate[MOTORLENS_OUTPUTS] = {0}, sigma[MOTORLENS_OUTPUTS];
    float values[ROWS * CHANNELS];
    uint32_t count = 0;
    motorlens_start(&motor_sensor, &state, (int64_t)DRIVE_PERIOD_US * 1000);
    for (uint32_t frame = 0;; frame++) {
        const uint32_t t0_us = count * DRIVE_PERIOD_US;
        if (frame % HELLO_EVERY == 0)
            greet(t0_us);
        for (int row = 0; row < ROWS; row++, count++) {
            float *out = values + row * CHANNELS;
            motorlens_sample sample;
            uint32_t quality;
            out[0] = (float)(next_code() * DRIVE_VOLTAGE_STEP);
            out[1] = (float)(next_code() * DRIVE_CURRENT_STEP);
            sample.time_ns = (int64_t)count * DRIVE_PERIOD_US * 1000;
            sample.voltage_V = out[0];
            sample.current_A = out[1];
            sample.ambient_C = 20;
            sample.flags = 0;
            quality = motorlens_update(&motor_sensor, &state, &sample);
            if (row == 0)
                motorlens_evaluate(&motor_sensor, &state, &sample, quality, estimate, sigma);
            for (int k = 0; k < MOTORLENS_OUTPUTS; k++)
                out[2 + k] = (float)estimate[k];
        }
        send(motorlens_samples_f32(&sender, wire, 1, t0_us, 0, values, ROWS, CHANNELS));
    }
}
