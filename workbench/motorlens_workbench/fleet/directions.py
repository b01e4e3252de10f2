"""What recordings say, on a scale: in the directions of the free parameters, then of candidates at their null."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.prior import Prior, part_prior, textbook_prior
from motorlens_physics.motor_file import MotorFile
from motorlens_workbench.fleet.levels import Data
from motorlens_workbench.fleet.summary import Parabola, with_candidates

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Observation:
    """A recording of a motor, and what it says."""

    motor: str
    name: str
    date: datetime | None
    parabola: Parabola


@dataclass(frozen=True, eq=False)
class Scale:
    """Between parameters x and numbers of size 1: x = centre + size phi.

    Attributes:
        centre: (k,) what was expected beforehand.
        size: (k,) the same, positive, where a parameter is one of the textbook's; else its typical size.
        relative: (k,) where a deviation on the scale is a share of the parameter.
        bounds: (2, k) the physically possible values.
    """

    centre: Array
    size: Array
    relative: NDArray[np.bool_]
    bounds: Array

    def natural(self, phi: Array) -> Array:
        """(..., k) parameters; the nearest possible one where phi is beyond it."""
        return np.asarray(np.clip(self.centre + self.size * phi, *self.bounds))

    def limits(self) -> Array:
        """(2, k) the bounds on the scale."""
        return np.asarray((self.bounds - self.centre) / self.size)


@dataclass(frozen=True, eq=False)
class Directions:
    """Recordings in the directions of k free parameters, then of candidates.

    Attributes:
        keys: of both, K.
        free: k.
        file: with the candidates at their null.
        scale: of both.
        information: (R, K, K) and `vector` (R, K): the parabolas on the scale.
    """

    keys: tuple[str, ...]
    free: int
    file: MotorFile
    scale: Scale
    information: Array
    vector: Array

    def data(self, of: Data, expected: float) -> Data:
        """The model's data in all directions.

        Args:
            of: the data in the free parameters.
            expected: standard deviation, in typical sizes, of what all motors may have of a candidate; 0: none has it.
        """
        known = np.concatenate([of.known, np.full(len(self.keys) - self.free, expected)])
        return replace(of, information=self.information, vector=self.vector, known=known)

    def padded(self, values: Array) -> Array:
        """(K,) spreads of the free parameters, with 0 for the candidates."""
        return np.concatenate([values, np.zeros(len(self.keys) - self.free)])


def directions(
    file: MotorFile, observations: Sequence[Observation], keys: Sequence[str], scale: Scale
) -> Directions:
    """Recordings in the directions of free parameters, and of all candidates that they reach into."""
    switches = tuple(dict.fromkeys(key for o in observations for key in o.parabola.keys if key not in keys))
    file = with_candidates(file, [key.rpartition(".")[0] for key in switches])
    every = (*keys, *switches)
    if switches:
        own, _ = scale_of(file, prior_of(file, observations, switches))
        scale = Scale(
            np.concatenate([scale.centre, own.centre]), np.concatenate([scale.size, own.size]),
            np.concatenate([scale.relative, own.relative]), np.hstack([scale.bounds, own.bounds]),
        )  # fmt: skip
    information, vector = on_scale(observations, every, scale)
    return Directions(every, len(keys), file, scale, information, vector)


def prior_of(file: MotorFile, observations: Sequence[Observation], switches: Sequence[str] = ()) -> Prior:
    """What is known beforehand of the parameters that the recordings were fitted with, or of some switches."""
    prior = textbook_prior(file)
    for part in file.parts:
        prior = prior.joined(part_prior(file, part.name()))
    there = {key for o in observations for key in o.parabola.keys}
    return prior.only(switches or [key for key in prior.keys if key in there])


def scale_of(file: MotorFile, prior: Prior) -> tuple[Scale, Array]:
    """The scale of the parameters of a prior, and (k,) their deviations beforehand on it."""
    centre, sd = np.array(list(prior.centre.values())), np.array(list(prior.sd.values()))
    relative = np.array(["." not in key and prior.centre[key] > 0 for key in prior.keys])
    typical = np.array([abs(file.meaning(key).sd(file.rated)) for key in prior.keys])
    size = np.where(relative, np.abs(centre), np.where(typical > 0, typical, sd))
    bounds = np.array([file.meaning(key).bounds for key in prior.keys]).T
    return Scale(centre, size, relative, bounds), sd / size


def on_scale(observations: Sequence[Observation], keys: Sequence[str], scale: Scale) -> tuple[Array, Array]:
    """(R, k, k) information and (R, k) vector of parabolas on the scale.

    Parameters of a parabola that are not among the keys stay where it was found: a candidate at its null.
    """
    count = len(keys)
    information, vector = np.zeros((len(observations), count, count)), np.zeros((len(observations), count))
    for r, o in enumerate(observations):
        mine = [k for k, key in enumerate(keys) if key in o.parabola.keys]
        of = [o.parabola.keys.index(keys[k]) for k in mine]
        table, size = o.parabola.information[np.ix_(of, of)], scale.size[mine]
        information[r][np.ix_(mine, mine)] = size[:, None] * table * size
        vector[r, mine] = size * (o.parabola.gradient[of] + table @ (o.parabola.at[of] - scale.centre[mine]))
    return information, vector
