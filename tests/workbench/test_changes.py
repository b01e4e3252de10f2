"""Changes at once: those of a motor solved in closed form are found with their moment and size, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.changing import MOTOR, drive
from helpers.nameless import nameless

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.diagnose import diagnose, fitted_of
from motorlens_workbench.hypotheses.changes import Change
from motorlens_workbench.report.json import sentence
from motorlens_workbench.standing import stand
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
    # To a block and a half: a recording has 64.
    assert change.at_s == pytest.approx(at_s, abs=1.5 * change.time_s[3] / 64)


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


def warmed(before, after, cut=1200, samples=2400, period_s=3.0):
    """Two hours of a free shaft, in which a motor becomes another: simulated until then, and on from there."""
    rng = np.random.default_rng(4)
    time, constant = np.arange(samples) * period_s, np.ones(samples)
    level = rng.uniform(60, 230, samples // 60) * rng.choice([-1, 1], samples // 60)
    inputs = Inputs(time, np.repeat(level, 60), 0 * constant, 20 * constant)
    parts = [slice(0, cut + 1), slice(cut, samples)]
    states, start = [], None
    for motor, part in zip((before, after), parts, strict=True):
        there = Inputs(
            time[part], inputs.voltage_V[part], inputs.load_torque_Nm[part], inputs.ambient_C[part]
        )
        made = simulate(motor, there, start).states
        start = {name: float(values[-1]) for name, values in made.items()}
        states.append(made)
    current, speed, rise = (np.concatenate([states[0][x][:-1], states[1][x]]) for x in ("i", "w", "theta"))
    channels = {
        "voltage": inputs.voltage_V,
        "current": current + 0.05 * rng.standard_normal(samples),
        "speed": speed + rng.standard_normal(samples),
        "temperature": 20 + rise + 0.2 * rng.standard_normal(samples),
    }
    return Recording("bench", time, channels)


@pytest.mark.fit
def test_what_warmed_a_winding_before_is_not_undone_by_a_change():
    """A magnet that weakens: the winding stays as warm as it was at that moment, and cools as slowly as ever."""
    file = read_motor_file(MOTOR)
    weaker = replace(file.motor, ke=0.985 * file.motor.ke)
    is_dated(nameless(file, warmed(file.motor, weaker)), "ke", 3600.0, -0.015)


@pytest.mark.fit
def test_a_column_that_is_cut_is_what_a_simulation_of_the_change_gives():
    file = read_motor_file(MOTOR)
    worse = replace(file.motor, k0=0.9 * file.motor.k0)
    here = stand(fitted_of(estimate(file, prepare_all([warmed(file.motor, worse)], file))))
    bare = here.looks[1]
    cut = [score for score in bare.scores if score.name == "k0 changes at once"]
    _, simulated = bare.entries(cut, here.lines, here.lenses[1], here.fitted.prior)
    best = max(cut, key=lambda score: score.gain)
    assert abs(best.entry.shape.at_s - 3600.0) < 120.0
    for score, entry in zip(cut, simulated, strict=True):
        # A simulated change is a slope over the sample before it, which is little of what lasts.
        few = 5 / np.sum(here.lines[0].run.inputs.time_s >= score.entry.shape.at_s)
        for mine, theirs in ((score.entry.inner, entry.inner), (score.entry.cross, entry.cross)):
            assert np.abs(mine - theirs).max() < (0.002 + few) * np.abs(theirs).max()


@pytest.mark.fit
def test_a_constant_motor_is_adequate():
    found, verdict = diagnosed()
    assert verdict.kind == "adequate"
    assert found.outcome.unnamed is None
