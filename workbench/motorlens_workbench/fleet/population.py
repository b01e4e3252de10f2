"""The population of a make: what its motors have in common, by how much they differ, and which of them do not belong.

Two levels as in pharmacometrics (FOCEI; Wang 2007, doi:10.1007/s10928-007-9060-6): parameters of a motor are normal around
those of the make, those of a recording around those of its motor. The parabola of a recording is quadratic in the
parameters themselves, so that with them both levels are exact, and no point has to be chosen at which logarithms would be
straight. A motor that is too far from the others to be one of them is left out of the estimate of what they have in
common, and is still compared with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from motorlens_physics.estimate.prior import Prior, part_prior, textbook_prior
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_workbench.fleet.levels import MOST, Data, Solved, Spreads, misfit, solve, spreads
from motorlens_workbench.fleet.summary import TELLS, Parabola, with_candidates

Array = NDArray[np.float64]

# Share of fleets in which a motor that is like the others is said to be odd.
FALSE_ALARMS = 0.01
# An effect helps a motor if twice the logarithm of its likelihood rises by this: 5 % by chance.
HELPS_ONE = 3.84
# An effect is the make's if it helps this share of the motors (ctsem's `groupFreeThreshold`, Driver 2024).
MOST_OF_THEM = 0.5
# How often it is asked anew which motors belong.
TURNS = 8
# Candidates within this of the best are not told from it: twice the logarithm of the likelihood at the 1 % level.
ALIKE = 6.63
# Effects whose scores are so correlated (squared) are one to these recordings.
SAME = 0.95
# A motor is said to differ in so many parameters at most.
DIFFERENCES = 3


@dataclass(frozen=True)
class Observation:
    """A recording of a motor, and what it says."""

    motor: str
    name: str
    date: datetime | None
    parabola: Parabola


@dataclass(frozen=True)
class Difference:
    """A parameter, or an effect, by which a motor differs from its make: by how much, in its unit, and twice the gain in
    the logarithm of the likelihood; `alike` are keys that would explain it as well."""

    key: str
    by: float
    sd: float
    gain: float
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class MakeEffect:
    """An effect that most motors have: its key, in which share of them it helps, and what is not told from it."""

    key: str
    share: float
    gain: float
    alike: tuple[str, ...]

    @property
    def of_sensor(self) -> bool:
        """Whether it is a fault of the sensors with which all were recorded, and none of the motors."""
        return "_sensor_" in self.key


@dataclass(frozen=True, eq=False)
class Scale:
    """Between parameters x and numbers of size 1: x = centre + size phi.

    Attributes:
        centre: (k,) what was expected beforehand.
        size: (k,) the same, positive, where a parameter is one of the textbook's; else its typical size.
        relative: (k,) where a deviation on the scale is a share of the parameter.
    """

    centre: Array
    size: Array
    relative: NDArray[np.bool_]

    def natural(self, phi: Array) -> Array:
        """(..., k) parameters."""
        return np.asarray(self.centre + self.size * phi)


@dataclass(frozen=True, eq=False)
class Population:
    """What was found.

    Attributes:
        file: the motor file that the recordings were fitted with.
        keys: k parameters of that file that are free.
        scale: of the keys.
        known: (k,) deviation of each beforehand, on the scale.
        motors: M names.
        observations: R recordings.
        data: their parabolas on the scale.
        spreads: between motors, and between recordings of one motor.
        solved: the model with all motors, at the mean of those that belong.
        belongs: (M,) whether a motor took part in the estimate of the mean and the spreads.
        lacks: an effect of the make that the motor file lacks; None if none shows.
        differences: (M,) by what each motor differs, the most telling first; empty for one like the others.
        oddness: (M,) -log10 of the probability that chance makes a motor so different, all its parameters counted.
    """

    file: MotorFile
    keys: tuple[str, ...]
    scale: Scale
    known: Array
    motors: tuple[str, ...]
    observations: tuple[Observation, ...]
    data: Data
    spreads: Spreads
    solved: Solved
    belongs: NDArray[np.bool_]
    lacks: MakeEffect | None
    differences: tuple[tuple[Difference, ...], ...]
    oddness: Array

    @property
    def between(self) -> Array:
        """(k,) spread between motors that is to be reckoned with, on the scale."""
        return _between(self.spreads, self.known)

    def mean(self) -> tuple[Array, Array]:
        """(k,) parameters of the make and their deviations."""
        return self._natural(self.solved.mean, np.diagonal(self.solved.covariance))

    def of_motors(self) -> tuple[Array, Array]:
        """(M, k) parameters of each motor and their deviations, given all recordings; for an odd one, its own alone."""
        phi = self.solved.mean + self.solved.motor
        variance = np.diagonal(self.solved.motor_covariance, axis1=1, axis2=2)
        return self._natural(phi, variance)

    def alone(self) -> tuple[Array, Array]:
        """(M, k) the same from the recordings of each motor alone, and what was known beforehand."""
        information = np.zeros((len(self.motors), len(self.keys), len(self.keys)))
        vector = np.zeros((len(self.motors), len(self.keys)))
        np.add.at(information, self.data.motor, self.data.information)
        np.add.at(vector, self.data.motor, self.data.vector)
        covariance = np.linalg.inv(information + np.diag(self.known**-2))
        phi = np.einsum("mij,mj->mi", covariance, vector)
        return self._natural(phi, np.diagonal(covariance, axis1=1, axis2=2))

    def interval(self) -> tuple[Array, Array]:
        """(M, k) lower and upper ends of the 95 % intervals of `of_motors`."""
        value, sd = self.of_motors()
        return value - 1.96 * sd, value + 1.96 * sd

    def new_motor(self) -> MotorFile:
        """The motor file of the make: what may be expected of a motor that was not recorded yet."""
        values, _ = self.mean()
        width = np.sqrt(np.diagonal(self.solved.covariance) + self.between**2 + self.spreads.psi**2)
        sd = np.minimum(width, self.known) * self.scale.size
        source = f"population of {len(self.motors)} motors, {len(self.observations)} recordings"
        told = [k for k in range(len(self.keys)) if width[k] < self.known[k]]
        known = {self.keys[k]: Knowledge(float(sd[k]), source) for k in told}
        bounds = [self.file.meaning(key).bounds for key in self.keys]
        inside = {self.keys[k]: min(max(float(values[k]), bounds[k][0]), bounds[k][1]) for k in told}
        found = self.file.with_values(inside, known)
        return replace(found, name=f"make of {self.file.name}")

    def _natural(self, phi: Array, variance: Array) -> tuple[Array, Array]:
        return self.scale.natural(phi), np.sqrt(np.maximum(variance, 0)) * self.scale.size


def population(file: MotorFile, observations: Sequence[Observation]) -> Population:
    """The population of recordings that were fitted with a motor file; at least one."""
    prior = _prior(file, observations)
    keys, scale, known = prior.keys, *_scale(file, prior)
    motors = tuple(sorted({o.motor for o in observations}))
    number = np.array([motors.index(o.motor) for o in observations])
    belongs = np.ones(len(motors), dtype=bool)
    information, vector = _on_scale(observations, keys, scale)
    for _ in range(TURNS):
        data = Data(information, vector, number, len(motors), known, belongs)
        estimated = spreads(data)
        solved, likely = _judged(data, estimated)
        if np.all(likely == belongs):
            break
        belongs = likely
    found = Population(
        file, keys, scale, known, motors, tuple(observations), data, estimated, solved, data.belongs, None,
        ((),) * len(motors), np.zeros(len(motors)),
    )  # fmt: skip
    differences, oddness = _differences(found)
    return replace(found, lacks=_make_effect(found), differences=differences, oddness=oddness)


def _between(found: Spreads, known: Array) -> Array:
    # Motors of one make do not differ by more than was possible beforehand.
    return np.asarray(np.minimum(found.likely[0], np.maximum(found.omega, known)))


def _judged(data: Data, found: Spreads) -> tuple[Solved, NDArray[np.bool_]]:
    """All motors beside the mean of those that belong, and which of them do."""
    between = _between(found, data.known)
    surprise = _surprise(misfit(data, between, found.psi).gains())
    likely = surprise < -np.log10(FALSE_ALARMS / data.motors)
    # More than half of the motors are the make, whatever they are.
    likely = likely if likely.sum() > data.motors / 2 else data.belongs
    return solve(data, _strangers(between, data.known, data.belongs), found.psi), likely


def _prior(file: MotorFile, observations: Sequence[Observation], switches: Sequence[str] = ()) -> Prior:
    """What is known beforehand of the parameters that the recordings were fitted with, or of some switches."""
    prior = textbook_prior(file)
    for part in file.parts:
        prior = prior.joined(part_prior(file, part.name()))
    there = {key for o in observations for key in o.parabola.keys}
    return prior.only(switches or [key for key in prior.keys if key in there])


def _scale(file: MotorFile, prior: Prior) -> tuple[Scale, Array]:
    centre, sd = np.array(list(prior.centre.values())), np.array(list(prior.sd.values()))
    relative = np.array(["." not in key and prior.centre[key] > 0 for key in prior.keys])
    typical = np.array([abs(file.meaning(key).sd(file.rated)) for key in prior.keys])
    size = np.where(relative, np.abs(centre), np.where(typical > 0, typical, sd))
    return Scale(centre, size, relative), sd / size


def _on_scale(observations: Sequence[Observation], keys: Sequence[str], scale: Scale) -> tuple[Array, Array]:
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


def _strangers(between: Array, known: Array, belongs: NDArray[np.bool_]) -> Array:
    """(M, k) spreads by motor: one that is not like the others may be anything that was possible beforehand."""
    return np.where(belongs[:, None], between, np.maximum(between, known))


def _surprise(gains: Array) -> Array:
    """(M,) -log10 of the probability that the largest of so many gains is so large by chance (Bonferroni)."""
    tested = np.count_nonzero(gains > 0, axis=1)
    logarithm = (
        np.log(2) + norm.logsf(np.sqrt(gains.max(axis=1, initial=0.0))) + np.log(np.maximum(tested, 1))
    )
    return np.asarray(np.maximum(-logarithm / np.log(10), 0.0))


@dataclass(frozen=True, eq=False)
class Extended:
    """The population's recordings in the directions of its parameters, then of candidates.

    Attributes:
        keys: of both.
        file: with the candidates at their null.
        scale: of both.
        data: with spreads of 0 for the candidates, whose mean is their null.
        psi: between recordings.
    """

    keys: tuple[str, ...]
    file: MotorFile
    scale: Scale
    data: Data
    psi: Array


def extended(found: Population) -> Extended:
    """With all candidates of the recordings."""
    switches = tuple(
        dict.fromkeys(key for o in found.observations for key in o.parabola.keys if key not in found.keys)
    )
    file = with_candidates(found.file, [key.rpartition(".")[0] for key in switches])
    keys, nothing = (*found.keys, *switches), np.zeros(len(switches))
    scale = found.scale
    if switches:
        own, _ = _scale(file, _prior(file, found.observations, switches))
        scale = Scale(
            np.concatenate([scale.centre, own.centre]), np.concatenate([scale.size, own.size]),
            np.concatenate([scale.relative, own.relative]),
        )  # fmt: skip
    information, vector = _on_scale(found.observations, keys, scale)
    data = replace(
        found.data, information=information, vector=vector, known=np.concatenate([found.known, nothing])
    )
    return Extended(keys, file, scale, data, np.concatenate([found.spreads.psi, nothing]))


def _make_effect(found: Population) -> MakeEffect | None:
    """The candidate that explains most, of those that help most motors; None if there is none."""
    # Each motor by itself: what all have in common has already moved what they have in common.
    wide = extended(found)
    keys, file = wide.keys, wide.file
    nothing = np.zeros(len(keys) - len(found.keys))
    off = misfit(wide.data, np.concatenate([np.full(len(found.keys), MOST), nothing]), wide.psi)
    told = np.diagonal(off.information, axis1=1, axis2=2) > TELLS**-2
    helps = (off.gains() > HELPS_ONE) & told
    score, information = off.score[found.belongs], off.information[found.belongs].sum(axis=0)
    best: MakeEffect | None = None
    if len(found.motors) < 2 or len(keys) == len(found.keys):
        return None
    enough = float(chi2.isf(FALSE_ALARMS / (len(keys) - len(found.keys)), 1))
    for k in range(len(found.keys), len(keys)):
        total = float(score[:, k].sum())
        same = helps[found.belongs, k] & (np.sign(score[:, k]) == np.sign(total))
        counted = int(np.count_nonzero(told[found.belongs, k]))
        if 2 * counted < len(same) or not _possible(file, keys[k], total):
            continue
        share, gain = np.count_nonzero(same) / counted, total**2 / information[k, k]
        if share > MOST_OF_THEM and gain > max(enough, best.gain if best else 0.0):
            size = np.sqrt(np.diagonal(information))
            alike = [
                j for j in range(len(found.keys), len(keys))
                if j != k and information[j, k] ** 2 > SAME * (size[j] * size[k]) ** 2
                and _possible(file, keys[j], float(score[:, j].sum()))
            ]  # fmt: skip
            best = MakeEffect(keys[k], float(share), float(gain), tuple(keys[j] for j in alike))
    return best


def _differences(found: Population) -> tuple[tuple[tuple[Difference, ...], ...], Array]:
    """By what each motor differs, and how odd it is."""
    wide = extended(found)
    keys, file, size = wide.keys, wide.file, wide.scale.size
    off = misfit(wide.data, np.concatenate([found.between, np.zeros(len(keys) - len(found.keys))]), wide.psi)
    # What a motor does not tell it cannot be odd in; a candidate goes where its bounds let it.
    least = np.concatenate([found.known**-2, np.full(len(keys) - len(found.keys), TELLS**-2)])
    allowed = np.diagonal(off.information, axis1=1, axis2=2) > least
    for k in range(len(found.keys), len(keys)):
        allowed[:, k] &= [_possible(file, keys[k], float(score)) for score in off.score[:, k]]
    off = off.where(allowed)
    oddness = _surprise(off.gains())
    enough = float(chi2.isf(FALSE_ALARMS / (len(found.motors) * len(keys)), 1))
    said = []
    for m in range(len(found.motors)):
        mine: list[Difference] = []
        rest = off
        while len(mine) < DIFFERENCES:
            gains = rest.gains()[m]
            k = int(np.argmax(gains))
            if gains[k] < enough:
                break
            given = rest.given(m, k)
            after = given.gains()[m]
            alike = [
                keys[j] for j in np.flatnonzero((gains > gains[k] - ALIKE) & (after < HELPS_ONE)) if j != k
            ]
            information = rest.information[m, k, k]
            mine.append(Difference(
                keys[k], float(size[k] * rest.score[m, k] / information), float(size[k] / np.sqrt(information)),
                float(gains[k]), tuple(alike),
            ))  # fmt: skip
            rest = given
        said.append(tuple(mine))
    return tuple(said), oddness


def _possible(file: MotorFile, key: str, direction: float) -> bool:
    """Whether a candidate can go from its null in a direction, within its bounds."""
    meaning = file.meaning(key)
    assert meaning.null is not None
    return meaning.bounds[1] > meaning.null if direction > 0 else meaning.bounds[0] < meaning.null
