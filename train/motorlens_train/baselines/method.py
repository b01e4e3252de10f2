"""What a baseline is: something that is fitted to recordings and then estimates from voltage and current."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError

Array = NDArray[np.float64]
OUTPUTS = ("speed", "temperature", "resistance")
UNITS = {"speed": "rad/s", "temperature": "K", "resistance": "ohm"}


@dataclass(frozen=True)
class Estimate:
    """Estimates and one standard deviation of each, (N,): speed (rad/s), winding rise above ambient (K), resistance (ohm).

    What a method does not estimate is NaN.
    """

    speed: Array
    temperature: Array
    resistance: Array
    speed_sd: Array
    temperature_sd: Array
    resistance_sd: Array

    @property
    def values(self) -> Array:
        """(N, 3)."""
        return np.column_stack([self.speed, self.temperature, self.resistance])

    @property
    def sds(self) -> Array:
        """(N, 3)."""
        return np.column_stack([self.speed_sd, self.temperature_sd, self.resistance_sd])

    @staticmethod
    def of(values: Array, sds: Array) -> "Estimate":
        """From (N, 3) each."""
        return Estimate(*np.asarray(values, dtype=np.float64).T, *np.asarray(sds, dtype=np.float64).T)


class Method(Protocol):
    """An estimator of speed, temperature and resistance."""

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> Self:
        """The method fitted to recordings with their true channels, starting from a motor file.

        Raises:
            DataError: a recording lacks a channel the method cannot do without.
        """

    def estimate(self, recording: Recording) -> Estimate:
        """Estimates at every sample from voltage, current and time alone.

        Raises:
            DataError: the recording has no current.
        """


def inputs(recording: Recording) -> tuple[Array, Array, Array]:
    """Time (s), voltage (V), current (A), (N,) each; a missing sample of the current is interpolated.

    Raises:
        DataError: the recording has no current.
    """
    if not recording.has("current"):
        raise DataError(
            f"{recording.name}: no current column (current_A); estimation needs voltage and current"
        )
    time, current = recording.time_s, recording.channels["current"]
    missing = ~np.isfinite(current)
    if missing.any():
        current = np.interp(time, time[~missing], current[~missing])
    return time, recording.channels["voltage"], np.asarray(current)


def steps_of(time: Array) -> Array:
    """Step into each sample, (N,); the first takes the median step."""
    return np.diff(time, prepend=time[0] - float(np.median(np.diff(time))))


def truth(recording: Recording, motor_file: MotorFile) -> Array:
    """True outputs (N, 3), NaN where they were not measured.

    The rise is the winding's temperature less the ambient one (the rating plate's if none was measured); the resistance is
    its own channel, or follows from the rise by the motor file.
    """
    c, nothing = recording.channels, np.full(len(recording), np.nan)
    rise = c["temperature"] - c.get("ambient", motor_file.rated.ambient_C) if "temperature" in c else nothing
    resistance = c["resistance"] if "resistance" in c else np.asarray(motor_file.motor.resistance(rise))
    return np.column_stack([c.get("speed", nothing), rise, resistance])


def residual_sd(method: Method, recordings: Sequence[Recording], motor_file: MotorFile) -> Array:
    """Root mean square (3,) of a method's errors on recordings; NaN where the truth is not known."""
    total, count = np.zeros(3), np.zeros(3)
    for recording in recordings:
        squares = np.square(method.estimate(recording).values - truth(recording, motor_file))
        known = np.isfinite(squares)
        total += np.where(known, squares, 0.0).sum(0)
        count += known.sum(0)
    return np.asarray(np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan))


def low_pass(time: Array, u: Array, tau_s: float) -> Array:
    """First-order low-pass (N,), started at the first sample; exact for samples held until the next one."""
    return np.asarray(_low_pass(np.exp(-steps_of(time) / tau_s), np.asarray(u, dtype=np.float64)))


def _low_pass(decay: Array, u: Array) -> Array:
    if np.allclose(decay, decay[0], rtol=1e-9):
        from scipy.signal import lfilter

        a = float(decay[0])
        return np.asarray(lfilter([1 - a], [1, -a], u, zi=[a * u[0]])[0])
    y = np.empty_like(u)
    s = u[0]
    for k in range(len(u)):
        s = u[k] + (s - u[k]) * decay[k]
        y[k] = s
    return y
