"""Quantisation by a converter."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from motorlens_physics.parameter import param
from motorlens_physics.sensor_model import Array, SensorModel


@dataclass(frozen=True)
class SensorQuantisation(SensorModel):
    """An analogue-to-digital converter: the nearest multiple of its step; for simulation only.

    IEEE Std 1241-2010, Terminology and test methods for analog-to-digital converters: ideal code bin width.

    >>> SensorQuantisation("voltage", step=0.25).record(np.arange(2.0), np.array([1.3, -0.9]), np.random.default_rng(0))
    array([ 1.25, -1.  ])
    """

    kind: ClassVar[str] = "quantisation"

    step: float = param(
        0.0, "channel", "one count of the converter", bounds=(0.0, 1e4), prior=0.001, of="channel", fixed=True
    )

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        return self.step * np.round(y / self.step) if self.step else y.copy()
