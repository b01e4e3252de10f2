"""One recording and the model's free run on it: the error, in units of its noise and by frequency."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from motorlens_physics.estimate.free_run import FreeRun
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.run import STATE_OF
from motorlens_workbench.balances import EQUATIONS, missing_of

Array = NDArray[np.float64]

# No channel is measured to so little (A, rad/s, K): the least noise by which an error is divided.
NOISELESS = 1e-12


@dataclass(frozen=True)
class Overlay(FreeRun):
    """One recording and the model's free run on it, of whose states those that were not measured, and what each equation
    lacks."""

    missing: Mapping[str, NDArray[np.float32]]  # equation -> (N,) in the unit of `EQUATIONS`, as it is drawn

    def error_of(self, channel: str) -> Array:
        """(N,) measured less predicted; 0 where nothing was measured."""
        k = self.run.channels.index(channel)
        return np.where(self.run.valid, self.run.measured[:, k] - self.predicted[:, k], 0.0)

    @property
    def band_Hz(self) -> tuple[float, float]:
        """The lowest and the highest frequency of its spectra."""
        time = self.run.inputs.time_s
        samples = next_fast_len(len(time), real=True)
        lowest = (1 - 1 / samples) / float(time[-1] - time[0])
        return lowest, lowest * (samples // 2)

    def spectrum(self, channel: str) -> tuple[Array, Array]:
        """Frequencies (Hz) and power (unit^2, one-sided, sums to the mean square) of the error of a channel."""
        time = self.run.inputs.time_s
        # Evenly resampled, to as many samples as have a fast transform.
        even = np.linspace(time[0], time[-1], next_fast_len(len(time), real=True))
        power = _power(np.interp(even, time, self.error_of(channel)))
        return np.fft.rfftfreq(len(even), even[1] - even[0]), power

    @property
    def noise(self) -> Array:
        """(C,) the floor, in the order of `run.channels`; a channel at rest has none, and is given `NOISELESS`."""
        return np.maximum(self.floor, NOISELESS)

    @property
    def in_sigma(self) -> Array:
        """(N,) error of a sample in standard deviations of the noise, over its channels."""
        whole = np.zeros(len(self.run.valid))
        for channel, noise in zip(self.run.channels, self.noise, strict=True):
            whole += (self.error_of(channel) / noise) ** 2
        return np.sqrt(whole / len(self.run.channels))

    def state(self, channel: str) -> Array:
        """(N,) a measured output, or the simulated one where it was not measured."""
        if channel in self.run.channels:
            return self.run.measured[:, self.run.channels.index(channel)]
        simulated = self.trajectory.states[STATE_OF[channel]]
        return simulated + self.trajectory.inputs.ambient_C if channel == "temperature" else simulated


def overlay_of(model: Model, r: int, one: FreeRun) -> Overlay:
    """Recording `r` of a model beside its free run."""
    missing = missing_of(model, one.run, r, one.trajectory, one.predicted)
    drawn = {name: missing.pop(name).astype(np.float32) for name in EQUATIONS}
    # What was measured is drawn and sorted by as measured: of the simulation the rest is kept.
    seen = {STATE_OF[channel] for channel in one.run.channels}
    unseen = {name: y.copy() for name, y in one.trajectory.states.items() if name not in seen}
    return Overlay(one.run, replace(one.trajectory, states=unseen), one.predicted, one.floor, drawn)


def _power(y: Array) -> Array:
    power = np.abs(np.fft.rfft(y)) ** 2 / len(y) ** 2
    power[1 : -1 if len(y) % 2 == 0 else None] *= 2
    return np.asarray(power)
