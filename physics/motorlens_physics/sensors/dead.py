"""A channel that dies."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorDead(SensorModel):
    """A sensor that shows the same value from some moment on, whatever happens; for simulation only.

    Isermann (2006), Fault-Diagnosis Systems, ISBN 978-3-540-24112-6, chapter 20: stuck sensors.

    >>> dead = SensorDead("speed", after=1.5, shows=3.0)
    >>> dead.record(np.arange(4.0), np.array([10.0, 11.0, 12.0, 13.0]), np.random.default_rng(0))
    array([10., 11.,  3.,  3.])
    """

    kind: ClassVar[str] = "dead"

    after: float = param(1e9, "s", "time of death", bounds=(0.0, 1e9), prior=1.0, fixed=True)
    shows: float = param(
        0.0, "channel", "value shown from then on", bounds=(-1e6, 1e6), prior=0.1, of="channel", fixed=True
    )

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        return np.where(time_s < self.after, y, self.shows)
