"""A torque that nobody measured, as short as a sample: it must not pass for the voltage's noise, nor that for inertia."""

import numpy as np
import pytest
from helpers.plain_motor import RATED
from helpers.short_torque import CURRENT_SD, MOTOR, TORQUE_SD, VOLTAGE_SD, recorded

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.noise import TORQUE
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip


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
    assert np.sqrt(run.noise.channels[0]) == pytest.approx(CURRENT_SD, rel=0.05)
    values, sd = found.fit.model.values(), found.fit.sd()
    assert max(abs(values[key] - MOTOR[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")) < 3
