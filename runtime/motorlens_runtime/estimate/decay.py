"""exp of what is not positive, of IEEE operations alone: the same bits from numpy, from the C core and on a microcontroller.

Libraries differ in the last bit of exp (numpy's own differs from libm's in one of twenty), and a filter carries that bit on.
"""

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_TURNS, _LN2_HIGH, _LN2_LOW = 1.4426950408889634, 6.93147180369123816490e-01, 1.90821492927058770002e-10
# The Taylor series to the 13th power; for |r| <= ln 2 / 2 what is left is below 5e-18 of the value.
_SERIES = tuple(1.0 / math.factorial(k) for k in range(12, -1, -1))
_NOTHING = -708.0


def decay(x: Array) -> Array:
    """exp(x) of x <= 0, any shape; 0 below -708. `exp_between` of the C core has the same operations in the same order.

    x = k ln 2 + r with |r| <= ln 2 / 2; the series of r, and k into the exponent.
    """
    bounded = np.maximum(x, _NOTHING)
    k = np.trunc(bounded * _TURNS - 0.5)
    r = (bounded - k * _LN2_HIGH) - k * _LN2_LOW
    p = np.full_like(r, 1.0 / math.factorial(13))
    for term in _SERIES:
        p *= r
        p += term
    result: Array = np.where(x < _NOTHING, 0.0, np.ldexp(p, k.astype(np.int32)))
    return result
