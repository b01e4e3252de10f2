"""A shape of a hypothesis against what a model leaves: its best size, and how probable as much is by chance.

Lagrange-multiplier (score) test: Breusch and Pagan (1980), doi:10.2307/2297111. Scatter between blocks: Liang and Zeger
(1986), doi:10.1093/biomet/73.1.13.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, gammaln

from motorlens_workbench.hypotheses.hypothesis import Hypothesis, Shape

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Entry:
    """Sums over blocks of one shape of a hypothesis.

    Attributes:
        hypothesis: whose.
        shape: which.
        cross: (B, p + 1, k) products with the columns of the fitted parameters and, last, with the errors.
        inner: (B, k, k) products within the shape.
    """

    hypothesis: Hypothesis
    shape: Shape
    cross: Array
    inner: Array

    def towards(self, other: "Entry", share: float) -> "Entry":
        """With sums that go a share of the way to those of the same shape along other inputs."""
        return replace(
            self,
            cross=self.cross + share * (other.cross - self.cross),
            inner=self.inner + share * (other.inner - self.inner),
        )


@dataclass(frozen=True)
class Score:
    """A shape against what a model leaves.

    Attributes:
        entry: the shape.
        coefficient: (k,) its best size, in units of its columns.
        covariance: (k, k) of that, scatter between blocks included.
        information: (k, k) what white noise would make the inverse of that.
        gain: twice the fall of the negative log likelihood.
        scatter: between blocks, over what white noise would give, at least 1.
        weight: minus the logarithm of the probability of as much by chance.
        width: how many columns the recordings know.
        rests: (B, k) score of each block beside the best size, corrected for leverage.
        inverse: (k, k) of the information.
        doubt: what `doubted` has added to the scatter.
    """

    entry: Entry
    coefficient: Array
    covariance: Array
    information: Array
    gain: float
    scatter: float
    weight: float
    width: int
    rests: Array
    inverse: Array
    doubt: float = 0.0

    def doubt_of(self, other: "Score | None") -> float:
        """How far from this size another is, in units of the scatter.

        Args:
            other: of the same shape, if more noise of the inputs is left; None: there it would not be told, and may be 0.
        """
        moved = self.coefficient if other is None else other.coefficient - self.coefficient
        return float(moved @ self.information @ moved) / self.width

    def doubted(self, doubt: float) -> "Score":
        """With more scatter: what makes the score besides noise and what is missing."""
        scatter = self.scatter + doubt
        return replace(
            self,
            scatter=scatter,
            covariance=self.covariance * (scatter / self.scatter),
            weight=-log_chance(self.gain / scatter, self.width),
            doubt=self.doubt + doubt,
        )

    def in_units(self, unit: float) -> "Score":
        """With its size in units of so many of those of its columns."""
        return replace(
            self,
            coefficient=self.coefficient / unit,
            covariance=self.covariance / unit**2,
            information=self.information * unit**2,
            rests=self.rests * unit,
            inverse=self.inverse / unit**2,
        )

    def winning(self, gain: float) -> "Score":
        """With no more gain than this."""
        gain = float(np.clip(gain, 0.0, self.gain))
        return replace(self, gain=gain, weight=-log_chance(gain / self.scatter, self.width))

    def or_at_least(self, statistic: float) -> "Score":
        """With at least this gain over its scatter."""
        if statistic <= self.gain / self.scatter:
            return self
        return replace(self, gain=statistic * self.scatter, weight=-log_chance(statistic, self.width))

    @property
    def name(self) -> str:
        """Of the hypothesis."""
        return self.entry.hypothesis.name

    @property
    def undivided(self) -> float:
        """The weight if it scattered as white noise does."""
        return -log_chance(self.gain, self.width)

    @property
    def possible(self) -> bool:
        """Whether the size is within its limits, but for two standard deviations, and no wonder of nature.

        A size far beyond what such an effect can have is the mark of a column that hardly differs from what parameters do.
        """
        if np.hypot(*self.coefficient[[0, -1]]) > self.entry.hypothesis.most:
            return False
        if len(self.coefficient) != 1:
            return True
        low, high = self.entry.shape.limits()
        slack = 2 * float(np.sqrt(self.covariance[0, 0]))
        return bool(low - slack <= self.coefficient[0] <= high + slack)

    def detectable(self, weight: float) -> float:
        """The size of a single column at which `weight` would be expected, in its units; inf if it cannot be as large.

        What the recordings do not show at all, as an equation without a measured state, leaves rounding as information.
        """
        gain = float(chdtri(1, np.exp(-min(weight, 700.0))))
        size = float(np.sqrt(gain * self.scatter / max(self.information[0, 0], 1e-300)))
        largest = self.entry.hypothesis.most
        if len(self.coefficient) == 1:
            low, high = self.entry.shape.limits()
            largest = min(largest, max(-low, high))
        return size if size <= largest else float("inf")


def scatter_of(rests: Array, inverse_: Array, width: NDArray[np.int64]) -> Array:
    """(S,) how much more scores (S, B, k) of blocks scatter than white noise, at least 1.

    Slow noise shows between longer blocks.
    """
    worst = np.ones(len(rests))
    for merged in (1, 2, 4):
        joined = np.add.reduceat(rests, np.arange(0, rests.shape[1], merged), axis=1)
        worst = np.maximum(worst, np.sum((joined @ inverse_) * joined, axis=(1, 2)) / width)
    return worst


def log_chance(statistic: float, width: int) -> float:
    """Logarithm of the probability that a chi-squared variable is larger; its asymptote where that is nought.

    >>> round(log_chance(3.84, 1), 1), round(log_chance(4000.0, 2))
    (-3.0, -2000)
    """
    told = float(chdtrc(width, statistic))
    if told > 1e-300:
        return float(np.log(told))
    half = statistic / 2
    return float(-half + (width / 2 - 1) * np.log(half) - gammaln(width / 2))


def inverse(gram: Array) -> Array:
    """Of symmetric matrices (..., k, k); directions of which rounding alone is left count as unknown."""
    if not gram.size:
        return gram
    power = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(power > 0, power, 1.0))
    scales = scale[..., :, None] * scale[..., None, :]
    values, vectors = np.linalg.eigh(gram / scales)
    told = np.divide(1.0, values, out=np.zeros(values.shape), where=values > 1e-11 * values[..., -1:])
    return np.asarray((vectors * told[..., None, :]) @ vectors.swapaxes(-1, -2) / scales)
