"""The diagnosis as one page: verdict sentence, pictures, numbers, how to reproduce it."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from motorlens_physics.estimate.model import predict
from motorlens_physics.estimate.run import UNIT_OF
from motorlens_workbench.diagnose import Finding
from motorlens_workbench.evidence.ledger import common
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.unmeasured_torque import UnmeasuredTorque
from motorlens_workbench.hypotheses.changes import Change
from motorlens_workbench.hypotheses.courses import Course
from motorlens_workbench.report.json import course, least_text, next_command, risen, size_text
from motorlens_workbench.report.overlay import overlay
from motorlens_workbench.report.page import Page, Section, significant, unit_text
from motorlens_workbench.report.pictures import Bar, Bars, Cell, Fact, Grid, Plot, Table, curves
from motorlens_workbench.verdict import Verdict

UNIT_AGAINST = {
    "speed": "rad/s",
    "current": "A",
    "temperature": "K above ambient",
    "time": "s",
    "angle": "rad",
    "frequency": "Hz",
    "travel": "rad since the last reversal",
}
# As many candidates as fit into a picture.
SHOWN = 16
# Squared correlations at which the next colour of the map of what looks alike begins.
BORDERS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 0.95, 0.99)

Content = list[str | Table | Bars | Grid | Plot]


def to_html(found: Finding, verdict: Verdict, document: dict[str, Any], command: str) -> Page:
    """The page of `--html`."""
    summary = [*_next_step(document), *document["cannot_tell"]]
    sections = []
    if verdict.torque is not None or verdict.shape is not None:
        sections.append(Section("The shape of what is missing", [_shape(verdict)]))
    sections += [
        Section("Measured and predicted", _overlays(found, document)),
        Section("The error falls", _ladder(document)),
        Section("Candidates", [*_gains(document), _table(document)]),
    ]
    if len(document["candidates"]) > 1:
        sections.append(Section("What looks alike", [_alike(found, document)]))
    sections.append(Section("Base parameters", [_parameters(found)]))
    title = f"motorlens diagnose: {document['motor']}"
    return Page(title, document["sentence"], summary, sections, [command], facts=_facts(document))


def _facts(document: dict[str, Any]) -> list[Fact]:
    """How sure each name is, and how far the error falls with what was named."""
    probability = {entry["name"]: entry["probability"] for entry in document["candidates"]}
    facts = []
    for group in document["groups"]:
        told = [f"{name.replace('_', ' ')} {100 * probability.get(name, 0.0):.0f} %" for name in group]
        facts.append(Fact("Probability", ", ".join(told)))
    error = document["error"]
    falls = [
        f"{channel} {significant(before, 3)} to {significant(error['after'][channel], 3)} {unit_text(UNIT_OF[channel])} "
        f"(noise floor {significant(error['noise_floor'][channel], 3)})"
        for channel, before in error["before"].items()
    ]
    return [*facts, Fact("Error held out, rms", ", ".join(falls))]


def _next_step(document: dict[str, Any]) -> list[str]:
    told = []
    if "separating_experiment" in document:
        told.append(f"{document['separating_experiment']['sentence']}.")
    if command := next_command(document):
        # The command comes last, to be copied as it stands.
        begin = "To go on with the likeliest" if told else "Next"
        told.append(f"{begin}, and then to diagnose again: {command}")
    return told


def _shape(verdict: Verdict) -> Plot:
    shape, x, y, sd = course(verdict)
    caption = (
        "Added to the right-hand side of its balance, after the base parameters have explained what they can; what they can "
        "imitate (an offset, a slope) is not in it. Shaded: the 90 % band."
    )
    label, line = f"{shape.term}, {shape.unit}", "missing term"
    if isinstance(shape, UnmeasuredTorque):
        caption = "What drove the shaft beside the motor, as the smoother of its errors has it. Shaded: the 90 % band."
    if isinstance(shape, Course | Change):
        label, line = f"change of {label}", "change"
        caption = "How far the parameter is from the constant that fits best. Shaded: the 90 % band."
    return curves(
        f"{shape.against}, {UNIT_AGAINST[shape.against]}", label, x,
        {line: ("lacking", y)}, band=(y - 1.645 * sd, y + 1.645 * sd), caption=caption,
    )  # fmt: skip


def _overlays(found: Finding, document: dict[str, Any]) -> Content:
    plots: Content = []
    # One recording is drawn, so both models stand beside it as the last one has its clock.
    remark = "Delays between channels are those found with what was named." if found.outcome.accepted else ""
    for r, run in enumerate(found.runs):
        run = replace(run, corrections=None)
        trajectory, before = predict(found.base.fit.model, run, r)
        predicted = {"base model": ("lacking", before)}
        if found.outcome.accepted:
            predicted["with what was named"] = (
                "predicted",
                predict(found.outcome.last.fitted.model, run, r)[1],
            )
        plots.append(overlay(run, trajectory, predicted, document["error"]["noise_floor"], remark=remark))
    return plots


def _ladder(document: dict[str, Any]) -> Content:
    error = document["error"]
    content: Content = []
    for channel, before in error["before"].items():
        rows = [Bar("base model", before, "lacking"), Bar("with what was named", error["after"][channel])]
        rows.append(Bar("noise floor", error["noise_floor"][channel], "noise"))
        content.append(Bars(f"Error of {channel}, rms", UNIT_OF[channel], rows))
    content += risen(error["before"], error["after"])
    content.append(
        "On blocks of time that the parameters were not fitted to, taken from all operating regions."
    )
    return content


def _gains(document: dict[str, Any]) -> Content:
    shown = [entry for entry in document["candidates"] if entry["gain"] > 0][:SHOWN]
    if not shown:
        return []
    bars = [Bar(entry["name"].replace("_", " "), entry["statistic"]) for entry in shown]
    needed = document["criteria"]["needed"]
    caption = "What each alone explains: minus the logarithm of the probability of as much by chance."
    title = "Weight of the evidence" + (f" ({needed:.3g} is beyond chance here)" if needed else "")
    return [Bars(title, "", bars, caption)]


def _table(document: dict[str, Any]) -> Table:
    entries = document["candidates"]
    rows = []
    for entry in entries:
        rows.append(
            [entry["name"].replace("_", " "), entry["equation"].replace("_", " "), _chance(entry["p"]),
             _probability(entry), size_text(entry), least_text(entry), entry["why_not"]]
        )  # fmt: skip
    headings = ["candidate", "equation", "p", "probability", "size", "would have been seen from", "note"]
    top = max((_weight(entry) for entry in entries), default=0.0)
    # All that share the first place, not whichever happens to be listed first.
    strong = [
        k
        for k, entry in enumerate(entries)
        if entry["name"] in document["chosen"]
        or (
            top > 0
            and any(entry["name"] in group for group in document["groups"])
            and _weight(entry) > 0.9 * top
        )
    ]
    return Table(
        headings, rows, "Smaller than what is detectable, an effect would not have been seen here.",
        [entry["name"] for entry in entries], strong,
    )  # fmt: skip


def _weight(entry: dict[str, Any]) -> float:
    return float(entry["probability"] or 0.0)


def _chance(p: float | None) -> str:
    return "" if p is None else (f"{p:.2g}" if p >= 1e-3 else f"{p:.0e}")


def _probability(entry: dict[str, Any]) -> str:
    return "" if entry["probability"] is None else f"{entry['probability']:.2f}"


def _alike(found: Finding, document: dict[str, Any]) -> Grid:
    first = found.outcome.first
    best = best_of(first.scores)
    names = [e["name"] for e in document["candidates"] if e["name"] in best][:SHOWN]
    shapes = [best[name].entry.shape for name in names]
    noises = [run.noise for run in first.fitted.runs if run.noise is not None]
    alike = _similarity(common(first.lines, noises, first.fitted.prior, shapes), len(first.book.keys), shapes)
    last = len(names) - 1
    cells = [
        Cell(column, last - row, float(alike[row, column]), f"{names[row]} and {names[column]}: {alike[row, column]:.3f}")
        for row in range(len(names))
        for column in range(row + 1)
    ]  # fmt: skip
    shown = [name.replace("_", " ") for name in names]
    numbers = [str(k + 1) for k in range(len(names))]
    return Grid(
        "the same by their numbers (to the right)", "candidates (downwards)", numbers,
        [f"{k + 1} {name}" for k, name in enumerate(shown)][::-1], cells, BORDERS,
        "Squared correlation after the base parameters have taken their share:",
        "1: these recordings cannot tell the two apart.",
    )  # fmt: skip


def _similarity(gram: np.ndarray, count: int, shapes: Sequence[Any]) -> np.ndarray:
    """Squared correlation of the first columns of shapes, once `count` fitted parameters have explained what they can."""
    base = np.arange(count)
    at = count + np.cumsum([0, *(shape.width for shape in shapes[:-1])])
    own = gram[np.ix_(base, base)] + np.eye(count)
    left = gram[np.ix_(at, at)] - gram[np.ix_(at, base)] @ np.linalg.solve(own, gram[np.ix_(base, at)])
    scale = np.sqrt(np.maximum(np.diagonal(left), 1e-300))
    return np.asarray((left / np.outer(scale, scale)) ** 2)


def _parameters(found: Finding) -> Table:
    base, last = found.base.fit, found.outcome.last.fitted
    spread = dict(zip(last.prior.keys, np.sqrt(np.maximum(np.diagonal(last.covariance), 0)), strict=True))
    rows = []
    for key in base.prior.keys:
        if "@" in key:
            continue
        rows.append(
            [
                key,
                base.prior.centre[key],
                base.model.values()[key],
                last.model.values()[key],
                float(spread[key]),
                unit_text(base.model.file.meaning(key).unit),
            ]
        )
    return Table(
        ["parameter", "motor file", "fitted, base", "fitted, after", "standard deviation", "unit"], rows
    )
