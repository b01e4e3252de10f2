"""What an effect adds to the three balances along a trajectory that lacks it."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]

# What warms with the winding starts this share as warm as it, unless a fit says otherwise.
SETTLED = 0.8
# Factors by which samples of an effect of the shaft angle are raised: in full up to the first, no more from the second on,
# where lines between the samples cannot stand for it (near half the sampling rate). In between it fades: samples that
# alternate in sign and come and go at once would add up to a torque that is not there.
RAISED, TOO_FAR = 1.5, 3.0


@dataclass(frozen=True)
class Forcing:
    """What is added to the three balances, (N,) or (N, k) each: V, N m, W."""

    voltage: Array
    torque: Array
    heat: Array


def forcing(effect: Effect, trajectory: Trajectory) -> Forcing:
    """What an effect at its present size would add along a trajectory, less what it adds at null."""
    if effect.turns():
        return _of_angle(effect, trajectory)
    motor = trajectory.motor
    switch = effect.switch()
    null = replace(effect, **{switch.name: switch.null})
    u = inputs_at(trajectory)
    full_x, null_x = (_states(one, trajectory, u) for one in (effect, null))
    rows = len(u.t)
    parts = {
        name: _array(getattr(effect, name)(motor, full_x, u), rows)
        - _array(getattr(null, name)(motor, null_x, u), rows)
        for name in ("voltage", "torque", "heat", "inductance")
    }
    if parts["inductance"].any():
        slope = _array(motor.balances(null_x, u)[0], rows) / np.maximum(
            _array(motor.inductance(null_x, u), rows), 1e-12
        )
        parts["voltage"] = parts["voltage"] - parts["inductance"] * slope
    return Forcing(parts["voltage"], parts["torque"], parts["heat"])


def _of_angle(effect: Effect, trajectory: Trajectory) -> Forcing:
    """As samples that, joined by straight lines, do in between what its true course does."""
    motor, u = trajectory.motor, inputs_at(trajectory)
    x = _states(effect, trajectory, u)
    rounds = getattr(effect, effect.with_role("count"), 1.0)
    advance, period_s = rounds * np.gradient(x.phi), float(np.median(np.diff(u.t)))
    lag_s = {"voltage": motor.L / motor.R_a0, "torque": motor.J / (motor.b + motor.ke**2 / motor.R_a0)}
    parts = {name: np.zeros(len(advance)) for name in lag_s}
    for name, lag in lag_s.items():
        if getattr(type(effect), name) is getattr(Effect, name):
            continue  # it adds nothing to this balance
        factor = between_samples(advance, lag / period_s)
        at = SimpleNamespace(**{**vars(x), "phi": x.phi + np.angle(factor) / rounds})
        size = np.abs(factor)
        kept = np.clip((TOO_FAR - size) / (TOO_FAR - RAISED), 0.0, 1.0)
        parts[name] = kept * size * getattr(effect, name)(motor, at, u)
    return Forcing(**parts, heat=_array(effect.heat(motor, x, u), len(advance)))


def inputs_at(trajectory: Trajectory) -> Any:
    """The inputs along a trajectory as effects read them."""
    i = trajectory.inputs
    return SimpleNamespace(v=i.voltage_V, load=i.load_torque_Nm, ambient=i.ambient_C, t=i.time_s)


def _states(effect: Effect, trajectory: Trajectory, u: Any) -> Any:
    x = SimpleNamespace(**trajectory.states)
    for name in effect.states:
        if name in trajectory.states:
            continue
        # The state's equation is affine in itself: ds/dt = a s + b.
        rows = len(u.t)
        setattr(x, name, np.zeros(rows))
        b = _array(effect.rates(trajectory.motor, x, u)[name], rows)
        setattr(x, name, np.ones(rows))
        a = _array(effect.rates(trajectory.motor, x, u)[name], rows) - b
        warm = SETTLED * float(trajectory.states["theta"][0])
        setattr(
            x,
            name,
            _integrate(
                u.t, a, b, warm if effect.states[name].kind == "rise" else effect.states[name].initial
            ),
        )
    return x


@numba.njit(cache=True, nogil=True)
def _integrate(time, a, b, first):  # type: ignore[no-untyped-def]
    s = np.empty(len(time))
    s[0] = first
    for k in range(len(time) - 1):
        dt = time[k + 1] - time[k]
        rate, drive = 0.5 * (a[k] + a[k + 1]), 0.5 * (b[k] + b[k + 1])
        z = rate * dt
        s[k + 1] = s[k] * np.exp(z) + drive * (np.expm1(z) / rate if abs(z) > 1e-12 else dt)
    return s


def _array(value: Any, rows: int) -> Array:
    return np.broadcast_to(np.asarray(value, dtype=np.float64), (rows,))


def between_samples(advance: Array, lag: float) -> NDArray[np.complex128]:
    """(N,) factor for samples of a rotating phasor, so that a first-order lag answers as to the phasor itself.

    The true answer over that of the sampled lag, 1 / (1 + j w T) over (b0 + b1 z) / (z - k) with z = exp(j w dt), where the
    lag is driven by straight lines between the samples (Franklin, Powell and Workman, Digital Control of Dynamic
    Systems, 3rd ed., section 6.3). A pure integrator driven by lines wants tan(h) / h, h = w dt / 2.

    Args:
        advance: (N,) phase from one sample to the next, rad, w dt.
        lag: time constant in samples, T / dt.

    >>> round(float(abs(between_samples(np.array([0.5]), 1e6)[0])), 4), round(float(np.tan(0.25) / 0.25), 4)
    (1.0214, 1.0214)
    """
    keep = np.exp(-1 / lag)
    later = 1 - lag * (1 - keep)
    z = np.exp(1j * advance)
    sampled = (1 - keep - later + later * z) / (z - keep)
    return np.asarray(1 / (1 + 1j * advance * lag) / np.where(np.abs(sampled) > 1e-12, sampled, 1e-12))
