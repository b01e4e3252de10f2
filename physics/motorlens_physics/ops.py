"""The functions that equations may use, for floats, arrays, symbols and quantities alike.

Physics is written once: the same method is evaluated on numbers, on batches, on SymPy symbols (to print and to
compile it) and, in tests, on quantities with units. Only the functions differ, and these choose by argument.
"""

import math
import sys
from typing import Any

import numpy as np


def tanh(z: Any) -> Any:
    """Hyperbolic tangent, the smooth sign."""
    return _apply("tanh", z)


def exp(z: Any) -> Any:
    """Exponential."""
    return _apply("exp", z)


def sqrt(z: Any) -> Any:
    """Square root."""
    return _apply("sqrt", z)


def sin(z: Any) -> Any:
    """Sine."""
    return _apply("sin", z)


def cos(z: Any) -> Any:
    """Cosine."""
    return _apply("cos", z)


def magnitude(z: Any, rounding: Any) -> Any:
    """|z| rounded off within `rounding` of zero, exactly zero there: sqrt(z^2 + r^2) - r, with a derivative everywhere."""
    return sqrt(z * z + rounding * rounding) - rounding


# Share of its knee within which a saturating term is smooth whatever its sharpness.
KNEE_ROUNDING = 1e-3


def saturated(z: Any, knee: Any, sharpness: Any) -> Any:
    """A smooth sign of z that has built up at `knee`: z / (|z|^s + knee^s)^(1/s), the larger s the sharper.

    >>> [round(saturated(3.0, 4.0, s), 4) for s in (1.0, 2.0)]
    [0.4286, 0.6]
    """
    size = sqrt(z * z + (KNEE_ROUNDING * knee) ** 2)
    return z / knee / ((size / knee) ** sharpness + 1) ** (1 / sharpness)


# Speed within which |w| is rounded off, rad/s: far below any speed at which a fan blows or iron is remagnetised.
SPEED_ROUNDING = 1e-3


def turning(w: Any) -> Any:
    """|w|, rounded off within 1e-3 rad/s of rest so that it has a derivative there."""
    return magnitude(w, SPEED_ROUNDING * unit(w))


def kelvin(celsius: Any) -> Any:
    """Absolute temperature in K of a temperature in degC."""
    return celsius + 273.15 * unit(celsius)


def unit(z: Any) -> Any:
    """The unit of a quantity, for a constant that is added to it; 1 for numbers and symbols."""
    return getattr(z, "units", 1)


def _apply(name: str, z: Any) -> Any:
    if hasattr(z, "free_symbols"):
        return getattr(sys.modules["sympy"], name)(z)
    return getattr(math if isinstance(z, float | int) else np, name)(z)
