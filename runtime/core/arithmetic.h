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

/* The same in single precision. */
static inline float float_two_to(int32_t k)
{
    const uint32_t bits = (uint32_t)(127 + k) << 23;
    float result;
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
#if MOTORLENS_LANES > 1
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
#else /* in a quarter of the room */
    static const double series[] = {1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0, 1.0 / 40320.0,
                                    1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0};
    double p = 1.0 / 6227020800.0;
    for (unsigned term = 0; term < sizeof series / sizeof *series; term++)
        p = p * r + series[term];
#endif
    return p * two_to(k);
}

#if MOTORLENS_LANES > 1
/* Eight numbers that are computed with at once: an extension of gcc and clang, which a PC has. */
#define MOTORLENS_VECTOR_LANES 8
typedef motorlens_real motorlens_vector __attribute__((vector_size(MOTORLENS_VECTOR_LANES * sizeof(motorlens_real))));
#endif

static inline motorlens_real real_exp(motorlens_real x)
{
#if MOTORLENS_SINGLE
    if (!(x > -87))
        return x != x ? x : 0;
    return x > 88 ? (float)INFINITY : motorlens_expf_between(x);
#else
    return motorlens_exp(x);
#endif
}

/* So many sums are added up side by side: a processor need not wait for one to go on, and reads each column once for all. Of
 * whole numbers in 64 bits, a microcontroller has registers for three. */
#define MOTORLENS_SUMS (MOTORLENS_SINGLE ? 3 : 4)

/* sums[m] = weights[m][j] * columns[j], added up over j < count, at least one, in this order; for the first `wanted` of
 * MOTORLENS_SUMS sums. */
static inline void sums_of(const motorlens_real *const *weights, const motorlens_lanes *columns, int count,
                           motorlens_lanes *sums, int wanted)
{
    const motorlens_real *p = weights[0], *q = weights[1], *r = weights[2], *s = weights[3];
#if MOTORLENS_LANES > 1
    for (int lane = 0; lane < MOTORLENS_LANES; lane += MOTORLENS_VECTOR_LANES) {
        motorlens_vector sum[MOTORLENS_SUMS], x;
        motorlens_vector a = {0}, b = {0}, c = {0}, d = {0}; /* each by a name of its own, so that it stays in a register */
        for (int j = 0; j < count; j++) {
            memcpy(&x, columns[j] + lane, sizeof x);
            a += p[j] * x;
            b += q[j] * x;
            c += r[j] * x;
            d += s[j] * x;
        }
        sum[0] = a, sum[1] = b, sum[2] = c, sum[3] = d;
        for (int m = 0; m < MOTORLENS_SUMS && m < wanted; m++)
            memcpy(sums[m] + lane, sum + m, sizeof x);
    }
#else
    motorlens_real a = 0, b = 0, c = 0, d = 0;
    const motorlens_real *x = *columns, *const end = x + count;
    do { /* there is one at least */
        a += *p++ * *x;
        b += *q++ * *x;
        c += *r++ * *x;
        d += *s++ * *x;
    } while (++x < end);
    sums[0][0] = a;
    if (wanted > 1)
        sums[1][0] = b;
    if (wanted > 2)
        sums[2][0] = c;
    if (wanted > 3)
        sums[3][0] = d;
#endif
}

/* A whole number, rounded: without the library's conversion, which computes in double where there is none. */
static inline motorlens_real real_of(int64_t x)
{
    return MOTORLENS_SINGLE ? (motorlens_real)(int32_t)(x >> 32) * 4294967296 + (motorlens_real)(uint32_t)x : (motorlens_real)x;
}

static inline motorlens_real real_abs(motorlens_real x)
{
    return MOTORLENS_SINGLE ? (motorlens_real)fabsf((float)x) : (motorlens_real)fabs((double)x);
}

static inline motorlens_real real_with_sign(motorlens_real size, motorlens_real of)
{
    return MOTORLENS_SINGLE ? (motorlens_real)copysignf((float)size, (float)of)
                            : (motorlens_real)copysign((double)size, (double)of);
}

static inline motorlens_real real_sqrt(motorlens_real x)
{
    return MOTORLENS_SINGLE ? (motorlens_real)sqrtf((float)x) : (motorlens_real)sqrt((double)x);
}

#endif
