"""Smoothing against a signal that is known: noise goes, steps and ramps stay."""

import numpy as np
import pytest
from scipy.signal import lfilter

from motorlens_physics.estimate.signals import Lasting, level_of, most_noise_sd, noise_sd, smoothed

SIGNALS = {
    "constant": np.full(6000, 3.0),
    "sinusoid": 50 * np.sin(np.arange(6000) / 300),
    "steps": np.repeat(np.random.default_rng(0).uniform(-50, 50, 12), 500),
    "triangle": 60 * np.abs(np.arange(6000) % 2000 - 1000) / 1000,
    "steps on a sinusoid": np.repeat(np.random.default_rng(1).uniform(-50, 50, 12), 500)
    + 10 * np.sin(np.arange(6000) / 50),
}


def test_noise_goes_and_steps_stay():
    rng = np.random.default_rng(0)
    levels = np.repeat(rng.uniform(-10, 10, 40), 250)
    ramp = np.interp(np.arange(10_000), [0, 3000, 3500, 10_000], [0, 0, 8, 8])
    truth = levels + ramp
    noisy = truth + 0.1 * rng.standard_normal(len(truth))
    assert noise_sd(noisy) == pytest.approx(0.1, rel=0.05)
    error = smoothed(noisy) - truth
    assert np.std(error) < 0.35 * 0.1
    steps = np.flatnonzero(np.diff(levels))
    near = (steps[:, None] + np.arange(-2, 4)).ravel()
    # At a step the error is that of the noise, not that of a rounded step of several units.
    assert np.std(error[near]) < 0.15
    assert np.abs(error[near]).max() < 0.5


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_what_a_fast_sinusoid_bends_by_is_no_noise(step: float) -> None:
    """A twentieth of a turn from sample to sample: second differences of 100 times (0.31)^2, sixth of 0.09."""
    bends = 100 * np.sin(2 * np.pi * np.arange(4000) / 20)
    seen = bends + np.random.default_rng(0).standard_normal(4000)
    seen = step * np.round(seen / step) if step else seen
    assert noise_sd(seen, step) == pytest.approx(1.0, rel=0.1)
    assert 1.0 < most_noise_sd(seen, step) < 1.15


@pytest.mark.parametrize("step", [0.0, 0.5])
def test_noise_is_rarely_more_than_the_most_that_it_may_be(step: float) -> None:
    rng = np.random.default_rng(1)
    most = []
    for phase in rng.uniform(0, 2 * np.pi, 300):
        seen = 20 * np.sin(np.arange(1000) / 200 + phase) + rng.standard_normal(1000)
        most.append(most_noise_sd(step * np.round(seen / step) if step else seen, step))
    # Two deviations, and the least of five orders.
    assert 0.002 < np.mean(np.array(most) < 1.0) < 0.1
    assert np.mean(most) < 1.15


def test_noise_that_comes_and_goes_may_be_much_more() -> None:
    lasts = np.repeat([0.1, 3.0], 500)
    seen = np.tile(lasts, 4) * np.random.default_rng(2).standard_normal(4000)
    mean = np.sqrt(np.mean(lasts**2))
    assert noise_sd(seen) < 0.5 * mean
    assert noise_sd(seen) < 0.7 * most_noise_sd(seen) and most_noise_sd(seen) < mean


def test_a_signal_without_noise_is_left_alone():
    y = np.sin(np.arange(1000) / 50)
    assert np.abs(smoothed(y) - y).max() < 0.01


@pytest.mark.parametrize("walk", [1e-5, 1e-3])
def test_a_level_that_wanders_is_followed_as_closely_as_its_noise_lets(walk):
    rng = np.random.default_rng(5)
    truth = np.cumsum(np.sqrt(walk) * rng.standard_normal(40_000))
    found = level_of(np.arange(40_000.0), truth + rng.standard_normal(40_000), 5.0)
    # Of the steady smoother (Durbin and Koopman, section 2.11): the filter's gain solves gain^2 / (1 - gain) = walk.
    gain = (np.sqrt(walk**2 + 4 * walk) - walk) / 2
    assert np.mean((found - truth) ** 2) == pytest.approx(gain / (2 - gain), rel=0.25)


def test_a_level_that_rests_is_averaged_over_all_of_it_with_gaps_and_all():
    rng = np.random.default_rng(6)
    time = np.cumsum(np.where(rng.random(10_000) < 0.01, 50.0, 1.0))
    found = level_of(time, 20.0 + 0.05 * rng.standard_normal(10_000), 60.0)
    assert 0 < np.abs(found - 20.0).max() < 5 * 0.05 / np.sqrt(10_000)
    assert np.array_equal(level_of(time, np.full(10_000, 20.0), 60.0), np.full(10_000, 20.0))


@pytest.mark.parametrize("sd", [0.5, 2.0])
@pytest.mark.parametrize(("name", "most"), [*zip(SIGNALS, (0.1, 0.2, 0.15, 0.2, 0.35), strict=True)])
def test_what_smoothing_leaves_of_noise(name: str, most: float, sd: float) -> None:
    """Of its standard deviation; and by no more than that is the signal bent, of which none is passed on to the noise."""
    signal = SIGNALS[name]
    noise = sd * np.random.default_rng(7).standard_normal(len(signal))
    left = smoothed(signal + noise, sd=sd) - signal
    assert np.std(left) < most * sd
    # The share of the noise that is left in the signal, not the signal's own error.
    assert -0.01 < left @ noise / (noise @ noise) < most


@pytest.mark.parametrize(("name", "most"), [*zip(list(SIGNALS)[:4], (0.15, 0.5, 0.5, 0.55), strict=True)])
@pytest.mark.parametrize("remains", [0.8, 0.95])
def test_what_smoothing_leaves_of_coloured_noise(name: str, most: float, remains: float) -> None:
    """Of noise half white, by its deviation; taken for white noise, all that is coloured would be left."""
    signal, rng = SIGNALS[name], np.random.default_rng(7)
    lasts = lfilter([np.sqrt(1 - remains**2)], [1.0, -remains], rng.standard_normal(len(signal)))
    noise = 0.5 * rng.standard_normal(len(signal)) + 0.87 * lasts
    left = smoothed(signal + noise, sd=0.5, lasting=Lasting(0.87, remains)) - signal
    assert np.std(left) < most
    assert np.std(smoothed(signal + noise, sd=0.5) - signal) > 0.7


def test_a_signal_that_wanders_from_sample_to_sample_is_left_as_it_is() -> None:
    rng = np.random.default_rng(3)
    signal = 10 * rng.standard_normal(3000)
    assert np.std(smoothed(signal, sd=0.5) - signal) < 0.05 * 0.5
