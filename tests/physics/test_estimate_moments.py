"""Loads that change between samples, of a motor solved in closed form ten times as finely as it is recorded."""

import numpy as np
import pytest
from helpers.changing import MOTOR, drive, textbook

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording

PERIOD_S, FINE, SAMPLES, EVERY = 0.02, 10, 2000, 50


def recorded(between: bool) -> Recording:
    """A voltage that changes at samples, and a load that does so, or anywhere."""
    rng = np.random.default_rng(8)
    levels = SAMPLES // EVERY
    voltage = np.repeat(rng.uniform(80.0, 200.0, levels), FINE * EVERY)
    load = np.repeat(rng.uniform(-6.0, 6.0, levels), FINE * EVERY)
    if between:
        load = np.repeat(load[:: FINE * EVERY], np.diff([0, *_moments(rng, levels), SAMPLES * FINE]))
    current, speed = drive(voltage, load, PERIOD_S / FINE)
    at = slice(0, None, FINE)
    channels = {
        "voltage": voltage[at],
        "load_torque": load[at] + 0.01 * rng.standard_normal(SAMPLES),
        "current": current[at] + 0.02 * rng.standard_normal(SAMPLES),
        "speed": speed[at] + 0.2 * rng.standard_normal(SAMPLES),
    }
    return Recording("bench", np.arange(SAMPLES) * PERIOD_S, channels)


def _moments(rng: np.random.Generator, levels: int) -> np.ndarray:
    return FINE * EVERY * np.arange(1, levels) + rng.integers(1, FINE, levels - 1)


@pytest.mark.fit
@pytest.mark.parametrize("between", [False, True])
def test_when_a_load_changed_is_left_open_where_that_is_likelier(between: bool) -> None:
    file = read_motor_file(MOTOR)
    found = estimate(file, prepare_all([recorded(between)], file))
    noise = found.runs[0].noise
    assert noise is not None and noise.between == (False, between)
    values, sd, truth = found.fit.model.values(), found.fit.sd(), textbook()
    for key in ("R_a0", "L", "ke", "J", "b"):
        assert abs(values[key] - truth[key]) < 4 * sd[key], key
        assert sd[key] < 0.2 * truth[key], key
