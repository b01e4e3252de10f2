"""What a fit found, in words that are the same in every command.

Four things can be wrong with a parameter although a number comes out: the recordings do not tell it, they tell it only
together with another, it ends at the edge of what is possible, or it is far from what the motor file says.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.fit import Fit, inverse
from motorlens_physics.estimate.prior import CALIBRATED, states

Array = NDArray[np.float64]

# A parameter of which more than this share of its prior deviation is left is not told: the recordings hold less than a
# quarter (1 / 0.9^2 - 1) of what was known of it before.
UNTOLD = 0.9
# Parameters that are this many times less certain alone than given all others are known only together; of these, those that
# are correlated so that to know the one would halve what is left of the other.
ALONE, TIED = 7.0, 0.87
# What lies this many deviations from the motor file contradicts it: one in two million would by chance.
FAR = 5.0
# Closer to a bound than this share of the deviation is at it.
AT_BOUND = 0.01


@dataclass(frozen=True)
class Findings:
    """What a fit says of the parameters of the motor file, effects and sensors included.

    Attributes:
        keys: of the parameters that were free.
        value: as fitted; of what is not told, the prior's.
        sd: standard deviations, never above the prior's.
        untold: key to a sentence: the recordings do not tell it, it stays what it was.
        confounded: sentences on parameters that are told only together.
        at_bound: key to a sentence: it ends at the edge of what is possible.
        far: key to a sentence: it is `FAR` or more deviations from the motor file.
        once: a sentence on what the motor file learnt from these recordings, if anything.
    """

    keys: tuple[str, ...]
    value: Mapping[str, float]
    sd: Mapping[str, float]
    untold: Mapping[str, str]
    confounded: tuple[str, ...]
    at_bound: Mapping[str, str]
    far: Mapping[str, str]
    once: tuple[str, ...]

    @property
    def told(self) -> tuple[str, ...]:
        """Keys of what the recordings tell."""
        return tuple(key for key in self.keys if key not in self.untold)

    @property
    def sentences(self) -> tuple[str, ...]:
        """All that is to be said."""
        return (
            *self.once, *self.untold.values(), *self.confounded, *self.at_bound.values(), *self.far.values()
        )  # fmt: skip

    @property
    def in_short(self) -> tuple[str, ...]:
        """The same, with one sentence on what is not told, for where a table has the values."""
        names = ", ".join(self.untold)
        untold = (
            f"These recordings do not tell {names}: nothing but what was known before stands behind them."
        )
        further = (*self.once, *self.confounded, *self.at_bound.values(), *self.far.values())
        return (untold, *further) if names else further


def findings(fit: Fit) -> Findings:
    """Judge a fit's parameters; nuisances of single recordings are not the motor's and are left out."""
    prior, file = fit.prior, fit.model.file
    keys = tuple(key for key in prior.keys if "@" not in key)
    fitted, deviation = fit.model.values(), fit.sd()
    widths = dict(zip(prior.keys, prior.width(fitted), strict=True))
    penalty = dict(zip(prior.keys, prior.penalties(fitted), strict=True))
    value: dict[str, float] = {}
    sd: dict[str, float] = {}
    untold: dict[str, str] = {}
    at_bound: dict[str, str] = {}
    far: dict[str, str] = {}
    for key in keys:
        meaning = file.meaning(key)
        centre, width, unit = prior.centre[key], prior.sd[key], meaning.unit
        unit = "" if unit == "1" else f" {unit}"
        value[key], sd[key] = fitted[key], min(deviation[key], widths[key])
        left = sd[key] / widths[key]
        # What has gone as far as contradicts the file was led there by data: back where it was, nothing would fit.
        if left > UNTOLD and penalty[key] < FAR**2:
            value[key], sd[key] = centre, width
            untold[key] = (
                f"{key}: these recordings do not tell it ({left:.0%} of its prior deviation is left); "
                f"it stays at {centre:.4g}{unit}"
            )
            continue
        for bound in prior.bounds[key]:
            if abs(value[key] - bound) <= AT_BOUND * sd[key]:
                sharp = meaning.role == "width" and bound == prior.bounds[key][0]
                at_bound[key] = (
                    f"{key}: {bound:.4g}{unit} or less; these recordings tell no more"
                    if sharp
                    else f"{key}: ends at {bound:.4g}{unit}, the edge of what is possible; something else is wrong, "
                    "or missing from the model"
                )
        # What the recordings add to the prior moves its centre by as much as its variance shrinks; that of a parameter that
        # they hardly tell, and have moved all the same, by no less than makes it told.
        beyond = np.sqrt(penalty[key] / (1 - min(left, UNTOLD) ** 2))
        if beyond >= FAR and states(file, key):
            far[key] = (
                f"{key}: {value[key]:.4g}{unit} is {beyond:.0f} standard deviations from the motor file's "
                f"{centre:.4g} +- {width:.2g}{unit}; one of the two is wrong"
            )
    return Findings(keys, value, sd, untold, _confounded(fit, keys, untold), at_bound, far, _once(fit, keys))


def _once(fit: Fit, keys: tuple[str, ...]) -> tuple[str, ...]:
    """That what was calibrated on these recordings does not count twice."""
    known, width = fit.model.file.knowledge, fit.prior.sd
    learnt = [key for key in keys if key in known and known[key].source.startswith(CALIBRATED)]
    twice = [key for key in learnt if width[key] != known[key].sd]
    if not twice:
        return ()
    return (
        f"{', '.join(twice)}: the motor file learnt them from recordings of these names; what was known before counts "
        "here, so that nothing counts twice",
    )


def correlation(fit: Fit, keys: tuple[str, ...]) -> Array:
    """(k, k) of some of the parameters fitted."""
    at = [fit.prior.keys.index(key) for key in keys]
    covariance = fit.covariance[np.ix_(at, at)]
    size = np.sqrt(np.maximum(np.diagonal(covariance), 1e-300))
    return np.asarray(covariance / np.outer(size, size))


def _confounded(fit: Fit, keys: tuple[str, ...], untold: Mapping[str, str]) -> tuple[str, ...]:
    told = tuple(key for key in keys if key not in untold)
    table = correlation(fit, told)
    alone = dict(zip(told, np.sqrt(np.diagonal(inverse(table))), strict=True))
    unsure = [key for key in told if alone[key] > ALONE]
    sentences: dict[frozenset[str], str] = {}
    while unsure:
        group, rest = [unsure[0]], unsure[1:]
        for key in group:
            tie = np.abs(table[told.index(key)])
            near = [b for b in rest if tie[told.index(b)] > TIED]
            group += near
            rest = [b for b in rest if b not in near]
        unsure = rest
        if not group[1:]:
            # Tied to several, to none of them alone so closely: the closest is named.
            tie = np.abs(table[told.index(group[0])])
            tie[told.index(group[0])] = 0.0
            group.append(told[int(np.argmax(tie))])
        names = " and ".join([", ".join(group[:-1]), group[-1]])
        least = min(alone[key] for key in group)
        # Of two that are each the other's closest it is said once.
        sentences.setdefault(
            frozenset(group),
            f"{names}: these recordings tell them only together "
            f"(each is {least:.0f} times less certain alone than given the others)",
        )
    return tuple(sentences.values())
