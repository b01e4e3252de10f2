/* What only the PC's shared object has: sizes, by which Python checks its own idea of the structs, and the network alone. */
#include "motorlens.h"
#include "link.h"

/* The arrays of `motorlens_push`. */
typedef struct {
    const int64_t *time_ns;
    const double *voltage_V, *current_A, *ambient_C;
    const uint32_t *flags;
    const int64_t *rows;
    double *estimate, *sigma;
    uint32_t *quality;
    double *features;
} motorlens_block;

size_t motorlens_size(int what);
int64_t motorlens_push_block(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_block *block, int64_t n,
                             int64_t m);
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
    default: return sizeof(motorlens_samples);
    }
}

int64_t motorlens_push_block(const motorlens_sensor *sensor, motorlens_state *state, const motorlens_block *block, int64_t n,
                             int64_t m)
{
    return motorlens_push(sensor, state, n, block->time_ns, block->voltage_V, block->current_A, block->ambient_C,
                          block->flags, m, block->rows, block->estimate, block->sigma, block->quality, block->features);
}

/* Estimates and deviations (n, outputs) of features (n, features). */
void motorlens_evaluate_features(const motorlens_sensor *sensor, int64_t n, const double *features, double *estimate,
                                 double *sigma)
{
    const int64_t width = sensor->features.features, outputs = sensor->network.outputs;
    uint32_t quality[MOTORLENS_LANES];
    motorlens_batch batch;
    motorlens_batch_start(&batch);
    for (int64_t k = 0, done = 0; k < n; k++) {
        if (motorlens_batch_add(sensor, &batch, features + k * width, 0) || k == n - 1) {
            motorlens_batch_finish(sensor, &batch, estimate + done * outputs, sigma + done * outputs, quality);
            done = k + 1;
        }
    }
}
