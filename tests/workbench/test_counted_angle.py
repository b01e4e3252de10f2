"""A log of a commanded voltage and of an encoder's counts, by other code, in which nothing is missing."""

from pathlib import Path

import pytest
from helpers.counted_angle import STATED, logged

from motorlens_physics.motor_file import voltage_commanded
from motorlens_physics.recording import read_recording
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.verdict import settle


# Steady steps as long as the rotor's time constant without a current, and uneven ones half as long with one.
@pytest.mark.fit
@pytest.mark.parametrize(
    ("number", "between"),
    [
        pytest.param(10, False, marks=pytest.mark.long),
        (14, False),
        pytest.param(14, True, marks=pytest.mark.long),
        (22, True),
        # Counts of a motor without any ripple repeat, and go with the angle.
        pytest.param(10, True, marks=pytest.mark.xfail(strict=True, reason="a cogging torque is named")),
    ],
)
def test_neither_counts_nor_a_command_that_changes_between_samples_pass_for_what_is_missing(
    number: int, between: bool, tmp_path: Path
) -> None:
    log = logged(4, number, between=between)
    recording = read_recording(log.write(tmp_path / "log.csv"), log.columns)
    found = diagnose(voltage_commanded(log.file), [recording])
    assert settle(found).kind == "adequate"
    run = found.base.runs[0]
    assert run.mean_speed and not run.late and run.noise is not None and run.noise.between == (between, False)
    values, sd = found.base.fit.model.values(), found.base.fit.sd()
    for key in STATED:
        assert abs(values[key] - log.truth[key]) < 4 * sd[key], key
