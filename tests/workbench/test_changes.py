"""Changes at once: those of a motor solved in closed form are found with their moment and size, and only there."""

import numpy as np
import pytest
from helpers.changing import MOTOR, drive
from helpers.nameless import nameless

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.hypotheses.changes import Change
from motorlens_workbench.report.json import sentence
from motorlens_workbench.verdict import settle

DT, N = 0.002, 2400
TIME = np.arange(N) * DT
# The same information in fewer samples: noise of eight thousand, less by the root of how many there are.
LESS = (N / 8000) ** 0.5


def recorded(**shares):
    rng = np.random.default_rng(4)
    voltage = 150 * np.repeat(rng.uniform(-1, 1, N // 60), 60)
    load = np.repeat(rng.uniform(-8, 8, N // 120), 120)
    current, speed = drive(voltage, load, DT, **shares)
    channels = {
        "voltage": voltage,
        "load_torque": load,
        "current": current + 0.05 * LESS * rng.standard_normal(N),
        "speed": speed + 0.5 * LESS * rng.standard_normal(N),
    }
    return Recording("bench", TIME, channels)


def diagnosed(**shares):
    found = diagnose(read_motor_file(MOTOR), (recorded(**shares),))
    return found, settle(found)


def is_dated(term, parameter, at_s, by):
    change = term.entry.shape
    assert isinstance(change, Change)
    assert change.term == parameter
    assert change.by(float(term.coefficient[0])) == pytest.approx(by, rel=0.15)
    assert change.at_s == pytest.approx(at_s, abs=0.12)


@pytest.mark.long
@pytest.mark.fit
def test_a_change_at_once_is_unknown_and_dated():
    found, verdict = diagnosed(flux=np.where(TIME > 1.8, 0.98, 1.0))
    assert verdict.kind == "unknown"
    is_dated(verdict.shape, "ke", 1.8, -0.02)
    assert "ke changes at once" in sentence(found, verdict)


@pytest.mark.fit
def test_a_change_of_the_resistance_is_dated_too():
    recording = recorded(resistance=np.where(TIME > 3.0, 1.04, 1.0))
    is_dated(nameless(read_motor_file(MOTOR), recording), "R_a0", 3.0, 0.04)


@pytest.mark.fit
def test_a_constant_motor_is_adequate():
    found, verdict = diagnosed()
    assert verdict.kind == "adequate"
    assert found.outcome.unnamed is None
