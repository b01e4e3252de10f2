"""A torque that nobody measured: what the noise of a model takes for it, over time.

It is a rival of every hypothesis (see `standing`). Where no hypothesis is beyond chance and the model, left to itself, is
still far off, it is what the recordings show instead: a load, more often than not.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.estimate.innovations import disturbances, read
from motorlens_physics.estimate.noise import TORQUE, Noise
from motorlens_physics.estimate.signals import decaying
from motorlens_workbench.criteria import INTERVAL
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.standing import Standing, likeliest_without, noise_of, unlikely_samples

Array = NDArray[np.float64]

# As many points as a picture shows.
POINTS = 400


@dataclass(frozen=True)
class UnmeasuredTorque:
    """What drove a shaft beside the motor and the load that was measured.

    Attributes:
        recording: in which it tells most.
        time_s: (k,) in it.
        torque_Nm: (k,) expected there, given all that was measured.
        sd_Nm: what that is good to, in the mean of all samples.
        won: by all recordings, twice the logarithm of how much likelier they are with such a torque than without.
    """

    recording: str
    time_s: Array
    torque_Nm: Array
    sd_Nm: float
    won: float
    term: str = "torque"
    against: str = "time"
    unit: str = "N*m"

    @property
    def size(self) -> str:
        """How large it is, for the reader; with its mean, if that is told."""
        mean = float(np.mean(self.torque_Nm))
        about = f" about a mean of {mean:.2g} {self.unit}" if abs(mean) > INTERVAL * self.sd_Nm else ""
        return f"{float(np.ptp(self.torque_Nm)):.2g} {self.unit} from the least to the most{about} in {self.recording}"


def unmeasured_torque(here: Standing) -> UnmeasuredTorque:
    """Of the model that stands."""
    won = [_won(line) for line in here.lines]
    line = here.lines[int(np.argmax(won))]
    noise, time = noise_of(line), line.run.inputs.time_s
    torque, drawn = _expected(line, noise, line.error), _drawn(line, noise)
    # How far the smoother is off does not depend on what it smooths (Durbin and Koopman 2012,
    # doi:10.1093/acprof:oso/9780199641178.001.0001, section 4.9).
    off = _expected(line, noise, drawn.error) - drawn.torque_Nm
    begins = np.unique(np.linspace(0, len(time), POINTS, endpoint=False).astype(int))
    counts = np.diff(np.append(begins, len(time)))
    return UnmeasuredTorque(
        line.run.name,
        np.add.reduceat(time, begins) / counts,
        np.add.reduceat(torque, begins) / counts,
        float(np.sqrt(np.mean(off**2))),
        sum(won),
    )


def _won(line: Line) -> float:
    with_it, without = (
        float(np.sum(unlikely_samples(line, noise, line.error)))
        for noise in (noise_of(line), likeliest_without(line, slice(TORQUE, TORQUE + 1)))
    )
    return without - with_it


def _expected(line: Line, noise: Noise, error: Array) -> Array:
    """(N,) the torque that errors (N, C) show."""
    heard = read(noise.space(line.run, line.linear, line.run.there), error)
    seen, _, _ = disturbances(heard.space, heard.filtered)
    return np.asarray(seen[:, TORQUE])


class _Drawn(NamedTuple):
    torque_Nm: Array
    error: Array


def _drawn(line: Line, noise: Noise) -> _Drawn:
    """A torque (N,) as it may be, and the errors (N, C) that it leaves beside all other noise of the run."""
    run, rng = line.run, np.random.default_rng(0)
    none = np.zeros(len(line.error))

    def lasting(variance: float, lasts_s: float) -> Array:
        keep = float(np.exp(-run.period_s / lasts_s))
        return decaying(np.sqrt(variance * (1 - keep**2)) * rng.standard_normal(len(none)), keep)

    torque = lasting(noise.disturbances[TORQUE], noise.lasts_s[TORQUE])
    error = line.of_forcing(Forcing(none, torque, none))[:, :, 0]
    voltage, load = noise.drawn(run, rng).T
    error += line.of_forcing(Forcing(voltage, load, none), held=run.inputs.hold)[:, :, 0]
    error += np.sqrt(noise.of_samples(run)) * rng.standard_normal(error.shape)
    for c, variance in enumerate(noise.lasting_of_channels(run)):
        if variance > 0:
            error[:, c] += lasting(variance, noise.lasts_s[-1])
    return _Drawn(torque, error)
