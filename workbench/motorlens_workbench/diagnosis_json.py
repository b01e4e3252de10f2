"""The diagnosis as JSON (schema motorlens.diagnose/1) and as text."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from motorlens_workbench.bend import Free
from motorlens_workbench.changes import Change
from motorlens_workbench.contacts import Spells
from motorlens_workbench.dead_channels import DeadChannel
from motorlens_workbench.diagnosis import Finding
from motorlens_workbench.experiments import Experiment
from motorlens_workbench.lasting import Lasting
from motorlens_workbench.look import held_out, noise_floor
from motorlens_workbench.selection import Test
from motorlens_workbench.variation import Variation
from motorlens_workbench.verdict import Verdict, sizes

SHOWN = 12


def to_json(
    found: Finding, verdict: Verdict, experiment: Experiment | None, recordings: Sequence[str], motor: str
) -> dict[str, Any]:
    """The document of DESIGN.md, `motorlens.diagnose/1`."""
    document: dict[str, Any] = {
        "schema": "motorlens.diagnose/1",
        "motor": motor,
        "recordings": list(recordings),
        "verdict": verdict.kind,
        "sentence": sentence(found, verdict),
        "chosen": list(verdict.chosen),
        "groups": [list(group) for group in verdict.groups],
        "equation": verdict.equation,
        "candidates": [
            *(_dead(one) for one in found.dead),
            *(_candidate(found, verdict, name) for name in ranked(found, verdict)),
        ],
        "error": errors(found),
        "cannot_tell": list(verdict.untold),
    }
    if experiment is not None:
        document["separating_experiment"] = {
            "test": experiment.test, "separates": list(experiment.separates), "seconds": experiment.seconds,
            "why": experiment.why, "with_sensor": experiment.with_sensor, "bare": experiment.bare,
            "check": list(experiment.check),
        }  # fmt: skip
    if verdict.shape is not None:
        bend = verdict.shape
        document["unknown_shape"] = {
            "term": bend.curve.term, "against": bend.curve.against, "unit": bend.curve.unit,
            "x": bend.knots.tolist(), "y": bend.value.tolist(), "sd": bend.sd.tolist(),
        }  # fmt: skip
    return document


def ranked(found: Finding, verdict: Verdict) -> list[str]:
    """Candidates, the accepted first, then by probability and by what the first screen says."""
    first = {**found.last.tests, **found.first.tests}
    return sorted(
        first.keys() - {one.name for one in found.dead},
        key=lambda name: (
            name not in verdict.chosen,
            -verdict.probability.get(name, 0.0),
            -first[name].statistic,
        ),
    )


def errors(found: Finding) -> dict[str, Any]:
    """Held-out RMSE of each channel before and after, and the noise floor."""
    before = held_out(found.first, found.runs)
    after = held_out(found.last, found.runs) if found.steps else before
    return {
        "before": before,
        "after": after,
        "noise_floor": noise_floor(found.last, found.runs),
        "held_out": True,
    }


def _dead(one: DeadChannel) -> dict[str, Any]:
    return {
        "name": one.name, "kind": "sensor", "equation": one.channel, "gain": 0.0, "statistic": 0.0, "p": 0.0,
        "probability": 0.99, "parameters": {"gain": {"value": one.gain, "sd": one.sd, "unit": "1"}},
        "minimum_detectable": None, "why_not": "",
    }  # fmt: skip


def _candidate(found: Finding, verdict: Verdict, name: str) -> dict[str, Any]:
    test: Test = found.first.tests.get(name) or found.last.tests[name]
    score = test.score
    late = found.last.tests.get(name, test)
    detectable = (
        late.detectable(found.last.samples)
        if name not in verdict.chosen
        else test.detectable(found.first.samples)
    )
    entry: dict[str, Any] = {
        "name": name,
        "kind": test.candidate.kind,
        "equation": test.candidate.equation,
        "gain": score.gain if score else 0.0,
        "statistic": test.statistic,
        "p": score.p if score else 1.0,
        "probability": verdict.probability.get(name, 0.0),
        "parameters": sizes(found, name),
        "minimum_detectable": detectable if np.isfinite(detectable) else None,
        "why_not": "" if score else "a copy of what the base parameters already do",
    }
    if score is not None and not test.allowed:
        at_rest = abs(test.size) > test.candidate.most
        entry["why_not"] = (
            "its sensor shows exactly zero at rest"
            if at_rest
            else "the wrong sign: it would stand for something else"
        )
    for step in found.steps:
        fit = step.found if step.test.candidate.name == name else step.refits.get(name)
        if fit is not None:
            entry["confirmed_rmse"] = _rmse(found, [e for e in fit.residuals])
    return entry


def _rmse(found: Finding, residuals: Sequence[Any]) -> dict[str, float]:
    pooled: dict[str, list[Any]] = {}
    for residual, run in zip(residuals, found.runs, strict=True):
        good = residual[run.fresh()]
        for c, channel in enumerate(run.channels):
            pooled.setdefault(channel, []).append(good[:, c])
    return {channel: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for channel, parts in pooled.items()}


def sentence(found: Finding, verdict: Verdict) -> str:
    """The verdict in one sentence."""
    words = {name: name.replace("_", " ") for name in found.first.tests}
    said = [f"{words.get(name, name.replace('_', ' '))}{_size(found, name)}" for name in verdict.chosen]
    if found.dead:
        dead = [f"{one.channel} sensor of {one.recording} ({one.state})" for one in found.dead]
        faults = {one.name for one in found.dead}
        others = [
            " or ".join(words.get(one, one) for one in group)
            for group in verdict.groups
            if group[0] not in faults
        ]
        beside = f". Missing beside: {'; and '.join(others)}" if others else ""
        return f"At fault: {' and '.join(dead)}{beside}."
    if verdict.kind in ("named", "sensor_fault"):
        what = "Missing" if verdict.kind == "named" else "At fault"
        return f"{what}: {' and '.join(said)}."
    if verdict.kind == "group":
        parts = []
        for group in verdict.groups:
            names = [words.get(name, name) for name in group]
            parts.append(names[0] if len(names) == 1 else f"one of {', '.join(names[:-1])} or {names[-1]}")
        return f"Missing: {'; and '.join(parts)}. These recordings cannot tell more."
    if verdict.kind == "unknown":
        assert verdict.shape is not None
        return (
            f"Something is missing in the {verdict.equation} equation that is in no catalogue; "
            f"{_shape(verdict.shape.curve)}."
        )
    if verdict.kind == "not_testable":
        return "These recordings cannot show whether anything is missing; why is among what they cannot tell."
    return "Nothing is missing above the sizes listed: larger effects would have been seen."


def _shape(curve: Free) -> str:
    if isinstance(curve, Lasting):
        return f"it follows the past of the {curve.past} and is shown against the frequency of that, in {curve.unit}"
    if isinstance(curve, Change):
        return f"{curve.parameter} changes at once, by {100 * curve.by:+.2g} %, at {curve.at_s:.4g} s of {curve.run}"
    if isinstance(curve, Spells):
        return (
            f"{curve.parameter} comes and goes as with a loose contact: some {curve.by:.2g} {curve.unit} more for "
            f"{100 * curve.share:.0f} % of the time, most in {curve.run}"
        )
    if isinstance(curve, Variation):
        return f"{curve.parameter} is no constant but changes with {curve.against}, in {curve.unit}"
    return f"it is shown against {curve.against}, in {curve.unit}"


def _size(found: Finding, name: str) -> str:
    for key, value in sizes(found, name).items():
        return f" ({key} = {value['value']:.4g} +- {value['sd']:.2g} {value['unit']})"
    return ""


def to_text(document: dict[str, Any]) -> str:
    """What the terminal shows."""
    rows = [document["sentence"], ""]
    error = document["error"]
    rows.append(f"{'channel':<14}{'before':>12}{'after':>12}{'noise':>12}   RMSE on blocks of time held out")
    for channel, before in error["before"].items():
        rows.append(
            f"{channel:<14}{before:>12.4g}{error['after'][channel]:>12.4g}{error['noise_floor'][channel]:>12.4g}"
        )
    rows += ["", f"{'candidate':<34}{'gain':>10}{'p':>10}{'probability':>13}{'size':>12}{'detectable':>12}"]
    for entry in document["candidates"][:SHOWN]:
        size = next(iter(entry["parameters"].values()), {"value": float("nan"), "unit": ""})
        least = entry["minimum_detectable"]
        rows.append(
            f"{entry['name']:<34}{entry['gain']:>10.4g}{entry['p']:>10.1e}{entry['probability']:>13.2f}"
            f"{size['value']:>12.4g}{least if least is not None else float('nan'):>12.3g} {size['unit']}"
        )
    if document["cannot_tell"]:
        rows += ["", *document["cannot_tell"]]
    if "separating_experiment" in document:
        test = document["separating_experiment"]
        rows += ["", f"To tell {', '.join(test['separates'])} apart: {test['why']}"]
    return "\n".join(rows)
