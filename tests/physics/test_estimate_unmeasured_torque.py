"""A torque that nobody measured, as short as a sample: it must not pass for the voltage's noise, nor that for inertia."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL
from scipy.signal import lfilter

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.noise import TORQUE
from motorlens_physics.estimate.notes import notes_of
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
# A recording of an hour and a half at a sample a second, near standstill; a share of the torque remains at the next sample.
SAMPLES, REMAINS = 5400, float(np.exp(-1.0))
VOLTAGE_SD, CURRENT_SD, TORQUE_SD = 0.16, 0.02, 0.013
# Noise of the load's sensor, far less than the torque that it does not see.
LOAD_SD = 0.003
MOTOR = {**TYPICAL, "J": 0.9 * TYPICAL["J"], "ke": 0.9 * TYPICAL["ke"]}


def recorded(*, loaded: bool) -> Recording:
    """Voltage and current; `loaded`, also a load that steps and is measured."""
    rng = np.random.default_rng(11)
    corners = np.sort(rng.uniform(0, SAMPLES, 60))
    volts = np.interp(np.arange(SAMPLES), corners, 0.08 * RATED["voltage"] * rng.uniform(-1, 1, 60))
    torque = TORQUE_SD * lfilter([np.sqrt(1 - REMAINS**2)], [1.0, -REMAINS], rng.standard_normal(SAMPLES))
    voltage_noise, current_noise = rng.standard_normal((2, SAMPLES))
    load = np.zeros(SAMPLES)
    if loaded:
        load = np.repeat(0.05 * RATED["load_torque"] * rng.uniform(-1, 1, SAMPLES // 300), 300)
    states = plain_motor.simulated(MOTOR, volts, load + torque, plain_motor.Test(1.0, SAMPLES, 1, False, 0.0))
    channels = {
        "voltage": volts + VOLTAGE_SD * voltage_noise,
        "current": states[:, 0] + CURRENT_SD * current_noise,
    }
    if loaded:
        channels["load_torque"] = load + LOAD_SD * rng.standard_normal(SAMPLES)
    return Recording("slow.csv", np.arange(float(SAMPLES)), channels)


@pytest.mark.fit
@pytest.mark.parametrize("loaded", [False, True])
def test_a_motor_that_follows_within_a_sample_is_told_beside_a_torque_that_nobody_measured(
    loaded: bool,
) -> None:
    """Beside a load that was measured, too: no noise of its sensor is as large."""
    file = MotorFile("plate", Motor(), PLATE)
    found = estimate(file, prepare_all([recorded(loaded=loaded)], file))
    (run,) = found.runs
    assert run.noise is not None
    voltage_V2, _, torque_Nm2 = run.noise.disturbances[:3]
    assert run.noise.lasts_s[TORQUE] <= 3.0
    # Taken to hold from sample to sample it would be found 15 % too large, and the current's noise 8 % too small.
    assert np.sqrt(torque_Nm2) == pytest.approx(TORQUE_SD, rel=0.12)
    assert np.sqrt(voltage_V2) == pytest.approx(VOLTAGE_SD, rel=0.15)
    assert np.sqrt(run.noise.of_sensors(run)[0]) == pytest.approx(CURRENT_SD, rel=0.05)
    values, sd = found.fit.model.values(), found.fit.sd()
    assert max(abs(values[key] - MOTOR[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")) < 3


@pytest.mark.fit
@pytest.mark.parametrize("stated", [True, False])
def test_a_load_of_exactly_nothing_says_that_the_shaft_is_bare(stated: bool) -> None:
    """Then there is no torque sensor that could be wrong, and no torque but the motor's own: none is made up for errors."""
    file, load = MotorFile("plate", Motor(), PLATE), np.zeros(SAMPLES)
    load[-1] = 0.0 if stated else 1e-6
    recording = recorded(loaded=False)
    recording = replace(recording, channels={**recording.channels, "load_torque": load})
    (run,) = estimate(file, prepare_all([recording], file)).runs
    assert run.bare == stated and run.load_known and ("load_torque" in run.known) != stated
    assert run.noise is not None and (run.noise.disturbances[TORQUE] == 0.0) == stated
    assert any("nothing is on the shaft" in note for note in notes_of([run])) == stated
