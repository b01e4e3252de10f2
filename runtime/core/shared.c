/* What only the PC's shared object has: sizes, by which Python checks its own idea of the structs, and the network alone. */
#include "motorlens.h"
#include "link.h"
#include "stream.h"

size_t motorlens_size(int what);
void motorlens_evaluate_features(const motorlens_sensor *sensor, int64_t n, const double *features, double *estimate,
                                 double *sigma);

size_t motorlens_size(int what)
{
    switch (what) {
    case 0: return sizeof(motorlens_sensor);
    case 1: return sizeof(motorlens_state);
    case 2: return sizeof(motorlens_step);
    case 3: return sizeof(motorlens_operation);
    case 4: return sizeof(motorlens_program);
    case 5: return sizeof(motorlens_block);
    case 6: return sizeof(motorlens_link);
    case 7: return sizeof(motorlens_frame);
    case 8: return sizeof(motorlens_samples);
    default: return sizeof(motorlens_stream);
    }
}

/* Estimates and deviations (outputs, n) of features (n, features). */
void motorlens_evaluate_features(const motorlens_sensor *sensor, int64_t n, const double *features, double *estimate,
                                 double *sigma)
{
    const int64_t width = sensor->features.features;
    for (int64_t first = 0; first < n; first += MOTORLENS_LANES) {
        const int rows = n - first < MOTORLENS_LANES ? (int)(n - first) : MOTORLENS_LANES;
        motorlens_lanes columns[MOTORLENS_FEATURES];
        uint32_t quality[MOTORLENS_LANES] = {0};
        for (int64_t k = 0; k < width; k++)
            for (int lane = 0; lane < MOTORLENS_LANES; lane++)
                columns[k][lane] = features[(first + (lane < rows ? lane : 0)) * width + k];
        motorlens_evaluate_rows(sensor, (const motorlens_lanes *)columns, rows, n, estimate + first, sigma + first, quality);
    }
}
