"""A population from parabolas that are drawn, not fitted: every true value is known, and no recording is simulated."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from motorlens_physics.motor_file import read_motor_file
from motorlens_workbench.fleet.history import histories
from motorlens_workbench.fleet.population import Observation, population
from motorlens_workbench.fleet.summary import Parabola

KEYS = ("R_a0", "ke", "b", "k0", "coulomb_friction.tau_c", "quadratic_drag.c")
MAKE = np.array([3.8, 0.9, 0.0017, 4.33])
SPREAD = np.array([0.06, 0.03, 0.15, 0.0])
# Of one recording, relative; the last is not told at all. Then of the candidates, in their units.
OWN = np.array([0.01, 0.002, 0.50, 50.0])
CANDIDATES = np.array([0.02, 2e-7])
BROKEN, DRAGS = 7, 11
MOTORS, EACH = 60, 5
SINCE = 3


def drawn(rng, friction_of_all):
    out, truth = [], np.empty((MOTORS, 4))
    width = np.concatenate([MAKE * OWN, CANDIDATES])
    # Viscous and Coulomb friction are alike in a recording.
    correlation = np.eye(6)
    correlation[2, 4] = correlation[4, 2] = -0.8
    covariance = correlation * np.outer(width, width)
    information, root = np.linalg.inv(covariance), np.linalg.cholesky(covariance)
    for m in range(MOTORS):
        truth[m] = MAKE * np.exp(SPREAD * rng.standard_normal(4))
        if m == BROKEN:
            truth[m, 0] *= 1.5
        for r in range(EACH):
            friction = friction_of_all + (0.3 if m == DRAGS and r >= SINCE else 0.0)
            x = np.concatenate([truth[m], [friction, 0.0]])
            top = x + root @ rng.standard_normal(6)
            # Found where b is far from its top, as a prior would leave it; candidates at their null.
            at = np.concatenate([np.maximum(top[:4], 0.2 * MAKE), [0.0, 0.0]])
            at[3] = MAKE[3]
            day = datetime(2026, 1, 1) + timedelta(days=30 * r)
            parabola = Parabola(KEYS, at, information @ (top - at), information)
            out.append(Observation(f"m{m:02d}", f"m{m:02d}/{r}.csv", day, parabola))
    return out, truth


@pytest.fixture(scope="module")
def file():
    return read_motor_file("mellah2016")


@pytest.fixture(scope="module")
def plain(file):
    observations, truth = drawn(np.random.default_rng(5), 0.0)
    return population(file, observations), truth


def test_the_make_is_recovered(plain):
    found, truth = plain
    mean, sd = found.mean()
    assert found.keys == KEYS[:4]
    assert np.all(np.abs(mean - MAKE)[:3] < 3 * sd[:3])
    others = np.arange(MOTORS) != BROKEN
    actual, spread = np.std(truth[others], axis=0, ddof=1), found.spreads.omega * found.scale.size
    np.testing.assert_allclose(spread[:2], actual[:2], rtol=0.05)
    assert spread[2] == pytest.approx(0.15 * MAKE[2], abs=3 * found.spreads.sd[0, 2] * found.scale.size[2])
    # What no recording tells stays what the motor file says, and is not said to spread.
    assert sd[3] == pytest.approx(0.43, rel=0.05)
    assert found.spreads.omega[3] == 0


def test_intervals_of_motors_cover_and_borrow(plain):
    found, truth = plain
    low, high = found.interval()
    others = np.arange(MOTORS) != BROKEN
    inside = ((low < truth) & (truth < high))[others, :3]
    assert 0.90 <= inside.mean() <= 0.99
    _, sd = found.of_motors()
    _, alone = found.alone()
    # b is poorly told by a recording: the others help; R is not.
    assert np.median(sd[others, 2] / alone[others, 2]) < 0.85
    assert np.median(sd[others, 0] / alone[others, 0]) == pytest.approx(1.0, abs=0.05)


def test_the_odd_ones_and_what_is_odd_about_them(plain):
    found, _ = plain
    odd = {found.motors[m]: found.differences[m] for m in range(MOTORS) if found.differences[m]}
    assert set(odd) == {f"m{BROKEN:02d}", f"m{DRAGS:02d}"}
    assert odd[f"m{BROKEN:02d}"][0].key == "R_a0"
    assert odd[f"m{DRAGS:02d}"][0].key == "coulomb_friction.tau_c"
    assert not found.belongs[BROKEN]
    assert found.lacks is None


def test_since_when(plain):
    found, _ = plain
    changed = {(s.motor, s.key): s.change for s in histories(found) if s.change is not None}
    assert set(changed) >= {(f"m{DRAGS:02d}", "coulomb_friction.tau_c")}
    seen = changed[f"m{DRAGS:02d}", "coulomb_friction.tau_c"]
    assert seen.at == SINCE
    assert seen.size == pytest.approx(0.3, abs=4 * seen.sd)
    # One motor in a hundred is claimed to have changed by chance: more than 3 of 59 in one of 300 such tests.
    assert len({motor for motor, _ in changed} - {f"m{DRAGS:02d}"}) <= 3


def test_an_effect_of_all_is_the_makes(file):
    found = population(file, drawn(np.random.default_rng(3), 0.3)[0])
    assert found.lacks is not None
    assert found.lacks.key == "coulomb_friction.tau_c"
    assert found.lacks.share > 0.9


def test_the_file_of_the_make_says_what_a_new_motor_may_be(plain):
    found, _ = plain
    make = found.new_motor()
    mean, _ = found.mean()
    assert make.motor.R_a0 == pytest.approx(mean[0])
    assert make.knowledge["R_a0"].sd == pytest.approx(found.scale.size[0] * found.spreads.omega[0], rel=0.05)
    assert make.knowledge["k0"] == found.file.knowledge["k0"]
