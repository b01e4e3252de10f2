"""Bayes factors of the contest against integrals done numerically."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad

from motorlens_workbench.contest import log_bayes_factor


def score(size: float, information: float, *, named: bool = True) -> SimpleNamespace:
    """A single column whose best size, in typical sizes, is known with some information."""
    return SimpleNamespace(
        entry=SimpleNamespace(hypothesis=SimpleNamespace(named=named)),
        gain=size**2 * information,
        information=np.array([[information]]),
        coefficient=np.array([size]),
        width=1,
    )


@pytest.mark.parametrize("size", [0.3, 1.0, 4.0, 30.0])
@pytest.mark.parametrize("information", [100.0, 1e4])
@pytest.mark.parametrize("scatter", [1.0, 5.0])
def test_a_name_is_weighed_by_the_integral_over_cauchys_sizes(size, information, scatter):
    """Laplace's approximation, but for a constant that all names share: half the logarithm of 2 over pi."""
    known = information / scatter
    around = size + np.linspace(-8, 8, 17) / np.sqrt(known)
    exact = quad(
        lambda c: np.exp(-0.5 * known * (c - size) ** 2) / (np.pi * (1 + c**2)),
        around[0], around[-1], points=around[1:-1], limit=200,
    )[0]  # fmt: skip
    told = log_bayes_factor(score(size, information), scatter) - 0.5 * size**2 * known
    assert told + 0.5 * np.log(2 / np.pi) == pytest.approx(np.log(exact), abs=0.12)


def test_of_two_that_explain_as_much_the_one_nearer_its_typical_size_is_likelier():
    gain = 60.0
    told = {size: log_bayes_factor(score(size, gain / size**2), 1.0) for size in (0.05, 1.0, 20.0)}
    assert told[1.0] > told[0.05] + 1 and told[1.0] > told[20.0] + 1
