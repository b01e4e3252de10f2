"""A population from parabolas that are drawn, not fitted: every true value is known, and no recording is simulated."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.drawn_fleet import BROKEN, DRAGS, KEYS, MAKE, MOTORS, SINCE, drawn

from motorlens_physics.motor_file import read_motor_file
from motorlens_workbench.fleet.directions import Observation
from motorlens_workbench.fleet.history import histories
from motorlens_workbench.fleet.population import population
from motorlens_workbench.fleet.summary import Parabola


@pytest.fixture(scope="module")
def file():
    return read_motor_file("mellah2016")


@pytest.fixture(scope="module")
def plain(file):
    observations, truth = drawn(np.random.default_rng(5), 0.0)
    return population(file, observations), truth


@pytest.fixture(scope="module")
def dragging(file):
    return population(file, drawn(np.random.default_rng(3), 0.3)[0])


def test_the_make_is_recovered(plain):
    found, truth = plain
    mean, sd = found.mean()
    assert found.keys == KEYS[:4]
    assert np.all(np.abs(mean - MAKE)[:3] < 3 * sd[:3])
    others = np.arange(MOTORS) != BROKEN
    actual, spread = np.std(truth[others], axis=0, ddof=1), found.spreads.omega * found.scale.size
    np.testing.assert_allclose(spread[:2], actual[:2], rtol=0.05)
    assert spread[2] == pytest.approx(0.15 * MAKE[2], abs=3 * found.spreads.sd[0, 2] * found.scale.size[2])
    # What no recording tells stays what the motor file says, of each motor too, and is not said to spread.
    assert sd[3] == pytest.approx(0.43, rel=0.05)
    assert found.spreads.omega[3] == 0
    np.testing.assert_allclose(found.of_motors()[1][:, 3], 0.43, rtol=0.001)


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


@pytest.mark.parametrize("noise", [0.3, 1.0, 3.0])
def test_a_motor_is_known_as_the_whole_posterior_says_where_no_spread_is_told(file, noise):
    """Beside it by quadrature over the spread: a motor is off by 1 at most beforehand, its make by what is left of that."""
    motors, known = 6, file.knowledge["k0"].sd
    at, ratios = file.motor.k0, []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = np.sqrt(0.5) * (rng.standard_normal() + rng.standard_normal(motors))
        shown = truth + noise * rng.standard_normal(motors)
        observations = [
            Observation(f"m{m}", f"m{m}.csv", None, Parabola(
                ("k0",), np.array([at]), np.array([y / noise**2 / known]), np.array([[(noise * known) ** -2]]),
            ))
            for m, y in enumerate(shown)
        ]  # fmt: skip
        found = population(file, observations)
        if found.spreads.omega[0] > 0:
            continue
        logs, means, squares = [], [], []
        for between in np.linspace(0.0, 1.0, 401)[1:-1]:
            before = between * np.eye(motors) + (1 - between)
            whole = before + noise**2 * np.eye(motors)
            gain = before @ np.linalg.inv(whole)
            logs.append(-0.5 * (shown @ np.linalg.solve(whole, shown) + np.linalg.slogdet(whole)[1]))
            means.append(gain @ shown)
            squares.append(np.diagonal(before - gain @ before) + means[-1] ** 2)
        weight = np.exp(np.array(logs) - max(logs))
        weight /= weight.sum()
        expected = np.sqrt(weight @ np.array(squares) - (weight @ np.array(means)) ** 2)
        ratios.append(found.of_motors()[1][:, 0] / known / expected)
        # None is known less for being one of a make.
        assert np.all(found.of_motors()[1] <= 1.001 * found.alone()[1])
    assert len(ratios) > 3
    # Not too narrow; with a mean that is off by all that was known of a motor, and a motor by as much again, up to 1.32.
    assert 0.95 < np.mean(ratios) < 1.13, np.mean(ratios)


def test_the_odd_ones_and_what_is_odd_about_them(plain):
    found, _ = plain
    odd = {found.motors[m]: found.differences[m] for m in range(MOTORS) if found.differences[m]}
    assert set(odd) == {f"m{BROKEN:02d}", f"m{DRAGS:02d}"}
    assert odd[f"m{BROKEN:02d}"][0].key == "R_a0"
    assert odd[f"m{DRAGS:02d}"][0].key == "coulomb_friction.tau_c"
    assert not found.belongs[BROKEN]
    assert found.lacks is None


@pytest.mark.long
@pytest.mark.fit
def test_motors_that_are_odd_in_an_effect_alone_do_not_count(file):
    """They leave the make what it is without them: friction would pass for a spread of b."""
    slight = (3, 25, 50)
    every, _ = drawn(np.random.default_rng(7), 0.0, slight)
    strangers = {f"m{m:02d}" for m in (BROKEN, DRAGS, *slight)}
    found = population(file, every)
    without = population(file, [o for o in every if o.motor not in strangers])
    assert {found.motors[m] for m in np.flatnonzero(~found.belongs)} == strangers
    np.testing.assert_allclose(found.spreads.omega, without.spreads.omega, rtol=1e-4)
    np.testing.assert_allclose(found.solved.mean, without.solved.mean, rtol=1e-6)
    assert found.spreads.omega[2] * found.scale.size[2] == pytest.approx(0.15 * MAKE[2], rel=0.4)


def test_what_all_motors_have_makes_none_of_them_odd(dragging):
    found = dragging
    odd = {found.motors[m] for m in range(MOTORS) if found.differences[m]}
    assert odd == {f"m{BROKEN:02d}", f"m{DRAGS:02d}"}


@pytest.mark.fit
def test_nothing_lies_beyond_what_is_possible(file):
    """b, which is told within 50 %, of motors that have none: the normal distribution of it goes below 0."""
    every, _ = drawn(np.random.default_rng(5), 0.0)
    shift = np.array([0.0, 0.0, MAKE[2], 0.0, 0.0, 0.0])
    moved = [
        replace(
            o, parabola=replace(o.parabola, gradient=o.parabola.gradient - o.parabola.information @ shift)
        )
        for o in every
    ]
    found = population(file, moved)
    assert (
        np.min((found.scale.centre + found.scale.size * (found.solved.mean + found.solved.motor))[:, 2]) < 0
    )
    values, (low, high) = found.of_motors()[0], found.interval()
    assert np.min(low) >= 0
    assert np.all((low <= values) & (values <= high))
    assert np.min(found.alone()[0]) >= 0
    assert all(
        np.min(s.value) >= 0 and np.all((s.low <= s.value) & (s.value <= s.high)) for s in histories(found)
    )


def test_since_when(plain):
    found, _ = plain
    changed = {(s.motor, s.key): s.change for s in histories(found) if s.change is not None}
    assert set(changed) >= {(f"m{DRAGS:02d}", "coulomb_friction.tau_c")}
    seen = changed[f"m{DRAGS:02d}", "coulomb_friction.tau_c"]
    assert seen.at == SINCE
    assert seen.size == pytest.approx(0.3, abs=4 * seen.sd)
    # One motor in a hundred is claimed to have changed by chance: more than 3 of 59 in one of 300 such tests.
    assert len({motor for motor, _ in changed} - {f"m{DRAGS:02d}"}) <= 3


def test_an_effect_of_all_is_the_makes(dragging):
    found = dragging
    assert found.lacks is not None
    assert found.lacks.key == "coulomb_friction.tau_c"
    assert found.lacks.share > 0.9
    # What did nothing when it was in the motor file is not asked again; the other candidate shows in none.
    assert population(found.file, found.observations, {"coulomb_friction.tau_c"}).lacks is None


def test_the_file_of_the_make_says_what_a_new_motor_may_be(plain):
    found, _ = plain
    make = found.new_motor()
    mean, _ = found.mean()
    assert make.motor.R_a0 == pytest.approx(mean[0])
    assert make.knowledge["R_a0"].sd == pytest.approx(found.scale.size[0] * found.spreads.omega[0], rel=0.05)
    assert make.knowledge["k0"] == found.file.knowledge["k0"]


@pytest.mark.parametrize(("slight", "shared"), [((-0.03, 0.03), True), ((0.0, 0.0), False)])
def test_what_most_have_each_in_its_own_way_is_asked_of_strangers_too(file, slight, shared):
    """Six motors, two of them far off in their sensors' offset: with two that are slightly off, four of six have one."""
    keys = (*KEYS[:3], "current_sensor_offset.offset")
    sd = np.array([*(MAKE[:3] * [0.01, 0.01, 0.05]), 0.01])
    information = np.diag(sd**-2)
    tops = [np.array([*MAKE[:3], offset]) for offset in (0.0, 0.0, *slight, 0.3, -0.3)]
    at = np.array([*MAKE[:3], 0.0])
    found = population(file, [
        Observation(f"m{m}", f"m{m}/run.csv", None, Parabola(keys, at, information @ (top - at), information))
        for m, top in enumerate(tops)
    ])  # fmt: skip
    assert np.flatnonzero(~found.belongs).tolist() == [4, 5]
    if shared:
        assert found.lacks is not None
        assert (found.lacks.key, found.lacks.share) == (keys[3], pytest.approx(4 / 6))
    else:
        assert found.lacks is None
