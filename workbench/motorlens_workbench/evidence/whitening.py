"""Coloured noise: a vector autoregression of the residuals, and the filter that makes them white.

Residuals of an output-error model are coloured (an unmeasured torque shows in current and speed at once), so tests that take
them as white call everything significant. The channels are predicted from their own and each other's past; the prediction
error is white, and the same filter applied to sensitivities keeps least squares efficient (Luetkepohl, New Introduction to
Multiple Time Series Analysis, 2005, section 3.2).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Short lags, and whether means over longer pasts join them: (order, with memory).
CHOICES = ((0, False), (2, False), (6, False), (2, True), (6, True), (16, True))
# Rows over which the longer pasts reach (first-order filters).
MEMORIES = (10.0, 40.0, 160.0, 640.0)
# Frequencies that stand for all of them in a mean: spectra of so few lags are smooth.
FREQUENCIES = 200
# Times as much power, which is much more: what a fit finds in white noise differs by a tenth or so.
STEEP = 1.5


@dataclass(frozen=True)
class Whitener:
    """Filter of C channels sampled together.

    Attributes:
        coefficients: (p + 1, C, C); `coefficients[k, c, j]` weighs channel j at lag k in the prediction of channel c.
            At lag 0 only channels before c take part.
        sigma: (C,) standard deviation of the prediction error, the unit of the whitened residual.
        memories: (q,) rows over which the means of longer pasts reach.
        memory: (q, C, C) weights of those means, like `coefficients`.
    """

    coefficients: Array
    sigma: Array
    memories: tuple[float, ...] = ()
    memory: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))

    @property
    def order(self) -> int:
        """How many past samples are used one by one."""
        return len(self.coefficients) - 1

    @property
    def blue(self) -> NDArray[np.bool_]:
        """(C,) channels with more power at the highest frequencies than in the mean, and much more than at the lowest."""
        turns = np.pi * (np.arange(FREQUENCIES) + 0.5) / FREQUENCIES
        powers = self._powers(np.array([0.0, *turns, np.pi]))
        mean = np.mean(powers[1:-1], axis=0)
        return np.asarray(powers[-1] > np.maximum(mean, STEEP * powers[0]))

    def _powers(self, turns: Array) -> Array:
        """(T, C) spectral density of each channel at angles per row (T,), over that of white noise of 1."""
        lag = np.exp(-1j * turns[:, None] * np.arange(self.order + 1))
        keep, once = np.exp(-1 / np.array(self.memories, dtype=np.float64)), np.exp(-1j * turns)[:, None]
        mean = (1 - keep) * once / (1 - keep * once)
        taken = np.tensordot(lag, self.coefficients, axes=1) + np.tensordot(mean, self.memory, axes=1)
        response = np.linalg.inv(np.eye(len(self.sigma)) - taken) * self.sigma
        return np.asarray(np.sum(np.abs(response) ** 2, axis=2))

    def among(self, which: NDArray[np.bool_], sigma: Array) -> "Whitener":
        """Of some of C channels (C,), of which the others are white, with `sigma` (C,)."""
        at, channels = np.flatnonzero(which), len(which)
        coefficients = np.zeros((self.order + 1, channels, channels))
        memory = np.zeros((len(self.memories), channels, channels))
        coefficients[:, at[:, None], at] = self.coefficients
        if self.memories:
            memory[:, at[:, None], at] = self.memory
        sigma = sigma.copy()
        sigma[at] = self.sigma
        return Whitener(coefficients, sigma, self.memories, memory)

    def __call__(self, y: Array) -> Array:
        """Whiten (N, C) or (N, C, m): prediction errors in units of sigma; the first `order` rows are 0."""
        columns = y[:, :, None] if y.ndim == 2 else y
        (white,) = self.in_blocks([columns])
        return white[:, :, 0] if y.ndim == 2 else white

    def in_blocks(self, blocks: Iterable[Array]) -> Iterator[Array]:
        """Whiten (N, C, m), given and returned in blocks (len, C, m) that follow each other from the first row on."""
        keep = np.exp(-1 / np.array(self.memories, dtype=np.float64))
        past = y = np.zeros((0, 0, 0))
        for block in blocks:
            if not y.size:
                past, y = np.zeros((len(keep), *block.shape[1:])), block[:0]
            before = min(len(y), self.order)
            y = np.concatenate([y[len(y) - before :], block])
            white = np.empty(block.shape)
            _whiten(y, before, self.coefficients, self.sigma, keep, self.memory, past, white)
            yield white


@numba.njit(cache=True, nogil=True)
def _whiten(y, first, coefficients, sigma, keep, memory, past, white):  # type: ignore[no-untyped-def]
    order, channels, width = len(coefficients) - 1, y.shape[1], y.shape[2]
    for row in range(len(white)):
        t = first + row
        for c in range(channels):
            for m in range(width):
                white[row, c, m] = y[t, c, m]
            for j in range(channels):
                for lag in range(min(order, t) + 1):
                    weight = coefficients[lag, c, j]
                    if weight != 0.0:
                        for m in range(width):
                            white[row, c, m] -= weight * y[t - lag, j, m]
                for q in range(len(keep)):
                    weight = memory[q, c, j]
                    for m in range(width):
                        white[row, c, m] -= weight * past[q, j, m]
            scale = 0.0 if t < order else 1.0 / sigma[c]
            for m in range(width):
                white[row, c, m] *= scale
        for q in range(len(keep)):
            for j in range(channels):
                for m in range(width):
                    past[q, j, m] = keep[q] * past[q, j, m] + (1.0 - keep[q]) * y[t, j, m]


@numba.njit(cache=True, nogil=True)
def _past_mean(y, keep):  # type: ignore[no-untyped-def]
    means = np.empty(y.shape)
    for j in range(y.shape[1]):
        mean = 0.0
        for t in range(y.shape[0]):
            mean = keep * mean + (1 - keep) * y[t, j]
            means[t, j] = mean
    return means


def past_mean(y: Array, reach: float) -> Array:
    """Exponential mean of (N, C) over the past, the present included; starts at zero."""
    return np.asarray(_past_mean(np.ascontiguousarray(y), float(np.exp(-1 / reach))))


def white(sigma: Array) -> Whitener:
    """The filter for noise that is white already."""
    channels = len(sigma)
    return Whitener(np.zeros((1, channels, channels)), np.asarray(sigma, dtype=np.float64))


def fit_whitener(residual: Array, valid: NDArray[np.bool_], floor: Array, used: int = 0) -> Whitener:
    """Estimate the filter from residuals, its length by the Bayesian information criterion.

    Args:
        residual: (N, C).
        valid: (N,) rows that hold a sample in every channel; a row counts if all its lags are valid.
        floor: (C,) smallest believable sigma, such as the quantisation noise.
        used: parameters already spent on these residuals, for an unbiased sigma.
    """
    rows, channels = residual.shape
    choices = [choice for choice in CHOICES if (choice[0] + 4 * choice[1] + 1) * channels * 20 <= rows] or [
        (0, False)
    ]
    longest = max(order for order, _ in choices)
    kept = valid.copy()
    for lag in range(1, longest + 1):
        kept[lag:] &= valid[:-lag]
    kept[:longest] = False
    reaches = tuple(reach for reach in MEMORIES if 10 * reach <= rows)
    told = kept[longest:]
    past = [residual[longest - lag : rows - lag] for lag in range(1, longest + 1)]
    past += [past_mean(residual, reach)[longest - 1 : rows - 1] for reach in reaches] if longest else []
    table = np.concatenate([*past, residual[longest:]], axis=1)[told]
    # Every design is made of some of these columns: their products are enough.
    products = table.T @ table
    lags, means, now = np.split(np.arange(len(products)), [channels * longest, len(products) - channels])
    best: tuple[float, Whitener] | None = None
    for order, remembers in choices:
        used_means = means if remembers else means[:0]
        before = np.concatenate([lags[: channels * order], used_means])
        weights = np.zeros((len(products), channels))
        for c in range(channels):
            given = np.concatenate([before, now[:c]])
            weights[given, c] = _regress(products[np.ix_(given, given)], products[given, now[c]])
        left = np.eye(len(products))[:, now] - weights
        squares = np.maximum(np.einsum("ic,ij,jc->c", left, products, left), 0.0)
        spent = len(before) + np.arange(channels)
        count = np.maximum(len(table) - spent - used / channels, max(0.5 * len(table), 1))
        sigma = np.maximum(np.sqrt(squares / count), floor)
        criterion = len(table) * 2 * np.sum(np.log(sigma)) + np.sum(spent) * np.log(max(len(table), 2))
        if best is None or criterion < best[0]:
            by_lag = np.concatenate([now, lags[: channels * order]])
            coefficients, memory = (
                weights[at].reshape(-1, channels, channels).transpose(0, 2, 1) for at in (by_lag, used_means)
            )
            kept_means = reaches if remembers else ()
            best = (
                criterion,
                Whitener(np.ascontiguousarray(coefficients), sigma, kept_means, np.ascontiguousarray(memory)),
            )
    assert best is not None
    return best[1]


def _regress(gram: Array, right: Array) -> Array:
    if not len(gram):
        return right
    # A ridge far below the noise keeps exact copies (two channels of one signal) from blowing up.
    ridge = np.diag(1e-9 * np.diagonal(gram) + 1e-30)
    return np.asarray(np.linalg.lstsq(gram + ridge, right, rcond=1e-13)[0])
