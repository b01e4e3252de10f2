"""Which motors are not like the others, in what they differ, and what most of them have that the motor file lacks.

A motor is compared with the mean of those that belong, in the directions of the free parameters and of all candidates
(score tests). What all motors have of a candidate is no oddness of any: for this question its mean is free.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from motorlens_workbench.fleet.directions import Directions
from motorlens_workbench.fleet.levels import MOST, Data, Misfit, misfit
from motorlens_workbench.fleet.summary import TELLS

Array = NDArray[np.float64]

# Share of fleets in which a motor that is like the others is said to be odd.
FALSE_ALARMS = 0.01
# An effect helps a motor if twice the logarithm of its likelihood rises by this: 5 % by chance.
HELPS_ONE = 3.84
# An effect is the make's if it helps this share of the motors (ctsem's `groupFreeThreshold`, Driver 2024).
MOST_OF_THEM = 0.5
# Candidates within this of the best are not told from it: twice the logarithm of the likelihood at the 1 % level.
ALIKE = 6.63
# Effects whose scores are so correlated (squared) are one to these recordings.
SAME = 0.95
# A motor is said to differ in so many parameters at most.
DIFFERENCES = 3
# What all motors may have of a candidate: its typical size, as its prior says.
EXPECTED = 1.0


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
    """What most motors have: its key, in which share of them it helps, and what is not told from it."""

    key: str
    share: float
    gain: float
    alike: tuple[str, ...]

    @property
    def name(self) -> str:
        """Of the effect, or of the sensor's fault."""
        return self.key.rpartition(".")[0]

    @property
    def of_sensor(self) -> bool:
        """Whether it is a fault of the sensors with which all were recorded, and none of the motors."""
        return "_sensor_" in self.key


def compared(wide: Directions, data: Data, between: Array, psi: Array) -> Misfit:
    """Each motor beside the mean of those that belong, in every direction that its recordings tell.

    Args:
        wide: the recordings.
        data: the same in the free parameters, with the motors that belong.
        between, psi: (k,) spreads between motors, and between recordings.
    """
    off = misfit(wide.data(data, EXPECTED), wide.padded(between), wide.padded(psi), wide.scale.limits())
    # What a motor does not tell it cannot be odd in.
    least = np.concatenate([data.known**-2, np.full(len(wide.keys) - wide.free, TELLS**-2)])
    return off.where(np.diagonal(off.information, axis1=1, axis2=2) > least)


def surprise(gains: Array) -> Array:
    """(M,) -log10 of the probability that the largest of so many gains is so large by chance (Bonferroni)."""
    tested = np.count_nonzero(gains > 0, axis=1)
    logarithm = (
        np.log(2) + norm.logsf(np.sqrt(gains.max(axis=1, initial=0.0))) + np.log(np.maximum(tested, 1))
    )
    return np.asarray(np.maximum(-logarithm / np.log(10), 0.0))


def alike(gains: Array) -> NDArray[np.bool_]:
    """(M,) whether chance makes a motor so unlike the others in more than one of `FALSE_ALARMS` fleets."""
    return np.asarray(surprise(gains) < -np.log10(FALSE_ALARMS / len(gains)))


def make_effect(
    wide: Directions, data: Data, psi: Array, needless: Collection[str] = ()
) -> MakeEffect | None:
    """The candidate that explains most, of those that help most motors; None if there is none.

    Args:
        wide: the recordings.
        data: the same in the free parameters, with the motors that belong.
        psi: (k,) spreads between recordings.
        needless: keys of candidates that were in the motor file and did nothing there: no longer asked.
    """
    candidates = [k for k in range(wide.free, len(wide.keys)) if wide.keys[k] not in needless]
    if data.motors < 2 or not candidates:
        return None
    # Strangers are asked too: one may be strange by what most have, each in its own way. A few do not outvote the others.
    data = replace(data, belongs=np.ones(data.motors, dtype=bool))
    # Each motor by itself: what all have in common has already moved what they have in common.
    apart = wide.padded(np.full(wide.free, MOST))
    off = misfit(wide.data(data, 0.0), apart, wide.padded(psi), wide.scale.limits())
    told = np.diagonal(off.information, axis1=1, axis2=2) > TELLS**-2
    each, signs = off.gains(), np.sign(off.score)
    helps = (each > HELPS_ONE) & told
    score, table = off.score.sum(axis=0), off.information.sum(axis=0)
    together = replace(off, score=score[None], information=table[None]).gains()[0]
    counted = np.count_nonzero(told, axis=0)
    # What all have alike; else what they have, each in its own way: another offset in each sensor.
    for same, gains, free in (
        (helps & (signs == np.sign(score)), together, np.ones_like(counted)),
        (helps, np.sum(each * told, axis=0), counted),
    ):
        share = np.count_nonzero(same, axis=0) / np.maximum(counted, 1)
        enough = chi2.isf(FALSE_ALARMS / len(candidates), np.maximum(free, 1))
        asked = [
            k for k in candidates
            if 2 * counted[k] >= len(same) and share[k] > MOST_OF_THEM and gains[k] > enough[k]
        ]  # fmt: skip
        if asked:
            break
    else:
        return None
    best = max(asked, key=lambda k: float(gains[k]))
    size = np.sqrt(np.diagonal(table))
    group = [
        j for j in candidates
        if j == best or (gains[j] > 0 and table[j, best] ** 2 > SAME * (size[j] * size[best]) ** 2)
    ]  # fmt: skip
    # Where the recordings do not tell a fault of the sensors from an effect of the motors, the effect stands for both.
    k = max(group, key=lambda j: ("_sensor_" not in wide.keys[j], float(gains[j])))
    others = tuple(wide.keys[j] for j in group if j != k)
    return MakeEffect(wide.keys[k], float(share[k]), float(gains[k]), others)


def differences(wide: Directions, off: Misfit) -> tuple[tuple[Difference, ...], ...]:
    """(M,) by what each motor differs, the most telling first; empty for one like the others."""
    motors = len(off.score)
    enough = float(chi2.isf(FALSE_ALARMS / (motors * len(wide.keys)), 1))
    return tuple(_differences(wide.keys, wide.scale.size, off, m, enough) for m in range(motors))


def _differences(
    keys: Sequence[str], size: Array, off: Misfit, m: int, enough: float
) -> tuple[Difference, ...]:
    out: list[Difference] = []
    while len(out) < DIFFERENCES:
        gains = off.gains()[m]
        k = int(np.argmax(gains))
        if gains[k] < enough:
            break
        given = off.given(m, k)
        after = given.gains()[m]
        equal = [
            keys[j]
            for j in np.flatnonzero((gains > gains[k] - ALIKE) & (after < HELPS_ONE)).tolist()
            if j != k
        ]
        out.append(Difference(
            keys[k], float(size[k] * off.shifts()[m, k]), float(size[k] / np.sqrt(off.information[m, k, k])),
            float(gains[k]), tuple(equal),
        ))  # fmt: skip
        off = given
    return tuple(out)
