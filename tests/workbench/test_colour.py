"""The colour that is left in innovations: of what is noise, and of what lies between two levels of a converter."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.estimate.model import TOLERANCE
from motorlens_physics.estimate.noise import first_noise
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_workbench.evidence.colour import coloured, gain_of
from motorlens_workbench.evidence.whitening import fit_whitener

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
ROWS, NOISE, REMAINS = 2000, 0.1, 0.8


@pytest.mark.parametrize("step", [0.0, 0.05, 0.8])
def test_what_lies_between_two_levels_is_no_colour_of_the_noise(step: float) -> None:
    """Innovations of a speed that are correlated, and smaller than the noise says."""
    rng = np.random.default_rng(9)
    white, fresh = rng.standard_normal((2, ROWS))
    slow = fresh.copy()
    for k in range(1, ROWS):
        slow[k] = REMAINS * slow[k - 1] + np.sqrt(1 - REMAINS**2) * fresh[k]
    time = np.arange(ROWS) * 0.01
    channels = {"voltage": np.sign(np.sin(time)), "current": white, "speed": slow}
    run = prepare(Recording("coarse.csv", time, channels), read_motor_file(MOTOR))
    run = replace(run, steps=np.array([0.0, step]))
    noise = first_noise(run, np.full((ROWS, 2), NOISE), 1.0, TOLERANCE)
    # What came new to the speed a sample before shows in the current, which foretells nothing of itself.
    left = np.column_stack([white + 0.5 * np.roll(fresh, 1), 0.7 * slow])
    won = gain_of(run, left, fit_whitener(left, np.ones(ROWS, bool), np.zeros(2)), noise, 0)
    # An autoregression leaves 1 - REMAINS^2 of the speed's power, and of the current's 1 of 1.25, worth ROWS times the
    # logarithms of that; white noise is worth a few.
    expected = -ROWS * (np.log(1 - REMAINS**2) + np.log(1 / 1.25))
    assert won < 30 if step > NOISE * np.sqrt(12) else won == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("counted", [True, False])
def test_counts_that_come_late_and_are_made_up_for_are_no_colour(counted: bool) -> None:
    """A speed whose noise is the difference of that of its counts beside a current whose noise lasts; or their sum."""
    rng = np.random.default_rng(3)
    fresh, slow = rng.standard_normal((2, ROWS + 1))
    for k in range(1, ROWS + 1):
        slow[k] = REMAINS * slow[k - 1] + np.sqrt(1 - REMAINS**2) * slow[k]
    time = np.arange(ROWS) * 0.01
    left = np.column_stack([slow[1:], fresh[1:] - fresh[:-1] if counted else fresh[1:] + fresh[:-1]])
    channels = {"voltage": np.sign(np.sin(time)), "current": left[:, 0], "speed": left[:, 1]}
    run = prepare(Recording("counted.csv", time, channels), read_motor_file(MOTOR))
    whitener = coloured(run, left, 0)
    assert np.any(whitener.coefficients[:, 1]) != counted
    won = gain_of(run, left, whitener, first_noise(run, np.full((ROWS, 2), NOISE), 1.0, TOLERANCE), 0)
    # What lasts in the current is worth as much either way; in the speed, half of its power to order 6.
    of_current = -ROWS * np.log(1 - REMAINS**2)
    of_speed = 0.0 if counted else ROWS * np.log(2 / (1 + 1 / 8))
    assert won == pytest.approx(of_current + of_speed, rel=0.15)


@pytest.mark.parametrize("times", [1 + 1e-12, 1.5])
def test_what_is_as_small_as_is_believed_of_any_noise_has_no_colour(times: float) -> None:
    """A simulation without noise: what it leaves lasts, and is nothing; but a deviation more than that counts."""
    rng = np.random.default_rng(5)
    left = np.cumsum(rng.standard_normal((ROWS, 2)), axis=0)
    left *= 0.02 / np.std(left, axis=0)
    time = np.arange(ROWS) * 0.01
    channels = {"voltage": np.sign(np.sin(time)), "current": rng.standard_normal(ROWS), "speed": np.cos(time)}
    run = prepare(Recording("quiet.csv", time, channels), read_motor_file(MOTOR))
    noise = first_noise(run, np.zeros((ROWS, 2)), 1.0, TOLERANCE)
    noise = replace(noise, sensors=times * noise.floor[:, None])
    won = gain_of(run, left, coloured(run, left, 0), noise, 0)
    assert won == 0.0 if times < 1.1 else won > ROWS
