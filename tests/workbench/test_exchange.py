"""A name that has entered a model of recordings by another plant: what stands in its place in the end."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.hidden import known
from helpers.textbook import textbook_on, with_name

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest import exchange, rivals
from motorlens_workbench.contest.contest import _needed
from motorlens_workbench.contest.entering import Step, _beside_all
from motorlens_workbench.contest.exchange import exchanged
from motorlens_workbench.contest.rivals import Rivals, rivals_of
from motorlens_workbench.contest.worth import own_score
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.standing import Standing, stand
from motorlens_workbench.verdict import _groups

FRICTION_NM = 0.0188
# Without an hour of heating, hysteresis (which also heats) brakes exactly like Coulomb friction.
ALIKE = {"coulomb_friction", "hysteresis_iron_loss"}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on a recording with Coulomb friction."""
    hidden = [{"name": "coulomb_friction", "size": FRICTION_NM, "shape": {}}]
    return textbook_on(tmp_path_factory.mktemp("friction"), "servo_24V", hidden, "no_load_steps", 12.0)


def entered(bare: Standing, name: str) -> tuple[Standing, Accepted]:
    """With a name in the model, fitted in full."""
    score, fitted = with_name(bare, name)
    return stand(fitted), Accepted(
        score.entry.hypothesis, score.gain / score.scatter, score.scatter, score.weight
    )


@pytest.mark.fit
@pytest.mark.parametrize("wrong", [pytest.param("quadratic_drag", marks=pytest.mark.long), "constant_torque"])
def test_what_was_put_in_takes_the_place_of_what_had_entered(bare: Standing, wrong: str) -> None:
    here, one = entered(bare, wrong)
    then, (other,) = exchanged(here, [one], (), lambda text: None)
    assert other.hypothesis.name in ALIKE and then is not here
    assert not any(key.startswith(f"{wrong}.") for key in then.fitted.model.values())
    assert then.fitted.model.values()[other.hypothesis.key] == pytest.approx(FRICTION_NM, rel=0.1)
    assert then.unlikely < here.unlikely - 20
    # What it was exchanged for has been fitted as well, and is no rival any more.
    assert rivals_of(then, other).probability.get(wrong, 0.0) < 1e-3


@pytest.mark.fit
def test_what_was_put_in_stays_and_nothing_is_counted_against_it_that_is_less_likely(bare: Standing) -> None:
    here, one = entered(bare, "coulomb_friction")
    then, (other,) = exchanged(here, [one], (), lambda text: None)
    assert other.hypothesis.name in ALIKE
    likely = rivals_of(then, other).probability
    assert sum(likely.get(name, 0.0) for name in ALIKE) > 0.95
    assert set(other.instead) <= ALIKE, "nothing else seems likelier, so nothing else was fitted"


@pytest.mark.long
@pytest.mark.fit
def test_what_seems_too_unlikely_for_the_group_is_fitted_before_it_is_left_out(tmp_path: Path) -> None:
    """A core that loses little heat of its own is a housing, but seems another thing beside a housing that was fitted."""
    housing = {"name": "two_node_thermal", "size": 0.16, "shape": {"node_k": 0.395, "node_H": 1156.0}}
    bare = textbook_on(tmp_path, "servo_24V", [housing], "heat_soak", 3000.0, noise=0.002)
    here, entering = entered(bare, "two_node_thermal")
    unfitted = rivals_of(here, entering)
    assert 0.01 < unfitted.probability["iron_core"] < 0.05 and unfitted.group == ("two_node_thermal",)
    then, (one,) = exchanged(here, [entering], (), lambda text: None)
    told = rivals_of(then, one)
    assert told.group == ("two_node_thermal", "iron_core") and 0.1 < told.probability["iron_core"] < 0.25


@pytest.mark.fit
def test_a_drop_that_heats_nothing_is_a_rival_of_a_dead_time_and_explains_exactly_as_much(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    hidden = [{"name": "dead_time", "size": 0.8, "shape": {}}]
    place = tmp_path_factory.mktemp("dead")
    here, one = entered(textbook_on(place, "servo_24V", hidden, "load_steps", 12.0), "dead_time")
    assert "temperature" in here.lines[0].run.channels
    likely, scores = rivals_of(here, one).probability, rivals_of(here, one).scores
    # None of its heat is one deviation from all of it.
    assert likely["brush_voltage_drop"] / likely["dead_time"] == pytest.approx(np.exp(-0.5), rel=0.02)
    assert scores["brush_voltage_drop"].gain == scores["dead_time"].gain > 100


@pytest.mark.fit
def test_what_explains_as_much_is_a_rival_where_hardly_anything_is_likelier_than_nothing(
    bare: Standing, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where blocks of time scatter by as much as a name explains, it does not pay for having said its size."""
    here, one = entered(bare, "coulomb_friction")
    before = rivals_of(here, one).probability

    def scattered(*of):
        score = own_score(*of)
        return replace(score, scatter=score.gain)

    monkeypatch.setattr(rivals, "own_score", scattered)
    likely = rivals_of(here, one).probability
    assert set(likely) == ALIKE
    odds, then = (of["hysteresis_iron_loss"] / of["coulomb_friction"] for of in (before, likely))
    assert 0.5 < odds < 2.0 and 0.5 < then < 2.0


# Twice the logarithm by which each of 64 blocks of time is likelier with the rival: all alike; all of it in one block; less
# likely, but for chance.
AGREED = 0.5 + 0.2 * np.random.default_rng(2).standard_normal(64)
OPEN = np.r_[np.ones(31), -np.ones(33)]
ONE_BLOCK = np.r_[32.0, np.zeros(63)]


@pytest.mark.parametrize(
    ("there", "ahead", "back", "won", "shape", "stands", "instead"),
    [
        ("beyond chance", 0.8, 0.9, AGREED, 0.0, "rival", {"name": -np.log(9.0)}),
        ("beyond chance", 0.8, 0.9, -AGREED, 0.0, "name", {"rival": 0.0}),
        ("beyond chance", 0.8, 0.999, ONE_BLOCK, 0.0, "rival", {"name": -2.0}),
        ("beyond chance", 0.8, 0.9, AGREED, -4.5, "name", {"rival": np.log(9.0) - 4.5}),
        ("beyond chance", 0.8, 0.9, OPEN, 1.0, "rival", {"name": -1.0}),
        ("beyond chance", 0.8, 0.9, -AGREED, 1.0, "name", {"rival": 0.0}),
        ("beyond chance", 0.8, 0.01, AGREED, 0.0, "name", {"rival": 0.0}),
        ("beyond chance", 0.8, 0.01, -AGREED, 0.0, "name", {"rival": 0.5 * np.log(4.0 / 99.0)}),
        ("beyond chance", 0.04, 0.9, -AGREED, 0.0, "name", {"rival": -np.log(24.0)}),
        ("by chance", 0.8, 0.9, AGREED, 0.0, "name", {"rival": 0.0}),
        ("by chance", 0.8, 0.01, -AGREED, 0.0, "name", {"rival": 0.5 * np.log(4.0 / 99.0)}),
        ("not told", 0.8, 0.9, AGREED, 0.0, "name", {"rival": -np.inf}),
    ],
    ids=[
        "both say so",
        "but it leaves what is less likely",
        "one block of time says so",
        "but its shape is three deviations from what it may be",
        "its shape is likelier, and nothing else tells them apart",
        "its shape is likelier, but it leaves what is less likely",
        "its own model does not say so, though it leaves what is likelier",
        "nothing says so",
        "only its own model says so, which leaves what is less likely",
        "but it may be there by chance",
        "it may be there by chance, and is less likely",
        "not told in its own model",
    ],
)
def test_a_rival_stands_if_both_models_say_so_as_far_as_blocks_of_time_agree(
    monkeypatch, there, ahead, back, won, shape, stands, instead
):
    """The share of the rival is `ahead` from here, and `back` from the model that has it."""

    def accepted(name):
        return Accepted(SimpleNamespace(name=name), 1.0, 1.0, 1.0)  # type: ignore[arg-type]

    def rivals_of(here, one):
        if one.hypothesis.name == "name":
            likely = {"name": 1.0 - ahead, "rival": ahead}
            likely |= {other: 0.0 for other in one.instead}
        else:
            likely = {"name": 1.0 - back, "rival": back}
        scores = {
            name: SimpleNamespace(entry=SimpleNamespace(hypothesis=SimpleNamespace(name=name)))
            for name in likely
        }
        return Rivals(one.hypothesis.name, likely, scores)  # type: ignore[arg-type]

    def fitted_in_its_place(here, one, other, own):
        if there == "not told":
            raise ModelError(there)
        return SimpleNamespace(fitted="rival"), accepted("rival"), there == "beyond chance"

    monkeypatch.setattr(exchange, "rivals_of", rivals_of)
    monkeypatch.setattr(exchange, "fitted_in_its_place", fitted_in_its_place)
    monkeypatch.setattr(exchange, "_in_the_place_of", lambda there, new, one: rivals_of(there, new))
    left = SimpleNamespace(likelier_by_block=lambda other: won)
    monkeypatch.setattr(exchange, "residual_of", lambda here, fitted: left)
    monkeypatch.setattr(exchange, "log_shape", lambda one, fitted: shape if one.name == "rival" else 0.0)
    here = SimpleNamespace(fitted="name", residual=None)
    _, (one,) = exchanged(here, [accepted("name")], (), lambda text: None)  # type: ignore[arg-type]
    assert one.hypothesis.name == stands
    assert one.instead == pytest.approx(instead, rel=0.02)


def test_what_could_stand_in_two_places_is_offered_where_it_is_likeliest():
    first = Rivals("drop", {"drop": 0.6, "offset": 0.3, "friction": 0.1}, {})
    second = Rivals("friction", {"friction": 0.5, "offset": 0.2, "drop": 0.3}, {})
    names = ["drop", "offset", "friction"]
    assert _groups([first, second], names) == [("drop", "offset"), ("friction",)]


@pytest.mark.fit
def test_what_has_ended_at_its_null_leaves_whatever_another_size_would_explain(bare: Standing) -> None:
    there, friction = entered(bare, "coulomb_friction")
    nothing = there.fitted.model.with_values({friction.hypothesis.key: 0.0})
    here = stand(replace(there.fitted, model=nothing))
    score = own_score(here.book, here.fitted, friction.hypothesis)
    assert score is not None and score.weight > 30
    last = replace(friction, hypothesis=replace(friction.hypothesis, name="constant_torque"))
    then, left = _needed(here, [friction, last], (), lambda text: None)
    assert left == [last] and not any(key.startswith("coulomb_friction.") for key in then.fitted.prior.keys)


@pytest.mark.long
@pytest.mark.blind
def test_what_seems_to_explain_most_in_a_model_that_has_it_is_no_likelier_than_what_was_fitted_beside_it(
    tmp_path: Path,
) -> None:
    """Radiation, ten times what is detectable, told as a second node alone: of the two either explains nearly as much."""
    made = known("dev-3246", tmp_path)
    found = diagnose(read_motor_file(made.motor), [read_recording(path) for path in made.recordings])
    (accepted,), (rivals,) = found.outcome.accepted, found.outcome.rivals
    assert (
        set(rivals.group)
        == {"two_node_thermal", "radiation"}
        == {accepted.hypothesis.name, *rivals.group[1:]}
    )
    # In its model the one that entered seems to explain twice what the other does: beside it, that had not been so.
    assert rivals.scores["two_node_thermal"].gain > 1.5 * rivals.scores["radiation"].gain
    assert 0.2 < rivals.probability["radiation"] < 0.6


@pytest.mark.parametrize("apart", [0.0, 3.0, -8.0])
def test_names_fitted_from_the_same_model_are_as_likely_beside_each_other_as_they_explain(
    apart: float,
) -> None:
    """And what has been estimated from the beginning is known better."""
    information = np.array([[400.0]])

    def challenger(name: str, gain: float) -> Any:
        hypothesis = SimpleNamespace(name=name, named=True, shapes=(0,))
        entry = SimpleNamespace(hypothesis=hypothesis)
        score = SimpleNamespace(
            name=name,
            entry=entry,
            gain=gain,
            scatter=2.0,
            coefficient=np.ones(1),
            information=information,
            width=1,
        )
        return SimpleNamespace(score=score, named=True, name=name, gain=gain)

    one, other, third = (challenger(name, 30.0) for name in ("one", "other", "third"))
    made = [
        (each, SimpleNamespace(cost=100.0 - won))
        for each, won in ((one, 40.0), (other, 40.0 - 4.0 * apart), (third, 36.0))
    ]
    accepted = Accepted(one.score.entry.hypothesis, 40.0, 2.0, 9.0, beside={"third": -5.0})
    step = _beside_all(Step(accepted=accepted), one, made, 100.0)  # type: ignore[arg-type]
    assert step.accepted is not None
    assert step.accepted.beside == pytest.approx({"other": -apart, "third": -5.0})
    assert _beside_all(Step(), one, made, 100.0) == Step()  # type: ignore[arg-type]
