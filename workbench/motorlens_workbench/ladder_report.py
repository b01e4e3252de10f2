"""The ladder of held-out error as JSON (schema motorlens.add/1), text and page."""

import math
from typing import Any

from motorlens_workbench.ladder import Ladder
from motorlens_workbench.report import PREDICTED, Picture, Section, Table, bars, figure, page


def to_json(found: Ladder, effect: str, motor: str, written: str | None) -> dict[str, Any]:
    """The document; `written` is the new motor file, None if the data did not support it."""
    last = found.rungs[-1].file
    return {
        "schema": "motorlens.add/1",
        "effect": effect,
        "motor": motor,
        "written": written,
        "supported": found.supported,
        "why_not": found.why,
        "statistic": found.statistic,
        "ladder": [
            {"added": rung.added, "held_out": dict(rung.held_out), "judged": dict(rung.judged)} for rung in found.rungs
        ],
        "noise_floor": dict(found.noise_floor),
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
    before, after = rungs[-2]["held_out"], rungs[-1]["held_out"]
    channel = max(after, key=lambda c: abs(math.log(max(after[c], 1e-300) / max(before[c], 1e-300))))
    change = 100 * (1 - after[channel] / max(before[channel], 1e-300))
    verb = "lower" if change >= 0 else "higher"
    return f"The error of {channel} on data held out is {abs(change):.1f} % {verb}; written to {document['written']}."


def to_text(document: dict[str, Any]) -> str:
    """What the terminal shows."""
    rows = [sentence(document), ""]
    channels = list(document["noise_floor"])
    judged = bool(document["ladder"][-1]["judged"])
    heading = f"{'model':<34}" + "".join(f"{c:>14}" for c in channels)
    rows.append(heading + ("   on recordings not fitted: " + ", ".join(channels) if judged else ""))
    for rung in document["ladder"]:
        label = (
            ("+ " + rung["added"])
            if rung["added"] and not rung["added"].startswith("without")
            else rung["added"]
        )
        line = f"{label or 'textbook':<34}" + "".join(
            f"{rung['held_out'].get(c, float('nan')):>14.4g}" for c in channels
        )
        rows.append(
            line
            + (
                "   " + ", ".join(f"{rung['judged'].get(c, float('nan')):.4g}" for c in channels)
                if judged
                else ""
            )
        )
    rows.append(f"{'noise floor':<34}" + "".join(f"{document['noise_floor'][c]:>14.4g}" for c in channels))
    rows += ["", f"{'parameter':<34}{'value':>14}{'sd':>12}"]
    for key, entry in document["parameters"].items():
        spread = f"{entry['sd']:>12.2g}" if entry["sd"] is not None else " " * 12
        rows.append(f"{key:<34}{entry['value']:>14.5g}{spread} {entry['unit']}")
    return "\n".join(rows)


def to_html(document: dict[str, Any], command: str) -> str:
    """The page of `--html`."""
    channels = list(document["noise_floor"])
    names = [rung["added"] or "textbook" for rung in document["ladder"]] + ["noise floor"]
    pictures = []
    for c in channels:
        values = [*(rung["held_out"].get(c, 0.0) for rung in document["ladder"]), document["noise_floor"][c]]
        drawn = figure(
            [bars(names, values, PREDICTED)], f"RMSE of {c} on blocks of time held out", "", 90 + 34 * len(names),
            margin={"l": 190, "r": 20, "t": 10, "b": 45},
        )  # fmt: skip
        pictures.append(Picture(drawn))
    rows = [
        [key, entry["value"], entry["sd"] or "", entry["unit"]]
        for key, entry in document["parameters"].items()
    ]
    sections: list[Section] = [Section("The error falls", pictures)]
    if document["ladder"][-1]["judged"]:
        judged = [
            [r["added"] or "textbook", *(r["judged"].get(c, float("nan")) for c in channels)]
            for r in document["ladder"]
        ]
        sections.append(Section("On recordings that were not fitted", [Table(["model", *channels], judged)]))
    sections.append(
        Section("Parameters", [Table(["parameter", "value", "standard deviation", "unit"], rows)])
    )
    return page(f"motorlens add {document['effect']}", sentence(document), [], sections, [command])
