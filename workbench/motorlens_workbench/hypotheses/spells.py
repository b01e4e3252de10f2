"""Spells: samples of which some lie beyond the others, for a while at a time.

What a fit leaves is taken for a hidden Markov chain: a sample is usual, or other in one of several ways, and stays so for as
long as is likeliest (Baum, Petrie, Soules and Weiss 1970, doi:10.1214/aoms/1177697196). So one sample may tell little where
its spell tells enough. The usual level is fitted with it, by expectation and maximisation (Dempster, Laird and Rubin 1977,
doi:10.1111/j.2517-6161.1977.tb01600.x).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Degrees of freedom of Student's t that what is left follows: a model that is a little wrong has longer tails than noise.
FREEDOM = 4.0
# A fit begins at the likeliest of these sizes, in standard deviations, shares of samples that are other than the rest, and
# samples in a spell.
SIZES, OFTEN, LASTS = np.geomspace(1.0, 1000.0, 16), (0.1, 0.01, 0.001), (1.0, 4.0, 16.0)
# It ends once a step wins less than this, or after so many, with a share within these.
WINS, STEPS, SHARES = 1e-3, 200, (1e-4, 0.5)
# Directions in which the terms of the usual level differ by less than this share are one.
ALIKE = 1e-12


@dataclass(frozen=True)
class Residuals:
    """What a robust fit leaves.

    Attributes:
        values: (M,), one after another.
        scale: (M,) their standard deviation where they are usual.
        terms: (M, k) that the usual level consists of.
    """

    values: Array
    scale: Array
    terms: Array


@dataclass(frozen=True)
class Spells:
    """Samples of two kinds.

    Attributes:
        wins: logarithm of how many times as likely they are as all of one kind.
        size: by how much the other kind lies beyond the usual, in units of its form.
        share: of the samples that are of the other kind.
        count: how many spells there are.
        values: (M,) what lies beyond the usual level.
        other: (M,) probability of each sample of being of the other kind.
    """

    wins: float
    size: float
    share: float
    count: float
    values: Array
    other: Array


def level(residuals: Residuals) -> Residuals:
    """With the likeliest usual level, if all samples are usual."""
    likely = -np.inf
    for _ in range(STEPS):
        before, likely = likely, float(np.sum(_likelihood(residuals.values, residuals.scale)))
        if likely < before + WINS:
            break
        weights = _pull(residuals.values, residuals.scale)
        residuals = replace(residuals, values=_beyond_level(residuals, residuals.values, weights))
    return residuals


def spells(residuals: Residuals, forms: Sequence[Array], lasting: bool) -> Spells:
    """Samples that lie beyond the usual by a size times one of the forms (M,), each as likely as another.

    Args:
        residuals: the samples.
        forms: of what is other.
        lasting: whether a sample is likelier to be as the one before it, or as likely after any.
    """
    values, scale = residuals.values, residuals.scale
    alone = np.sum(_likelihood(values, scale))

    def beyond(values: Array, size: float) -> Array:
        usual = _likelihood(values, scale)
        return np.exp(np.column_stack([_likelihood(values - size * form, scale) - usual for form in forms]))

    def begun(size: float) -> tuple[float, float, float, float]:
        by = beyond(values, size)
        tried = [
            (share, max(1 - 1 / lasts, share)) for share in OFTEN for lasts in (LASTS if lasting else (1.0,))
        ]
        return max((smoothed(by, *one)[0], size, *one) for one in tried)

    _, size, share, stays = max(
        begun(float(size)) for size in SIZES / np.sqrt(np.mean((forms[0] / scale) ** 2))
    )
    wins = -np.inf
    for _ in range(STEPS):
        before = wins
        chain, other, again = smoothed(beyond(values, size), share, stays)
        wins = chain + float(np.sum(_likelihood(values, scale)) - alone)
        if wins < before + WINS:
            break
        pulls = [one * _pull(values - size * form, scale) for one, form in zip(other.T, forms, strict=True)]
        weight = sum(float(np.sum(pull * form**2)) for pull, form in zip(pulls, forms, strict=True))
        moment = sum(float(np.sum(pull * form * values)) for pull, form in zip(pulls, forms, strict=True))
        size = max(moment / weight, 0.0)
        usual = (1 - other.sum(axis=1)) * _pull(values, scale)
        weights = usual + sum(pulls)
        # What the level is to be fitted to: without what is expected of the spells.
        rest = values - size * sum(pull * form for pull, form in zip(pulls, forms, strict=True)) / weights
        values = values - rest + _beyond_level(residuals, rest, weights)
        share = float(np.clip(other.sum() / len(values), *SHARES))
        stays = float(np.clip(again / other[:-1].sum(), share, 1 - 1 / len(values))) if lasting else share
    return Spells(wins, size, share, other.sum() - again, values, other.sum(axis=1))


def _beyond_level(residuals: Residuals, values: Array, weights: Array) -> Array:
    """What least squares with weights (M,) leave of values (M,)."""
    weighted = residuals.terms.T * weights
    return np.asarray(
        values - residuals.terms @ np.linalg.lstsq(weighted @ residuals.terms, weighted @ values, ALIKE)[0]
    )


def _likelihood(error: Array, scale: Array) -> Array:
    """(M,) logarithm of Student's t, but for a constant."""
    return np.asarray(-np.log(scale) - 0.5 * (FREEDOM + 1) * np.log1p((error / scale) ** 2 / FREEDOM))


def _pull(error: Array, scale: Array) -> Array:
    """(M,) weights with which least squares are as likely as Student's t can be, but for a constant."""
    return np.asarray(1 / (FREEDOM + (error / scale) ** 2) / scale**2)


@njit(cache=True, nogil=True)
def smoothed(by, share, stays):  # type: ignore[no-untyped-def]
    """A hidden Markov chain that is usual, or other in one of K ways, each as often as another.

    Args:
        by: (M, K) how many times as likely each sample is in each way as usually.
        share: of the samples that are other.
        stays: probability that the next one is so in the same way; otherwise it is usual.

    Returns:
        Logarithm of how many times as likely all are as if all were usual; (M, K) probability of each sample of being other
        in each way; expected number of samples after which the next is so in the same way.
    """
    samples, ways = by.shape
    begins = share / (1 - share) * (1 - stays)
    # Forwards: of each sample given those up to it. `ahead` is that given those before it.
    given, ahead = np.empty((samples, ways)), np.empty((samples, ways))
    wins = 0.0
    for k in range(samples):
        usual, total = 1.0 - share, 0.0
        if k:
            others = np.sum(given[k - 1])
            usual = (1.0 - others) * (1.0 - begins) + others * (1.0 - stays)
        for j in range(ways):
            ahead[k, j] = (1.0 - others) * begins / ways + given[k - 1, j] * stays if k else share / ways
            given[k, j] = ahead[k, j] * by[k, j]
            total += given[k, j]
        total += usual
        for j in range(ways):
            given[k, j] /= total
        wins += np.log(total)
    # Backwards: of each sample given all.
    other, again = given.copy(), 0.0
    for k in range(samples - 2, -1, -1):
        usual = (1.0 - np.sum(other[k + 1])) / (1.0 - np.sum(ahead[k + 1]))
        for j in range(ways):
            both = given[k, j] * stays * other[k + 1, j] / ahead[k + 1, j]
            again += both
            other[k, j] = both + given[k, j] * (1.0 - stays) * usual
    return wins, other, again
