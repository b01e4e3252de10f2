"""Coloured noise: a vector autoregression of the residuals, and the filter that makes them white.

Residuals of an output-error model are coloured (an unmeasured torque shows in current and speed at once), so tests that take
them as white call everything significant. The channels are predicted from their own and each other's past; the prediction
error is white, and the same filter applied to sensitivities keeps least squares efficient (Luetkepohl, New Introduction to
Multiple Time Series Analysis, 2005, section 3.2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ORDERS = (0, 2, 6, 16, 40)


@dataclass(frozen=True)
class Whitener:
    """Filter of C channels sampled together.

    Attributes:
        coefficients: (p + 1, C, C); `coefficients[k, c, j]` weighs channel j at lag k in the prediction of channel c.
            At lag 0 only channels before c take part.
        sigma: (C,) standard deviation of the prediction error, the unit of the whitened residual.
    """

    coefficients: Array
    sigma: Array

    @property
    def order(self) -> int:
        """How many past samples are used."""
        return len(self.coefficients) - 1

    def __call__(self, y: Array) -> Array:
        """Whiten (N, C) or (N, C, m): prediction errors in units of sigma; the first `order` rows are 0."""
        columns = y[:, :, None] if y.ndim == 2 else y
        white = np.array(columns, dtype=np.float64)
        order = self.order
        for lag, weights in enumerate(self.coefficients):
            if not weights.any():
                continue
            past = columns[: len(columns) - lag] if lag else columns
            white[lag:] -= np.einsum("cj,njm->ncm", weights, past, optimize=True)
        white /= self.sigma[None, :, None]
        white[:order] = 0.0
        return white[:, :, 0] if y.ndim == 2 else white


def white(sigma: Array) -> Whitener:
    """The filter for noise that is white already."""
    channels = len(sigma)
    return Whitener(np.zeros((1, channels, channels)), np.asarray(sigma, dtype=np.float64))


def fit_whitener(residual: Array, valid: NDArray[np.bool_], floor: Array, used: int = 0) -> Whitener:
    """Estimate the filter from residuals, its order by the Bayesian information criterion.

    Args:
        residual: (N, C).
        valid: (N,) rows that hold a sample in every channel; a row counts if all its lags are valid.
        floor: (C,) smallest believable sigma, such as the quantisation noise.
        used: parameters already spent on these residuals, for an unbiased sigma.
    """
    rows, channels = residual.shape
    longest = max((order for order in ORDERS if (order + 1) * channels * 20 <= rows), default=0)
    kept = valid.copy()
    for lag in range(1, longest + 1):
        kept[lag:] &= valid[:-lag]
    kept[:longest] = False
    best: tuple[float, Whitener] | None = None
    for order in (order for order in ORDERS if order <= longest):
        coefficients = np.zeros((order + 1, channels, channels))
        sigma = np.zeros(channels)
        criterion = 0.0
        for c in range(channels):
            lagged = [
                residual[longest - lag : rows - lag, j]
                for lag in range(1, order + 1)
                for j in range(channels)
            ]
            regressors = (
                np.column_stack([*lagged, *(residual[longest:, j] for j in range(c))])
                if lagged or c
                else None
            )
            target = residual[longest:, c]
            keep = kept[longest:]
            if regressors is None:
                error = target[keep]
                spent = 0
            else:
                design = regressors[keep]
                gram = design.T @ design
                # A ridge far below the noise keeps exact copies (two channels of one signal) from blowing up.
                gram[np.diag_indices_from(gram)] *= 1 + 1e-9
                gram[np.diag_indices_from(gram)] += 1e-30
                weights = np.linalg.lstsq(gram, design.T @ target[keep], rcond=1e-13)[0]
                error = target[keep] - design @ weights
                past = channels * order
                coefficients[1:, c, :] = weights[:past].reshape(order, channels)
                coefficients[0, c, :c] = weights[past:]
                spent = len(weights)
            count = max(len(error) - spent - used, 1)
            sigma[c] = max(float(np.sqrt(np.sum(error**2) / count)), floor[c])
            criterion += len(error) * 2 * np.log(sigma[c]) + spent * np.log(max(len(error), 2))
        if best is None or criterion < best[0]:
            best = (criterion, Whitener(coefficients, sigma))
    assert best is not None
    return best[1]


def quantisation_step(y: Array) -> float:
    """The least significant bit of a channel; 0 if its values look continuous.

    A quantised channel has few distinct values, all whole multiples of the smallest difference between two of them.
    """
    values = np.unique(y[np.isfinite(y)])
    if len(values) < 3 or len(values) > 0.5 * len(y):
        return 0.0
    steps = np.diff(values)
    step = float(np.median(steps[steps < 2.5 * np.min(steps)]))
    whole = steps / step
    return step if np.max(np.abs(whole - np.round(whole))) < 0.1 else 0.0
