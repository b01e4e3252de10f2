"""Noise of a sensor."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorNoise(SensorModel):
    """White Gaussian noise; for simulation only.

    JCGM 100:2008 (GUM), 4.2: standard uncertainty of repeated readings.

    >>> shown = SensorNoise("current", sd=0.5).record(np.arange(4.0), np.full(4, 7.0), np.random.default_rng(1))
    >>> bool(np.allclose(shown - 7, 0.5 * np.random.default_rng(1).standard_normal(4)))
    True
    """

    kind: ClassVar[str] = "noise"

    sd: float = param(
        0.0, "channel", "standard deviation", bounds=(0.0, 1e4), prior=0.005, of="channel", fixed=True
    )

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        return y + self.sd * rng.standard_normal(len(y))
