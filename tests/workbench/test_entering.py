"""What may hold a rotor at rest, hidden in recordings of another plant: names that no linear look shows as they are."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.hidden import Case, generate
from helpers.textbook import textbook_on
from scipy.stats import t as students_t

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.points import weighed
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.contest import entering
from motorlens_workbench.contest.contest import contest
from motorlens_workbench.contest.entering import Step, enter_for_delays, enter_unseen
from motorlens_workbench.contest.needed import beyond_chance, unseen
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.ledger import Lens, ledger
from motorlens_workbench.refit import promise
from motorlens_workbench.standing import Standing, stand

STRIBECK = {"name": "stribeck_friction", "size": 0.0026, "shape": {"w_k": 15.1}}
COGGING = {"name": "cogging_torque", "size": 0.0084, "shape": {"cog_N": 12.0, "cog_p": 1.9}}


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize(
    ("motor", "hidden", "seen", "expected"),
    [
        ("gear_12V", STRIBECK, False, {"tau_s": (0.0026, 0.15), "w_k": (15.1, 0.05)}),
        ("servo_24V", COGGING, True, {"A": (0.0084, 0.15), "N": (12.0, 1e-9), "p": (1.9, 0.05)}),
    ],
    ids=["stribeck friction", "cogging torque"],
)
def test_what_holds_a_rotor_is_known_once_it_is_fitted(
    tmp_path: Path, motor: str, hidden: dict[str, Any], seen: bool, expected: dict[str, tuple[float, float]]
) -> None:
    said: list[str] = []
    here = textbook_on(tmp_path, motor, [hidden], "no_load_steps", 10.0)
    assert (hidden["name"] in [one.name for one in beyond_chance(here, [], [])]) is seen
    step = enter_unseen(here, unseen(here, []), (), said.append)
    assert said == [f"fitting with {hidden['name'].replace('_', ' ')}"], "others do not promise to win enough"
    assert step.accepted is not None and step.accepted.hypothesis.name == hidden["name"]
    assert step.standing is not None
    found = step.standing.fitted.model.values()
    for key, (true, rel) in expected.items():
        assert found[f"{hidden['name']}.{key}"] == pytest.approx(true, rel=rel)


@pytest.mark.fit
@pytest.mark.parametrize(
    ("name", "lags_s", "late"),
    [
        ("speed_sensor_lag", 0.03, 10),
        pytest.param("current_sensor_lag", 0.004, 0, marks=pytest.mark.long),
        ("", 0.0, 15),
    ],
)
def test_a_sensor_that_lags_is_told_from_channels_that_come_late_or_early(
    tmp_path: Path, name: str, lags_s: float, late: int
) -> None:
    """Either passes for the other as long as the other is not fitted, or both for one; samples are 2 ms apart."""
    lag = [{"name": name, "size": lags_s, "shape": {}}] if name else []
    here = textbook_on(tmp_path, "servo_24V", lag, "no_load_steps", 5.0, late)
    step = enter_for_delays(here, (), lambda text: None)
    (tried,) = step.judged
    assert not step.refused
    if not name:
        assert here.fitted.runs[0].late == {"speed": late}
        assert step.accepted is None and step.standing is None and step.judged[tried] < 0.5
        return
    assert tried == name and step.judged[name] > 2
    assert step.accepted is not None and step.standing is not None
    end = step.standing.fitted
    assert end.model.values()[f"{name}.tau"] == pytest.approx(lags_s, rel=0.1)
    assert end.runs[0].late.get("speed", 0) == late and not end.runs[0].late.get("current", 0)


@pytest.mark.long
@pytest.mark.fit
def test_what_a_delay_stands_for_is_asked_again_beside_what_was_missing(tmp_path: Path) -> None:
    """Where the voltage is off as well, at first neither fits: a lag of 6 ms passes for a delay of three samples."""
    hidden: list[dict[str, Any]] = [
        {"name": "speed_sensor_lag", "size": 0.006, "shape": {}},
        {"name": "voltage_sensor_offset", "size": 1.2, "shape": {}},
    ]
    here = textbook_on(tmp_path, "servo_24V", hidden, "no_load_steps", 6.0)
    assert here.fitted.runs[0].late == {"speed": 3}
    assert enter_for_delays(here, (), lambda text: None).accepted is None
    out = contest(here.fitted)
    assert {one.hypothesis.name for one in out.accepted} == {"speed_sensor_lag", "voltage_sensor_offset"}
    assert out.last.fitted.model.values()["speed_sensor_lag.tau"] == pytest.approx(0.006, rel=0.1)
    assert not any(out.last.fitted.runs[0].late.values())


# Slow voltages about nought, a converter of 12 bit, and a torque that nobody measured: a case that was told as a lag.
CREEPING = Case(
    id="creeping", seed=916646029943152014, motor="gear_12V", kind="single", hidden=(("constant_torque", 10.0),),
    noise=0.002, noise_kind="12bit", records="fast", excitation="near_standstill", stamped=False, small=True,
)  # fmt: skip


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("part", [slice(None), slice(3000, 6000)], ids=["all", "three tenths"])
def test_a_torque_that_passes_for_a_delay_is_not_told_as_a_lag(tmp_path: Path, part: slice) -> None:
    """Beside the lag its channel comes early; in a part of it, it smooths the noise of the voltage, and wins for that."""
    written = generate(CREEPING, tmp_path)
    file, whole = read_motor_file(written.motor), read_recording(written.recordings[0])
    channels = {name: channel[part] for name, channel in whole.channels.items()}
    time_s = whole.time_s[part] - whole.time_s[part][0]
    recording = replace(whole, time_s=time_s, channels=channels)
    here = stand(fitted_of(estimate(file, prepare_all([recording], file))))
    assert set(here.fitted.runs[0].late) == {"current"}
    step = enter_for_delays(here, (), lambda text: None)
    assert step.judged == {"current_sensor_lag": 0.0} and step.accepted is None and step.standing is None


@pytest.mark.parametrize(
    ("seen_from_here", "seen_from_there", "won"), [(-145.0, 2030.0, -145.0), (17.0, 16.0, 16.0)]
)
def test_what_only_the_noise_of_a_model_says_of_its_timing_is_not_won(
    monkeypatch: pytest.MonkeyPatch, seen_from_here: float, seen_from_there: float, won: float
) -> None:
    unlikely = {("here", "old"): 0.0, ("there", "old"): 0.0}
    unlikely |= {("here", "new"): -seen_from_here, ("there", "new"): -seen_from_there}
    monkeypatch.setattr(entering, "stand", lambda fitted: SimpleNamespace(name="there"))
    monkeypatch.setattr(entering, "unlikely_from", lambda frame, fitted: unlikely[frame.name, fitted])
    here = SimpleNamespace(name="here", fitted="old")
    assert entering._won_by_both(here, "new") == won  # type: ignore[arg-type]


@pytest.mark.fit
def test_where_nothing_is_late_no_lag_is_estimated_in_its_place(bare: Standing) -> None:
    said: list[str] = []
    assert enter_for_delays(bare, (), said.append) == Step() and not said
    # Nor where nothing can be tested.
    assert enter_for_delays(SimpleNamespace(null=None), (), said.append) == Step()  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook where nothing is missing."""
    return textbook_on(tmp_path_factory.mktemp("bare"), "servo_24V", [], "no_load_steps", 10.0)


@pytest.mark.fit
def test_where_nothing_holds_the_rotor_nothing_wins_enough_and_all_is_refused(bare: Standing) -> None:
    said: list[str] = []
    here = bare
    names = {one.name for one in unseen(here, [])}
    assert {"stribeck_friction", "coulomb_friction", "cogging_torque"} <= names
    step = enter_unseen(here, unseen(here, []), (), said.append)
    assert step.standing is None and set(step.refused) == names
    # A linear step from a model with friction may promise more than holds once it is fitted.
    assert not step.judged and set(said) <= {"fitting with stribeck friction"}
    assert not unseen(here, step.refused)


@pytest.mark.fit
def test_what_a_model_wins_by_itself_is_no_promise_of_a_name(bare: Standing) -> None:
    """Eight deviations beside the best resistance cost 64 and more, which every fit wins, and nothing is missing."""
    stood, key = bare.fitted, "R_a0"
    sd = float(np.sqrt(stood.covariance[stood.prior.keys.index(key), stood.prior.keys.index(key)]))
    away = stood.model.with_values({key: stood.model.values()[key] + 8 * sd})
    # As `under` makes them, but for the fit.
    there = stand(replace(stood, model=away))
    beside = ledger(there.lines, Lens(bare.noises), stood.prior, ()).beside()
    best, beginning = (_cost(model, bare) for model in (stood.model, away))
    assert beginning - best > 60
    promised = {
        one.name: promise(replace(stood, model=away, cost=beginning), beside, one) for one in unseen(bare, [])
    }
    assert promised and max(promised.values()) < 16


def _cost(model: Model, here: Standing) -> float:
    """Of a model on the runs of another, what is known beforehand included."""
    runs, prior = here.fitted.runs, here.fitted.prior
    point = weighed(model, runs, here.noises, [run.there for run in runs], prior.keys)
    return point.cost + prior.penalty(model.values())


@pytest.mark.fit
@pytest.mark.parametrize(
    ("likelier", "away", "goes_there"),
    [(3.0, 1.0, True), (3.0, 4.0, True), (3.0, 5.0, False), (-3.0, -3.0, True), (-7.0, 0.0, False)],
)
def test_of_two_fits_of_a_model_that_stands_which_is_likelier_with_all_that_is_known(
    bare: Standing, monkeypatch: pytest.MonkeyPatch, likelier: float, away: float, goes_there: bool
) -> None:
    """By Bayes: twice the logarithm of the likelihood, less that of Student's t, as a motor file errs.

    The fit from the beginning is taken unless the other is likelier by more than twice the logarithm of 20, 6.0.
    """
    here, stood, key = bare, bare.fitted, "R_a0"
    values, sd = stood.model.values(), stood.prior.sd[key]

    def known(deviations: float) -> entering.Fitted:
        """The fit, as if a parameter were known to be so far from where it is."""
        centre = {**stood.prior.centre, key: values[key] - deviations * sd}
        return replace(stood, prior=replace(stood.prior, centre=centre))

    start = 0.0 if away >= 0 else 3.0
    before, after = known(start), known(start + away)
    unlikely = -2 * np.diff(students_t.logpdf([start, start + away], 4))[0] - likelier
    assert goes_there == (unlikely < 2 * np.log(20))
    score = here.scores[0]
    monkeypatch.setattr(entering, "anew", lambda fitted: after)
    leaves = {id(before): SimpleNamespace(unlikely=0.0), id(after): SimpleNamespace(unlikely=-likelier)}
    monkeypatch.setattr(entering, "_residual", lambda here, fitted: leaves[id(fitted)])
    judged = Step(replace(here, fitted=after), unlikely=here.unlikely - likelier)
    monkeypatch.setattr(entering, "_judged", lambda here, one, start, own: judged)
    step = entering._timed_anew(here, score, Step(replace(here, fitted=before), unlikely=here.unlikely), ())
    assert step.standing is not None
    assert (step.standing.fitted is after) is goes_there
