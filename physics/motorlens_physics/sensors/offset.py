"""Offset of a sensor."""

from dataclasses import dataclass
from typing import Any, ClassVar

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorOffset(SensorModel):
    """A sensor that shows y + offset: a zero that was not set, or has drifted.

    JCGM 200:2012 (VIM), 4.20 (instrumental bias) and 4.28 (datum measurement error at zero).

    >>> SensorOffset("speed", offset=-0.5).read(12.0, None)  # 12 - 0.5
    11.5
    """

    kind: ClassVar[str] = "offset"
    excited_by: ClassVar[tuple[str, ...]] = ("no_load_steps", "coast_down", "load_steps")

    offset: float = param(
        0.0, "channel", "shown less true", bounds=(-1e4, 1e4), prior=0.02, of="channel", null=0.0
    )

    def read(self, y: Any, rate: Any) -> Any:
        return y + self.offset

    def unrecord(self, time_s: Array, shown: Array) -> Array:
        return shown - self.offset
