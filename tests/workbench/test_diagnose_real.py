"""What the diagnosis says of real motors, against what is documented of them (README of the recordings)."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from helpers.recordings import FOLDER, REGBOT_LEFT, needs_recordings, regbot

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.driven import driven
from motorlens_workbench.evidence.held_out import held_out
from motorlens_workbench.ladder import add
from motorlens_workbench.report.json import least_text, to_json
from motorlens_workbench.verdict import settle

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# A drop at brushes and driver of a few tenths of a volt, and what imitates it: an offset that is there at any speed.
DROP = {"brush_voltage_drop", "dead_time", "coasting_bridge", "current_sensor_offset", "speed_sensor_offset"}
FRICTION = {"coulomb_friction", "hysteresis_iron_loss", "directional_friction", "constant_torque"}


def diagnosed(paths, motor, columns=()):
    found = diagnose(read_motor_file(motor), [read_recording(path, columns) for path in paths])
    return found, settle(found)


@pytest.mark.long
@needs_recordings
@pytest.mark.fit
def test_a_drop_of_the_driver_is_among_what_a_wheel_motor_lacks():
    found, verdict = diagnosed([FOLDER / "regbot" / "robot_11_L.csv"], FOLDER / "regbot" / "command.toml")
    assert verdict.kind in ("group", "unknown")
    assert {"dead_time", "brush_voltage_drop"} <= set(verdict.groups[0])
    # What the verdict offers, what was tried and refused, and what would not have been seen are told apart.
    blind = next(text for text in verdict.untold if text.startswith("Not even")).partition(": ")[2]
    refused = [text for text in verdict.untold if text.startswith("The screen points at")]
    told = [name for group in verdict.groups for name in group] + blind.rstrip(".").split(", ")
    told += [re.split("[ ,.]", text)[4] for text in refused]
    assert sorted(told) == sorted(set(told))
    # The thermal equation is not tested, so no size of an effect in it would have been seen.
    document = to_json(found, verdict, None, ["rec.csv"], "motor.toml")
    thermal = [entry for entry in document["candidates"] if entry["equation"] == "thermal"]
    assert thermal and all(least_text(entry) == "no size" for entry in thermal)
    first, last = found.outcome.first, found.outcome.last
    before, after = held_out(first.book, first.lines), held_out(last.book, last.lines)
    assert after["speed"] < 0.75 * before["speed"] and after["current"] < 0.75 * before["current"]


@pytest.mark.long
@needs_recordings
@pytest.mark.fit
def test_wheel_motors_in_one_call_lack_a_drop_and_a_friction():
    """Held-out robots ran 2.24, then 1.58, then 1.30 rad/s off when the two were added, by the owners."""
    paths = [regbot(robot) for robot in (1, 3, 5)]
    found, verdict = diagnosed(paths, FOLDER / "regbot" / "command.toml", REGBOT_LEFT)
    assert verdict.kind in ("group", "unknown") and len(verdict.groups) >= 2
    offered = [set(group) for group in verdict.groups]
    assert any(group & {"brush_voltage_drop", "dead_time"} for group in offered)
    assert any(group & FRICTION for group in offered)
    assert set(verdict.chosen) <= DROP | FRICTION
    last = found.outcome.last
    assert held_out(last.book, last.lines)["speed"] < 1.5


@pytest.mark.long
@needs_recordings
@pytest.mark.fit
def test_an_engineer_adds_friction_and_then_a_drop_to_wheel_motors_and_the_error_falls():
    """As examples/hidden_effect/README.md does; friction alone, without the drop, a diagnosis would not take."""
    file = read_motor_file(EXAMPLES / "hidden_effect" / "regbot.toml")
    recordings = [read_recording(regbot(robot), REGBOT_LEFT) for robot in (1, 4)]
    reached, errors = None, []
    for effect, least, most in (("coulomb_friction", 0.4, 0.6), ("brush_voltage_drop", 0.25, 0.35)):
        step = add(file, [effect], recordings)
        assert step.supported, step.why
        before, after = (rung.held_out["speed"] for rung in step.rungs[-2:])
        assert least < 1 - after / before < most
        # What one step has led to is where the next one begins.
        assert reached is None or before == pytest.approx(reached, rel=0.02)
        reached, below, file = after, file, step.rungs[-1].file
        errors += [before, after]
    assert 0.57 < 1 - errors[-1] / errors[0] < 0.77
    # Where a fit ends is no matter of the last digits of where it begins: two ends here are nearly as likely.
    known = {key: below.knowledge[key] for key in ("R_a0", "L")}
    begun = {
        key: replace(one, prior=replace(one.prior, value=(1 + 1e-9) * one.prior.value))
        for key, one in known.items()
    }
    nudged = below.with_values({}, begun)
    again = add(nudged, ["brush_voltage_drop"], recordings)
    assert again.rungs[-1].held_out["speed"] == pytest.approx(step.rungs[-1].held_out["speed"], rel=0.04)
    drops = [rung.file.values()["brush_voltage_drop.V_b"] for rung in (step.rungs[-1], again.rungs[-1])]
    assert drops[1] == pytest.approx(drops[0], rel=0.03)


@pytest.mark.long
@needs_recordings
@pytest.mark.fit
def test_two_frictions_that_are_one_model_without_a_temperature_are_told_together():
    """Blocks of time scatter here, so that either is hardly likelier than none beside the model that has it."""
    runs = [FOLDER / "fra233" / f"studyV4_{name}_1.csv.gz" for name in ("Chirp", "Stair")]
    found, verdict = diagnosed(runs, EXAMPLES / "real_recordings" / "fra233.toml")
    one, other = "coulomb_friction", "hysteresis_iron_loss"
    assert {one, other} <= set(verdict.groups[0])
    probability = next(rivals.probability for rivals in found.outcome.rivals if one in rivals.probability)
    assert 0.5 < probability[one] / probability[other] < 2.0


@pytest.mark.long
@needs_recordings
@pytest.mark.fit
def test_the_iron_of_a_thruster_warms_its_winding_late_and_no_sensor_is_blamed():
    """A brushless motor of 700 g with one thermocouple at its winding: its iron is no part of the textbook's winding."""
    thermal = FOLDER / "ksu_thermal"
    columns = ["temperature=4LHE Temp (ºF)", "ambient=66NA Temp (ºF)"]
    recording = read_recording(thermal / "Spike-P80-1700_2020-02-11_162559.csv", columns)
    file, recordings = driven(read_motor_file(EXAMPLES / "real_recordings" / "mega.toml"), [recording])
    found = diagnose(file, recordings)
    verdict = settle(found)
    assert {"iron_core", "iron_heat_delay"} <= set(verdict.groups[0])
    assert not any("sensor" in name for name in verdict.chosen)
    first, last = found.outcome.first, found.outcome.last
    before, after = held_out(first.book, first.lines), held_out(last.book, last.lines)
    assert after["temperature"] < 0.25 * before["temperature"]
    # What is named is supported when it is added, though far from null Wald's test alone says too little of it.
    step = add(file, ["iron_core"], recordings)
    assert step.supported, step.why
    assert step.rungs[-1].held_out["temperature"] < 0.25 * step.rungs[0].held_out["temperature"]


@needs_recordings
@pytest.mark.fit
def test_nothing_is_told_from_a_motor_that_stands_still():
    _, verdict = diagnosed([FOLDER / "bad" / "const.csv"], FOLDER / "regbot" / "command.toml")
    assert verdict.kind == "not_testable" and not verdict.chosen
