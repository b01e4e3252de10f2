"""The 95 % interval for the function covers 95 % of it, with white errors and with errors that last."""

import numpy as np
import pytest
import torch

from motorlens_train.cascade import Architecture
from motorlens_train.posterior import full_variance
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, train


def lasting(rows: int, columns: int, rho: float, rng: np.random.Generator) -> np.ndarray:
    """Stationary first-order processes of unit variance."""
    drive = rng.standard_normal((rows, columns)) * np.sqrt(1 - rho**2)
    drive[0] /= np.sqrt(1 - rho**2)
    for n in range(1, rows):
        drive[n] += rho * drive[n - 1]
    return drive


def coverage(rho: float, seed: int, series: bool) -> tuple[float, float]:
    """Share of the function inside the band, and root mean square of its distance in standard deviations."""
    rng = np.random.default_rng([seed, 1])
    x, unseen = lasting(3000, 2, rho, rng), rng.standard_normal((1000, 2))

    def function(x: np.ndarray) -> np.ndarray:
        return np.tanh(x[:, :1] + 0.5 * seed - 1) + 0.5 * np.tanh(x[:, 1:] - x[:, :1])

    y = function(x) + 0.4 * lasting(3000, 1, rho, rng)
    settings = Settings(single=False, time_series=series, iterations=60)
    trained = train(Arrays(x, y), Architecture(2, (4,), 1), seed, settings)
    variance = full_variance(
        trained.network, trained.evidence.factor, trained.inputs.scale(torch.from_numpy(unseen))
    )
    deviation = (variance.sqrt() * trained.targets.deviation).numpy()
    distance = (trained.predict(torch.from_numpy(unseen)).numpy() - function(unseen)) / deviation
    return float(np.mean(np.abs(distance) <= 1.96)), float(np.sqrt(np.mean(distance**2)))


@pytest.mark.fit
def test_function_is_covered_where_errors_are_white() -> None:
    covered, distance = np.mean([coverage(0.0, seed, series=True) for seed in range(8)], axis=0)
    assert 0.85 < covered < 0.99 and 0.8 < distance < 1.3


@pytest.mark.fit
def test_only_a_tempered_posterior_is_as_sure_as_it_may_be_where_errors_last() -> None:
    """Errors and inputs correlated over 30 samples."""
    covered, distance = np.mean([coverage(0.935, seed, series=True) for seed in range(6)], axis=0)
    assert covered > 0.9 and 0.4 < distance < 1.2
    blind, far = np.mean([coverage(0.935, seed, series=False) for seed in range(6)], axis=0)
    assert blind < 0.8 and far > 1.5 * distance
