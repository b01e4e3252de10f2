"""Evidence: the linearised problem as sums of products over blocks of time, and what can be read from them.

Every base parameter, candidate effect, sensor fault and free curve is a column: what a unit of it adds to all measured
channels, whitened. All statistics of the diagnosis (gains, robust tests, similarity, smallest detectable sizes) are algebra
on the products of columns with each other and with the residual, kept per block of time so that what the noise model missed
shows as scatter between blocks.

Lagrange-multiplier (score) test: Breusch and Pagan (1980), doi:10.2307/2297111. Scatter between blocks: Liang and Zeger
(1986), doi:10.1093/biomet/73.1.13.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

Array = NDArray[np.float64]

RESIDUAL = "residual"
# A column of which rounding alone is left.
COPY = 1e-9


@dataclass(frozen=True)
class Evidence:
    """Sums of products of whitened columns.

    Attributes:
        names: the columns; the last is `RESIDUAL`.
        blocks: (B, M, M) sums over each block of time.
        samples: (B,) how many samples are in each block.
        power: (M,) diagonal of the sums before anything was projected out, the scale for `copy`.
        noise: (M,) what noise of the measured inputs puts into the sums: a column of which no more is left once others
            explained it is their copy.
    """

    names: tuple[str, ...]
    blocks: Array
    samples: Array
    power: Array
    noise: Array

    @classmethod
    def of(cls, names: Sequence[str], blocks: Array, samples: Array) -> "Evidence":
        """From raw sums; the residual's column is the last."""
        total = blocks.sum(axis=0)
        return cls((*names, RESIDUAL), blocks, samples, np.diagonal(total).copy(), np.zeros(len(total)))

    def index(self, names: Sequence[str]) -> NDArray[np.intp]:
        """Positions of columns."""
        position = {name: k for k, name in enumerate(self.names)}
        return np.array([position[name] for name in names], dtype=np.intp)

    def with_prior(self, centre: dict[str, float], sd: dict[str, float]) -> "Evidence":
        """Add what is known beforehand as one more block: each named column's coefficient is `centre` +- `sd`."""
        extra = np.zeros_like(self.blocks[0])
        for name, width in sd.items():
            k = self.names.index(name)
            extra[k, k] = 1 / width**2
            extra[k, -1] = extra[-1, k] = centre.get(name, 0.0) / width**2
            extra[-1, -1] += (centre.get(name, 0.0) / width) ** 2
        return replace(
            self,
            blocks=np.concatenate([self.blocks, extra[None]]),
            samples=np.append(self.samples, 0.0),
        )

    def solve(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Least squares on some columns: coefficients (k,) and covariance (k, k) for unit white noise."""
        total = self.total
        at = self.index(names)
        inverse = _inverse(total[np.ix_(at, at)])
        return inverse @ total[at, -1], inverse

    def given(self, names: Sequence[str]) -> "Evidence":
        """The evidence that is left once these columns have explained all they can of every other column."""
        at = self.index(names)
        rest = np.setdiff1d(np.arange(len(self.names)), at)
        if not len(at):
            return self
        total = self.total
        weights = _inverse(total[np.ix_(at, at)]) @ total[np.ix_(at, rest)]
        # blocks' = P^T blocks P with P = [-weights; I]
        inner = self.blocks[:, at[:, None], at]
        cross = self.blocks[:, at[:, None], rest]
        half = weights.T @ (0.5 * inner @ weights - cross)
        left = self.blocks[:, rest[:, None], rest] + half + half.transpose(0, 2, 1)
        return Evidence(
            tuple(self.names[k] for k in rest), left, self.samples, self.power[rest], self.noise[rest]
        )

    def of_columns(self, names: Sequence[str]) -> "Evidence":
        """Of some columns alone, with the residual."""
        at = np.append(self.index(names), len(self.names) - 1)
        return Evidence(
            (*names, RESIDUAL), self.blocks[:, at[:, None], at], self.samples, self.power[at], self.noise[at]
        )

    def split(self, name: str, parts: NDArray[np.bool_]) -> "Evidence":
        """With `name` in parts of the time alone, zero elsewhere, as further columns `name/0`, `name/1` and so on.

        Args:
            name: a column.
            parts: (S, B) which blocks belong to each part; blocks beyond (priors, what `less` leaves) belong to none.
        """
        count, width, blocks = len(parts), len(self.names), len(self.blocks)
        taken = np.zeros((blocks, width, width + count))
        taken[:, :, :width] = np.eye(width)
        taken[: parts.shape[1], self.names.index(name), width:] = parts.T
        # The residual stays the last.
        order = [*range(width - 1), *range(width, width + count), width - 1]
        made = taken.transpose(0, 2, 1) @ self.blocks @ taken
        made = made[:, order][:, :, order]
        names = (*self.names[:-1], *(f"{name}/{k}" for k in range(count)), RESIDUAL)
        noise = np.concatenate(
            [self.noise[:-1], np.full(count, self.noise[self.names.index(name)]), self.noise[-1:]]
        )
        return Evidence(names, made, self.samples, np.diagonal(made.sum(axis=0)).copy(), noise)

    def explained_by(self, names: Sequence[str], coefficient: Array) -> "Evidence":
        """With a residual from which some columns, times their coefficients (k,), were taken; the columns stay."""
        change = np.eye(len(self.names))
        change[self.index(names), -1] = -coefficient
        return replace(self, blocks=change.T @ self.blocks @ change)

    @cached_property
    def total(self) -> Array:
        """(M, M) sums over all blocks."""
        return np.asarray(self.blocks.sum(axis=0))

    def error(self) -> float:
        """Sum of squares of the whitened residual."""
        return float(self.blocks[:, -1, -1].sum())


def _inverse(gram: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = values > 1e-12 * values[-1]
    inverse = (vectors[:, keep] / values[keep]) @ vectors[:, keep].T
    return np.asarray(inverse / np.outer(scale, scale))


@dataclass(frozen=True)
class Score:
    """The test of one group of columns against what is left.

    Attributes:
        coefficient: (k,) least squares size of each column.
        covariance: (k, k) of it, scatter between blocks included.
        gain: fall of the whitened sum of squares, about twice the gain in log likelihood.
        inflation: scatter between blocks over what white noise would give, at least 1.
        statistic: gain over inflation, chi-squared with k degrees of freedom if nothing is there.
        blocks: how many blocks the information effectively comes from.
        free: share of the column that the base parameters cannot imitate (1 / variance inflation factor).
        information: (k, k) products of the columns.
    """

    names: tuple[str, ...]
    coefficient: Array
    covariance: Array
    gain: float
    inflation: float
    statistic: float
    blocks: float
    free: float
    information: Array

    @property
    def p(self) -> float:
        """Probability of a statistic as large by chance, from Student's t squared (F) with the effective blocks."""
        k = len(self.names)
        freedom = max(self.blocks - 1, 1.0)
        return float(fdtrc(k, freedom * 2, self.statistic / k))

    def inflated(self, inflation: float) -> "Score":
        """The same with another scatter."""
        return replace(
            self,
            inflation=inflation,
            statistic=self.gain / inflation,
            covariance=self.covariance * (inflation / self.inflation),
        )

    def detectable(self, statistic: float) -> float:
        """The size of the first column at which the statistic would be expected to reach this value."""
        return float(np.sqrt(statistic * self.inflation / max(self.information[0, 0], 1e-300)))


def score(left: Evidence, names: Sequence[str]) -> Score | None:
    """Score test of some columns together, given evidence from which the accepted columns were projected out.

    Returns None if nothing can be said about them: they are copies of accepted ones, or errors of the inputs (see
    `Evidence.less`) would put more into them than there is.
    """
    at = left.index(names)
    total = left.total
    information = total[np.ix_(at, at)]
    free = float(np.min(np.diagonal(information) / np.maximum(left.power[at], 1e-300)))
    noisy = bool(np.any(np.diagonal(information) <= left.noise[at]))
    if free < COPY or noisy or not np.isfinite(information).all():
        return None
    # A direction in which hardly more than noise is left says as little.
    inverse = _inverse(information + np.diag(left.noise[at]))
    coefficient = inverse @ total[at, -1]
    gain = float(total[at, -1] @ coefficient)
    if gain > total[-1, -1]:
        # More than there is to explain: what was taken out for errors of the inputs is larger than the evidence itself.
        return None
    # Scatter after the fitted size is taken out: taken before, it would grow with the effect and hide it. Noise slower
    # than a block shows between longer ones.
    here = left.blocks[:, at[:, None], at[None, :]]
    scores = left.blocks[:, at, -1] - here @ coefficient
    inflation = 1.0
    for merged in (1, 2, 4):
        joined = np.add.reduceat(scores, np.arange(0, len(scores), merged), axis=0)
        meat = joined.T @ joined
        # The fit has taken one of its degrees of freedom from every column.
        spare = max(1 - merged / max(len(scores), 1), 0.5)
        inflation = max(inflation, float(np.trace(inverse @ meat)) / len(at) / spare)
    share = np.einsum("ij,bji->b", inverse, here) / len(at)
    blocks = 1.0 / float(np.sum(share**2)) if share.any() else 1.0
    # Few blocks carry the information: their scatter is hardly known, so a margin is kept.
    covariance = inverse * inflation
    return Score(
        tuple(names), coefficient, covariance, gain, inflation, gain / inflation, blocks, free, information
    )


def own_score(evidence: Evidence, keys: Sequence[str], key: str) -> Score | None:
    """Score test of one fitted parameter beside all others, from the model that holds it: how evenly the data bear it."""
    return score(evidence.given([other for other in keys if other != key]), [key])


def statistics(left: Evidence, given: Sequence[str] = ()) -> Array:
    """(M - 1,) the robust statistic of every single column at once, given further columns; 0 for what these explain."""
    # Of the evidence given those columns only its diagonals and its last columns are needed, which is little work.
    at = left.index(given)
    total = left.total
    weights = _inverse(total[np.ix_(at, at)]) @ total[at] if len(at) else np.zeros((0, len(total)))
    cross = left.blocks[:, at]
    moved = 0.5 * (left.blocks[:, at[:, None], at] @ weights) - cross
    diagonal = np.diagonal(left.blocks, axis1=1, axis2=2) + 2 * np.sum(weights * moved, axis=1)
    last = left.blocks[:, :, -1] + moved[:, :, -1] @ weights + weights[:, -1] @ moved
    diagonal, last = diagonal[:, :-1], last[:, :-1]
    power = diagonal.sum(axis=0)
    known = power > np.maximum(COPY * np.maximum(left.power[:-1], 1e-300), left.noise[:-1])
    known[at] = False
    safe = np.where(known, power, 1.0)
    coefficient = last.sum(axis=0) / safe
    scores = last - diagonal * coefficient
    inflation = np.ones(len(power))
    for merged in (1, 2, 4):
        joined = np.add.reduceat(scores, np.arange(0, len(scores), merged), axis=0)
        spare = max(1 - merged / max(len(scores), 1), 0.5)
        inflation = np.maximum(inflation, np.sum(joined**2, axis=0) / safe / spare)
    return np.asarray(np.where(known, coefficient**2 * safe / inflation, 0.0))


def similarity(left: Evidence, names: Sequence[str]) -> Array:
    """(k, k) squared correlation of columns after projection: 1 means no data of this kind can tell them apart."""
    at = left.index(names)
    inner = left.total[np.ix_(at, at)]
    scale = np.sqrt(np.maximum(np.diagonal(inner), 1e-300))
    return np.asarray((inner / np.outer(scale, scale)) ** 2)


def curve_gain(left: Evidence, names: Sequence[str]) -> tuple[float, float, Score | None]:
    """Gain of a free curve beyond chance, and how many standard deviations that is.

    The statistic of k columns has mean k and variance 2 k by chance; the excess is what the curve explains.
    """
    kept = [name for name in names if _known(left, name)]
    tested = score(left, kept) if kept else None
    if tested is None:
        return 0.0, 0.0, None
    k = len(kept)
    excess = tested.statistic - k
    return excess * tested.inflation, excess / np.sqrt(2 * k), tested


def _known(left: Evidence, name: str) -> bool:
    k = left.names.index(name)
    power = left.blocks[:, k, k].sum()
    return bool(power > max(1e-6 * left.power[k], left.noise[k]) and left.power[k] > 0)
