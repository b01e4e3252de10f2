/* Functions of the network, of IEEE operations alone: the same bits on every machine, and no library that a
 * microcontroller's differs from. */
#ifndef MOTORLENS_ARITHMETIC_H
#define MOTORLENS_ARITHMETIC_H

#include <math.h>
#include <string.h>

#include "motorlens.h"

/* Two to the power k, a normal number. */
static inline double two_to(int32_t k)
{
    const uint64_t bits = (uint64_t)(1023 + k) << 52;
    double result;
    memcpy(&result, &bits, sizeof result);
    return result;
}

/* exp of -708 to 709: x = k ln 2 + r with |r| <= ln 2 / 2, the Taylor series of r to the 13th power (what is left is below
 * 5e-18 of it), and k into the exponent. `decay.py` has the same operations. */
static inline double exp_between(double x)
{
    const double turns = x * 1.4426950408889634;
    const int32_t k = (int32_t)(turns + (turns < 0.0 ? -0.5 : 0.5));
    const double r = (x - (double)k * 6.93147180369123816490e-01) - (double)k * 1.90821492927058770002e-10;
    double p = 1.0 / 6227020800.0;
    p = p * r + 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    return p * two_to(k);
}

/* The same in single precision, for -87 to 88: to the 7th power, what is left is below 6e-9 of it. */
static inline float expf_between(float x)
{
    const float turns = x * 1.44269504f;
    const int32_t k = (int32_t)(turns + (turns < 0.0f ? -0.5f : 0.5f));
    const float r = (x - (float)k * 0.693145752f) - (float)k * 1.42860677e-06f;
    const uint32_t bits = (uint32_t)(127 + k) << 23;
    float scale, p = 1.0f / 5040.0f;
    p = p * r + 1.0f / 720.0f;
    p = p * r + 1.0f / 120.0f;
    p = p * r + 1.0f / 24.0f;
    p = p * r + 1.0f / 6.0f;
    p = p * r + 0.5f;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

#define MOTORLENS_SINGLE (sizeof(motorlens_real) == sizeof(float))

static inline motorlens_real real_exp(motorlens_real x)
{
    if (MOTORLENS_SINGLE) {
        if (!(x > -87))
            return x != x ? x : 0;
        return x > 88 ? (motorlens_real)INFINITY : (motorlens_real)expf_between((float)x);
    }
    return (motorlens_real)motorlens_exp((double)x);
}

/* 1 - 2 / (exp(2 |x|) + 1) with the sign of x: exact to the last place of one, which is all that a sum of units sees. From 20
 * on it is one; of NaN it is NaN. Without a branch, so that a compiler computes many side by side. */
static inline motorlens_real real_tanh(motorlens_real x)
{
    const motorlens_real size = x < 0 ? -x : x, near = size < 20 ? size : 20;
    const motorlens_real e =
        MOTORLENS_SINGLE ? (motorlens_real)expf_between((float)(2 * near)) : (motorlens_real)exp_between(2 * (double)near);
    const motorlens_real result = 1 - 2 / (e + 1);
    return x != x ? x : x < 0 ? -result : result;
}

static inline motorlens_real real_sqrt(motorlens_real x)
{
    return MOTORLENS_SINGLE ? (motorlens_real)sqrtf((float)x) : (motorlens_real)sqrt((double)x);
}

#endif
