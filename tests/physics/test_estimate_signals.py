"""Smoothing against a signal that is known: noise goes, steps and ramps stay."""

import numpy as np
import pytest

from motorlens_physics.estimate.signals import noise_sd, smoothed


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


def test_a_signal_without_noise_is_left_alone():
    y = np.sin(np.arange(1000) / 50)
    assert np.abs(smoothed(y) - y).max() < 0.01
