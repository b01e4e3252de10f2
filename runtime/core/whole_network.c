/* The folded core graph in single precision: sums of products in whole numbers, functions in float. As `backend.NumpyBackend`.
 *
 * What is bounded (the features' place among those trained on, a one, the outputs of tanh and sigmoid) is kept in whole numbers
 * of 32 bits and added up in 64, where nothing is rounded: a sum of 44 products in float would lose two digits more, and a core
 * multiplies and adds whole numbers in one instruction, with a floating-point unit or without. What is not bounded is float.
 */
#include "arithmetic.h"

#if MOTORLENS_SINGLE

#define BOUNDED 134217728 /* 2^27 is one; `whole_tables.BOUNDED` */
#define HAS(function) ((MOTORLENS_FUNCTIONS >> (function)) & 1u)

/* What an argument gives: `width` numbers, in `room` or where they stand. */
static const float *value_of(const motorlens_argument *argument, int width, const int32_t *wholes, const float *reals, float *room)
{
    const int count = argument->columns;
    const float *weight = argument->real_weights;
    reals += argument->real_start;
    wholes += argument->start;
    if (count == 0 && weight == NULL)
        return reals;
    for (int k = 0; count > 0 && k < width; k += MOTORLENS_SUMS) {
        const int wanted = width - k < MOTORLENS_SUMS ? width - k : MOTORLENS_SUMS;
        int64_t sums[MOTORLENS_SUMS];
        if (argument->narrow)
            motorlens_narrow_sums((const int16_t *)argument->weights + k * count, wholes, count, sums, wanted);
        else
            motorlens_wide_sums((const int32_t *)argument->weights + k * count, wholes, count, sums, wanted);
        for (int m = 0; m < wanted; m++)
            room[k + m] = real_of(sums[m]) * float_two_to(argument->units[k + m]);
    }
    for (int k = 0; weight != NULL && k < width; k++) {
        float sum = count > 0 ? room[k] : 0.0f;
        for (int j = 0; j < argument->reals; j++)
            sum += *weight++ * reals[j];
        room[k] = sum;
    }
    return room;
}

/* tanh: 1 - 2 / (exp(2 |x|) + 1) with the sign of x; from 20 on it is one. */
static int32_t whole_tanh(float x)
{
    const float size = fabsf(x), e = motorlens_expf_between(2 * (size < 20.0f ? size : 20.0f));
    const int32_t result = BOUNDED - (int32_t)((2.0f * (float)BOUNDED) / (e + 1));
    return x < 0 ? -result : result;
}

/* A sensor that has no logarithm brings none: which functions there are is known when it is compiled. */
static float applied(const motorlens_step *step, float x, float y)
{
    const uint8_t function = step->function;
    if (HAS(MOTORLENS_MUL) && function == MOTORLENS_MUL)
        return x * y;
    if (HAS(MOTORLENS_EXP) && function == MOTORLENS_EXP)
        return real_exp(x);
    if (HAS(MOTORLENS_SQRT) && function == MOTORLENS_SQRT)
        return real_sqrt(x);
    if (HAS(MOTORLENS_CLIP) && function == MOTORLENS_CLIP)
        return x < step->low ? step->low : x > step->high ? step->high : x;
    if (HAS(MOTORLENS_RELU) && function == MOTORLENS_RELU)
        return x < 0 ? 0 : x;
    if (HAS(MOTORLENS_SOFTPLUS) && function == MOTORLENS_SOFTPLUS)
        return (x > 0 ? x : 0) + (float)motorlens_log(1.0 + (double)real_exp(x > 0 ? -x : x));
    if (HAS(MOTORLENS_LOG) && function == MOTORLENS_LOG)
        return (float)motorlens_log((double)x);
    if (HAS(MOTORLENS_DIV) && function == MOTORLENS_DIV)
        return x / y;
    if (HAS(MOTORLENS_ABS) && function == MOTORLENS_ABS)
        return real_abs(x);
    if (HAS(MOTORLENS_RECIPROCAL) && function == MOTORLENS_RECIPROCAL)
        return 1 / x;
    if (HAS(MOTORLENS_MAX) && function == MOTORLENS_MAX)
        return x < y || y != y ? y : x;
    if (HAS(MOTORLENS_MIN) && function == MOTORLENS_MIN)
        return y < x || y != y ? y : x;
    return x; /* there are no others */
}

void motorlens_network_evaluate(const motorlens_sensor *sensor, int32_t *wholes, float *reals, float *estimate, float *sigma)
{
    const motorlens_network *network = &sensor->network;
    const int features = sensor->features.features, width = network->outputs;
    int32_t *whole = wholes + (MOTORLENS_WHITENED ? features : 0);
    float *real = reals + (MOTORLENS_WHITENED ? 0 : features);
    float room[2][MOTORLENS_WIDTH];
    const float *values;
    *whole++ = BOUNDED; /* the one */
    for (int s = 0; s < network->count; s++) {
        const motorlens_step *step = network->steps + s;
        const float *x = value_of(step->argument[0], step->width, wholes, reals, room[0]), *y = x;
        if (step->argument[1] != step->argument[0])
            y = value_of(step->argument[1], step->width, wholes, reals, room[1]);
        for (int k = 0; k < step->width; k++) {
            if (HAS(MOTORLENS_TANH) && step->function == MOTORLENS_TANH)
                *whole++ = whole_tanh(x[k]);
            else if (HAS(MOTORLENS_SIGMOID) && step->function == MOTORLENS_SIGMOID)
                *whole++ = (int32_t)((float)BOUNDED / (1 + real_exp(-x[k])));
            else
                *real++ = applied(step, x[k], y[k]);
        }
    }
    values = value_of(network->estimate, width, wholes, reals, room[0]);
    for (int k = 0; k < width; k++)
        estimate[k] = values[k];
    values = value_of(network->sigma, width, wholes, reals, room[0]);
    for (int k = 0; k < width; k++)
        sigma[k] = values[k];
}

#endif
