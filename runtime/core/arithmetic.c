/* exp and log, of IEEE operations alone. */
#include "arithmetic.h"

double motorlens_decay(double x)
{
    /* What has decayed further is nothing. */
    return x < -708.0 ? 0.0 : exp_between(x);
}

double motorlens_exp(double x)
{
    if (!(x >= -708.0))
        return x != x ? x : 0.0;
    return x > 709.0 ? (double)INFINITY : exp_between(x);
}

double motorlens_log(double x)
{
    /* x = 2^k m with m within a factor of sqrt(2) of one; log m = 2 artanh s, s = (m - 1) / (m + 1), |s| < 0.172. */
    static const double series[] = {1.0 / 19.0, 1.0 / 17.0, 1.0 / 15.0, 1.0 / 13.0, 1.0 / 11.0,
                                    1.0 / 9.0, 1.0 / 7.0, 1.0 / 5.0, 1.0 / 3.0};
    uint64_t bits;
    int32_t k = 0;
    double m, s, square, p;
    if (!(x > 0.0))
        return x == 0.0 ? -(double)INFINITY : (double)NAN;
    if (!isfinite(x))
        return x;
    if (x < 2.2250738585072014e-308) {
        x *= 18014398509481984.0; /* 2^54: a subnormal number becomes a normal one */
        k = -54;
    }
    memcpy(&bits, &x, sizeof bits);
    k += (int32_t)(bits >> 52) - 1023;
    bits = (bits & 0x000FFFFFFFFFFFFFu) | 0x3FF0000000000000u;
    memcpy(&m, &bits, sizeof m);
    if (m > 1.4142135623730951) {
        m *= 0.5;
        k++;
    }
    s = (m - 1.0) / (m + 1.0);
    square = s * s;
    p = 1.0 / 21.0;
    for (unsigned term = 0; term < sizeof series / sizeof *series; term++)
        p = p * square + series[term];
    return (double)k * 6.93147180369123816490e-01 + (2.0 * s + (2.0 * s * square * p + (double)k * 1.90821492927058770002e-10));
}

#if MOTORLENS_SINGLE

/* exp of -87 to 88 in single precision, as `exp_between`: to the 7th power, what is left is below 6e-9 of it. */
float motorlens_expf_between(float x)
{
    const float turns = x * 1.44269504f;
    const int32_t k = (int32_t)(turns + (turns < 0.0f ? -0.5f : 0.5f));
    const float r = (x - (float)k * 0.693145752f) - (float)k * 1.42860677e-06f;
    float p = 1.0f / 5040.0f;
    p = p * r + 1.0f / 720.0f;
    p = p * r + 1.0f / 120.0f;
    p = p * r + 1.0f / 24.0f;
    p = p * r + 1.0f / 6.0f;
    p = p * r + 0.5f;
    p = p * r + 1.0f;
    p = p * r + 1.0f;
    return p * float_two_to(k);
}

#endif
