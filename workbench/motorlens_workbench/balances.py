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
# Samples of which the balances are taken together.
_AT_ONCE = 65_536


def missing_of(
    model: Model,
    run: Run,
    r: int,
    trajectory: Trajectory,
    predicted: Array,
) -> dict[str, Array]:
    """What each equation lacks, (N,), with measured states wherever there are some and simulated ones elsewhere.

    Args:
        model: the model.
        run: what was measured.
        r: which run of the model's it is.
        trajectory: of that run, as simulated.
        predicted: (N, C) what its sensors would show: what they add to the truth is taken out of what was measured.
    """
    motor, time = trajectory.motor, run.inputs.time_s
    masses = dict(zip(EQUATIONS, (motor.L, motor.J, motor.H), strict=True))
    reach = filter_times(run, time_constants(motor))
    missing = balances_of(model, run, r, trajectory, predicted)
    for name, of in zip(EQUATIONS, STATE_OF.values(), strict=True):
        y, tau = measured_state(run, trajectory, predicted, of), reach[name]
        rate = (y - lowpass(y, time, tau)) / tau
        missing[name] = masses[name] * rate - lowpass(missing[name], time, tau)
    return missing


def balances_of(model: Model, run: Run, r: int, trajectory: Trajectory, predicted: Array) -> dict[str, Array]:
    """What each equation says, (N,): L di/dt in V, J dw/dt in N m and H dtheta/dt in W, if the model is right.

    Args: as of `missing_of`.
    """
    inputs = inputs_of(model, run, r)
    balances = {name: np.empty(len(inputs.time_s)) for name in EQUATIONS}
    # Sample by sample, so some at a time: of a long recording the steps of a formula would need more room than its data.
    for begin in range(0, len(inputs.time_s), _AT_ONCE):
        rows = slice(begin, begin + _AT_ONCE)
        states = {name: measured_state(run, trajectory, predicted, name, rows) for name in trajectory.states}
        x = SimpleNamespace(**states)
        some = inputs.part(rows)
        u = SimpleNamespace(v=some.voltage_V, load=some.load_torque_Nm, ambient=some.ambient_C, t=some.time_s)
        # What goes with the shaft's angle is simulated only where that is known.
        for name, balance in zip(EQUATIONS, trajectory.motor.balances(x, u), strict=True):
            balances[name][rows] = balance
    return balances


def measured_state(
    run: Run, trajectory: Trajectory, predicted: Array, name: str, rows: slice = slice(None)
) -> Array:
    """Some rows of a state (N,) as it was measured, without what its sensor adds, or as simulated if it was not."""
    column = {STATE_OF[channel]: k for k, channel in enumerate(run.channels)}
    simulated = trajectory.states[name][rows]
    if name not in column:
        return simulated
    return np.asarray(simulated + run.measured[rows, column[name]] - predicted[rows, column[name]])


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
    return np.asarray(_follow(y, time_s, tau_s))


@njit(cache=True)
def _follow(y, time, tau):  # type: ignore[no-untyped-def]
    # Exact for a ramp: s' = y1 - slope tau + (s - y0 + slope tau) keep.
    out = np.empty(len(y))
    out[0] = y[0]
    for k in range(len(y) - 1):
        dt = time[k + 1] - time[k]
        lag = (y[k + 1] - y[k]) / dt * tau
        out[k + 1] = y[k + 1] - lag + (out[k] - y[k] + lag) * np.exp(-dt / tau)
    return out
