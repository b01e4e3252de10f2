"""What is missing about one speed alone: of a motor solved in closed form it is found with its place, and only there."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.changing import MOTOR, drive
from helpers.nameless import nameless

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_workbench.diagnose import diagnose, fitted_of
from motorlens_workbench.evidence.ledger import Lens, ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.hypotheses.bumps import FINER, Bump, fine_curves, in_bumps
from motorlens_workbench.report.json import sentence
from motorlens_workbench.standing import Standing, stand
from motorlens_workbench.verdict import settle

DT, N = 0.002, 2400
# A resonance of what the motor drives, in N m, about a speed and over a width in rad/s.
HEIGHT, SPEED, WIDTH = 0.3, 120.0, 6.0
# Updates of the speed at which the bump acts: each leaves less than a fiftieth of the change of the one before.
ROUNDS = 6


def recorded(height: float) -> Recording:
    rng = np.random.default_rng(7)
    voltage = 150 * np.repeat(rng.uniform(-1, 1, N // 60), 60)
    load = np.repeat(rng.uniform(-8, 8, N // 120), 120)
    current, speed = drive(voltage, load, DT)
    for _ in range(ROUNDS):
        bump = height * np.exp(-(((np.abs(speed) - SPEED) / WIDTH) ** 2)) * np.sign(speed)
        current, speed = drive(voltage, load + bump, DT)
    channels = {
        "voltage": voltage,
        "load_torque": load,
        "current": current + 0.03 * rng.standard_normal(N),
        "speed": speed + 0.3 * rng.standard_normal(N),
    }
    return Recording("bench", np.arange(N) * DT, channels)


@pytest.fixture(scope="module")
def here() -> Standing:
    file = read_motor_file(MOTOR)
    return stand(fitted_of(estimate(file, prepare_all([recorded(HEIGHT)], file))))


@pytest.mark.fit
def test_every_bump_has_the_sums_of_columns_of_its_own(here):
    hypotheses = fine_curves([line.trajectory for line in here.lines], here.fitted.model.file.rated)
    lens = Lens(here.noises)
    parts = in_bumps(ledger(here.lines, lens, here.fitted.prior, hypotheses).entries)
    some = parts[:: len(parts) // 20]
    alone = [replace(entry.hypothesis, shapes=(entry.shape,)) for entry in some]
    for part, entry in zip(some, ledger(here.lines, lens, here.fitted.prior, alone).entries, strict=True):
        assert part.cross == pytest.approx(entry.cross, rel=1e-9, abs=1e-9 * np.abs(entry.cross).max())
        assert part.inner == pytest.approx(entry.inner, rel=1e-9, abs=1e-9 * np.abs(entry.inner).max())


@pytest.mark.fit
def test_a_bump_is_seen_where_a_curve_over_all_speeds_hardly_sees_it(here):
    best = best_of(here.looks[0].scores)
    bump, curve = best["torque about one speed"], best["torque against speed"]
    assert isinstance(bump.entry.shape, Bump)
    assert bump.weight > 1.5 * curve.weight
    fine, coarse = np.diff(bump.entry.shape.knots), np.diff(curve.entry.shape.knots)
    assert np.sum(fine) == pytest.approx(np.sum(coarse))
    assert np.median(fine) == pytest.approx(np.median(coarse) / FINER, rel=0.3)


@pytest.mark.long
@pytest.mark.fit
def test_a_bump_is_unknown_and_told_with_its_speed():
    found = diagnose(read_motor_file(MOTOR), (recorded(HEIGHT),))
    verdict = settle(found)
    assert verdict.kind == "unknown"
    assert verdict.equation == "mechanical"
    assert isinstance(verdict.shape.entry.shape, Bump)
    place = verdict.shape.entry.shape.place(verdict.shape.coefficient)
    assert abs(place) == pytest.approx(SPEED, abs=WIDTH)
    _, value, _ = verdict.shape.entry.shape.values(verdict.shape.coefficient, verdict.shape.covariance)
    # It acts against the motion.
    assert -np.sign(place) * value[np.argmax(np.abs(value))] == pytest.approx(HEIGHT, rel=0.2)
    assert f"a torque about {place:.3g} rad/s alone" in sentence(found, verdict)


@pytest.mark.fit
def test_without_one_there_is_none():
    assert nameless(read_motor_file(MOTOR), recorded(0.0)) is None
