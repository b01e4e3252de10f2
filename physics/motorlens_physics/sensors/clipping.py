"""A sensor at the end of its range."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorClipping(SensorModel):
    """A sensor that shows no more than its limit, either way; for simulation only.

    JCGM 200:2012 (VIM), 4.7, measuring interval.

    >>> SensorClipping("current", limit=10.0).record(np.arange(3.0), np.array([-12.0, 4.0, 60.0]), np.random.default_rng(0))
    array([-10.,   4.,  10.])
    """

    kind: ClassVar[str] = "clipping"

    limit: float = param(
        1e6, "channel", "largest magnitude shown", bounds=(0.0, 1e6), prior=2.0, of="channel", fixed=True
    )

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        return np.clip(y, -self.limit, self.limit)
