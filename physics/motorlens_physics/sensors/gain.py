"""Gain error of a sensor."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorGain(SensorModel):
    """A sensor that shows gain y: a shunt, a divider or a scale that is not what the data sheet says.

    JCGM 200:2012 (VIM), 4.12, sensitivity of a measuring system.

    >>> SensorGain("current", gain=1.03).read(5.0, None)  # 1.03 5
    5.15
    """

    kind: ClassVar[str] = "gain"
    excited_by: ClassVar[tuple[str, ...]] = ("load_steps", "no_load_steps", "duty")

    gain: float = param(1.0, "1", "shown over true", bounds=(0.1, 10.0), prior=0.03, null=1.0)

    def read(self, y: Any, rate: Any) -> Any:
        return self.gain * y

    def unrecord(self, time_s: Array, shown: Array) -> Array:
        return shown / self.gain
