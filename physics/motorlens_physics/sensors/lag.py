"""Lag of a sensor."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numba import njit
from scipy.linalg import solveh_banded

from motorlens_physics.parameter import Parameter, param
from motorlens_physics.sensor_model import Array, SensorModel

# Typical time constants in s: a filter before the converter, an encoder's averaging, a thermocouple in a coil.
LAG_OF_CHANNEL = {"voltage": 1e-3, "current": 1e-3, "speed": 1e-2, "temperature": 30.0, "load_torque": 1e-2}

# How much the square of a second difference counts beside that of an error, of what lags long: white noise grows as a
# difference over two steps would make it grow, and corners are smoothed less than by that (`test_every_sensor.py`). Of what
# lags by less than a sample it counts ever less, as the cube of how little the sample before weighs.
ROUGH = 0.1


@dataclass(frozen=True)
class SensorLag(SensorModel):
    """A sensor that follows with a first-order lag: tau ds/dt = y - s.

    `read` is the lag to first order, y - tau dy/dt; `record` is exact (y linear between samples). Its inverse is, too, where
    the lag is much shorter than a sample; a longer one hides what alternates from one sample to the next, and `unrecord`
    gives the smoothest y that shows nearly the same.
    Bentley (2005), Principles of Measurement Systems, 4th edition, ISBN 978-0-13-043028-1, section 4.1.

    >>> SensorLag("speed", tau=0.02).read(40.0, 300.0)  # 40 - 0.02 300
    34.0
    """

    kind: ClassVar[str] = "lag"
    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "no_load_steps", "duty")

    tau: float = param(0.0, "s", "time constant", bounds=(0.0, 1e4), prior=0.01, null=0.0)

    def parameters(self) -> dict[str, Parameter]:
        lag = super().parameters()["tau"]
        return {"tau": replace(lag, prior=LAG_OF_CHANNEL[self.channel])}

    def read(self, y: Any, rate: Any) -> Any:
        return y - self.tau * rate

    def record(self, time_s: Array, y: Array, rng: np.random.Generator) -> Array:
        if self.tau == 0 or len(y) < 2:
            return y.copy()
        # On a ramp the sensor settles tau times the slope behind; only the distance from there decays. Before the first
        # sample the quantity is taken to have rested.
        dt = np.diff(time_s)
        keep = np.exp(-dt / self.tau)
        slope = np.diff(y) / dt
        settled = y[:-1] - self.tau * slope
        return np.asarray(_decayed(keep, settled * (1 - keep) + slope * dt, float(y[0])))

    def unrecord(self, time_s: Array, shown: Array) -> Array:
        if self.tau == 0 or len(shown) < 3:
            return shown
        # What a step adds to what is shown is a mean of the quantity at its two ends. The more alike both weigh, the less is
        # told of what alternates from sample to sample: least squares, with second differences taken for errors as well.
        dt = np.diff(time_s)
        # Of the distance to where the sensor settles, one over the share that goes in a step.
        steps = -1 / np.expm1(-dt / self.tau)
        mean = shown[:-1] + steps * np.diff(shown)
        weights = 1 - steps + self.tau / dt, steps - self.tau / dt
        rough = ROUGH * (weights[0] / weights[1]) ** 3
        # The upper bands of the normal equations. The first sample is taken to be on the line through the first two shown.
        bands, right = np.zeros((3, len(shown))), np.zeros(len(shown))
        bands[2, 0], right[0] = 1.0, shown[0] + self.tau * (shown[1] - shown[0]) / dt[0]
        _add(bands, weights, np.ones(len(mean)))
        _add(bands, (1.0, -2.0, 1.0), rough[1:])
        right[:-1] += weights[0] * mean
        right[1:] += weights[1] * mean
        return np.asarray(solveh_banded(bands, right))


def _add(bands: Array, row: tuple[float | Array, ...], counts: Array) -> None:
    """Add the squares of a row of coefficients of neighbours, so much each, to the bands of normal equations."""
    for i, one in enumerate(row):
        for j, other in enumerate(row[i:], start=i):
            bands[2 - (j - i), j : j + len(counts)] += counts * one * other


@njit(cache=True, nogil=True)
def _decayed(keep, drive, first):  # type: ignore[no-untyped-def]
    shown = np.empty(len(drive) + 1)
    shown[0] = first
    for k in range(len(drive)):
        shown[k + 1] = keep[k] * shown[k] + drive[k]
    return shown
