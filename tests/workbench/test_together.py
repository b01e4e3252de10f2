"""Two effects of another plant that enter a model together, and one beside which nothing does."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.hidden import plant
from helpers.hidden.motors import MOTORS

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import MotorFile, read_motor_file, voltage_commanded
from motorlens_physics.recording import Recording
from motorlens_workbench.contest import together
from motorlens_workbench.contest.together import enter_two
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, stand

BRIDGE = "coasting_bridge"
# What a voltage and a speed do not tell apart.
FRICTION = {
    "coulomb_friction",
    "hysteresis_iron_loss",
    "brush_voltage_drop",
    "dead_time",
    "stribeck_friction",
}


@pytest.fixture(scope="module")
def file(tmp_path_factory) -> MotorFile:
    """Of a motor whose voltage is a command."""
    return voltage_commanded(
        read_motor_file(MOTORS["gear_12V"].write_datasheet(tmp_path_factory.mktemp("file") / "motor.toml"))
    )


def swept(file: MotorFile, friction: float, bump: float = 0.0) -> Standing:
    """Where the textbook stands beside a sweep, a second a level, over a bridge that opens in the off time.

    Beside friction there may be a bump of the torque about a speed, in shares of the rated torque.
    """
    motor = MOTORS["gear_12V"]
    time = np.arange(400.0)
    inputs = np.zeros((len(time), plant.INPUTS))
    inputs[:, plant.VOLTAGE] = np.interp(time, [0, 100, 300, 400], [0, 8, -8, 0])
    inputs[:, plant.FLUX] = 1.0
    p = plant.vector(
        **motor.textbook, coasting=1.0, bus_V=motor.voltage_V, tau_c=friction * motor.torque_Nm,
        bump=bump * motor.torque_Nm, bump_w=0.25 * motor.speed_rad_s, bump_width=0.05 * motor.speed_rad_s,
    )  # fmt: skip
    states = plant.simulate(1.0, inputs, plant.rest(), p, substeps=40)
    noise = 0.003 * motor.speed_rad_s * np.random.default_rng(0).standard_normal(len(time))
    channels = {"voltage": inputs[:, plant.VOLTAGE], "speed": states[:, plant.W] + noise}
    runs = prepare_all([Recording("sweep.csv", time, channels)], file)
    return stand(fitted_of(estimate(file, runs)))


def beside(here: Standing, name: str) -> dict[str, tuple]:
    """The attempt with a name, as the contest has it where it does not hold."""
    end = with_hypothesis(here.fitted, here.book.beside(), best_of(here.scores)[name])
    assert end is not None
    return {name: (here.fitted, settled(end))}


@pytest.mark.fit
def test_a_bridge_and_friction_enter_together(file):
    here, said = swept(file, 0.1), []
    found = enter_two(here, beside(here, BRIDGE), (), said.append)
    assert said[0] == "beside coasting bridge"
    assert found is not None
    there, (first, second) = found
    assert first.hypothesis.name == BRIDGE and second.hypothesis.name in FRICTION
    assert there.fitted.model.values()[f"{BRIDGE}.s"] == pytest.approx(1.0, abs=0.05)
    assert there.times_noise < 2.0 < here.times_noise
    # A model of other parameters is none to go on from.
    other = {name: (replace(model), end) for name, (model, end) in beside(here, BRIDGE).items()}
    assert enter_two(here, other, (), said.append) is None


@pytest.mark.long
@pytest.mark.fit
def test_two_that_leave_more_than_noise_are_not_the_truth(file, monkeypatch):
    """A bump of the torque is missing besides, and in no catalogue: each is beyond chance beside the other."""
    here = swept(file, 0.1, bump=0.1)
    assert enter_two(here, beside(here, BRIDGE), (), lambda text: None) is None
    monkeypatch.setattr(together, "follows", lambda standing: True)
    found = enter_two(here, beside(here, BRIDGE), (), lambda text: None)
    assert found is not None and found[0].times_noise > 100


@pytest.mark.long
@pytest.mark.fit
def test_beside_what_is_the_whole_truth_nothing_enters(file):
    here = swept(file, 0.0)
    assert enter_two(here, beside(here, BRIDGE), (), lambda text: None) is None
