"""Names that a textbook parameter makes up for, hidden in recordings of another plant: only the motor file tells them."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from helpers.textbook import textbook_on
from scipy.stats import t as students_t

from motorlens_physics.estimate.fit import Fit
from motorlens_workbench.contest.contest import contest
from motorlens_workbench.contest.entering import Step
from motorlens_workbench.contest.far_from_file import enter_for_file, far_from_file
from motorlens_workbench.contest.needed import beyond_chance
from motorlens_workbench.diagnose import Finding
from motorlens_workbench.report.json import next_command, sentence, to_json
from motorlens_workbench.standing import Standing
from motorlens_workbench.verdict import Verdict, settle

# The loss of an iron core, as a share of what the file says that it is: all but what viscous friction does.
IRON = {"name": "iron_loss_torque", "size": 0.8, "shape": {}}


@pytest.fixture(scope="module")
def iron(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on a motor with a loss in its iron."""
    return textbook_on(tmp_path_factory.mktemp("iron"), "gear_12V", [IRON], "no_load_steps", 10.0)


@pytest.fixture(scope="module")
def found(iron: Standing) -> Finding:
    """What a contest says of it."""
    fitted = iron.fitted
    base = SimpleNamespace(fit=Fit(fitted.model, fitted.prior, fitted.covariance, (), 0.0))
    return Finding(base, contest(fitted))  # type: ignore[arg-type]


@pytest.mark.fit
def test_what_viscous_friction_makes_up_for_is_seen_with_the_file_at_its_word(iron: Standing) -> None:
    assert set(far_from_file(iron.fitted)) == {"b"} and not beyond_chance(iron, [], [])
    said: list[str] = []
    step = enter_for_file(iron, said.append)
    (what,) = said
    assert "iron loss torque" in what and what.endswith("which b may make up for")
    assert step.accepted is not None and step.standing is not None
    assert step.accepted.hypothesis.name == "iron_loss_torque" and set(step.accepted.made_up_for) == {"b"}
    fitted = step.standing.fitted
    assert not far_from_file(fitted)
    at = fitted.prior.keys.index("iron_loss_torque.s")
    sd = float(fitted.covariance[at, at]) ** 0.5
    assert 0.03 < sd < 0.2
    assert fitted.model.values()["iron_loss_torque.s"] == pytest.approx(0.8, abs=3 * sd)
    # Ten deviations are fifty in a logarithm if the file is right, and some nine if it may be wrong.
    assert 3 < step.accepted.than_file < 10


@pytest.mark.fit
def test_that_the_file_may_be_wrong_is_said_in_front_of_the_name(found: Finding) -> None:
    verdict = settle(found)
    assert verdict.kind == "unknown" and verdict.equation == "mechanical" and verdict.shape is None
    assert verdict.chosen == verdict.instead == ("iron_loss_torque",) and verdict.contradicted == ("b",)
    assert 0.9 < verdict.probability["iron_loss_torque"] < 0.9999
    document = to_json(found, verdict, None, ["rec.csv"], "motor.toml")
    assert document["sentence"].startswith(
        "Either b is not what the motor file says, or iron loss torque (s = "
    )
    assert document["contradicts_file"] == {"parameters": ["b"], "or_missing": ["iron_loss_torque"]}
    assert any(text.startswith("Without iron_loss_torque, b: ") for text in document["cannot_tell"])
    # The error does not fall: `add` writes nothing by itself.
    assert " iron_loss_torque " in next_command(document) and " --force " in next_command(document)


@pytest.mark.fit
def test_of_a_motor_that_cannot_be_no_name_is_told(found: Finding) -> None:
    """The same recording, had its motor an inertia that can be no larger."""
    last = found.outcome.last
    known = last.fitted.prior
    least, most = known.bounds["J"]
    inertia = last.fitted.model.values()["J"]
    assert least < inertia < most
    edge = replace(last.fitted, prior=replace(known, bounds={**known.bounds, "J": (least, inertia)}))
    outcome = replace(found.outcome, last=replace(last, fitted=edge))
    verdict = settle(replace(found, outcome=outcome))
    assert verdict.kind == "unknown" and verdict.impossible and verdict.contradicted == ("J",)
    assert verdict.shape is None and verdict.torque is None
    assert not verdict.chosen and not any(verdict.probability.values())
    assert sentence(found, verdict) == (
        "Either J is not what the motor file says, or something is missing that it makes up for: it ends where no motor is, "
        "and of such a one no name is told."
    )


def test_names_that_hold_by_themselves_are_told_in_front_of_that() -> None:
    found = SimpleNamespace(outcome=SimpleNamespace(accepted=()), dead=())
    verdict = Verdict(
        kind="unknown",
        chosen=("brush_voltage_drop", "iron_loss_torque"),
        groups=(("brush_voltage_drop", "dead_time"), ("iron_loss_torque",)),
        equation="mechanical",
        probability={"brush_voltage_drop": 0.6, "dead_time": 0.4, "iron_loss_torque": 0.9},
        shape=None,
        torque=None,
        contradicted=("b", "k_ir"),
        instead=("iron_loss_torque",),
        impossible=False,
        beside="",
        untold=(),
    )
    assert sentence(found, verdict) == (  # type: ignore[arg-type]
        "Missing: one of brush voltage drop or dead time; and either b and k_ir are not what the motor file says, or iron "
        "loss torque is missing, which they make up for; nothing else shows above the sizes listed."
    )


@pytest.mark.fit
def test_errors_of_what_a_file_states_follow_students_t(iron: Standing) -> None:
    """Against another implementation of it; what else is known counts in full."""
    model, prior = iron.fitted.model, iron.fitted.prior
    there = model.with_values(prior.centre)

    def unlikely(key: str, deviations: float) -> float:
        moved = there.with_values({key: prior.centre[key] + deviations * prior.sd[key]})
        return replace(iron.fitted, model=moved, prior=prior).unlikely_beforehand

    for deviations in (1.0, 13.0):
        falls = students_t.logpdf(0.0, 4) - students_t.logpdf(deviations, 4)
        assert unlikely("b", deviations) == pytest.approx(2 * falls, rel=1e-6)
    assert unlikely("initial.w@0", 3.0) == pytest.approx(9.0, rel=1e-6)


@pytest.mark.fit
def test_where_nothing_is_far_from_the_file_nothing_is_fitted(
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    bare = textbook_on(tmp_path_factory.mktemp("bare"), "gear_12V", [], "no_load_steps", 10.0)
    said: list[str] = []
    assert enter_for_file(bare, said.append) == Step() and not said
    # Nor where nothing can be tested.
    nothing = SimpleNamespace(fitted=bare.fitted, null=None)
    assert enter_for_file(nothing, said.append) == Step() and not said  # type: ignore[arg-type]
