/* main.c - an example. Lines of time in s, voltage in V, current in A (and ambient temperature in degC, where the sensor
 * needs it) in; estimate, deviation and quality word out. In a drive, what stands in the loop stands in the interrupt of the
 * current controller: `update` at every sample, `evaluate` where an estimate is wanted.
 */
#include <math.h>
#include <stdio.h>

#include "sensor.h"

int main(void)
{
    motorlens_state state;
    motorlens_sample sample = {0, 0, 0, (motorlens_real)NAN, 0};
    double time_s, voltage_V, current_A, ambient_C;
    motorlens_start(&SENSOR, &state, 1000000); /* a sample each millisecond */
    while (scanf("%lf,%lf,%lf", &time_s, &voltage_V, &current_A) == 3) {
        motorlens_real estimate[MOTORLENS_OUTPUTS], sigma[MOTORLENS_OUTPUTS];
        uint32_t quality;
        if (SENSOR.gate.needs_ambient) {
            if (scanf(",%lf", &ambient_C) != 1)
                return 1;
            sample.ambient_C = (motorlens_real)ambient_C;
        }
        sample.voltage_V = (motorlens_real)voltage_V;
        sample.current_A = (motorlens_real)current_A;
        sample.time_ns = (int64_t)floor(time_s * 1e9 + 0.5);
        sample.flags = 0;
        quality = motorlens_update(&SENSOR, &state, &sample);
        if (quality == MOTORLENS_BACKWARDS)
            return 1;
        quality = motorlens_evaluate(&SENSOR, &state, &sample, quality, estimate, sigma);
        printf("%.9g", time_s);
        for (int k = 0; k < SENSOR.network.outputs; k++)
            printf(",%.9g,%.9g", (double)estimate[k], (double)sigma[k]);
        printf(",%lu\n", (unsigned long)quality);
    }
    return 0;
}
