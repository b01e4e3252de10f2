"""Channels that were recorded late are found, moved and said; recordings come from an integrator of their own."""

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL, recorded

from motorlens_physics.estimate.delays import delays_of
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

pytestmark = pytest.mark.fit
PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
PERIOD_S = 0.002


@pytest.mark.parametrize("late", [0, 23])
def test_a_channel_that_was_recorded_late_is_found_moved_and_said(late: int) -> None:
    # The motor in hand is a fifth slower than its file, which must not pass for a delay, nor the delay for inertia.
    motor = TYPICAL | {"J": 1.2 * TYPICAL["J"]}
    time, channels = recorded(
        motor, plain_motor.Test(PERIOD_S, 3000, 300, True, 0.005), np.random.default_rng(3)
    )
    channels["speed"] = np.concatenate([channels["speed"][:1].repeat(late), channels["speed"][: 3000 - late]])
    file = MotorFile("plate", Motor(), PLATE)
    found = estimate(file, prepare_all([Recording("late.csv", time, channels)], file))
    said = delays_of(found.fit, found.runs)
    assert [(one.channel, one.recording) for one in said] == ([("speed", "late.csv")] if late else [])
    for one in said:
        assert one.value_s == pytest.approx(late * PERIOD_S, abs=0.1 * PERIOD_S)
        assert abs(one.value_s - late * PERIOD_S) < 5 * one.sd_s
        assert "s after its voltage" in one.sentence
    inertia, sd = found.fit.model.file.motor.J, found.fit.sd()["J"]
    assert inertia == pytest.approx(motor["J"], rel=0.01)
    assert abs(inertia - motor["J"]) < 4 * sd
