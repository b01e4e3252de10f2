"""The ladder of held-out error as JSON (schema motorlens.add/1), text and page."""

import math
from collections.abc import Sequence
from typing import Any

from motorlens_physics.estimate.free_run import free_runs
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.run import UNIT_OF
from motorlens_physics.recording import Recording
from motorlens_workbench.ladder import Ladder
from motorlens_workbench.report.json import risen
from motorlens_workbench.report.overlay import overlay
from motorlens_workbench.report.page import Page, Section, unit_text
from motorlens_workbench.report.pictures import Bar, Bars, Grid, Plot, Table


def to_json(found: Ladder, effects: Sequence[str], motor: str, written: str | None) -> dict[str, Any]:
    """The document; `written` is the new motor file, None if the data did not support it."""
    last = found.rungs[-1].file
    return {
        "schema": "motorlens.add/1",
        "effect": " and ".join(effects),
        "effects": list(effects),
        "motor": motor,
        "written": written,
        "supported": found.supported,
        "why_not": found.why,
        "statistic": found.statistic,
        "new": found.new,
        "ladder": [
            {"added": rung.added, "held_out": dict(rung.held_out), "judged": dict(rung.judged)} for rung in found.rungs
        ],
        "noise_floor": dict(found.noise_floor),
        "said": list(found.rungs[-1].said),
        "parameters": {
            key: {
                "value": value,
                "sd": last.knowledge[key].sd if key in last.knowledge else None,
                "unit": last.meaning(key).unit,
            }
            for key, value in last.values().items()
        },
    }  # fmt: skip


def sentence(document: dict[str, Any]) -> str:
    """What came of it."""
    name = document["effect"].replace("_", " ")
    rungs = document["ladder"]
    if not document["supported"]:
        end = (
            f"; written to {document['written']} all the same"
            if document["written"]
            else "; nothing was written"
        )
        return f"The data do not support {name}: {document['why_not']}{end}."
    before, after = rungs[-1 - document["new"]]["held_out"], rungs[-1]["held_out"]
    channel = max(after, key=lambda c: abs(math.log(max(after[c], 1e-300) / max(before[c], 1e-300))))
    said = f"The error of {channel} on data held out is {_change(before[channel], after[channel])}"
    was, now = rungs[-1 - document["new"]]["judged"], rungs[-1]["judged"]
    if channel in now:
        but = "and" if (after[channel] > before[channel]) == (now[channel] > was[channel]) else "but"
        said += f", {but} {_change(was[channel], now[channel])} on recordings not fitted"
    return f"{said}; written to {document['written']}."


def _change(before: float, after: float) -> str:
    change = 100 * (1 - after / max(before, 1e-300))
    return f"{abs(change):.1f} % {'lower' if change >= 0 else 'higher'}"


def to_text(document: dict[str, Any]) -> str:
    """What the terminal shows."""
    rows = [sentence(document), "", "Error, rms, on blocks of time that the parameters were not fitted to:"]
    channels = list(document["noise_floor"])
    judged = bool(document["ladder"][-1]["judged"])
    heading = f"{'model':<34}" + "".join(f"{c + ', ' + UNIT_OF.get(c, ''):>20}" for c in channels)
    rows.append(heading + ("   on recordings not fitted: " + ", ".join(channels) if judged else ""))
    for rung in document["ladder"]:
        label = (
            ("+ " + rung["added"])
            if rung["added"] and not rung["added"].startswith("without")
            else rung["added"]
        )
        line = f"{label or 'textbook':<34}" + "".join(
            f"{rung['held_out'].get(c, float('nan')):>20.4g}" for c in channels
        )
        rows.append(
            line
            + (
                "   " + ", ".join(f"{rung['judged'].get(c, float('nan')):.4g}" for c in channels)
                if judged
                else ""
            )
        )
    rows.append(f"{'noise floor':<34}" + "".join(f"{document['noise_floor'][c]:>20.4g}" for c in channels))
    rows += _risen(document)
    rows += ["", f"{'parameter':<34}{'value':>14}{'sd':>12}"]
    for key, entry in document["parameters"].items():
        spread = f"{entry['sd']:>12.2g}" if entry["sd"] is not None else " " * 12
        rows.append(f"{key:<34}{entry['value']:>14.5g}{spread} {unit_text(entry['unit'])}".rstrip())
    return "\n".join([*rows, "", *document["said"]] if document["said"] else rows)


def to_html(document: dict[str, Any], command: str, overlays: Sequence[Plot] = ()) -> Page:
    """The page of `--html`.

    Args:
        document: see `to_json`.
        command: to get it again.
        overlays: before and after, see `before_and_after`.
    """
    channels = list(document["noise_floor"])
    rungs = document["ladder"]
    bars: list[str | Table | Bars | Grid | Plot] = []
    for c in channels:
        rows = [Bar(_label(rung["added"]), rung["held_out"].get(c, math.nan)) for rung in rungs]
        rows.append(Bar("noise floor", document["noise_floor"][c], "noise"))
        bars.append(Bars(f"Error of {c}, rms", UNIT_OF.get(c, ""), rows))
    bars += _risen(document)
    bars.append("On blocks of time that the parameters were not fitted to, taken from all operating regions.")
    rows_ = [
        [key, e["value"], "" if e["sd"] is None else e["sd"], unit_text(e["unit"])]
        for key, e in document["parameters"].items()
    ]
    sections = [Section("The error falls" if document["supported"] else "The error", bars)]
    if overlays:
        sections.append(Section("Before and after", list(overlays)))
    if rungs[-1]["judged"]:
        judged = [[_label(r["added"]), *(r["judged"].get(c, math.nan) for c in channels)] for r in rungs]
        headings = ["model", *(f"{c}, {UNIT_OF.get(c, '')}" for c in channels)]
        caption = "Run freely from the first samples, rms."
        sections.append(Section("On recordings that were not fitted", [Table(headings, judged, caption)]))
    parameters = Table(["parameter", "value", "standard deviation", "unit"], rows_)
    sections.append(Section("Parameters", [parameters, *document["said"]]))
    return Page(f"motorlens add {document['effect']}", sentence(document), [], sections, [command])


def before_and_after(found: Ladder, recordings: Sequence[Recording]) -> list[Plot]:
    """Free runs of the models of the ladder before and after this step beside each recording.

    Raises:
        ModelError: one of them cannot be simulated on a recording.
    """
    if not found.new:
        return []
    before, after = found.rungs[-1 - found.new].file, found.rungs[-1].file
    files = {"before": ("lacking", before), "after": ("predicted", after)}
    plots = []
    for recording in recordings:
        predicted = {}
        for name, (role, file) in files.items():
            beside = free_runs(file, prepare_all([recording], file))[1][0]
            predicted[name] = (role, beside.predicted)
        plots.append(overlay(beside.run, beside.trajectory, predicted, found.noise_floor))
    return plots


def _risen(document: dict[str, Any]) -> list[str]:
    rungs = document["ladder"]
    # Without an effect the error rises, and nobody wonders.
    if not document["new"] or rungs[-1]["added"].startswith("without"):
        return []
    return risen(rungs[-1 - document["new"]]["held_out"], rungs[-1]["held_out"])


def _label(added: str) -> str:
    if not added:
        return "textbook"
    return added.replace("_", " ") if added.startswith("without") else "+ " + added.replace("_", " ")
