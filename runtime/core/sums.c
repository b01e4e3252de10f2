/* Sums of products in whole numbers, three side by side: as many as a core has registers for. In a file of its own, so that the
 * compiler gives them all registers. */
#include "arithmetic.h"

#if MOTORLENS_SINGLE

/* sums[m] = weights[m * count + j] * columns[j], added up over j < count, at least one; for the first `wanted` of three. */
#define DEFINE_SUMS(name, kind)                                                                      \
    void name(const kind *weights, const int32_t *columns, int count, int64_t *sums, int wanted)     \
    {                                                                                                \
        const kind *p = weights, *q = wanted > 1 ? p + count : p, *r = wanted > 2 ? q + count : q;   \
        const int32_t *const end = columns + count;                                                  \
        int64_t a = 0, b = 0, c = 0;                                                                 \
        do {                                                                                         \
            const int64_t x = *columns++;                                                            \
            a += x * *p++;                                                                           \
            b += x * *q++;                                                                           \
            c += x * *r++;                                                                           \
        } while (columns < end);                                                                     \
        sums[0] = a, sums[1] = b, sums[2] = c;                                                       \
    }
DEFINE_SUMS(motorlens_narrow_sums, int16_t)
DEFINE_SUMS(motorlens_wide_sums, int32_t)

#endif
