"""Lag of a sensor."""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numba import njit

from motorlens_physics.parameter import Parameter, param
from motorlens_physics.sensor_model import Array, SensorModel

# Typical time constants in s: a filter before the converter, an encoder's averaging, a thermocouple in a coil.
LAG_OF_CHANNEL = {"voltage": 1e-3, "current": 1e-3, "speed": 1e-2, "temperature": 30.0, "load_torque": 1e-2}


@dataclass(frozen=True)
class SensorLag(SensorModel):
    """A sensor that follows with a first-order lag: tau ds/dt = y - s.

    `read` is the lag to first order, y - tau dy/dt; `record` and `unread` are exact (y linear between samples).
    Bentley (2005), Principles of Measurement Systems, 4th edition, ISBN 978-0-13-043028-1, section 4.1.

    >>> SensorLag("speed", tau=0.02).unread(40.0, 300.0)  # 40 + 0.02 300
    46.0
    """

    kind: ClassVar[str] = "lag"
    excited_by: ClassVar[tuple[str, ...]] = ("direct_on_line", "no_load_steps", "duty")

    tau: float = param(0.0, "s", "time constant", bounds=(0.0, 1e4), prior=0.01, null=0.0)

    def parameters(self) -> dict[str, Parameter]:
        lag = super().parameters()["tau"]
        return {"tau": replace(lag, prior=LAG_OF_CHANNEL[self.channel])}

    def read(self, y: Any, rate: Any) -> Any:
        return y - self.tau * rate

    def unread(self, shown: Any, rate: Any) -> Any:
        return shown + self.tau * rate

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


@njit(cache=True, nogil=True)
def _decayed(keep, drive, first):  # type: ignore[no-untyped-def]
    shown = np.empty(len(drive) + 1)
    shown[0] = first
    for k in range(len(drive)):
        shown[k + 1] = keep[k] * shown[k] + drive[k]
    return shown
