"""The population of a make: what its motors have in common, by how much they differ, and which of them do not belong.

Two levels as in pharmacometrics (FOCEI; Wang 2007, doi:10.1007/s10928-007-9060-6): parameters of a motor are normal around
those of the make, those of a recording around those of its motor. The parabola of a recording is quadratic in the
parameters themselves, so that with them both levels are exact; where it is taken, `study` says. A motor that is too far from
the others to be one of them is left out of the estimate of what they have in common, and is still compared with it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_workbench.fleet.directions import (
    Directions,
    Observation,
    Scale,
    directions,
    on_scale,
    prior_of,
    scale_of,
)
from motorlens_workbench.fleet.levels import Data, Solved, Spreads, led_away, solve, spreads
from motorlens_workbench.fleet.odd import (
    FALSE_ALARMS,
    Difference,
    MakeEffect,
    alike,
    compared,
    differences,
    make_effect,
    surprise,
)

Array = NDArray[np.float64]

# How often it is asked anew which motors belong.
TURNS = 8


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
        wide: their parabolas on the scale, candidates included.
        data: the same in the free parameters.
        spreads: between motors, and between recordings of one motor.
        solved: the model with all motors, at the mean of those that belong; motors as of a make that together with them is
            off by what was known beforehand, see `_of_motors`.
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
    wide: Directions
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

    def of_recordings(self) -> Array:
        """(R, k) likeliest parameters of each motor as each recording found it, given all recordings."""
        return self.scale.natural(self.solved.recording)

    def alone(self) -> tuple[Array, Array]:
        """(M, k) the same from the recordings of each motor alone, and what was known beforehand.

        By how much recordings of one motor differ is taken from all: a motor's own few do not tell it.
        """
        covariance = np.linalg.inv(self.solved.motor_information + np.diag(self.known**-2))
        phi = np.einsum("mij,mj->mi", covariance, self.solved.motor_vector)
        return self._natural(phi, np.diagonal(covariance, axis1=1, axis2=2))

    def interval(self) -> tuple[Array, Array]:
        """(M, k) lower and upper ends of the 95 % intervals of `of_motors`."""
        phi = self.solved.mean + self.solved.motor
        off = 1.96 * np.sqrt(np.diagonal(self.solved.motor_covariance, axis1=1, axis2=2))
        return self.scale.natural(phi - off), self.scale.natural(phi + off)

    def new_motor(self) -> MotorFile:
        """The motor file of the make: what may be expected of a motor that was not recorded yet."""
        values, _ = self.mean()
        width = np.sqrt(np.diagonal(self.solved.covariance) + self.between**2 + self.spreads.psi**2)
        sd = np.minimum(width, self.known) * self.scale.size
        source = f"population of {len(self.motors)} motors, {len(self.observations)} recordings"
        told = [k for k in range(len(self.keys)) if width[k] < self.known[k]]
        known = {self.keys[k]: Knowledge(float(sd[k]), source) for k in told}
        found = self.file.with_values({self.keys[k]: float(values[k]) for k in told}, known)
        return replace(found, name=f"make of {self.file.name}")

    def led_away(self, observations: Sequence[Observation]) -> Array:
        """(k,) by how much such recordings of its motors lead away from them: standard deviations, on the scale."""
        mine = [
            o for o in observations if o.motor in self.motors and self.belongs[self.motors.index(o.motor)]
        ]
        if not mine:
            return np.zeros(len(self.keys))
        number = np.array([self.motors.index(o.motor) for o in mine])
        information, vector = on_scale(mine, self.keys, self.scale)
        data = replace(self.data, information=information, vector=vector, motor=number)
        sd = np.sqrt(np.maximum(np.diagonal(self.solved.motor_covariance, axis1=1, axis2=2), 0.0))
        return led_away(data, self.solved.mean + self.solved.motor, sd)

    def _natural(self, phi: Array, variance: Array) -> tuple[Array, Array]:
        return self.scale.natural(phi), np.sqrt(np.maximum(variance, 0)) * self.scale.size


def population(
    file: MotorFile, observations: Sequence[Observation], needless: Collection[str] = ()
) -> Population:
    """The population of recordings that were fitted with a motor file; at least one.

    What it lacks is none of what has turned out `needless`.
    """
    prior = prior_of(file, observations)
    keys, scale, known = prior.keys, *scale_of(file, prior)
    motors = tuple(sorted({o.motor for o in observations}))
    number = np.array([motors.index(o.motor) for o in observations])
    wide = directions(file, observations, keys, scale)
    on_own = on_scale(observations, keys, scale)
    belongs = np.ones(len(motors), dtype=bool)
    for _ in range(TURNS):
        data = Data(*on_own, number, len(motors), known, belongs)
        estimated = spreads(data)
        between = _between(estimated, known)
        off = compared(wide, data, between, estimated.psi)
        like = alike(off.gains())
        # More than half of the motors are the make, whatever they are.
        if 2 * np.count_nonzero(like) <= len(motors) or np.all(like == belongs):
            break
        belongs = like
    solved = _of_motors(data, estimated, between)
    return Population(
        file, keys, scale, known, motors, tuple(observations), wide, data, estimated, solved, data.belongs,
        make_effect(wide, data, estimated.psi, needless), differences(wide, off), surprise(off.gains()),
    )  # fmt: skip


def varies(found: Population, effect: MakeEffect) -> bool:
    """Whether motors of the make differ in an effect that is in the motor file."""
    return effect.key in found.keys and bool(found.spreads.omega[found.keys.index(effect.key)] > 0)


def needed(found: Population, effect: MakeEffect) -> bool:
    """Whether the make has more of an effect of the motor file than chance would make of none, or motors differ in it."""
    if effect.key not in found.keys:
        return False
    if varies(found, effect):
        return True
    k, null = found.keys.index(effect.key), found.file.meaning(effect.key).null
    assert null is not None
    off = found.solved.mean[k] - (null - found.scale.centre[k]) / found.scale.size[k]
    return bool(off**2 > chi2.isf(FALSE_ALARMS, 1) * found.solved.covariance[k, k])


def _between(found: Spreads, known: Array) -> Array:
    # Motors of one make do not differ by more than was possible beforehand.
    return np.asarray(np.minimum(found.likely[0], np.maximum(found.omega, known)))


def _of_motors(data: Data, found: Spreads, between: Array) -> Solved:
    """The mean, and all motors about it.

    What was known beforehand was known of a motor, which is off with its make and by itself. Were both as wide as that, a
    motor of which recordings tell nothing would be known less for being one of a make. Of the mean alone it is all that is
    known, whatever a spread that is not told may be. A spread that is told is narrower by far, or shows that what was said
    to be known was not so.
    """
    make, known = solve(data, between, found.psi), data.known
    left = np.sqrt(np.maximum(known**2 - between**2, 0.0))
    about = replace(data, known=np.where(found.omega > 0, known, left))
    off = np.diagonal(solve(about, between, found.psi).covariance)
    # One that is not like the others may be anything that was possible beforehand.
    stranger = np.maximum(between, np.sqrt(np.maximum(known**2 - off, 0.0)))
    each = solve(about, np.where(data.belongs[:, None], between, stranger), found.psi)
    return replace(each, mean=make.mean, covariance=make.covariance, motor=each.mean + each.motor - make.mean)
