"""The standard deviation that the sensor publishes, calibrated on duty cycles the network was not trained on.

`sigma^2 = function variance (last-layer posterior) + exp(c . z)`: what remains has a variance that depends on
what the output layer reads, z, because a motor at constant load tells less than one that starts. The weights
c maximise the likelihood of the errors on the calibration cycles (Nix and Weigend 1994) under a ridge that is
chosen by leaving half of the cycles out.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize

from motorlens_train.specification import Array

RIDGES = (0.001, 0.01, 0.1, 1.0)
# No sensor is better than this share of how far its output spreads; below it, how near it came says nothing.
FLOOR = 2e-3
# With fewer cycles than this, how errors depend on the situation cannot be learned: one variance for all.
ENOUGH = 6


def noise_head(read: Sequence[Array], errors: Sequence[Array], function_variance: Sequence[Array]) -> Array:
    """Weights of the logarithm of the remaining variance.

    Args:
        read: per cycle `[N, Z]`, what the output layer reads; column 0 is the constant.
        errors: per cycle `[N, K]`, scaled.
        function_variance: per cycle `[N, K]`, scaled.

    Returns:
        `[K, Z]`.
    """
    heads = []
    for k in range(errors[0].shape[1]):
        parts = [
            (z, e[:, k] ** 2 + FLOOR**2, s[:, k])
            for z, e, s in zip(read, errors, function_variance, strict=True)
        ]
        if len(parts) < ENOUGH:
            constant = np.zeros(read[0].shape[1])
            constant[0] = np.log(np.mean(np.concatenate([square for _, square, _ in parts])))
            heads.append(constant)
            continue
        halves = (parts[::2], parts[1::2])
        scores = [
            sum(_surprise(_fit(halves[1 - side], ridge), halves[side]) for side in (0, 1)) for ridge in RIDGES
        ]
        heads.append(_fit(parts, RIDGES[int(np.argmin(scores))]))
    return np.stack(heads)


_Part = tuple[Array, Array, Array]


def _fit(parts: Sequence[_Part], ridge: float) -> Array:
    z, square, variance = (np.concatenate([part[j] for part in parts]) for j in range(3))

    def objective(c: Array) -> tuple[float, Array]:
        noise = np.exp(np.clip(z @ c, -25.0, 10.0))
        total = variance + noise
        value = 0.5 * np.mean(np.log(total) + square / total) + 0.5 * ridge * c[1:] @ c[1:]
        slope = z.T @ (0.5 * noise / total * (1 - square / total)) / len(z)
        return float(value), np.asarray(slope + ridge * np.concatenate([[0.0], c[1:]]))

    start = np.zeros(z.shape[1])
    start[0] = np.log(square.mean())
    return np.asarray(minimize(objective, start, jac=True, method="L-BFGS-B", options={"maxiter": 200}).x)


def _surprise(c: Array, parts: Sequence[_Part]) -> float:
    """Negative log likelihood per sample on other cycles."""
    z, square, variance = (np.concatenate([part[j] for part in parts]) for j in range(3))
    total = variance + np.exp(np.clip(z @ c, -25.0, 10.0))
    return float(np.mean(np.log(total) + square / total))
