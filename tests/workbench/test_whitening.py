"""Whitening against a known vector autoregression, and quantisation steps against a known converter."""

import itertools

import numpy as np
import pytest

from motorlens_physics.estimate.converter import quantisation_step
from motorlens_workbench.evidence.whitening import CHOICES, Whitener, fit_whitener, white


def coloured(rows: int, seed: int) -> np.ndarray:
    """Two channels that share a slow disturbance, by a recursion written out."""
    rng = np.random.default_rng(seed)
    e = rng.standard_normal((rows, 2))
    y = np.zeros((rows, 2))
    for t in range(1, rows):
        y[t, 0] = 0.9 * y[t - 1, 0] + 0.5 * e[t, 0]
        y[t, 1] = 0.3 * y[t - 1, 1] - 0.6 * y[t - 1, 0] + 0.8 * y[t, 0] + 0.2 * e[t, 1]
    return y


@pytest.mark.fit
def test_the_filter_of_a_known_process_is_found():
    y = coloured(40_000, 1)
    whitener = fit_whitener(y, np.ones(len(y), bool), np.zeros(2))
    assert whitener.sigma == pytest.approx([0.5, 0.2], rel=0.02)
    assert whitener.coefficients[0, 1, 0] == pytest.approx(0.8, abs=0.02)
    assert whitener.coefficients[1, 0, 0] == pytest.approx(0.9, abs=0.02)
    assert whitener.coefficients[1, 1, 0] == pytest.approx(-0.6, abs=0.02)
    z = whitener(y)[whitener.order :]
    products = z[:-1].T @ z[1:] / len(z)
    assert np.abs(products).max() < 4 / np.sqrt(len(z))
    assert np.cov(z.T) == pytest.approx(np.eye(2), abs=0.03)


def test_the_filter_is_the_regression_on_the_past_by_numpy():
    y = coloured(4000, 4)
    y[:, 1] += y[:, 0] ** 2 / 50
    whitener = fit_whitener(y, np.ones(len(y), bool), np.zeros(2))
    assert whitener.order and not whitener.memories
    # All choices are compared on the same rows, after the longest of pasts.
    longest = max(order for order, _ in CHOICES)
    now, order = y[longest:], whitener.order
    past = np.hstack([y[longest - lag : len(y) - lag] for lag in range(1, order + 1)])
    for c in range(2):
        design = np.hstack([past, now[:, :c]])
        weights, squares, *_ = np.linalg.lstsq(design, now[:, c], rcond=None)
        assert whitener.coefficients[1:, c].ravel() == pytest.approx(weights[: 2 * order], abs=1e-6)
        assert whitener.coefficients[0, c, :c] == pytest.approx(weights[2 * order :], abs=1e-6)
        assert whitener.sigma[c] ** 2 == pytest.approx(squares[0] / (len(now) - len(weights)), rel=1e-6)


def test_columns_are_filtered_like_the_residual():
    y = coloured(4000, 2)
    whitener = fit_whitener(y, np.ones(len(y), bool), np.zeros(2))
    columns = np.stack([y, 3 * y, y[:, ::-1]], axis=2)
    filtered = whitener(columns)
    assert filtered[:, :, 0] == pytest.approx(whitener(y))
    assert filtered[:, :, 1] == pytest.approx(3 * whitener(y))


@pytest.mark.parametrize("memories", [(), (3.0, 10.0)])
def test_blocks_are_filtered_as_the_whole_is(memories: tuple[float, ...]) -> None:
    rng = np.random.default_rng(7)
    y, lags = rng.standard_normal((61, 2, 3)), rng.standard_normal((4, 2, 2))
    whitener = Whitener(lags, np.array([0.5, 2.0]), memories, rng.standard_normal((len(memories), 2, 2)))
    # Some are shorter than the filter's past.
    edges = [0, 1, 3, 20, 22, 23, 61]
    found = whitener.in_blocks(y[first:last] for first, last in itertools.pairwise(edges))
    np.testing.assert_array_equal(np.concatenate(list(found)), whitener(y))


def test_the_filter_is_the_sum_over_lags_and_means_written_out():
    rng = np.random.default_rng(5)
    y = rng.standard_normal((60, 2, 3))
    now = np.array([[0.0, 0.0], [0.7, 0.0]])
    lags, memory = rng.standard_normal((2, 2, 2)), rng.standard_normal((2, 2, 2))
    whitener = Whitener(np.concatenate([now[None], lags]), np.array([0.5, 2.0]), (3.0, 10.0), memory)
    z = whitener(y)
    assert not z[:2].any()
    for t in range(2, 60):
        error = y[t] - now @ y[t] - lags[0] @ y[t - 1] - lags[1] @ y[t - 2]
        for reach, weights in zip((3.0, 10.0), memory, strict=True):
            keep = np.exp(-1 / reach)
            age = np.arange(t)[::-1]
            error -= weights @ np.tensordot((1 - keep) * keep**age, y[:t], axes=1)
        assert z[t] == pytest.approx(error / np.array([[0.5], [2.0]]), rel=1e-9, abs=1e-12)


def test_invalid_rows_do_not_count():
    y = coloured(20_000, 3)
    valid = np.ones(len(y), bool)
    valid[5000:6000] = False
    broken = y.copy()
    broken[5000:6000] = 1e6
    whitener = fit_whitener(broken, valid, np.zeros(2))
    assert whitener.sigma == pytest.approx([0.5, 0.2], rel=0.05)


def test_sigma_has_a_floor():
    y = np.full((1000, 1), 1e-12) * np.sin(np.arange(1000))[:, None]
    assert fit_whitener(y, np.ones(1000, bool), np.array([0.01])).sigma[0] == 0.01
    assert white(np.array([2.0]))(np.full((3, 1), 4.0)) == pytest.approx(np.full((3, 1), 2.0))


@pytest.mark.parametrize("step", [0.005, 0.019, 1.0])
def test_quantisation_step_of_a_converter(step):
    rng = np.random.default_rng(4)
    y = step * np.round(
        (np.sin(np.linspace(0, 20, 20_000)) * 60 * step + step * rng.standard_normal(20_000)) / step
    )
    assert quantisation_step(y) == pytest.approx(step, rel=1e-6)
    assert quantisation_step(rng.standard_normal(1000)) == 0.0


@pytest.mark.parametrize(("before", "blue"), [(-1.0, True), (-0.5, True), (0.0, False), (0.5, False)])
def test_noise_is_blue_that_cancels_from_one_row_to_the_next(before: float, blue: bool) -> None:
    """A moving average of two rows, beside white noise: at frequency f its power is 1 + b^2 + 2 b cos(2 pi f)."""
    fresh = np.random.default_rng(7).standard_normal((20_001, 2))
    y = np.column_stack([fresh[1:, 0] + before * fresh[:-1, 0], fresh[1:, 1]])
    whitener = fit_whitener(y, np.ones(len(y), bool), np.zeros(2))
    assert whitener.blue.tolist() == [blue, False]
    if blue:
        lowest, highest = whitener._powers(np.array([0.0, np.pi]))[:, 0]
        assert highest == pytest.approx((1 - before) ** 2, rel=0.25)
        assert lowest < 0.3


def test_what_swings_is_not_blue_nor_what_lasts() -> None:
    rng, t = np.random.default_rng(8), np.arange(8000)
    hum = np.sin(0.6 * t) + 0.3 * rng.standard_normal(len(t))
    drift = 0.02 * np.cumsum(rng.standard_normal(len(t))) + rng.standard_normal(len(t))
    for y in (hum, drift):
        whitener = fit_whitener(y[:, None], np.ones(len(y), bool), np.zeros(1))
        assert whitener.order > 0 and not whitener.blue.any()


MEMORY = np.random.default_rng(1).uniform(-0.1, 0.1, (2, 2, 2))
LAGS = np.stack([np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([[0.6, 0.1], [0.0, -0.3]])])


@pytest.mark.parametrize(
    "whitener", [white(np.array([0.5, 3.0])), Whitener(LAGS, np.array([0.5, 3.0]), (3.0, 10.0), MEMORY)]
)
def test_a_whitener_among_other_channels_is_the_same_and_leaves_them(whitener: Whitener) -> None:
    y, between = coloured(400, 5), np.random.default_rng(6).standard_normal(400)
    among = whitener.among(np.array([True, False, True]), np.array([9.0, 2.0, 9.0]))
    found = among(np.column_stack([y[:, 0], between, y[:, 1]]))
    assert np.array_equal(found[:, [0, 2]], whitener(y))
    assert found[whitener.order :, 1] == pytest.approx(between[whitener.order :] / 2.0)
