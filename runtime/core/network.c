/* The folded core graph: for each step some sums of products over the columns so far, and a function. As `backend.NumpyBackend`. */
#include <math.h>

#include "arithmetic.h"

#if !MOTORLENS_SINGLE

/* Sums of products in the order of the columns, each row of the batch for itself. */
static const motorlens_lanes *value_of(const motorlens_argument *argument, int width, const motorlens_lanes *columns,
                                       motorlens_lanes *room)
{
    const motorlens_real *weights = argument->weights;
    const int count = argument->columns;
    columns += argument->start;
    if (weights == NULL)
        return columns;
    for (int k = 0; k < width; k += MOTORLENS_SUMS) {
        const motorlens_real *of[MOTORLENS_SUMS];
        for (int m = 0; m < MOTORLENS_SUMS; m++)
            of[m] = weights + (k + m < width ? k + m : width - 1) * count;
        sums_of(of, columns, count, room + k, width - k);
    }
    return (const motorlens_lanes *)room;
}

/* tanh of `count` numbers: 1 - 2 / (exp(2 |x|) + 1) with the sign of x, exact to the last place of one, which is all that a sum of
 * units sees; from 20 on it is one, of NaN it is NaN. In loops without a branch, which a compiler turns into vector
 * instructions. */
static void all_tanh(const motorlens_real *x, int count, motorlens_real *out)
{
    for (int k = 0; k < count; k++) {
        const motorlens_real size = real_abs(x[k]);
        out[k] = size < 20 ? size : 20;
    }
    for (int k = 0; k < count; k++) {
        const motorlens_real e = exp_between(2 * out[k]);
        out[k] = real_with_sign(1 - 2 / (e + 1), x[k]);
    }
    for (int k = 0; k < count; k++)
        out[k] = x[k] != x[k] ? x[k] : out[k];
}

#if MOTORLENS_LANES > 1
/* `real_exp` of `count` numbers, likewise: what is beyond its range is set afterwards. */
static void all_exp(const motorlens_real *x, int count, motorlens_real *out)
{
    for (int k = 0; k < count; k++) {
        const motorlens_real low = x[k] > -708.0 ? x[k] : -708.0;
        out[k] = low < 709.0 ? low : 709.0;
    }
    for (int k = 0; k < count; k++)
        out[k] = exp_between(out[k]);
    for (int k = 0; k < count; k++)
        if (!(x[k] >= -708.0 && x[k] <= 709.0))
            out[k] = real_exp(x[k]);
}
#endif

/* A sensor that has no logarithm brings none: which functions there are is known when it is compiled. */
#define HAS(function) ((MOTORLENS_FUNCTIONS >> (function)) & 1u)

static motorlens_real of_one(uint8_t function, motorlens_real x)
{
    switch (function) {
    case MOTORLENS_EXP: return real_exp(x);
    case MOTORLENS_SQRT: return real_sqrt(x);
    case MOTORLENS_SIGMOID: return 1 / (1 + real_exp(-x));
    case MOTORLENS_RELU: return x < 0 ? 0 : x;
    case MOTORLENS_SOFTPLUS:
        return HAS(MOTORLENS_SOFTPLUS)
                   ? (x > 0 ? x : 0) + (motorlens_real)motorlens_log(1.0 + (double)real_exp(x > 0 ? -x : x))
                   : 0;
    case MOTORLENS_LOG: return HAS(MOTORLENS_LOG) ? (motorlens_real)motorlens_log((double)x) : 0;
    case MOTORLENS_ABS: return real_abs(x);
    default: return 1 / x; /* MOTORLENS_RECIPROCAL */
    }
}

static motorlens_real of_two(uint8_t function, motorlens_real x, motorlens_real y)
{
    switch (function) {
    case MOTORLENS_MUL: return x * y;
    case MOTORLENS_DIV: return x / y;
    case MOTORLENS_MAX: return x < y || y != y ? y : x;
    default: return y < x || y != y ? y : x; /* MOTORLENS_MIN */
    }
}

void motorlens_network_evaluate(const motorlens_network *network, int features, motorlens_lanes *columns,
                                motorlens_lanes *estimate, motorlens_lanes *sigma)
{
    motorlens_lanes room[2][MOTORLENS_WIDTH];
    motorlens_lanes *next = columns + features;
    const motorlens_lanes *value;
    for (int lane = 0; lane < MOTORLENS_LANES; lane++)
        (*next)[lane] = 1;
    next++;
    for (int s = 0; s < network->count; s++) {
        const motorlens_step *step = network->steps + s;
        const int width = step->width, count = width * MOTORLENS_LANES;
        const motorlens_lanes *first = value_of(&step->argument[0], width, (const motorlens_lanes *)columns, room[0]);
        const motorlens_real *x = *first, *y = x;
        motorlens_real *out = *next;
        if (step->arguments == 2)
            y = *value_of(&step->argument[1], width, (const motorlens_lanes *)columns, room[1]);
        if (step->function == MOTORLENS_TANH) { /* some apart, so that they are computed side by side */
            all_tanh(x, count, out);
#if MOTORLENS_LANES > 1
        } else if (step->function == MOTORLENS_EXP) {
            all_exp(x, count, out);
#endif
        } else if (step->function == MOTORLENS_MUL) {
            for (int k = 0; k < count; k++)
                out[k] = x[k] * y[k];
        } else if (step->function == MOTORLENS_CLIP) {
            for (int k = 0; k < count; k++)
                out[k] = x[k] < step->low ? step->low : x[k] > step->high ? step->high : x[k];
        } else if (step->arguments == 1) {
            for (int k = 0; k < count; k++)
                out[k] = of_one(step->function, x[k]);
        } else {
            for (int k = 0; k < count; k++)
                out[k] = of_two(step->function, x[k], y[k]);
        }
        next += width;
    }
    value = value_of(&network->estimate, network->outputs, (const motorlens_lanes *)columns, room[0]);
    for (int k = 0; k < network->outputs; k++)
        for (int lane = 0; lane < MOTORLENS_LANES; lane++)
            estimate[k][lane] = value[k][lane] + network->offset[k];
    value = value_of(&network->sigma, network->outputs, (const motorlens_lanes *)columns, room[0]);
    for (int k = 0; k < network->outputs; k++)
        for (int lane = 0; lane < MOTORLENS_LANES; lane++)
            sigma[k][lane] = value[k][lane];
}

#endif
