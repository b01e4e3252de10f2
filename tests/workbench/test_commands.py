"""A command acts when the drive has computed it: found, whatever the motor file says of the voltage."""

from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.estimate.calibrate import calibrate
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.diagnose import diagnose

# Its motor file says that the voltage is a command.
WHEEL = Path(__file__).resolve().parents[2] / "examples/hidden_effect/regbot.toml"
ROWS, PERIOD_S = 800, 0.001


def logged(late: int) -> Recording:
    """The wheel under random levels that are held; the log has each command `late` samples before it acts."""
    rng = np.random.default_rng(4)
    time = np.arange(ROWS) * PERIOD_S
    command = np.repeat(rng.choice([-6.0, -3.0, 2.0, 4.0, 6.0], ROWS // 20), 20)
    applied = np.concatenate([np.full(late, command[0]), command[: ROWS - late]])
    still = np.zeros(ROWS)
    inputs = Inputs(time, applied, still, np.full(ROWS, 22.0), held=True)
    states = simulate(read_motor_file(WHEEL).motor, inputs).states
    measured = {
        "voltage": command,
        "current": states["i"] + 0.01 * rng.standard_normal(ROWS),
        "speed": states["w"] + 0.1 * rng.standard_normal(ROWS),
    }
    return Recording("wheel", time, measured)


@pytest.mark.parametrize("late", [0, 1])
def test_a_command_that_acts_late_is_found_and_the_inductance_does_not_make_up_for_it(late):
    file = read_motor_file(WHEEL)
    found = estimate(file, [prepare(logged(late), file)])
    assert dict(found.runs[0].late) == ({"current": 1, "speed": 1} if late else {})
    # How a load ran that was not recorded, nothing tells.
    ((voltage, _, _),) = found.fit.model.held
    assert voltage is True
    assert found.fit.model.file.motor.L == pytest.approx(0.0066, rel=0.03)


@pytest.mark.fit
def test_calibrate_and_diagnose_stand_on_the_same_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    file, recording = read_motor_file(WHEEL), logged(0)
    monkeypatch.setattr("motorlens_workbench.diagnose.contest", lambda *given: None)
    base, found = diagnose(file, [recording]).base, calibrate(file, [recording])
    assert found.findings.untold and found.findings.told
    values, sd = base.fit.model.values(), base.fit.sd()
    for key in found.findings.told:
        assert values[key] == found.value[key] and sd[key] == found.sd[key]
