"""The diagnosis as JSON (schema motorlens.diagnose/1) and as text."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.run import UNIT_OF
from motorlens_workbench.contest.needed import needed_weight
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.diagnose import Finding
from motorlens_workbench.evidence.held_out import held_out
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.experiments import Experiment
from motorlens_workbench.hypotheses.bumps import Bump
from motorlens_workbench.hypotheses.changes import Change
from motorlens_workbench.hypotheses.contact import Contact
from motorlens_workbench.hypotheses.courses import Course
from motorlens_workbench.hypotheses.dead_channels import DeadChannel
from motorlens_workbench.hypotheses.memory import Memory
from motorlens_workbench.report.page import significant, unit_text
from motorlens_workbench.verdict import (
    Verdict,
    detectable,
    in_its_place,
    measured,
    seen_named,
    sizes,
    told_together,
)

Array = NDArray[np.float64]

SHOWN = 12
# What is likelier by chance than this is not seen.
SEEN = 0.01


def to_json(
    found: Finding, verdict: Verdict, experiment: Experiment | None, recordings: Sequence[str], motor: str,
    options: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """The document of `motorlens diagnose --json`, schema `motorlens.diagnose/1`.

    Args:
        found, verdict, experiment: what it says.
        recordings, motor: the files.
        options: how they were read, as flags of the command line.
    """
    first, last = seen_named(found.outcome.first), seen_named(found.outcome.last)
    dead = {one.name for one in found.dead}
    names = [name for name in {**first, **last, **dict.fromkeys(verdict.chosen)} if name not in dead]
    entries = [_candidate(found, verdict, name, first.get(name), last.get(name)) for name in names]
    entries.sort(
        key=lambda entry: (-entry["probability"], entry["name"] not in verdict.chosen, -entry["statistic"])
    )
    document: dict[str, Any] = {
        "schema": "motorlens.diagnose/1",
        "motor": motor,
        "recordings": list(recordings),
        "options": list(options),
        "verdict": verdict.kind,
        "sentence": sentence(found, verdict),
        "chosen": list(verdict.chosen),
        "groups": [list(group) for group in verdict.groups],
        "equation": verdict.equation,
        "candidates": [*(_dead(one) for one in found.dead), *entries],
        "error": errors(found),
        "cannot_tell": list(verdict.untold),
        "criteria": {**asdict(CRITERIA), "needed": _needed(found)},
    }
    if experiment is not None:
        document["separating_experiment"] = {
            "test": experiment.test, "separates": list(experiment.separates),
            "parts": [list(part) for part in experiment.parts], "seconds": experiment.seconds, "why": experiment.why,
            "sentence": experiment.sentence, "with_sensor": experiment.with_sensor, "bare": experiment.bare,
            "check": list(experiment.check),
        }  # fmt: skip
    if verdict.contradicted:
        document["contradicts_file"] = {
            "parameters": list(verdict.contradicted),
            "or_missing": list(verdict.instead),
        }
    if verdict.torque is not None or verdict.shape is not None:
        shape, x, y, sd = course(verdict)
        document["unknown_shape"] = {
            "term": shape.term, "against": shape.against, "unit": shape.unit,
            "x": x.tolist(), "y": y.tolist(), "sd": sd.tolist(),
        }  # fmt: skip
    return document


def course(verdict: Verdict) -> tuple[Any, Array, Array, Array]:
    """What has no name: its shape, and (k,) against what, how large it is there, and the standard deviation of that."""
    if verdict.torque is not None:
        seen = verdict.torque
        return seen, seen.time_s, seen.torque_Nm, np.full(len(seen.time_s), seen.sd_Nm)
    assert verdict.shape is not None
    shape: Any = verdict.shape.entry.shape
    return shape, *shape.values(verdict.shape.coefficient, verdict.shape.covariance)


def _needed(found: Finding) -> float | None:
    last = found.outcome.last
    return float(needed_weight(last)) if last.null else None


def errors(found: Finding) -> dict[str, Any]:
    """Held-out RMSE of each channel before and after, and the noise floor."""
    first, last = found.outcome.first, found.outcome.last
    before = held_out(first.book, first.lines)
    after = held_out(last.book, last.lines) if found.outcome.accepted else before
    return {"before": before, "after": after, "noise_floor": last.floor, "held_out": True}


def risen(before: Mapping[str, float], after: Mapping[str, float]) -> list[str]:
    """A sentence on the channels whose error is larger after than before, in the digits that are shown; none without any.

    >>> risen({"speed": 2.0}, {"speed": 1.0})
    []
    >>> print(*risen({"speed": 2.0, "current": 0.100}, {"speed": 1.0, "current": 0.112}))
    The error of current rises (0.1 to 0.112): what was added was judged by all channels together, in units of their noise.
    """
    rise = [
        f"{channel} rises ({significant(error, 3)} to {significant(after[channel], 3)})"
        for channel, error in before.items()
        if after.get(channel, 0.0) > error and significant(after[channel], 3) != significant(error, 3)
    ]
    why = "what was added was judged by all channels together, in units of their noise."
    return [f"The error of {', of '.join(rise)}: {why}"] if rise else []


def _dead(one: DeadChannel) -> dict[str, Any]:
    return {
        "name": one.name, "kind": "sensor", "equation": one.channel, "gain": 0.0, "statistic": 0.0, "p": 0.0,
        "probability": 1.0, "parameters": {"gain": {"value": one.gain, "sd": one.sd, "unit": "1"}},
        "minimum_detectable": None, "why_not": "", "told_together": [],
    }  # fmt: skip


def _candidate(
    found: Finding, verdict: Verdict, name: str, first: Score | None, last: Score | None
) -> dict[str, Any]:
    accepted = next((one for one in found.outcome.accepted if one.hypothesis.name == name), None)
    rival = in_its_place(found, name)
    seen = rival or first or last
    hypothesis = accepted.hypothesis if accepted else seen.entry.hypothesis  # type: ignore[union-attr]
    # Of what is in the model, the size that would have been seen is that of the look that saw it.
    look = first if accepted or rival else (last or first)
    least = abs(hypothesis.typical) * detectable(found, look) if look else float("inf")
    if accepted:
        # It was seen at its size: a look from afar, with the model bent by what it lacks, may ask for more.
        null = found.outcome.last.fitted.model.file.meaning(hypothesis.key).null or 0.0
        least = min(least, abs(measured(found, accepted)[0] - null))
    weight = accepted.weight if accepted else seen.weight if seen and seen.possible else 0.0
    return {
        "name": name,
        "kind": hypothesis.kind,
        "equation": hypothesis.equation,
        "gain": accepted.gain if accepted else seen.gain if seen else 0.0,
        "statistic": weight,
        # Where no number is as small, the smallest.
        "p": float(np.exp(-min(weight, 700.0))),
        "probability": verdict.probability.get(name, 0.0),
        "parameters": sizes(found, name),
        "minimum_detectable": least if np.isfinite(least) else None,
        "why_not": "" if accepted or seen is None or seen.possible else "a size that it cannot have",
        "told_together": told_together(found, accepted) if accepted else [],
    }


def sentence(found: Finding, verdict: Verdict) -> str:
    """The verdict in one sentence."""
    said = [f"{_words(name)}{_size(found, name)}" for name in verdict.chosen]
    faults = {one.name for one in found.dead}
    offered = []
    for group, name in zip(verdict.groups, verdict.chosen, strict=True):
        if group[0] in faults:
            continue
        likelier = sorted(group, key=lambda one: -verdict.probability[one])
        names = [_words(one) for one in likelier]
        offered.append(
            f"{names[0]}{_size(found, name)}"
            if len(names) == 1
            else f"one of {', '.join(names[:-1])} or {names[-1]}"
        )
    if found.dead:
        dead = [f"{one.channel} sensor of {one.recording} ({one.state})" for one in found.dead]
        beside = f". Missing beside: {'; and '.join(offered)}" if offered else ""
        return f"At fault: {' and '.join(dead)}{beside}."
    if verdict.kind in ("named", "sensor_fault"):
        what = "Missing" if verdict.kind == "named" else "At fault"
        return f"{what}: {' and '.join(said)}."
    if verdict.kind == "group":
        return f"Missing: {'; and '.join(offered)}. These recordings cannot tell more."
    if verdict.contradicted:
        either = _or_the_file(verdict, dict(zip(verdict.chosen, offered, strict=True)))
        return f"{either} {verdict.beside}" if verdict.beside else either
    if verdict.kind == "unknown":
        rest = _shape(verdict)
        if offered:
            return (
                f"Missing: {'; and '.join(offered)}; and in the {verdict.equation} equation something is left that no "
                f"effect of the catalogue explains; {rest}."
            )
        return f"Something is missing in the {verdict.equation} equation that no effect explains; {rest}."
    if verdict.kind == "not_testable":
        return "These recordings cannot show whether anything is missing; why is among what they cannot tell."
    nothing = "Nothing is missing above the sizes listed: larger effects would have been seen."
    return f"{nothing} {verdict.beside}" if verdict.beside else nothing


def _or_the_file(verdict: Verdict, offered: Mapping[str, str]) -> str:
    """Where a parameter is far from the motor file, and nothing else shows beside names that hold by themselves."""
    sure = [text for name, text in offered.items() if name not in verdict.instead]
    missing = [text for name, text in offered.items() if name in verdict.instead]
    verb, makes = ("is", "it makes") if len(verdict.contradicted) == 1 else ("are", "they make")
    wrong = f"{' and '.join(verdict.contradicted)} {verb} not what the motor file says"
    which = f"{' and '.join(missing)} is missing, which" if missing else "something is missing that"
    either = f"Missing: {'; and '.join(sure)}; and either" if sure else "Either"
    if verdict.impossible:
        ends = "it ends" if len(verdict.contradicted) == 1 else "they end"
        return f"Either {wrong}, or {which} {makes} up for: {ends} where no motor is, and of such a one no name is told."
    return f"{either} {wrong}, or {which} {makes} up for; nothing else shows above the sizes listed."


def _words(name: str) -> str:
    return name.replace("_", " ")


def _shape(verdict: Verdict) -> str:
    if verdict.torque is not None:
        return f"a torque over time, {verdict.torque.size}, as a load is that nobody measured"
    assert verdict.shape is not None
    score = verdict.shape
    shape: Any = score.entry.shape
    if isinstance(shape, Memory):
        return f"it follows the past of the {shape.past} and is shown against the frequency of that, in {shape.unit}"
    if isinstance(shape, Change):
        return shape.told(float(score.coefficient[0]))
    if isinstance(shape, Contact):
        return (
            f"{shape.term} comes and goes as with a loose contact: some {shape.by:.2g} {shape.unit} more for "
            f"{100 * shape.share:.0f} % of the time, most in {shape.recording}"
        )
    _, y, _ = shape.values(score.coefficient, score.covariance)
    size = f"{float(np.ptp(y)):.2g} {shape.unit} from the least to the most"
    if isinstance(shape, Bump):
        place = shape.place(score.coefficient)
        return f"a {shape.term} about {place:.3g} rad/s alone, {size}"
    if isinstance(shape, Course):
        return f"{shape.parameter} is no constant but changes with {shape.against}, by {size}"
    return f"a {shape.balance} against {shape.against}, {size}"


def _size(found: Finding, name: str) -> str:
    for one in found.outcome.accepted:
        if one.hypothesis.name == name:
            if names := told_together(found, one):
                return f" ({_together(names)})"
            value, sd = measured(found, one)
            key = one.hypothesis.key
            unit = found.outcome.last.fitted.model.file.meaning(key).unit
            return f" ({key.rpartition('.')[2]} = {value:.4g} +- {sd:.2g} {unit})"
    return ""


def to_text(document: Mapping[str, Any]) -> str:
    """What the terminal shows."""
    rows = [document["sentence"], ""]
    error = document["error"]
    rows.append(f"{'channel':<18}{'before':>12}{'after':>12}{'noise':>12}   RMSE on blocks of time held out")
    for channel, before in error["before"].items():
        rms = before, error["after"][channel], error["noise_floor"][channel]
        rows.append(f"{channel + ', ' + UNIT_OF[channel]:<18}" + "".join(f"{value:>12.4g}" for value in rms))
    rows += risen(error["before"], error["after"])
    shown = document["candidates"][:SHOWN]
    told = [entry["why_not"] or size_text(entry) for entry in shown]
    width = max(map(len, [*told, "size"])) + 2
    rows += [
        "",
        f"{'hypothesis':<34}{'probability':>12}{'p by chance':>13}   {'size':<{width}}would have been seen from",
    ]
    for entry, size in zip(shown, told, strict=True):
        rows.append(
            f"{entry['name'].replace('_', ' '):<34}{entry['probability']:>12.2f}{entry['p']:>13.1e}   {size:<{width}}"
            f"{least_text(entry)}"
        )
    if document["cannot_tell"]:
        rows += ["", *document["cannot_tell"]]
    if "separating_experiment" in document:
        rows += ["", document["separating_experiment"]["sentence"]]
    if command := next_command(document):
        begin = "To go on with the likeliest" if "separating_experiment" in document else "Next"
        rows += ["", f"{begin}: {command}"]
    return "\n".join(rows)


def next_command(document: Mapping[str, Any]) -> str:
    """The command that adds the likeliest of each group; empty where that is nothing but a channel that is dead."""
    listed = {entry["name"]: entry for entry in document["candidates"]}
    # The name in front of a group stands for all that the recordings cannot tell from it, and may be the less likely.
    addable = [
        [name for name in group if name in listed and listed[name]["gain"] > 0]
        for group in document["groups"]
    ]
    # One that explains nothing from where the others have led was estimated from the beginning, which `add` may not find.
    likeliest = [
        max(names, key=lambda name: (listed[name]["p"] <= SEEN, float(listed[name]["probability"])))
        for names in addable
        if names
    ]
    if not likeliest:
        return ""
    words = [
        "motorlens",
        "add",
        *dict.fromkeys(likeliest),
        "--motor",
        document["motor"],
        *document["options"],
    ]
    # No error falls by what a parameter had made up for.
    force = ["--force"] if document.get("contradicts_file", {}).get("or_missing") else []
    # Of better.toml comes better2.toml: the old file is kept.
    before = re.fullmatch(r"better(\d*)\.toml", Path(document["motor"]).name)
    better = f"better{int(before[1] or 1) + 1}.toml" if before else "better.toml"
    return shlex.join([*words, *force, "--fit", *document["recordings"], "-o", better])


def size_text(entry: Mapping[str, Any]) -> str:
    """The size of a candidate with its deviation and unit; "not seen" where it is within its own uncertainty."""
    if entry["told_together"]:
        return _together(entry["told_together"])
    size = next(iter(entry["parameters"].values()), None)
    if size is None or not np.isfinite(size["sd"]):
        return "not seen"
    if entry["probability"] == 0.0 and (entry["p"] > SEEN or entry["minimum_detectable"] is None):
        return "not seen"
    return f"{size['value']:.3g} +- {size['sd']:.2g} {_unit(size)}".rstrip()


def _together(names: Sequence[str]) -> str:
    """In the place of sizes that recordings tell only together."""
    return f"{', '.join(names)} told only together"


def least_text(entry: Mapping[str, Any]) -> str:
    """The smallest size that would have been seen, with its unit; "no size" where none that it may have would."""
    size = next(iter(entry["parameters"].values()), {"unit": ""})
    least = entry["minimum_detectable"]
    return "no size" if least is None else f"{least:.3g} {_unit(size)}".rstrip()


def _unit(size: Mapping[str, Any]) -> str:
    """As a table has it: a pure number has none."""
    return unit_text(str(size["unit"]))
