/* golden_test.c - do the golden values come out? Prints the worst error as a share of each output's scale, of the
 * estimates and of their deviations, and ends with 0 if both are within the tolerance.
 *
 *     cc -std=c99 -O2 -ffp-contract=off -o golden_test golden_test.c sensor.c arithmetic.c bank.c estimate.c features.c \
 *         gate.c network.c observer.c -lm
 */
#include <math.h>
#include <stdio.h>

#include "golden.h"
#include "sensor.h"

int main(void)
{
    motorlens_real estimate[GOLDEN_OUTPUTS], sigma[GOLDEN_OUTPUTS];
    double worst[2] = {0.0, 0.0};
    motorlens_state state;
    motorlens_start(&SENSOR, &state, 1000000);
    for (int row = 0; row < GOLDEN_ROWS; row++) {
        motorlens_sample sample = {golden_time_ns[row], (motorlens_real)golden_voltage_V[row],
                                   (motorlens_real)golden_current_A[row], (motorlens_real)golden_ambient_C[row], 0};
        const uint32_t quality = motorlens_update(&SENSOR, &state, &sample);
        motorlens_evaluate(&SENSOR, &state, &sample, quality, estimate, sigma);
        for (int k = 0; k < GOLDEN_OUTPUTS; k++) {
            const int at = row * GOLDEN_OUTPUTS + k;
            const double apart = fabs((double)estimate[k] - golden_estimate[at]) / golden_scale[k];
            const double wider = fabs((double)sigma[k] - golden_sigma[at]) / golden_scale[k];
            if (!(apart <= worst[0]))
                worst[0] = apart;
            if (!(wider <= worst[1]))
                worst[1] = wider;
        }
    }
    printf("%.3g %.3g of scale, tolerance %.3g\n", worst[0], worst[1], GOLDEN_TOLERANCE);
    return !(worst[0] <= GOLDEN_TOLERANCE && worst[1] <= GOLDEN_TOLERANCE);
}
