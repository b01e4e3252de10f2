"""Types of the compiled functions, for numba and for `native`; copied to the head of generated modules."""

import math  # noqa: F401  (for the generated modules)

import numpy as np  # noqa: F401  (likewise)
from numba import boolean, float64, int64, njit, types  # noqa: F401  (likewise)

Vector = Matrix = Any = object
# Rounding may differ by the order of operations; infinities and NaN keep their meaning.
fastmath = ("contract", "arcp", "nsz", "reassoc")
options = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": set(fastmath)}
v = float64[::1]
m = float64[:, ::1]
mm = float64[:, :, ::1]
of_step = types.void(v, v, float64, v, float64, float64, float64, v, v, v)
of_rest = types.UniTuple(float64, 3)(v, v, float64, v, float64)
of_torque = float64(v, v, float64, v, float64, float64)
of_linear = types.void(v, v, float64, v, float64, float64, int64[::1], m, m)
of_work = types.Tuple((mm, mm, mm, m, int64[::1], m, mm, v))
of_propagate = types.void(
    types.FunctionType(of_linear), v, v, float64, v, float64, float64, float64, v, v, float64, float64, m, of_work
)  # fmt: skip
pointers = [types.FunctionType(f) for f in (of_step, of_rest, of_torque, of_linear, of_propagate)]
of_integrate = int64(*pointers, v, m, int64, boolean, v, v, v, v, float64, m, m, of_work, mm, mm)
