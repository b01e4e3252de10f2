"""Two effects of another plant are missing, and a name that makes up for a part of both has entered first."""

import pytest
from helpers.textbook import textbook_on, with_name

from motorlens_workbench.contest import instead
from motorlens_workbench.contest.instead import enter_instead
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.standing import Standing, stand

FRICTION_NM, DEAD_V = 0.0188, 0.8
FRICTION = {"name": "coulomb_friction", "size": FRICTION_NM, "shape": {}}
DEAD = {"name": "dead_time", "size": DEAD_V, "shape": {}}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on a recording with friction and a dead time."""
    return textbook_on(tmp_path_factory.mktemp("two"), "servo_24V", [FRICTION, DEAD], "load_steps", 5.0)


def entered(bare: Standing, name: str) -> tuple[Standing, Accepted]:
    score, fitted = with_name(bare, name)
    won = score.gain / score.scatter
    return stand(fitted), Accepted(score.entry.hypothesis, won, score.scatter, score.weight)


@pytest.mark.fit
def test_both_stand_in_the_place_of_a_part_of_both(bare: Standing) -> None:
    here, one = entered(bare, "quadratic_drag")
    said: list[str] = []
    found = enter_instead(here, [one], (), said.append)
    assert found is not None and "in the place of quadratic drag" in said[0]
    there, names = found
    assert {one.hypothesis.name for one in names} == {"coulomb_friction", "dead_time"}
    values = there.fitted.model.values()
    assert values["coulomb_friction.tau_c"] == pytest.approx(FRICTION_NM, rel=0.05)
    assert values["dead_time.V_dt"] == pytest.approx(DEAD_V, rel=0.05)
    assert there.unlikely < here.unlikely - 1000


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("known", ["unlikely_as_known", "follows"])
def test_what_is_no_likelier_or_leaves_something_is_not_taken(
    bare: Standing, monkeypatch: pytest.MonkeyPatch, known: str
) -> None:
    here, one = entered(bare, "quadratic_drag")
    monkeypatch.setattr(instead, known, lambda *of: here.unlikely if known == "unlikely_as_known" else False)
    assert enter_instead(here, [one], (), lambda text: None) is None


@pytest.mark.long
@pytest.mark.fit
def test_beside_the_whole_truth_nothing_takes_a_place(bare: Standing) -> None:
    here, one = entered(bare, "coulomb_friction")
    there, other = entered(here, "dead_time")
    said: list[str] = []
    assert enter_instead(there, [one, other], (), said.append) is None
    assert sum("in the place of" in text for text in said) == 4
