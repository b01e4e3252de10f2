"""Faults of the sensors that were recorded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensor_model import SensorModel, sensor_catalogue
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]


@dataclass(frozen=True)
class SensorShape:
    """A fault at its typical size, and the multiples of it that are possible."""

    sensor: SensorModel
    bounds: tuple[float, float]

    @property
    def width(self) -> int:
        """How many columns it has."""
        return 1

    def columns(self, line: Line) -> Array:
        """(N, C, 1) what the fault would change in the channels."""
        return line.of_sensor(self.sensor)

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return self.bounds


def sensors(file: MotorFile, runs: Sequence[Run]) -> list[Hypothesis]:
    """All faults that sensors of these recordings may have, and that the motor file has not.

    A sensor that shows exactly zero at rest has no offset beyond half its smallest step.
    """
    present = {sensor.name() for sensor in file.sensors}
    recorded = {"voltage"} | {channel for run in runs for channel in (*run.channels, *run.known)}
    exact: dict[str, float] = {}
    for run in runs:
        exact |= {
            channel: min(limit, exact.get(channel, limit)) for channel, limit in run.offset_below.items()
        }
    listed = []
    for name, sensor in sensor_catalogue().items():
        if name in present or sensor.channel not in recorded:
            continue
        fault, switch = sensor.typical(file.rated), sensor.switch()
        assert switch is not None and switch.null is not None
        typical = switch.typical(file.rated) - switch.null
        ends = sorted((end - switch.null) / typical for end in switch.bounds)
        if sensor.kind == "offset" and sensor.channel in exact:
            most = exact[sensor.channel] / abs(typical)
            ends = [max(ends[0], -most), min(ends[1], most)]
        shape = SensorShape(fault, (ends[0], ends[1]))
        listed.append(Hypothesis(name, "sensor", sensor.channel, (shape,), f"{name}.{switch.name}", typical))
    return listed
