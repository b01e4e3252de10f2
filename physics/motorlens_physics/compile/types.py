"""Types of the compiled functions, for numba and for `native`; generated modules import all of this."""

import math  # noqa: F401  (for the generated modules)
from typing import Any, NamedTuple

import numpy as np  # noqa: F401  (likewise)
from numba import boolean, float64, int64, njit, types  # noqa: F401  (likewise)

# Arrays of one, two and three axes; any, so that the loops read as Python.
Vector = Any
Matrix = Any
# Rounding may differ by the order of operations; infinities and NaN keep their meaning.
fastmath = ("contract", "arcp", "nsz", "reassoc")
options = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": set(fastmath)}

# Where `u`, what acts at an instant, keeps its parts: voltage, load torque, ambient and shaft angle, their slopes, the
# slopes of an imposed current and speed, whether they are imposed, and whether the terminals are shorted.
ANGLE, SLOPES, IMPOSED_SLOPES, IMPOSED, SHORTED, ACTING = 3, 4, 8, 10, 12, 13
# Where `Given.acting` keeps what is imposed and its slopes, current before speed, and how wide it then is.
IMPOSED_VALUES, SLOPES_OF_IMPOSED, TIED = 8, 10, 12
# Which of a pair the current and the speed are.
CURRENT, SPEED = 0, 1
# What is imposed in a sample, as bits: the current, the speed (of zero by an open terminal, by a lock), a voltage of zero.
IMPOSES_CURRENT, IMPOSES_SPEED, OPENS, LOCKS, SHORTS = 1, 2, 4, 8, 16
# Where `Course.carry` keeps the length of the next step, the steps accepted and rejected, and how many may yet be tried.
TRIAL, ACCEPTED, REJECTED, ALLOWED = 0, 1, 2, 3


class Given(NamedTuple):
    """What acts on a motor, over N samples.

    `acting` is (N, 12): voltage, load torque, ambient, shaft angle and their slopes to the next sample, then the current and
    the speed that are imposed and their slopes. `imposed` holds the bits from `IMPOSES_CURRENT` on, (N,). Where the
    terminals are driven and the shaft is free throughout, they are (N, 8) and (0,). `p` are the parameters, see
    `System.keys`.
    """

    time: Vector
    acting: Matrix
    imposed: Vector
    smooth: bool
    p: Vector


class Course(NamedTuple):
    """How far the integration is: the state, see `TRIAL` for `carry`, and the tolerances of its error."""

    x: Vector
    carry: Vector
    atol: Vector
    rtol: float


class Variations(NamedTuple):
    """Sensitivities along the way, see `variational`; without them everything is empty.

    Columns of `S` (n, columns) are forced parameters, then what is only perturbed at its start or imposed, and, if
    `matrices` (N - 1, n, n + 6) are asked for, n + 6 for the unit perturbations of a sample. `kept` (N, rows, columns)
    has n rows, and one for the terminal voltage if anything is imposed. `slots` says which column a forcing goes to, and
    `beside` which one a constant added to the voltage, the imposed current and the imposed speed has, -1 for none.
    `a` (3, n, n + 1), `g` (3, n, forced + 1), `over` (n, 4 n) and `T`, like S, are for working.
    """

    S: Matrix
    kept: Matrix
    matrices: Matrix
    slots: Vector
    beside: Vector
    a: Matrix
    g: Matrix
    over: Matrix
    T: Matrix


v = float64[::1]
m = float64[:, ::1]
mm = float64[:, :, ::1]
indices = int64[::1]
of_given = types.NamedTuple((v, m, indices, boolean, v), Given)
of_course = types.NamedTuple((v, v, v, float64), Course)
of_variations = types.NamedTuple((m, mm, mm, indices, indices, mm, mm, m, m), Variations)
of_step = types.void(v, v, float64, v, float64, float64, float64, v, v, v)
of_rest = types.UniTuple(float64, 4)(v, v, float64, v, float64)
of_balance = types.UniTuple(float64, 2)(v, v, float64, v, float64, float64)
of_linear = types.void(v, v, float64, v, float64, float64, indices, m, m)
of_stiffness = float64(v, float64, float64, mm)
of_transfer = types.void(v, float64, float64, mm, float64, float64, m)
of_propagate = types.void(
    types.FunctionType(of_linear), types.FunctionType(of_stiffness), types.FunctionType(of_transfer), v, v, float64, v,
    float64, float64, float64, v, v, float64, float64, of_variations,
)  # fmt: skip
pointers = [
    types.FunctionType(f)
    for f in (of_step, of_rest, of_balance, of_linear, of_stiffness, of_transfer, of_propagate)
]
of_integrate = int64(*pointers, of_given, of_course, m, of_variations)
