"""Noise of measured channels: its size, its colour, and weights that outliers do not get."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from motorlens_physics.simulation import Array

# Huber's bound in standard deviations: 95 % efficient on Gaussian noise would be 1.345; 2.5 keeps 99.9 %.
HUBER = 2.5
# Orders of colour that are tried.
ORDERS = (1, 2, 4, 8, 16)


@dataclass(frozen=True)
class Noise:
    """Noise of one channel of one run: an autoregression a_1 .. a_p driven by white noise of deviation sd."""

    sd: float
    colour: tuple[float, ...] = ()

    def whitened(self, columns: Array) -> Array:
        """Columns (N,) or (N, m) through the whitening filter, in units of the white noise."""
        if not self.colour:
            return columns / self.sd
        filtered = lfilter([1.0, *(-a for a in self.colour)], [1.0], columns, axis=0)
        # The first samples have no past; they count by the deviation of the coloured noise, which is larger.
        p = len(self.colour)
        filtered[:p] = columns[:p] * (self.sd / self.marginal_sd)
        return np.asarray(filtered / self.sd)

    @property
    def marginal_sd(self) -> float:
        """Deviation of the coloured noise itself."""
        if not self.colour:
            return self.sd
        response = lfilter([1.0], [1.0, *(-a for a in self.colour)], np.concatenate([[1.0], np.zeros(4095)]))
        return float(self.sd * np.sqrt(np.sum(response**2)))


def estimate(residual: Array, floor: float, *, order: int | None) -> Noise:
    """The noise that residuals show, missing samples (NaN) left out.

    Args:
        residual: (N,) measured less predicted.
        floor: smallest deviation that is believed.
        order: of the colour: 0 white, None as many as the residuals ask for (Akaike's criterion).
    """
    valid = np.isfinite(residual)
    sd = max(robust_sd(residual[valid]), floor)
    if order == 0 or valid.sum() < 200:
        return Noise(sd)
    clean = np.where(valid, np.clip(np.nan_to_num(residual), -4 * sd, 4 * sd), 0.0)
    n = clean.size
    orders = ORDERS if order is None else (order,)
    lags = np.array([clean[: n - k] @ clean[k:] for k in range(max(orders) + 1)]) / n
    if order is None and abs(lags[1]) < 4 / np.sqrt(n) * lags[0]:
        return Noise(sd)
    best, score = Noise(sd), np.inf
    for p in orders:
        # Yule-Walker: always a stable autoregression.
        a = solve_toeplitz(lags[:p] * np.where(np.arange(p) == 0, 1 + 1e-9, 1.0), lags[1 : p + 1])
        innovation = np.sqrt(max(lags[0] - a @ lags[1 : p + 1], 0.0))
        criterion = 2 * n * np.log(max(innovation, floor)) + 2 * p
        if criterion < score:
            best, score = Noise(max(float(innovation), floor), tuple(a.tolist())), criterion
    return best


def robust_sd(residual: Array) -> float:
    """Root mean square of residuals with those beyond Huber's bound cut to it, consistent for Gaussian noise."""
    if residual.size == 0:
        return 0.0
    sd = float(1.4826 * np.median(np.abs(residual)))
    if sd == 0.0:
        return float(np.sqrt(np.mean(residual**2)))
    # Expected square of a Gaussian cut at HUBER.
    consistency = 0.97756
    for _ in range(20):
        sd = float(np.sqrt(np.mean(np.clip(residual, -HUBER * sd, HUBER * sd) ** 2) / consistency))
    return sd


def huber_weights(whitened: Array) -> Array:
    """Weights that turn squares into Huber's loss."""
    size = np.abs(whitened)
    return np.where(size <= HUBER, 1.0, HUBER / np.maximum(size, HUBER))


def huber_loss(whitened: Array) -> float:
    """Huber's loss, half the square near zero."""
    size = np.abs(whitened)
    return float(np.sum(np.where(size <= HUBER, 0.5 * size**2, HUBER * (size - 0.5 * HUBER))))
