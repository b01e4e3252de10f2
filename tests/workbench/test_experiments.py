"""The test proposed for a group is one that tells it apart, and is not proposed where nothing of the kind could."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.hidden import known

from motorlens_physics.effect import catalogue
from motorlens_physics.inputs import Inputs
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.recording import Recording, read_recording
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_physics.sensor_model import sensor_catalogue
from motorlens_physics.simulation import simulate
from motorlens_workbench import experiments
from motorlens_workbench.diagnose import Finding, diagnose
from motorlens_workbench.experiments import Experiment, propose
from motorlens_workbench.verdict import Verdict, settle

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
NOISE = {"voltage": 0.5, "current": 0.05, "speed": 0.5, "temperature": 0.3, "load_torque": 0.02}
SAMPLES = 4000
# The same information in fewer samples: noise of ten thousand, less by the root of how many there are.
NOISE = {channel: sd * (SAMPLES / 10_000) ** 0.5 for channel, sd in NOISE.items()}
TWINS = {"constant_torque", "load_torque_sensor_offset"}


def recorded(
    test: str, seconds: float, torque: float = 0.0, faults: dict[str, float] | None = None
) -> Recording:
    file = read_motor_file(MOTOR)
    effect = replace(catalogue()["constant_torque"].typical(file.rated), tau_0=torque)
    rng = np.random.default_rng(5)
    truth = perform(
        replace(file, motor=file.motor.with_effect(effect)),
        scenarios()[test](seconds, seconds / SAMPLES),
        rng,
    )
    sensors = tuple(
        replace(sensor_catalogue()[f"load_torque_sensor_{name}"], **{name: size})
        for name, size in (faults or {}).items()
    )
    return measure(truth, sensors, NOISE, rng)


@pytest.fixture(scope="module")
def rough() -> MotorFile:
    return read_motor_file(MOTOR).with_values({"R_a0": 4.0, "ke": 0.85, "J": 0.039, "b": 0.0018})


def proposed(found: Finding) -> tuple[Verdict, Experiment | None]:
    verdict = settle(found)
    return verdict, propose(found, verdict, np.random.default_rng(0))


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("said", [False, True])
@pytest.mark.parametrize("guilty", sorted(TWINS))
def test_an_offset_of_the_torque_sensor_is_told_from_a_torque_with_the_sensor_off(rough, guilty, said):
    """At every load the two are one; on a bare shaft, said by zeros or not, the torque stays and the sensor is gone."""
    hidden = {"torque": 0.3} if guilty == "constant_torque" else {"faults": {"offset": 0.3}}
    first = recorded("load_steps", 30.0, **hidden)
    verdict, experiment = proposed(diagnose(rough, [first]))
    assert set(verdict.groups[0]) == TWINS
    assert experiment is not None and experiment.bare and experiment.test
    assert "torque sensor taken off" in experiment.why
    second = recorded(experiment.test, experiment.seconds, **hidden)
    bare = {q: y for q, y in second.channels.items() if q != "load_torque"}
    if said:
        bare["load_torque"] = np.zeros(len(second.time_s))
    found = diagnose(rough, [first, replace(second, channels=bare)])
    assert [run.bare for run in found.runs] == [False, said]
    assert settle(found).groups == ((guilty,),)


@pytest.mark.long
@pytest.mark.fit
def test_no_run_tells_one_wrong_scale_from_another(rough):
    """Torque over current, voltage over speed: four scales in one ratio (ke), whatever the motor does."""
    verdict, experiment = proposed(diagnose(rough, [recorded("load_steps", 30.0, faults={"gain": 1.1})]))
    assert "load_torque_sensor_gain" in verdict.groups[0] and len(verdict.groups[0]) >= 4
    assert experiment is not None and not experiment.test
    assert {"current", "voltage", "speed", "load_torque"} <= set(experiment.check)
    assert "reference instrument" in experiment.why


@pytest.mark.parametrize(("seconds", "offered"), [(20_000.0, True), (54_000.0, False)])
def test_no_test_is_offered_that_takes_longer_than_a_working_day(
    monkeypatch: pytest.MonkeyPatch, seconds: float, offered: bool
) -> None:
    """A drive without a back-EMF to speak of has a time constant of minutes: its slow ramp would take 15 hours."""
    monkeypatch.setattr(experiments, "_of_scenario", lambda *of: (np.eye(1), seconds))
    monkeypatch.setattr(experiments, "_apart", lambda asked, gram: ({("a", "b"): 1e6 * gram[0, 0]}, 0.0))
    asked = SimpleNamespace(gram=np.zeros((1, 1)), scatter=1.0, names=("a", "b"))
    took = experiments._told(asked, "slow_ramp", {}, (), np.random.default_rng(0))  # type: ignore[arg-type]
    assert took == (((("a",), ("b",)), seconds) if offered else None)


@pytest.mark.parametrize(
    ("far", "parts", "times"),
    [
        # What a run of its usual length tells of each pair, in what is needed; it may be made up to 20 times as long.
        ({"ab": 1.0, "ac": 1.0, "bc": 10.0}, (("a",), ("b",), ("c",)), 1.0),
        ({"ab": 0.1, "ac": 1.0, "bc": 1.0}, (("a",), ("b",), ("c",)), 10.0),
        ({"ab": 1.0, "ac": 1.0, "bc": 0.0}, (("a",), ("b", "c")), 1.0),
        ({"ab": 0.1, "ac": 1.0, "bc": 0.02}, (("a",), ("b", "c")), 10.0),
        # That b is told from c is of no use while either may be a.
        ({"ab": 0.0, "ac": 0.0, "bc": 10.0}, None, 0.0),
    ],
)
def test_a_group_is_in_parts_of_which_no_two_are_left_together(
    monkeypatch: pytest.MonkeyPatch,
    far: dict[str, float],
    parts: tuple[tuple[str, ...], ...] | None,
    times: float,
) -> None:
    needed = experiments.SETTLED

    def apart(asked: object, gram: np.ndarray) -> tuple[dict[tuple[str, str], float], float]:
        return {(pair[0], pair[1]): 1.001 * needed * share * gram[0, 0] for pair, share in far.items()}, 0.0

    monkeypatch.setattr(experiments, "_apart", apart)
    monkeypatch.setattr(experiments, "_of_scenario", lambda *of: (np.eye(1), 100.0))
    asked = SimpleNamespace(gram=np.zeros((1, 1)), scatter=1.0, names=("a", "b", "c"))
    told = experiments._told(asked, "load_steps", {}, (), np.random.default_rng(0))  # type: ignore[arg-type]
    assert (told is None) == (parts is None)
    if told is not None:
        assert told[0] == parts
        # Lengths are tried in steps of a third.
        assert 100.0 * times <= 1.002 * told[1] < 135.0 * times


@pytest.mark.long
@pytest.mark.fit
def test_a_run_both_ways_tells_a_drop_from_offsets_that_no_run_tells_from_each_other(rough) -> None:
    """One way all are a constant voltage. A drop turns with the current, and offsets do not."""
    file = read_motor_file(MOTOR)
    drop = replace(catalogue()["brush_voltage_drop"].typical(file.rated), V_b=4.0)
    time = np.arange(SAMPLES) * 0.005
    volts = 150.0 + 40.0 * np.sin(2 * np.pi * time / 4.0)
    # The motor never brakes: its current has one sign throughout.
    load = 8.0 + 2.0 * np.sin(2 * np.pi * time / 5.0)
    inputs = Inputs(time, volts, load, np.full(SAMPLES, 25.0))
    truth = simulate(file.motor.with_effect(drop), inputs)
    rng = np.random.default_rng(8)
    shown = {
        "voltage": volts,
        "current": truth.states["i"],
        "speed": truth.states["w"],
        "load_torque": load,
    }
    assert shown["current"][400:].min() > 1.0
    channels = {q: y + NOISE[q] * rng.standard_normal(SAMPLES) for q, y in shown.items()}
    channels["ambient"] = np.full(SAMPLES, 25.0)
    recording = Recording("one way.csv", time[400:], {q: y[400:] for q, y in channels.items()})
    verdict, experiment = proposed(diagnose(rough, [recording]))
    group = next(group for group in verdict.groups if "brush_voltage_drop" in group)
    offsets = {"speed_sensor_offset", "voltage_sensor_offset"}
    drops = {"brush_voltage_drop", "dead_time"}
    assert set(group) == {*drops, *offsets}
    assert experiment is not None and experiment.test and experiment.separates == group
    assert {frozenset(part) for part in experiment.parts} == {frozenset(offsets), frozenset(drops)}
    assert set(experiment.check) == {"speed", "voltage"}
    assert "it leaves" in experiment.why and "no run" not in experiment.why
    assert experiment.sentence.startswith("To tell ") and " or speed sensor offset" in experiment.sentence
    # It says what it leaves, and so it does once it is done: a dead time takes the shape of a drop whose heat nothing shows.
    step_s = experiment.seconds / SAMPLES
    both_ways = perform(
        replace(file, motor=file.motor.with_effect(drop)),
        scenarios()[experiment.test](experiment.seconds, step_s),
        rng,
    )
    made = measure(both_ways, (), NOISE, rng)
    made = replace(made, channels={q: y for q, y in made.channels.items() if q in channels})
    assert [set(group) for group in settle(diagnose(rough, [recording, made])).groups] == [drops]


@pytest.mark.long
@pytest.mark.fit
def test_no_run_without_a_thermometer_tells_what_a_drop_heats(rough) -> None:
    """A dead time is a drop at brushes that heats nothing: transients between samples of a slow run had told them apart."""
    file = read_motor_file(MOTOR)
    drop = replace(catalogue()["brush_voltage_drop"].typical(file.rated), V_b=4.0)
    rng = np.random.default_rng(9)
    truth = perform(
        replace(file, motor=file.motor.with_effect(drop)),
        scenarios()["load_steps"](20.0, 20.0 / SAMPLES),
        rng,
    )
    seen = measure(truth, (), NOISE, rng)
    kept = {q: y for q, y in seen.channels.items() if q not in ("temperature", "resistance")}
    verdict, experiment = proposed(diagnose(rough, [replace(seen, channels=kept)]))
    assert set(verdict.groups[0]) == {"brush_voltage_drop", "dead_time"}
    assert experiment is not None and (experiment.test == "" or experiment.with_sensor == "temperature")


@pytest.mark.long
@pytest.mark.blind
def test_no_run_tells_a_drift_of_the_ambient_that_comes_at_once_from_a_thermometer_that_is_off(
    tmp_path,
) -> None:
    """A minute of a locked rotor had been proposed, for a drift that takes a quarter of an hour; it left all three."""
    made = known("dev-0442", tmp_path)
    verdict, experiment = proposed(
        diagnose(read_motor_file(made.motor), [read_recording(path) for path in made.recordings])
    )
    (group,) = verdict.groups
    assert {made.truth["hidden"][0]["name"], "ambient_drift"} <= set(group)
    assert experiment is not None and not experiment.test and experiment.check == ("temperature",)
