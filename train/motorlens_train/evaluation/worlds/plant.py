"""A brushed motor by a classical Runge-Kutta method (order 4), a brake that opposes the motion, and a speed controller."""

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# States.
I, W, THETA = range(3)  # noqa: E741


class Constants(NamedTuple):
    """The motor: ohm, H, V s/rad, kg m2, N m s/rad, 1/K, W/K, s/rad, W s2/rad2, J/K; a brush drop, V; and the speed
    (rad/s) and the current (A) over which brake and drop turn round."""

    R: float = 3.5
    L: float = 0.034
    ke: float = 0.9346
    J: float = 0.0328
    b: float = 0.00154
    alpha: float = 0.004
    k0: float = 4.33
    kT: float = 0.0028
    k_ir: float = 0.00667
    H: float = 18e3
    drop: float = 0.0
    turning: float = 0.3
    knee: float = 0.1

    def longest_s(self, brake_Nm: float) -> float:
        """The longest step of the integration: a fortieth of L/R, a fifth of the brake's fastest rate."""
        return min(self.L / self.R / 40, self.turning * self.J / max(brake_Nm, 1e-12) / 5)

    def at_the_shaft(self, brake_Nm: Array, torque_Nm: Array, speed_rad_s: Array) -> Array:
        """What a brake and a torque are against the motion, N m (N,): at rest the brake takes what it is asked for."""
        return np.asarray(brake_Nm * np.tanh(speed_rad_s / self.turning) + torque_Nm)


class Loop(NamedTuple):
    """A speed controller: V s/rad, V/rad, and its limit, V."""

    proportional: float
    integral: float
    limit: float


OPEN = Loop(0.0, 0.0, 0.0)


@nb.njit(cache=True)  # type: ignore[untyped-decorator]
def _rates(
    x: Array, v: float, brake: float, torque: float, c: Array, out: Array
) -> None:  # pragma: no cover - compiled
    i, w, theta = x[I], x[W], x[THETA]
    r = c[0] * (1.0 + c[5] * theta)
    lost = c[10] * i / np.sqrt(i * i + c[12] * c[12])
    out[I] = (v - r * i - lost - c[2] * w) / c[1]
    out[W] = (c[2] * i - c[4] * w - brake * np.tanh(w / c[11]) - torque) / c[3]
    out[THETA] = (r * i * i + lost * i + c[8] * w * w - c[6] * (1.0 + c[7] * abs(w)) * theta) / c[9]


@nb.njit(cache=True)  # type: ignore[untyped-decorator]
def _run(
    time: Array, voltage: Array, held: bool, brake: Array, torque: Array, reference: Array, gains: Array, x0: Array,
    c: Array, longest: float, states: Array,
) -> None:  # fmt: skip  # pragma: no cover - compiled
    x, y = x0.copy(), np.empty(3)
    k1, k2, k3, k4 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    integral = 0.0
    states[0] = x
    for n in range(len(time) - 1):
        h = time[n + 1] - time[n]
        if reference.size > 0:
            error = reference[n] - x[W]
            wanted = gains[0] * error + gains[1] * integral
            voltage[n] = min(max(wanted, -gains[2]), gains[2])
            if voltage[n] == wanted:
                integral += error * h
        v0 = voltage[n]
        # A controller's voltage is held: the next one is not known yet.
        v1 = v0 if held or reference.size > 0 else voltage[n + 1]
        pieces = int(np.ceil(h / longest))
        s = h / pieces
        for p in range(pieces):
            a = v0 + (v1 - v0) * p / pieces
            b = v0 + (v1 - v0) * (p + 1) / pieces
            m = 0.5 * (a + b)
            _rates(x, a, brake[n], torque[n], c, k1)
            for j in range(3):
                y[j] = x[j] + 0.5 * s * k1[j]
            _rates(y, m, brake[n], torque[n], c, k2)
            for j in range(3):
                y[j] = x[j] + 0.5 * s * k2[j]
            _rates(y, m, brake[n], torque[n], c, k3)
            for j in range(3):
                y[j] = x[j] + s * k3[j]
            _rates(y, b, brake[n], torque[n], c, k4)
            for j in range(3):
                x[j] += s / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
        states[n + 1] = x
    if reference.size > 0:
        voltage[-1] = voltage[-2]


def run(
    constants: Constants, time_s: Array, voltage_V: Array, held: bool, brake_Nm: Array, torque_Nm: Array, start: Array,
    reference: Array | None = None, loop: Loop = OPEN, longest_s: float | None = None,
) -> tuple[Array, Array]:  # fmt: skip
    """States (N, 3), current A, speed rad/s and rise K, at the instants; and the voltage (N,) as it was applied.

    Args:
        constants: the motor.
        time_s: (N,) instants.
        voltage_V: (N,); ignored with a reference.
        held: whether the voltage stands between samples; else it runs linearly.
        brake_Nm, torque_Nm: (N,) a brake that opposes the motion, a torque that acts whatever the motion; held.
        start: (3,) states at the first instant.
        reference: (N,) rad/s, for the speed controller.
        loop: the controller.
        longest_s: of the integration's steps; None: what the motor asks for.
    """
    states, applied = np.empty((len(time_s), 3)), voltage_V.astype(np.float64).copy()
    wanted = np.empty(0) if reference is None else reference
    longest = constants.longest_s(float(np.abs(brake_Nm).max())) if longest_s is None else longest_s
    _run(
        time_s,
        applied,
        held,
        brake_Nm,
        torque_Nm,
        wanted,
        np.array(loop),
        start,
        np.array(constants),
        longest,
        states,
    )
    return states, applied
