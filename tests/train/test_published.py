"""Bayesian regularisation against a published figure of it: how many parameters a noisy sine takes.

MathWorks, "Improve Shallow Neural Network Generalization and Avoid Overfitting", trains `feedforwardnet(20, 'trainbr')`
(Foresee and Hagan 1997) on `x = -1:.05:1; t = sin(2*pi*x) + 0.1*randn(size(x))` and prints about 12 effective parameters
out of 61, a number that "should remain approximately the same, no matter how large the number of parameters in the
network becomes". The noise drawn there is not published, so this is the mean over several draws.
"""

from functools import cache

import numpy as np

from motorlens_train.cascade import Architecture
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, train


@cache
def effective(width: int, draw: int) -> tuple[float, float]:
    """Effective parameters of the better of two starts, and the noise it finds."""
    x = np.linspace(-1, 1, 41)[:, None]
    y = np.sin(2 * np.pi * x) + 0.1 * np.random.default_rng(draw).standard_normal(x.shape)
    architecture = Architecture(1, (width,), 1, skips=False)
    starts = [train(Arrays(x, y), architecture, seed, Settings(single=False)) for seed in (1, 2)]
    best = max(starts, key=lambda trained: trained.evidence.log_evidence)
    assert architecture.parameters == 3 * width + 1
    return float(best.evidence.gamma.sum()), float(best.targets.deviation / best.hyper.beta.sqrt())


def test_a_noisy_sine_takes_about_twelve_of_sixty_one_parameters() -> None:
    gamma, noise = np.mean([effective(20, draw) for draw in range(3)], axis=0)
    assert 9 < gamma < 14
    assert 0.085 < noise < 0.115


def test_their_number_does_not_grow_with_the_network() -> None:
    pairs = [(effective(20, draw)[0], effective(40, draw)[0]) for draw in range(2)]
    for narrow, wide in pairs:
        assert abs(wide - narrow) < 2.5, "twice the units, and as many parameters in effect"
