"""One self-contained page: verdict first, then pictures, then numbers, then how to reproduce it. Opens without a network.

Pictures are plotly figures, so that a reader can zoom and hover; the library stands once in the page. Long series are
thinned to what a screen can show, keeping every extreme.
"""

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.web import style

Array = NDArray[np.float64]

# Points a series may have in a picture: twice what a wide screen has pixels.
SHOWN = 4000
MEASURED, PREDICTED, LACKING, NOISE = "#555b66", "#1f5fa8", "#c2410c", "#9aa3af"
AXIS, ZERO, CLEAR = "#eaeef2", "#d8dee4", "rgba(0,0,0,0)"

# What these colours, and those of the axes, become on a dark screen; the same as in the style sheet.
_DARK = {
    MEASURED: "#b4bcc6", PREDICTED: "#6cabf0", LACKING: "#f08a4b", NOISE: "#6b7480", AXIS: "#262c33", ZERO: "#3a424c",
}  # fmt: skip
# Pictures are drawn for the screen as it is, and again when the reader turns it light or dark.
_DRAW = """
const dark = matchMedia("(prefers-color-scheme: dark)"), pictures = [];
function draw(name, figure) {
  const colours = %s;
  const shown = dark.matches
    ? JSON.parse(JSON.stringify(figure).replace(/#[0-9a-f]{6}/g, c => colours[c] || c))
    : structuredClone(figure);
  shown.layout.font = {color: getComputedStyle(document.body).color};
  for (const trace of shown.data)
    if (dark.matches && typeof trace.colorscale === "string") trace.colorscale = [[0, "#1d2228"], [1, "#6cabf0"]];
  Plotly.react(name, shown.data, shown.layout, {responsive: true, displaylogo: false});
}
function picture(name, figure) { pictures.push([name, figure]); draw(name, figure); }
dark.addEventListener("change", () => pictures.forEach(p => draw(...p)));
"""


@dataclass(frozen=True)
class Picture:
    """A plotly figure as plain data, and the sentence under it."""

    figure: Mapping[str, Any]
    caption: str = ""


@dataclass(frozen=True)
class Table:
    """A table; numbers are shown with four significant digits."""

    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it: paragraphs, pictures and tables in their order."""

    heading: str
    content: Sequence[str | Picture | Table]


def page(
    title: str, verdict: str, summary: Sequence[str], sections: Sequence[Section], commands: Sequence[str]
) -> str:
    """The whole page as HTML.

    Args:
        title: a small line above the verdict.
        verdict: the one sentence that matters.
        summary: what follows from it, a paragraph each.
        sections: pictures and numbers.
        commands: what to type to get this page again.
    """
    from plotly.offline import get_plotlyjs

    body = [f"<h1>{_text(title)}</h1>", f'<p class="verdict">{_text(verdict)}</p>']
    body += [f"<p>{_text(paragraph)}</p>" for paragraph in summary]
    number = 0
    for section in sections:
        body.append(f"<h2>{_text(section.heading)}</h2>")
        for item in section.content:
            if isinstance(item, Picture):
                number += 1
                body.append(_picture(item, f"picture{number}"))
            elif isinstance(item, Table):
                body.append(_table(item))
            else:
                body.append(f"<p>{_text(item)}</p>")
    body += ["<h2>To reproduce</h2>", f"<pre>{_text(chr(10).join(commands))}</pre>"]
    body.append(f'<p class="note">motorlens {version("motorlens")}</p>')
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{_text(title)}</title><style>{style()}</style><script>{get_plotlyjs()}</script>"
        f"<script>{_DRAW % json.dumps(_DARK)}</script></head>\n"
        f"<body>{chr(10).join(body)}</body></html>\n"
    )


def thinned(x: Array, y: Array, points: int = SHOWN) -> tuple[list[float | None], list[float | None]]:
    """At most `points` of a series, the lowest and the highest of each stretch: no spike is lost. NaN becomes a gap."""
    if len(x) > points:
        stretches = points // 2
        edges = np.linspace(0, len(x), stretches + 1).astype(int)
        keep = []
        for start, stop in pairwise(edges):
            part = y[start:stop]
            if np.isnan(part).all():
                keep.append(start)
                continue
            keep += sorted({start + int(np.nanargmin(part)), start + int(np.nanargmax(part))})
        x, y = x[keep], y[keep]
    return _rounded(x), _rounded(y)


def line(x: Array, y: Array, name: str, color: str, width: float = 1.3, **more: Any) -> dict[str, Any]:
    """A series as a plotly trace, thinned."""
    shown_x, shown_y = thinned(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
    return {
        "type": "scatter", "mode": "lines", "x": shown_x, "y": shown_y, "name": name,
        "line": {"color": color, "width": width}, **more,
    }  # fmt: skip


def band(x: Array, low: Array, high: Array, name: str, color: str) -> list[dict[str, Any]]:
    """A shaded band as two plotly traces."""
    edge = {"line": {"width": 0}, "hoverinfo": "skip", "mode": "lines", "type": "scatter"}
    return [
        {**edge, "x": _rounded(x), "y": _rounded(high), "showlegend": False},
        {**edge, "x": _rounded(x), "y": _rounded(low), "fill": "tonexty", "fillcolor": color, "name": name},
    ]


def bars(names: Sequence[str], values: Sequence[float], color: str, **more: Any) -> dict[str, Any]:
    """Horizontal bars, the first on top."""
    return {
        "type": "bar", "orientation": "h", "y": list(names)[::-1], "x": [_number(v) for v in values][::-1],
        "marker": {"color": color}, **more,
    }  # fmt: skip


def figure(
    traces: Sequence[Mapping[str, Any]], x: str, y: str, height: int = 320, **layout: Any
) -> dict[str, Any]:
    """A plotly figure with titled axes; further layout keys as plotly has them."""
    axes = {"gridcolor": AXIS, "zerolinecolor": ZERO}
    standard = {
        "height": height, "margin": {"l": 70, "r": 20, "t": 20, "b": 50}, "plot_bgcolor": CLEAR, "paper_bgcolor": CLEAR,
        "modebar": {"bgcolor": CLEAR},
        "xaxis": {**axes, "title": {"text": x}}, "yaxis": {**axes, "title": {"text": y}},
        "legend": {"orientation": "h", "y": 1.12}, "hovermode": "closest",
    }  # fmt: skip
    return {"data": list(traces), "layout": {**standard, **layout}}


def significant(value: Any) -> str:
    """A number with four significant digits, anything else as it is."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        return str(value)
    return f"{value:d}" if isinstance(value, int | np.integer) else f"{value:.4g}"


def _picture(item: Picture, name: str) -> str:
    # "</" inside a script would end it.
    data = json.dumps(item.figure, allow_nan=False).replace("</", "<\\/")
    caption = f'<p class="note">{_text(item.caption)}</p>' if item.caption else ""
    return f'<div id="{name}"></div><script>picture("{name}", {data});</script>{caption}'


def _table(item: Table) -> str:
    head = "".join(f"<th>{_text(heading)}</th>" for heading in item.headings)
    rows = "".join(
        "<tr>" + "".join(f"<td>{_text(significant(cell))}</td>" for cell in row) + "</tr>"
        for row in item.rows
    )
    caption = f'<p class="note">{_text(item.caption)}</p>' if item.caption else ""
    return f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>{caption}"


def _rounded(values: Array) -> list[float | None]:
    return [_number(value) for value in values]


def _number(value: float) -> float | None:
    return float(f"{value:.6g}") if np.isfinite(value) else None


def _text(text: str) -> str:
    return html.escape(text, quote=False)
