"""Spells against all courses that a short chain can take, and in noise of known size."""

import itertools

import numpy as np
import pytest

from motorlens_workbench.hypotheses.spells import Residuals, level, smoothed, spells

SAMPLES = 4000


def residuals(values, terms=None):
    terms = np.ones((len(values), 1)) if terms is None else terms
    return level(Residuals(values, np.ones(len(values)), terms))


def telegraph(rng, share, mean):
    """(N,) 1 in exponential spells of a mean length, otherwise 0."""
    out, at, state = np.zeros(SAMPLES), 0, 0
    while at < SAMPLES:
        length = 1 + int(rng.exponential(mean if state else mean * (1 / share - 1)))
        out[at : at + length] = state
        at, state = at + length, 1 - state
    return out


@pytest.mark.parametrize(("share", "stays", "ways"), [(0.2, 0.7, 2), (0.5, 0.5, 1), (0.01, 0.9, 2)])
def test_a_chain_is_the_sum_of_all_courses(share, stays, ways):
    samples = 7
    by = np.exp(np.random.default_rng(1).standard_normal((samples, ways)))
    begins = share / (1 - share) * (1 - stays)
    step = np.zeros((ways + 1, ways + 1))
    step[0, 0], step[0, 1:], step[1:, 0] = 1 - begins, begins / ways, 1 - stays
    step[1:, 1:] = stays * np.eye(ways)
    first = np.array([1 - share, *[share / ways] * ways])
    total, other, again = 0.0, np.zeros((samples, ways)), 0.0
    for course in itertools.product(range(ways + 1), repeat=samples):
        chance = first[course[0]] * np.prod([step[a, b] for a, b in itertools.pairwise(course)])
        chance *= np.prod([by[k, way - 1] for k, way in enumerate(course) if way])
        total += chance
        for k, way in enumerate(course):
            if way:
                other[k, way - 1] += chance
        again += chance * sum(a == b != 0 for a, b in itertools.pairwise(course))
    got = smoothed(by, share, stays)
    assert got[0] == pytest.approx(np.log(total), rel=1e-12)
    np.testing.assert_allclose(got[1], other / total, rtol=1e-10)
    assert got[2] == pytest.approx(again / total, rel=1e-10)
    # Over time as many are other as is stated.
    stationary = np.linalg.matrix_power(step, 1000)[0]
    assert stationary[1:].sum() == pytest.approx(share, rel=1e-9)


def test_spells_that_no_sample_shows_are_found_with_their_size_share_and_number():
    rng = np.random.default_rng(2)
    there = telegraph(rng, 0.2, 16.0)
    values = 1.2 * there + rng.standard_normal(SAMPLES)
    one = np.ones(SAMPLES)
    found = spells(residuals(values), [one], lasting=True)
    assert found.size == pytest.approx(1.2, rel=0.1)
    assert found.share == pytest.approx(there.mean(), rel=0.25)
    # Short ones are not seen.
    assert 0.5 < found.count / np.sum(np.diff(there) > 0) < 1.1
    assert np.corrcoef(there, found.other)[0, 1] > 0.75
    # Each sample by itself tells no more than a longer tail would.
    assert found.wins > 100 > 20 > spells(residuals(values), [one], lasting=False).wins
    for rival in ([-one], [one, -one]):
        assert spells(residuals(values), rival, lasting=True).wins < found.wins - 10


@pytest.mark.parametrize("lasting", [True, False])
def test_in_noise_spells_win_less_than_their_numbers_cost(lasting):
    rng = np.random.default_rng(3)
    form = np.sin(np.arange(SAMPLES) / 40)
    wins = [spells(residuals(rng.standard_normal(SAMPLES)), [form], lasting).wins for _ in range(30)]
    assert max(wins) < 0.5 * (3 if lasting else 2) * np.log(SAMPLES)
    # A share that is not quite nothing costs a little.
    assert min(wins) > -0.1


def test_the_usual_level_is_that_of_the_samples_that_are_usual():
    rng = np.random.default_rng(4)
    there, slope = telegraph(rng, 0.4, 30.0), np.linspace(-1, 1, SAMPLES)
    values = 0.5 + 2 * slope + 3.0 * there + rng.standard_normal(SAMPLES)
    found = spells(
        residuals(values, np.column_stack([np.ones(SAMPLES), slope])), [np.ones(SAMPLES)], lasting=True
    )
    gone = found.values - (values - 0.5 - 2 * slope)
    assert np.max(np.abs(gone)) < 0.15
    # All samples together have another.
    assert np.mean(values - 0.5) > 1.0
