"""How the motor is driven: terminal voltage or speed reference and load torque at the sample instants.

Everything is linear between samples and slews rather than jumps, so that a reader who interpolates the inputs linearly
is right. A load comes on after its segment has begun and is gone before it ends: it never meets a motor at rest, and it
may help (an overhauling load) only in the `rich` programme.
"""

from dataclasses import dataclass

import numpy as np
from helpers.hidden.motors import HiddenMotor
from helpers.hidden.plant import Array, Controller

EXCITATIONS = ("rich", "one_direction", "closed_loop", "near_standstill")


@dataclass(frozen=True)
class Programme:
    """A drive programme: `voltage` V or, in closed loop, `reference` rad/s; `load` N m; `dt` s."""

    dt: float
    voltage: Array
    load: Array
    reference: Array | None
    controller: Controller


def programme(
    motor: HiddenMotor,
    excitation: str,
    seconds: float,
    dt: float,
    slow: bool,
    loaded: bool,
    rng: np.random.Generator,
) -> Programme:
    """Draw a programme of `seconds` at steps of `dt`."""
    n = round(seconds / dt) + 1
    r, ke = motor.textbook["R"], motor.textbook["ke"]
    tau_m = r * motor.textbook["J"] / ke**2
    # Breakpoints (time, share of rated voltage or speed) and (time, share of rated torque), joined by straight lines.
    drive, load = [(0.0, 0.0)], [(0.0, 0.0)]
    t, level = 0.0, 0.0
    first = rng.uniform(0.5, 1.0) if not slow else rng.uniform(20, 60)
    drive.append((first, 0.0))
    t = first
    while t < seconds:
        if slow:
            length = rng.uniform(0.02, 0.11) * seconds
        else:
            length = (
                rng.uniform(0.4, 3.0)
                * max(1.0, tau_m / 0.05)
                * (2.0 if excitation == "near_standstill" else 1.0)
            )
        new = _level(excitation, rng, slow)
        if slow:
            ramp = rng.uniform(3.0, 6.0)
        elif excitation == "near_standstill" or rng.random() < 0.2:
            ramp = rng.uniform(0.3, 0.9) * length
        else:
            ramp = max(6 * dt, rng.uniform(0.5, 4.0) * tau_m * abs(new - level))
        drive.append((t + ramp, new))
        if (
            excitation in ("rich", "closed_loop")
            and not slow
            and rng.random() < 0.35
            and new != 0
            and length > 3 * ramp
        ):
            bit, size = rng.uniform(0.02, 0.1) * max(1.0, tau_m / 0.05), rng.uniform(0.02, 0.06)
            at = t + 1.5 * ramp
            while at + bit < t + 0.95 * length:
                value = new + size * rng.choice((-1.0, 1.0))
                drive += [(at + 5 * dt, value), (at + bit, value)]
                at += bit
        drive.append((t + length, drive[-1][1]))
        if loaded and rng.random() < 0.75:
            _add_load(load, motor, excitation, new, t, length, ramp, slow, dt, rng)
        t, level = t + length, drive[-1][1]
    time = np.arange(n) * dt
    shape = np.interp(time, *_increasing(drive))
    torque = motor.torque_Nm * np.interp(time, *_increasing(load))
    if excitation == "closed_loop":
        gain = (0.5 * r * motor.textbook["J"] / (ke * 8 * dt) if not slow else 0.0) + (
            0.02 * ke if slow else 0.0
        )
        gain = min(gain, 3 * ke)
        control = Controller(gain, gain / max(4 * tau_m, 20 * dt), motor.voltage_V, ke)
        return Programme(dt, np.zeros(n), torque, shape * motor.speed_rad_s, control)
    return Programme(dt, shape * motor.voltage_V, torque, None, Controller(0.0, 0.0, 0.0, 0.0))


def _level(excitation: str, rng: np.random.Generator, slow: bool) -> float:
    if excitation == "near_standstill":
        return float(rng.uniform(-0.09, 0.09)) if rng.random() > 0.15 else 0.0
    if rng.random() < (0.25 if slow else 0.12):
        return 0.0
    top = 0.85 if excitation == "closed_loop" else 1.0
    size = rng.uniform(0.12, top) if not slow else rng.uniform(0.4, top)
    return float(size if excitation == "one_direction" else size * rng.choice((-1.0, 1.0)))


def _add_load(
    load: list[tuple[float, float]], motor: HiddenMotor, excitation: str, level: float, t: float, length: float,
    ramp: float, slow: bool, dt: float, rng: np.random.Generator,
) -> None:  # fmt: skip
    # As much as leaves a fifth of the voltage to the speed, with the winding hot and 20 % of tolerance.
    spare = (
        (abs(level) - 0.25)
        * motor.voltage_V
        / (1.9 * motor.textbook["R"])
        * motor.textbook["ke"]
        / motor.torque_Nm
    )
    most = min(1.1, spare)
    on, off = t + ramp + 0.2 * length, t + 0.85 * length
    edge = rng.uniform(4.0, 8.0) if slow else max(10 * dt, rng.uniform(0.02, 0.1))
    if most < 0.1 or on + 2 * edge > off - edge:
        return
    sign = -0.5 if excitation == "rich" and rng.random() < 0.25 else 1.0
    size = np.sign(level) * sign * rng.uniform(0.1, most)
    again = np.sign(level) * sign * rng.uniform(0.1, most)
    middle = (on + off) / 2
    load += [
        (on, 0.0),
        (on + edge, size),
        (middle, size),
        (middle + edge, again),
        (off - edge, again),
        (off, 0.0),
    ]


def _increasing(points: list[tuple[float, float]]) -> tuple[Array, Array]:
    t, y = np.array(points).T
    keep = np.r_[True, np.diff(np.maximum.accumulate(t)) > 0]
    return t[keep], y[keep]
