"""The filter bank against the closed form and a long double recursion, and its bits against every way of cutting."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.estimate.bank import FilterBank

TAUS = [0.001, 0.01, 0.3, 5.0, 100.0, 900.0]


@pytest.fixture(scope="module")
def bank(parts):
    return parts.FilterBank(["current"] * len(TAUS), TAUS)


def steps(kind, n, rng):
    dt = np.full(n, 1e-3)
    if kind == "gaps":
        dt[rng.integers(0, n, 5)] = [0.0, 0.5, 3600.0, 0.002, 1e-9]
    if kind == "irregular":
        dt = rng.uniform(1e-5, 1e-2, n)
    return np.round(dt * 1e9) * 1e-9  # whole nanoseconds, as stamps have them


@pytest.mark.parametrize("kind", ["uniform", "gaps", "irregular"])
def test_recursion_in_long_double(bank, kind):
    rng = np.random.default_rng(0)
    n = 1000
    dt, u = steps(kind, n, rng), rng.normal(size=(n, len(TAUS)))
    state, expected = np.zeros(len(TAUS), dtype=np.longdouble), np.empty((n, len(TAUS)))
    for k in range(n):
        state = u[k] + (state - u[k]) * np.exp(-np.longdouble(dt[k]) / np.array(TAUS, dtype=np.longdouble))
        expected[k] = state
    _, filtered = bank.advance(bank.start(), dt, u.T)
    assert np.abs(filtered.T - expected).max() < 1e-14


@pytest.mark.fit
@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(["uniform", "gaps", "irregular"]),
    st.lists(st.integers(0, 9000), max_size=30),
    st.integers(0, 2**32 - 1),
)
def test_the_same_bits_however_it_is_cut(parts, bank, kind, cuts, seed):
    rng = np.random.default_rng(seed)
    n = parts.many
    dt, u = steps(kind, n, rng), rng.normal(size=(n, len(TAUS)))
    whole_state, whole = bank.advance(bank.start(), dt, u.T)
    state, parts = bank.start(), []
    edges = np.sort(cuts) % (n + 1)
    edges.sort()
    for dt_part, u_part in zip(np.split(dt, edges), np.split(u, edges), strict=True):
        rows = np.flatnonzero(rng.random(len(dt_part)) < 0.5)
        chosen = bank.advance(state, dt_part, u_part.T, rows)[1]
        state, filtered = bank.advance(state, dt_part, u_part.T)
        assert np.array_equal(chosen, filtered[:, rows])
        parts.append(filtered)
    assert np.array_equal(np.concatenate(parts, axis=1), whole)
    assert np.array_equal(bank.values(state), whole[:, -1])
    assert state.count == whole_state.count == n


@pytest.mark.parametrize("pause_s", [1.0, 3600.0, 86400.0])
def test_a_pause_is_the_closed_form(bank, pause_s):
    start = np.linspace(1, 60, len(TAUS))
    _, filtered = bank.advance(bank.start(start), np.array([pause_s]), np.full((len(TAUS), 1), 2.5))
    expected = 2.5 + (start - 2.5) * np.exp(-pause_s / np.array(TAUS))
    assert np.abs(filtered[:, 0] - expected).max() < 1e-14 * start.max()


def test_thousand_steps_are_one_long_step(bank):
    constant = np.full((len(TAUS), 1000), 7.0)
    _, many = bank.advance(bank.start(), np.full(1000, 1e-3), constant)
    _, one = bank.advance(bank.start(), np.array([1.0]), constant[:, :1])
    # exp(-dt/tau) is rounded near 1: with dt/tau = 1e-6 that is 1e-10 of a time constant at worst
    assert np.abs(many[:, -1] / one[:, 0] - 1).max() < 1e-10


@pytest.mark.long
@pytest.mark.fit
def test_a_day_at_a_kilohertz_ends_where_the_closed_form_says():
    """Thermal state after 24 h of a square wave of one hour, 8.64e7 samples; float32 would be per cents off."""
    bank, step = FilterBank(["current_squared"] * 2, [900.0, 100.0]), 1e-3
    state, exact = bank.start(), np.zeros(2)
    for hour in range(24):
        level = 60.0 if hour % 2 == 0 else 5.0
        chunk = np.full((2, 36_000), level)
        for _ in range(100):
            state, _ = bank.advance(state, np.full(36_000, step), chunk)
        exact = level + (exact - level) * np.exp(-3600.0 / bank.tau_s)
    assert np.abs(bank.values(state) / exact - 1).max() < 1e-9


def test_nothing_in_nothing_out(bank):
    state, filtered = bank.advance(bank.start(), np.zeros(0), np.zeros((len(TAUS), 0)))
    assert filtered.shape == (len(TAUS), 0) and state.count == 0
