"""The tests that a diagnosis may propose, performed on the same specimen: what `motorlens simulate` calls scenarios."""

import numpy as np
from helpers.hidden import plant
from helpers.hidden.excitation import Programme
from helpers.hidden.plant import Array, Controller
from helpers.hidden.world import Case, Record

# name -> (time, share of rated voltage), (time, share of rated torque); times as shares of the duration. The torque acts
# with the sign it has here: in `load_steps` against the motion, in `overhauling_load` with it as well.
_SHAPES: dict[str, tuple[list[float], list[float]]] = {
    "no_load_steps": ([0, 0.1, 0.3, 0.6, 1, 0.4, 0, -0.2, -0.5, -1, -0.7, -0.3, 0.15, 0.8, -0.1, 0], [0.0]),
    "load_steps": ([0, 1, 0.6, 0, -0.6, -1, 0], [0.0, 0.5, 0.9, 0.2]),
    "overhauling_load": ([1, 0.7, -0.7, -1], [0, 0.8, -0.6, 0.5, -0.5]),
    "heat_soak": ([1, 1, 1, 1, 0, 0, 0.5, 0.5, 0.5, 0, 0], [0.9]),
    "locked_rotor": ([0, 0.25, 0.5, 1, 0.5, 0, -0.5, -1, -0.5, -0.25, 0], [0.0]),
    "slow_ramp": ([0], [0.0]),
    "coast_down": ([1], [0.0]),
    "direct_on_line": ([1], [1.0]),
}
TESTS = tuple(_SHAPES)


def experiment(case: Case, name: str, seconds: float) -> Record:
    """A recording of a test, from the cold; `heat_soak` and `direct_on_line` at 1 Hz or 10 Hz, the others fast.

    Raises:
        KeyError: no such test.
    """
    motor = case.of_motor()
    volts, torques = _SHAPES[name]
    slow = name in ("heat_soak", "direct_on_line") and seconds > 300
    dt = (1.0 if case.small else 0.1) if slow else (0.002 if case.small else 0.001)
    seconds = max(seconds, 200 * dt)
    n = round(seconds / dt) + 1
    time = np.arange(n) * dt
    edge = 4.0 if slow else max(6 * dt, motor.textbook["R"] * motor.textbook["J"] / motor.textbook["ke"] ** 2)
    voltage = _stairs(time, np.repeat(volts, len(torques)) if len(volts) > 1 else np.array(volts), edge)
    load = np.zeros(n)
    if name == "slow_ramp":
        corners = seconds * np.array([0.0, 0.125, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0])
        voltage = np.interp(time, corners, [0.0, 1.0, -1.0, 0.0, 0.2, 0.0, -0.2, 0.0])
    elif name == "locked_rotor":
        voltage = voltage * motor.textbook["R"] * motor.current_A / motor.voltage_V
    elif name == "coast_down":
        voltage = np.minimum(time / (4 * edge), 1.0)
    if any(torques):
        shares = (
            np.tile(torques, len(volts)) if name in ("load_steps", "overhauling_load") else np.array(torques)
        )
        direction = (
            np.sign(_stairs(time, np.repeat(volts, len(torques)), 0.0))
            if len(shares) > 1
            else np.sign(voltage)
        )
        # A load comes on after the motor runs and is gone before the voltage is.
        load = np.where(np.abs(voltage) > 0.3, _stairs(time, shares, edge), 0.0) * direction
        load = np.minimum(np.abs(load), np.maximum(np.abs(voltage) - 0.3, 0)) * np.sign(load)
    drive = Programme(
        dt, voltage * motor.voltage_V, load * motor.torque_Nm, None, Controller(0.0, 0.0, 0.0, 0.0)
    )
    still = np.zeros(n)
    opened = 0.25 * seconds if name == "coast_down" else np.inf
    return Record(slow, drive, still, plant.rest(), locked=name == "locked_rotor", open_from_s=float(opened))


def _stairs(time: Array, values: Array | list[float], edge: float) -> Array:
    """Levels of equal length joined by ramps of `edge` seconds."""
    values = np.asarray(values, float)
    if len(values) == 1:
        return values[0] * np.minimum(time / edge, 1.0) if edge else np.full_like(time, values[0])
    at = time[-1] * np.arange(len(values)) / len(values)
    if edge == 0:
        return values[np.searchsorted(at, time, side="right") - 1]
    points = np.sort(np.r_[at, at[1:] + min(edge, 0.4 * at[1])])
    levels = np.r_[values[0], np.column_stack([values[:-1], values[1:]]).ravel()]
    return np.interp(time, points, levels)
