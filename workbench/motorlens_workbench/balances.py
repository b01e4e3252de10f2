"""What each balance of the motor lacks on a recording: its equation driven by the measured others.

Everything is low-passed, so that no derivative is taken of noise: J (w - LP(w)) / T - LP(torque) is the torque that the
mechanical equation lacks (Young 1981, doi:10.1016/0005-1098(81)90082-0).
"""

from types import SimpleNamespace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.estimate.model import Model, inputs_of
from motorlens_physics.estimate.run import STATE_OF, Run
from motorlens_physics.scenario import TimeConstants, time_constants
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]

EQUATIONS = {"electrical": "V", "mechanical": "N*m", "thermal": "W"}


def missing_of(model: Model, run: Run, r: int, trajectory: Trajectory, predicted: Array) -> dict[str, Array]:
    """What each equation lacks, (N,), with measured states wherever there are some and simulated ones elsewhere.

    Args:
        model: the model.
        run: what was measured.
        r: which run of the model's it is.
        trajectory: of that run, as simulated.
        predicted: (N, C) what its sensors would show: what they add to the truth is taken out of what was measured.
    """
    # What goes with the shaft's angle is simulated only where that is known.
    motor, inputs = trajectory.motor, inputs_of(model, run, r)
    states = dict(trajectory.states)
    for k, channel in enumerate(run.channels):
        states[STATE_OF[channel]] = states[STATE_OF[channel]] + run.measured[:, k] - predicted[:, k]
    x = SimpleNamespace(**states)
    u = SimpleNamespace(
        v=inputs.voltage_V, load=inputs.load_torque_Nm, ambient=inputs.ambient_C, t=inputs.time_s
    )
    pace = time_constants(motor)
    masses = (motor.L, motor.J, motor.H)
    reach = filter_times(run, pace)
    missing = {}
    for name, balance, mass, state in zip(
        EQUATIONS, motor.balances(x, u), masses, STATE_OF.values(), strict=True
    ):
        tau = reach[name]
        smooth = lowpass(
            np.broadcast_to(balance, run.inputs.time_s.shape).astype(np.float64), inputs.time_s, tau
        )
        rate = (states[state] - lowpass(states[state], inputs.time_s, tau)) / tau
        missing[name] = mass * rate - smooth
    return missing


def filter_times(run: Run, pace: TimeConstants) -> dict[str, float]:
    """Time constant of the low-pass in each equation, s: some samples, or the equation's own pace if that is slower."""
    few = 4 * run.period_s
    return {
        "electrical": max(few, pace.electrical_s),
        "mechanical": max(few, 0.3 * pace.mechanical_s),
        "thermal": max(few, 0.02 * pace.thermal_s),
    }


def lowpass(y: Array, time_s: Array, tau_s: float) -> Array:
    """First-order low-pass of (N,) samples that run linearly in between, exact for uneven spacing; starts at y[0]."""
    dt = np.diff(time_s)
    return np.asarray(_follow(y, np.diff(y) / dt, np.exp(-dt / tau_s), tau_s))


@njit(cache=True)
def _follow(y, slope, keep, tau):  # type: ignore[no-untyped-def]
    # Exact for a ramp: s' = y1 - slope tau + (s - y0 + slope tau) keep.
    out = np.empty_like(y)
    out[0] = y[0]
    for k in range(len(slope)):
        lag = slope[k] * tau
        out[k + 1] = y[k + 1] - lag + (out[k] - y[k] + lag) * keep[k]
    return out
