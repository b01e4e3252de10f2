"""A torque that nobody measured, as short as a sample: it must not pass for the voltage's noise, nor that for inertia."""

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL
from scipy.signal import lfilter

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
# A recording of an hour and a half at a sample a second, near standstill; the torque's part forgets within a sample.
SAMPLES, FORGETS = 5400, np.exp(-1.0)
VOLTAGE_SD, CURRENT_SD, TORQUE_SD = 0.16, 0.02, 0.013


@pytest.mark.fit
def test_a_motor_that_follows_within_a_sample_is_told_beside_a_torque_that_nobody_measured() -> None:
    rng = np.random.default_rng(11)
    motor = {**TYPICAL, "J": 0.9 * TYPICAL["J"], "ke": 0.9 * TYPICAL["ke"]}
    corners = np.sort(rng.uniform(0, SAMPLES, 60))
    volts = np.interp(np.arange(SAMPLES), corners, 0.08 * RATED["voltage"] * rng.uniform(-1, 1, 60))
    torque = TORQUE_SD * lfilter([np.sqrt(1 - FORGETS**2)], [1.0, -FORGETS], rng.standard_normal(SAMPLES))
    states = plain_motor.simulated(motor, volts, torque, plain_motor.Test(1.0, SAMPLES, 1, False, 0.0))
    channels = {
        "voltage": volts + VOLTAGE_SD * rng.standard_normal(SAMPLES),
        "current": states[:, 0] + CURRENT_SD * rng.standard_normal(SAMPLES),
    }
    file = MotorFile("plate", Motor(), PLATE)
    found = estimate(file, prepare_all([Recording("slow.csv", np.arange(float(SAMPLES)), channels)], file))
    (run,) = found.runs
    assert run.noise is not None
    voltage_V2, _, torque_Nm2 = run.noise.disturbances[:3]
    # Taken to hold from sample to sample it would be found 15 % too large, and the current's noise 8 % too small.
    assert np.sqrt(torque_Nm2) == pytest.approx(TORQUE_SD, rel=0.12)
    assert np.sqrt(voltage_V2) == pytest.approx(VOLTAGE_SD, rel=0.15)
    assert np.sqrt(run.noise.channels[0]) == pytest.approx(CURRENT_SD, rel=0.05)
    values, sd = found.fit.model.values(), found.fit.sd()
    assert max(abs(values[key] - motor[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")) < 3
