"""What a name explains in recordings of another plant, asked in three ways."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.textbook import textbook_on, with_name

from motorlens_workbench.contest.contest import too_large
from motorlens_workbench.contest.worth import agreement, held_score, worth
from motorlens_workbench.refit import _making_up_for, without_hypothesis
from motorlens_workbench.standing import Standing, residual_of, stand, summed, unlikely_from

MAGNET = {
    "name": "magnet_temperature",
    "size": 0.002,
    "shape": {"magnet_f": 0.7, "magnet_tau": 1067.5},
}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on fifty minutes of heating, in which the magnet loses 0.2 % of its flux a kelvin."""
    return textbook_on(tmp_path_factory.mktemp("magnet"), "gear_12V", [MAGNET], "heat_soak", 3000.0)


@pytest.mark.fit
def test_where_walds_test_says_too_little_the_score_test_says_what_the_likelihood_does(
    bare: Standing,
) -> None:
    score, end = with_name(bare, "magnet_temperature")
    rise = bare.unlikely - unlikely_from(bare, end)
    held = held_score(*summed(end), end, score.entry.hypothesis)
    assert held is not None and held.gain / held.scatter < 0.6 * rise
    won = residual_of(bare, end).likelier_by_block(bare.residual)
    agreed = agreement(won, bare.fitted, score.entry.hypothesis, rise)
    assert 0.75 * rise < agreed <= rise
    told = worth(bare, score, end)
    assert told.agreed == pytest.approx(agreed, rel=0.02)
    assert told.score is not None and told.score.gain / told.score.scatter == pytest.approx(agreed, rel=0.02)
    # It counts for no more than the likelihood rises.
    assert agreement(won, bare.fitted, score.entry.hypothesis, 5.0) <= 5.0
    assert agreement(won, bare.fitted, score.entry.hypothesis, -5.0) == 0.0


@pytest.mark.fit
@pytest.mark.parametrize(
    ("multiple", "largest", "allowed"),
    [(29.0, None, True), (31.0, None, False), (49.0, 50.0, True), (2.6, 2.5, False)],
)
def test_what_only_a_wonder_of_nature_explains_has_no_name(
    bare: Standing, multiple: float, largest: float | None, allowed: bool
) -> None:
    """As if the size that is found were so many times the typical one, of an effect whose largest is known or not."""
    score, end = with_name(bare, "magnet_temperature")
    size = end.model.values()["magnet_temperature.beta"]
    hypothesis = replace(score.entry.hypothesis, typical=size / multiple, largest=largest)
    one = replace(score, entry=replace(score.entry, hypothesis=hypothesis))
    assert end.allows(hypothesis) is allowed
    told = worth(bare, one, end)
    assert told.times > 1 and (told.accepted(hypothesis) is not None) is allowed
    # What only its size speaks against is told, of all that did not hold.
    for times, said in ((told.times, not allowed), (0.9, False)):
        large = too_large(SimpleNamespace(scores=(one,)), {one.name: times}, {one.name: (bare.fitted, end)})  # type: ignore[arg-type]
        assert large == ([one.name] if said else [])


@pytest.mark.fit
@pytest.mark.parametrize("name", ["radiation", "quadratic_drag"])
def test_what_is_not_missing_is_agreed_on_by_no_test(bare: Standing, name: str) -> None:
    """Beside the magnet, that is: from the model that has it."""
    _, magnet = with_name(bare, "magnet_temperature")
    here = stand(magnet)
    score, end = with_name(here, name)
    left = residual_of(here, end)
    rise = here.unlikely - left.unlikely
    # A chi-squared variable of one degree of freedom exceeds 10.8 once in a thousand.
    assert agreement(left.likelier_by_block(here.residual), magnet, score.entry.hypothesis, rise) < 10.8


@pytest.mark.fit
def test_where_a_name_is_taken_out_the_others_go_is_foretold(bare: Standing) -> None:
    """Against a fit of the model without it, from where the model with it has ended."""
    name = "magnet_temperature"
    _, end = with_name(bare, name)
    without = without_hypothesis(end, name)
    assert without is not None
    began, goes = end.model.values(), _making_up_for(end, name)
    far, foretold = np.array(
        [(without.model.values()[key] - began[key], goes[key]) for key in without.prior.keys]
    ).T
    # As the model without it weighs them, in squares of standard deviations.
    away, left = (float(step @ np.linalg.inv(without.covariance) @ step) for step in (far, far - foretold))
    assert 400 < away and left < 0.25 * away
