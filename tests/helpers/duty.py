"""The shipped motor and measured duty cycles of it."""

from functools import cache
from pathlib import Path

import numpy as np

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import chosen_scenario, measure, perform

MELLAH = read_motor_file(Path(__file__).resolve().parents[2] / "models" / "motors" / "mellah2016.toml")
NOISE = {"voltage": 0.5, "current": 0.05}


@cache
def measured_duty(seed: int, duration_s: float, rate_Hz: float = 100.0) -> Recording:
    """A duty cycle of the shipped motor with noisy voltage and current, all else true."""
    rng = np.random.default_rng(seed)
    return measure(perform(MELLAH, chosen_scenario("duty", duration_s, rate_Hz), rng), (), NOISE, rng)
