"""The functions that equations may use, for floats, arrays, symbols and quantities alike.

Physics is written once: the same method is evaluated on numbers, on batches, on SymPy symbols (to print and to
compile it) and, in tests, on quantities with units. Only the functions differ, and these choose by argument.
"""

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


def _apply(name: str, z: Any) -> Any:
    if hasattr(z, "free_symbols"):
        return getattr(sys.modules["sympy"], name)(z)
    return getattr(np, name)(z)
