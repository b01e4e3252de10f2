"""What goes with the shaft angle must be seen while the shaft turns: forcings in full, and torques at rest."""

from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.forcing import forcing
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench import selection
from motorlens_workbench.candidates import shaped
from motorlens_workbench.diagnosis import base_fit
from motorlens_workbench.look import look
from motorlens_workbench.turning import WhileTurning

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
TIME = np.arange(10_000) * 0.002
# Two stops of 4 s.
RUNS = (TIME % 10.0) < 6.0


def test_the_forcing_is_the_effects_own_but_for_the_last_turn_about_a_stop():
    file = read_motor_file(MOTOR)
    effect = shaped(catalogue()["unbalance_torque"].typical(file.rated), A=0.2)
    voltage = np.where(RUNS, 40.0, 0.0)
    inputs = Inputs(TIME, voltage, np.zeros(len(TIME)), np.full(len(TIME), 20.0), held=True)
    trajectory = simulate(file.motor.with_effect(effect), inputs)
    everywhere = forcing(effect, trajectory).torque
    turning = WhileTurning("unbalance_torque", (effect,)).forcing(trajectory).torque[:, 0]
    kept = turning != 0
    assert np.array_equal(turning[kept], everywhere[kept])
    # Six tenths, but for the first turn after a start and the last before a stop.
    assert 0.5 < np.mean(kept) < 0.6
    assert not kept[~RUNS & (np.abs(trajectory.speed_rad_s) < 0.1)].any()


def recording(unbalance_Nm: float, at_stops_Nm: float) -> Recording:
    """20 s at 500 Hz with two stops, a torque of its own sign at each of them, which nobody measured."""
    file = read_motor_file(MOTOR)
    rng = np.random.default_rng(3)
    voltage = np.where(RUNS, np.repeat(rng.uniform(25.0, 50.0, 20), 500), 0.0)
    load = np.where(
        RUNS, 0.0, at_stops_Nm * np.where(TIME < 10.0, 1.0, -1.0) * np.sin(np.pi * (TIME % 10.0 - 6.0) / 4.0)
    )
    ambient = np.full(len(TIME), 20.0)
    motor = file.motor
    if unbalance_Nm:
        motor = motor.with_effect(shaped(catalogue()["unbalance_torque"].typical(file.rated), A=unbalance_Nm))
    true = simulate(motor, Inputs(TIME, voltage, load, ambient, held=True))
    return Recording(
        "stops", TIME,
        {"voltage": voltage, "load_torque": np.zeros(len(TIME)),
         "current": true.current_A + 0.02 * rng.standard_normal(len(TIME)),
         "speed": true.speed_rad_s + 0.05 * rng.standard_normal(len(TIME))},
    )  # fmt: skip


@pytest.mark.fit
@pytest.mark.parametrize(("unbalance_Nm", "at_stops_Nm"), [(0.05, 0.0), (0.0, 0.05)])
def test_torques_at_rest_do_not_pass_for_what_goes_with_the_angle(unbalance_Nm, at_stops_Nm):
    file = read_motor_file(MOTOR)
    found, runs = base_fit(file, prepare_all([recording(unbalance_Nm, at_stops_Nm)], file))
    now = look(found, runs)
    unbalance = now.tests["unbalance_torque"]
    at_first_sight = selection.test_all(now.left, [unbalance.candidate], found.model)["unbalance_torque"]
    # Only one is seen while the shaft turns; the other may look real at first sight.
    assert at_first_sight.statistic > selection.REAL or unbalance_Nm == 0
    assert (unbalance.statistic > 1000) == (unbalance_Nm > 0)
    assert (unbalance.statistic < selection.REAL) == (unbalance_Nm == 0)
