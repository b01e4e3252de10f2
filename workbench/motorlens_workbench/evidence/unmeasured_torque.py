"""A torque that nobody measured: what the noise of a model takes for it, over time.

It is a rival of every hypothesis (see `standing`). Where no hypothesis is beyond chance and the model, left to itself, is
still far off, it is what the recordings show instead: a load, more often than not.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.innovations import disturbances, read
from motorlens_physics.estimate.noise import TORQUE
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
        sd_Nm: what that is good to.
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


def unmeasured_torque(here: Standing) -> UnmeasuredTorque:
    """Of the model that stands."""
    won = [_won(line) for line in here.lines]
    line = here.lines[int(np.argmax(won))]
    noise, time = noise_of(line), line.run.inputs.time_s
    seen, _, _ = disturbances(*_heard(line))
    torque = seen[:, TORQUE]
    # At the likeliest variance that is the square of what is expected, and of how uncertain that is, in the mean.
    left = float(noise.disturbances[TORQUE] - np.mean(torque**2))
    begins = np.unique(np.linspace(0, len(time), POINTS, endpoint=False).astype(int))
    counts = np.diff(np.append(begins, len(time)))
    return UnmeasuredTorque(
        line.run.name,
        np.add.reduceat(time, begins) / counts,
        np.add.reduceat(torque, begins) / counts,
        float(np.sqrt(max(left, 0.0))),
        sum(won),
    )


def _won(line: Line) -> float:
    with_it, without = (
        float(np.sum(unlikely_samples(line, noise, line.error)))
        for noise in (noise_of(line), likeliest_without(line, slice(TORQUE, TORQUE + 1)))
    )
    return without - with_it


def _heard(line: Line):  # type: ignore[no-untyped-def]
    heard = read(noise_of(line).space(line.run, line.linear, line.run.there), line.error)
    return heard.space, heard.filtered
