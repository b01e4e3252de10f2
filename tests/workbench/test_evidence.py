"""The block algebra against plain least squares on the stacked columns, and its tests against their nominal rates."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from motorlens_workbench.evidence import (
    Evidence,
    curve_gain,
    score,
    similarity,
    statistics,
)
from motorlens_workbench.selection import usual_scatter


def evidence_of(columns: np.ndarray, residual: np.ndarray, blocks: int) -> Evidence:
    stacked = np.column_stack([columns, residual]).reshape(blocks, -1, columns.shape[1] + 1)
    names = [f"c{k}" for k in range(columns.shape[1])]
    return Evidence.of(names, np.einsum("bni,bnj->bij", stacked, stacked), np.full(blocks, stacked.shape[1]))


@pytest.fixture
def problem():
    rng = np.random.default_rng(0)
    columns = rng.standard_normal((6400, 5))
    columns[:, 3] += 2 * columns[:, 0]
    columns[:, 4] = 0.7 * columns[:, 3] + 0.1 * columns[:, 4]
    residual = 0.3 * columns[:, 0] + 0.2 * columns[:, 3] + rng.standard_normal(6400)
    return columns, residual


@pytest.mark.fit
def test_projection_equals_regression(problem):
    columns, residual = problem
    left = evidence_of(columns, residual, 64).given(["c0", "c1"])
    base = columns[:, :2]
    project = np.eye(6400) - base @ np.linalg.pinv(base)
    x, e = project @ columns[:, 2:], project @ residual
    assert left.total == pytest.approx(
        np.column_stack([x, e]).T @ np.column_stack([x, e]), rel=1e-8, abs=1e-6
    )
    tested = score(left, ["c3"])
    assert tested is not None
    assert tested.coefficient[0] == pytest.approx(x[:, 1] @ e / (x[:, 1] @ x[:, 1]), rel=1e-8)
    full = np.linalg.lstsq(columns[:, [0, 1, 3]], residual, rcond=None)
    assert tested.coefficient[0] == pytest.approx(full[0][2], rel=1e-8)
    assert tested.gain == pytest.approx(e @ e - full[1][0], rel=1e-8)
    assert similarity(left, ["c3", "c4"])[0, 1] == pytest.approx(
        np.corrcoef(x[:, 1], x[:, 2])[0, 1] ** 2, abs=2e-3
    )


@pytest.mark.parametrize(
    ("size", "noisy", "least", "most"),
    [
        (0.0, 1.0, 1.0, 1.6),  # noise
        (8.0, 1.0, 1.0, 1.6),  # what the best shape explains does not count against it
        (8.0, 4.0, 8.0, 32.0),  # noise four times as loud in the blocks that count does, squared
    ],
)
def test_wrong_shapes_scatter_for_the_right_one_and_for_noise(size, noisy, least, most):
    """Six shapes of two columns that resemble each other, in 20 blocks of 64, hardly there in others."""
    rng = np.random.default_rng(4)
    shapes = rng.standard_normal((100, 12)) + rng.standard_normal((100, 1))
    columns = np.concatenate([shapes * rng.standard_normal((1, 12)) for _ in range(64)])
    loud = np.repeat(np.arange(64) < 20, 100)
    columns[~loud] *= 0.1
    residual = size * columns[:, 0] + np.where(loud, noisy, 1.0) * rng.standard_normal(6400)
    left = evidence_of(columns, residual, 64)
    labels = [[f"it#{v}.0", f"it#{v}.1"] for v in range(6)]
    left = replace(left, names=(*(label for pair in labels for label in pair), left.names[-1]))
    candidate = SimpleNamespace(columns=lambda: labels)
    scores = [score(left, pair) for pair in labels]
    assert least <= usual_scatter(left, candidate, scores) < most
    if size and noisy == 1.0:
        assert np.median([tested.inflation for tested in scores]) > 5.0


def test_neighbours_on_a_grid_scatter_alike():
    scores = [
        SimpleNamespace(statistic=10.0 / k, inflation=k, coefficient=np.ones(1)) for k in (1.0, 4.0, 9.0)
    ]
    candidate = SimpleNamespace(columns=lambda: [["it#0.0"], ["it#1.0"], ["it#2.0"]])
    assert usual_scatter(None, candidate, scores) == 4.0


def test_projection_in_two_steps_is_projection_in_one(problem):
    evidence = evidence_of(*problem, 64)
    once, twice = evidence.given(["c0", "c3"]), evidence.given(["c0"]).given(["c3"])
    assert once.names == twice.names
    assert once.blocks == pytest.approx(twice.blocks, rel=1e-6, abs=1e-6)


def test_statistics_beside_columns_are_those_of_the_projected_evidence(problem):
    left = evidence_of(*problem, 64).given(["c0"])
    beside = dict(zip(left.names, statistics(left, ["c3", "c1"]), strict=False))
    assert beside["c3"] == beside["c1"] == 0.0
    # What is left of c4 is little, and so are both sums that cancel.
    projected = left.given(["c3", "c1"])
    for name, value in zip(projected.names, statistics(projected), strict=False):
        tested = score(projected, [name])
        assert tested is not None
        assert beside[name] == pytest.approx(value, rel=1e-9, abs=1e-12)
        assert beside[name] == pytest.approx(tested.statistic, rel=1e-9, abs=1e-12)


def test_a_prior_is_a_pseudo_measurement(problem):
    columns, residual = problem
    evidence = evidence_of(columns, residual, 64).with_prior({"c0": 0.5}, {"c0": 0.01})
    value, covariance = evidence.solve(["c0", "c3"])
    design = np.vstack([columns[:, [0, 3]], [[100.0, 0.0]]])
    target = np.append(residual, 50.0)
    assert value == pytest.approx(np.linalg.lstsq(design, target, rcond=None)[0], rel=1e-8)
    assert covariance == pytest.approx(np.linalg.inv(design.T @ design), rel=1e-6)


def test_a_copy_of_an_accepted_column_says_nothing(problem):
    columns, residual = problem
    copied = np.column_stack([columns, 2 * columns[:, 0] - columns[:, 1]])
    left = evidence_of(copied, residual, 64).given(["c0", "c1"])
    assert score(left, ["c5"]) is None


@pytest.mark.fit
def test_rates_under_the_null_are_nominal():
    """White noise: p values below 5 % in 5 % of cases, and few curves beyond chance."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((3200, 12))
    below = curves = 0
    runs = 300
    for _ in range(runs):
        left = evidence_of(columns, rng.standard_normal(3200), 32).given(["c0", "c1"])
        names = [f"c{k}" for k in range(2, 12)]
        tests = [score(left, [name]) for name in names]
        below += sum(test.p < 0.05 for test in tests if test)
        curves += curve_gain(left, names)[1] > 2.0
    assert 0.025 < below / (10 * runs) < 0.065
    assert curves / runs < 0.08


def test_scatter_between_blocks_takes_the_colour_that_whitening_missed_into_account():
    """A random walk in the residual makes nominal gains huge; the robust statistic stays a chi-squared."""
    rng = np.random.default_rng(2)
    statistics, gains = [], []
    for _ in range(100):
        slow = np.repeat(rng.standard_normal(64), 100)
        column = np.sin(np.arange(6400) / 900)[:, None]
        tested = score(evidence_of(column, slow + rng.standard_normal(6400), 64), ["c0"])
        assert tested is not None
        statistics.append(tested.statistic)
        gains.append(tested.gain)
    assert np.mean(gains) > 20
    assert 0.5 < np.mean(statistics) < 1.6


def test_the_detectable_size_is_detected_as_often_as_it_says():
    rng = np.random.default_rng(3)
    column = rng.standard_normal((6400, 1))
    first = score(evidence_of(column, rng.standard_normal(6400), 64), ["c0"])
    assert first is not None
    size = first.detectable(25.0)
    reached = [
        score(evidence_of(column, size * column[:, 0] + rng.standard_normal(6400), 64), ["c0"]).statistic
        for _ in range(100)
    ]
    assert 0.8 < np.mean(reached) / 25.0 < 1.15


def test_a_column_split_in_time_is_a_column_that_is_zero_elsewhere(problem):
    columns, residual = problem
    after = np.array([np.arange(64) >= 20, (np.arange(64) >= 5) & (np.arange(64) < 9)])
    split = evidence_of(columns, residual, 64).split("c3", after)
    parts = [np.where(np.repeat(part, 100), columns[:, 3], 0.0) for part in after]
    whole = evidence_of(np.column_stack([columns, *parts]), residual, 64)
    assert split.names == ("c0", "c1", "c2", "c3", "c4", "c3/0", "c3/1", "residual")
    assert split.blocks == pytest.approx(whole.blocks, rel=1e-12, abs=1e-9)
