"""What acts on a motor: voltage, load and ambient, sample by sample, and what its terminals and its shaft are tied to."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.compile.types import (
    ANGLE,
    IMPOSED_SLOPES,
    IMPOSED_VALUES,
    IMPOSES_CURRENT,
    IMPOSES_SPEED,
    LOCKS,
    OPENS,
    SHORTS,
    SLOPES,
    SLOPES_OF_IMPOSED,
    TIED,
)
from motorlens_physics.conditions import Shaft, Terminal, codes
from motorlens_runtime.errors import DataError

Array = NDArray[np.float64]
_NOTHING_IMPOSED = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Inputs:
    """What acts on a motor: (N,) float64 each; between samples held at the earlier one, or linear.

    Attributes:
        time_s: strictly increasing, spacing may vary.
        voltage_V: at the terminals.
        load_torque_Nm: positive against a forward rotation.
        ambient_C: ambient temperature.
        held: whether the values hold until the next sample (a drive's output) or run linearly to it: of all, or of voltage,
            load torque and ambient each.
        terminal: (N,) of `Terminal`; None: driven throughout. The voltage is that of samples where they are driven.
        shaft: (N,) of `Shaft`; None: free throughout.
        current_A: (N,) what a current-controlled drive imposes; held or linear as the voltage would be.
        speed_rad_s: (N,) what turns the shaft imposes; linear.
        angle_rad: (N,) the shaft angle where it is known, for what goes with it; linear. None: the integral of the speed.
    """

    time_s: Array
    voltage_V: Array
    load_torque_Nm: Array
    ambient_C: Array
    held: bool | tuple[bool, bool, bool] = False
    terminal: NDArray[np.int64] | None = None
    shaft: NDArray[np.int64] | None = None
    current_A: Array | None = None
    speed_rad_s: Array | None = None
    angle_rad: Array | None = None

    def __post_init__(self) -> None:
        self._check_conditions()
        given = [
            name for name in ("current_A", "speed_rad_s", "angle_rad") if getattr(self, name) is not None
        ]
        for name in ("time_s", "voltage_V", "load_torque_Nm", "ambient_C", *given):
            values = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, values)
            if values.shape != self.time_s.shape or values.ndim != 1:
                raise DataError(
                    f"inputs: {name} has shape {values.shape}, time_s has {np.shape(self.time_s)}"
                )
            if not np.isfinite(values).all():
                raise DataError(
                    f"inputs: {name} is not finite at sample {int(np.argmin(np.isfinite(values)))}"
                )
        backwards = np.diff(self.time_s) <= 0
        if backwards.any():
            raise DataError(f"inputs: time_s does not increase at sample {int(np.argmax(backwards)) + 1}")
        if self.time_s.size == 0:
            raise DataError("inputs: no samples")

    def _check_conditions(self) -> None:
        for name, kind, imposed, by in (
            ("terminal", Terminal, "current_A", Terminal.CURRENT),
            ("shaft", Shaft, "speed_rad_s", Shaft.TURNED),
        ):
            values = getattr(self, name)
            if values is None:
                continue
            given = codes(kind, values, f"inputs: {name}")
            object.__setattr__(self, name, given)
            if given.shape != np.shape(self.time_s):
                raise DataError(f"inputs: {name} has shape {given.shape}, time_s has {np.shape(self.time_s)}")
            if (given == by).any() and getattr(self, imposed) is None:
                raise DataError(f"inputs: {name} is {by.name.lower()}, but {imposed} is not given")

    def part(self, rows: slice) -> "Inputs":
        """Some consecutive samples, with what their terminals and shaft are tied to."""
        own: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        own |= {name: y[rows] for name, y in own.items() if isinstance(y, np.ndarray)}
        return Inputs(**own)

    @property
    def hold(self) -> tuple[bool, bool, bool]:
        """Whether voltage, load torque and ambient hold between samples, each."""
        return (self.held,) * 3 if isinstance(self.held, bool) else self.held


def acting_of(inputs: Inputs) -> tuple[Array, NDArray[np.int64]]:
    """What acts on the motor from each sample on, and what is imposed, see `compile.types.Given`."""
    samples, spans = inputs.time_s.size, np.diff(inputs.time_s)
    free = inputs.terminal is None and inputs.shaft is None
    acting = np.zeros((samples, IMPOSED_SLOPES if free else TIED))

    def put(value: int, slope: int, y: Array, runs: NDArray[np.bool_] | bool) -> None:
        acting[:, value] = y
        if samples > 1:
            slopes = acting[:-1, slope]
            np.divide(np.diff(y), spans, out=slopes)
            slopes *= runs
            acting[-1, slope] = acting[-2, slope]

    held = inputs.hold
    for j, y in enumerate((inputs.voltage_V, inputs.load_torque_Nm, inputs.ambient_C)):
        put(j, SLOPES + j, y, not held[j])
    if inputs.angle_rad is not None:
        put(ANGLE, SLOPES + ANGLE, inputs.angle_rad, True)
    if free:
        return acting, _NOTHING_IMPOSED
    terminal = np.zeros(samples, dtype=np.int64) if inputs.terminal is None else inputs.terminal
    shaft = np.zeros(samples, dtype=np.int64) if inputs.shaft is None else inputs.shaft
    for j, (tied, imposed, runs) in enumerate(
        (
            (terminal == Terminal.CURRENT, inputs.current_A, not held[0]),
            (shaft == Shaft.TURNED, inputs.speed_rad_s, True),
        )
    ):
        if imposed is not None and tied.any():
            both = tied[:-1] & tied[1:] & runs
            put(IMPOSED_VALUES + j, SLOPES_OF_IMPOSED + j, np.where(tied, imposed, 0.0), both)
    acting[(terminal == Terminal.SHORTED)[:, None] & np.isin(np.arange(TIED), (0, SLOPES))] = 0.0
    how = (
        IMPOSES_CURRENT * np.isin(terminal, (Terminal.OPEN, Terminal.CURRENT))
        + IMPOSES_SPEED * np.isin(shaft, (Shaft.LOCKED, Shaft.TURNED))
        + OPENS * (terminal == Terminal.OPEN)
        + LOCKS * (shaft == Shaft.LOCKED)
        + SHORTS * (terminal == Terminal.SHORTED)
    )
    return acting, how.astype(np.int64) if how.any() else _NOTHING_IMPOSED
