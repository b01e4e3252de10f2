"""The diagnosis as one page: verdict sentence, pictures, numbers, how to reproduce it."""

from typing import Any

import numpy as np

from motorlens_workbench.diagnosis import Finding
from motorlens_workbench.evidence import similarity
from motorlens_workbench.model import predict
from motorlens_workbench.report import (
    LACKING,
    MEASURED,
    NOISE,
    PREDICTED,
    Picture,
    Section,
    Table,
    band,
    bars,
    figure,
    line,
    page,
)
from motorlens_workbench.run import UNIT_OF
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


def to_html(found: Finding, verdict: Verdict, document: dict[str, Any], command: str) -> str:
    """The page of `--html`."""
    summary = [*_next_step(document), *document["cannot_tell"]]
    sections = []
    if verdict.shape is not None:
        sections.append(Section("The shape of what is missing", [_shape(verdict)]))
    sections += [
        Section("Measured and predicted", _overlays(found)),
        Section("The error falls", _ladder(document)),
        Section("Candidates", [*_gains(document), _table(document)]),
    ]
    if len(found.first.tests) > 1:
        sections.append(Section("What looks alike", [_alike(found, document)]))
    sections.append(Section("Base parameters", [_parameters(found)]))
    return page(
        f"motorlens diagnose: {document['motor']}", document["sentence"], summary, sections, [command]
    )


def _next_step(document: dict[str, Any]) -> list[str]:
    if "separating_experiment" in document:
        test = document["separating_experiment"]
        return [f"To tell {', '.join(test['separates'])} apart: {test['why']}."]
    if document["chosen"]:
        return [f"Next: motorlens add {document['chosen'][0]}, and diagnose again."]
    return []


def _shape(verdict: Verdict) -> Picture:
    bend = verdict.shape
    assert bend is not None
    traces = band(
        bend.knots,
        bend.value - 1.645 * bend.sd,
        bend.value + 1.645 * bend.sd,
        "90 % band",
        "rgba(194,65,12,0.2)",
    )
    traces.append(line(bend.knots, bend.value, "missing term", LACKING, 2.0))
    drawn = figure(
        traces,
        f"{bend.curve.against}, {UNIT_AGAINST[bend.curve.against]}",
        f"{bend.curve.term}, {bend.curve.unit}",
    )
    return Picture(
        drawn,
        "Added to the right-hand side of its balance, after the base parameters have explained what they can; "
        "what they can imitate (an offset, a slope) is not in it.",
    )


def _overlays(found: Finding) -> list[Picture]:
    pictures = []
    for r, run in enumerate(found.runs):
        time = run.inputs.time_s
        before = predict(found.base.model, run, r)[1]
        after = predict(found.last.found.model, run, r)[1]
        for k, channel in enumerate(run.channels):
            measured = np.where(run.valid, run.measured[:, k], np.nan)
            traces = [
                line(time, measured, "measured", MEASURED),
                line(time, before[:, k], "base model", NOISE),
            ]
            if found.steps:
                traces.append(line(time, after[:, k], "with what was named", PREDICTED))
            traces.append(
                line(time, run.measured[:, k] - before[:, k], "error, base", NOISE, 1.0, yaxis="y2")
            )
            if found.steps:
                traces.append(
                    line(time, run.measured[:, k] - after[:, k], "error, after", LACKING, 1.0, yaxis="y2")
                )
            axes = {"gridcolor": "#eaeef2", "zerolinecolor": "#9aa3af"}
            layout = {
                "xaxis": {**axes, "title": {"text": "time, s"}, "anchor": "y2"},
                "yaxis": {**axes, "title": {"text": f"{channel}, {UNIT_OF[channel]}"}, "domain": [0.36, 1]},
                "yaxis2": {**axes, "title": {"text": "error"}, "domain": [0, 0.28]},
            }
            pictures.append(Picture(figure(traces, "time, s", "", 430, **layout), f"{run.name}: {channel}"))
    return pictures


def _ladder(document: dict[str, Any]) -> list[str | Picture | Table]:
    error = document["error"]
    content: list[str | Picture | Table] = []
    for channel, before in error["before"].items():
        values = [before, error["after"][channel], error["noise_floor"][channel]]
        drawn = figure(
            [bars(["base model", "with what was named", "noise floor"], values, PREDICTED)],
            f"RMSE of {channel}, {UNIT_OF[channel]}", "", 190, margin={"l": 170, "r": 20, "t": 10, "b": 50},
        )  # fmt: skip
        content.append(Picture(drawn))
    content.append(
        "On blocks of time that the parameters were not fitted to, taken from all operating regions."
    )
    return content


def _gains(document: dict[str, Any]) -> list[Picture]:
    shown = [entry for entry in document["candidates"] if entry["gain"] > 0][:SHOWN]
    drawn = figure(
        [bars([entry["name"] for entry in shown], [entry["statistic"] for entry in shown], PREDICTED)],
        "robust statistic (26 counts as real)", "", 60 + 22 * len(shown), margin={"l": 230, "r": 20, "t": 10, "b": 50},
    )  # fmt: skip
    return [
        Picture(
            drawn,
            "What each candidate alone would explain, scatter between blocks of time taken into account.",
        )
    ]


def _table(document: dict[str, Any]) -> Table:
    rows = []
    for entry in document["candidates"]:
        size = next(iter(entry["parameters"].values()), None)
        value = f"{size['value']:.4g} +- {size['sd']:.2g} {size['unit']}" if size else ""
        least = entry["minimum_detectable"]
        rows.append(
            [entry["name"], entry["equation"], entry["gain"], entry["p"], entry["probability"], value,
             "" if least is None else least, entry["why_not"]]
        )  # fmt: skip
    headings = ["candidate", "equation", "gain", "p", "probability", "size", "smallest detectable", ""]
    return Table(
        headings, rows, "Smaller than the smallest detectable size, an effect would not have been seen here."
    )


def _alike(found: Finding, document: dict[str, Any]) -> Picture:
    names = [e["name"] for e in document["candidates"] if e["name"] in found.first.tests][:SHOWN]
    names = [name for name in names if found.first.tests[name].score is not None]
    labels = [
        found.first.tests[name].candidate.columns()[found.first.tests[name].variant][0] for name in names
    ]
    alike = similarity(found.first.left, labels)
    heat = {
        "type": "heatmap", "x": names, "y": names, "z": np.round(alike, 4).tolist(), "zmin": 0, "zmax": 1,
        "colorscale": "Blues",
    }  # fmt: skip
    drawn = figure([heat], "", "", 560, margin={"l": 230, "r": 20, "t": 10, "b": 190})
    return Picture(
        drawn,
        "Squared correlation after the base parameters have taken their share; 1: these recordings cannot tell them apart.",
    )


def _parameters(found: Finding) -> Table:
    file, base, last = found.base.prior.centre, found.base, found.last.found
    spread = last.sd()
    rows = []
    for key in base.prior.keys:
        if "@" in key:
            continue
        rows.append([key, file[key], base.model.values()[key], last.model.values()[key], spread[key]])
    return Table(["parameter", "motor file", "fitted, base", "fitted, after", "standard deviation"], rows)
