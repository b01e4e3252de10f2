"""One self-contained page: verdict first, then pictures, then numbers, then how to reproduce it. Opens without a network."""

import html
import json
import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_runtime.web import asset, style
from motorlens_workbench.report.pictures import Bars, Fact, Grid, Plot, Samples, Table, packed
from motorlens_workbench.report.thinning import BUDGET_OCTETS, within

SCRIPTS = (
    ("motorlens_runtime.web.uplot", "uPlot.iife.min.js"),
    ("motorlens_workbench.report", "curves.js"),
    ("motorlens_workbench.report", "time_plots.js"),
    ("motorlens_workbench.report", "plots.js"),
)
# Paragraphs above the pictures.
SHOWN = 3
STYLES = (("motorlens_runtime.web.uplot", "uPlot.min.css"), ("motorlens_workbench.report", "report.css"))


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it, in its order; a string is a paragraph."""

    heading: str
    content: Sequence[str | Table | Bars | Grid | Plot]


@dataclass(frozen=True)
class Page:
    """The whole page; iterating gives it as HTML, piece by piece.

    Attributes:
        title: a small line above the verdict.
        verdict: the one sentence that matters.
        facts: what a reader wants to know first.
        summary: what follows from it, a paragraph each, the first `SHOWN` in sight.
        sections: pictures and numbers.
        commands: what to type to get this page again.
        budget_octets: what the samples of its plots may take, see `thinning`.
    """

    title: str
    verdict: str
    summary: Sequence[str]
    sections: Sequence[Section]
    commands: Sequence[str]
    budget_octets: float = BUDGET_OCTETS
    facts: Sequence[Fact] = ()

    def __iter__(self) -> Iterator[str]:
        yield '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
        yield f"<title>{_text(self.title)}</title><style>{style()}"
        yield from (asset(*name).decode() for name in STYLES)
        yield f'</style></head>\n<body><main class="report"><h1>{_text(self.title)}</h1>\n'
        yield f'<p class="verdict">{_text(self.verdict)}</p>\n'
        yield from _facts(self.facts)
        yield from _paragraphs(self.summary)
        plots = within(
            [item for s in self.sections for item in s.content if isinstance(item, Plot)], self.budget_octets
        )
        number = 0
        for section in self.sections:
            yield f"<section><h2>{_text(section.heading)}</h2>\n"
            for item in section.content:
                if isinstance(item, Plot):
                    yield f'<div class="picture" data-picture="{number}"></div>{_caption(plots[number].caption)}\n'
                    number += 1
                else:
                    yield f"<p>{_text(item)}</p>\n" if isinstance(item, str) else _shown(item) + "\n"
            yield "</section>\n"
        again = _text("\n".join(self.commands))
        yield '<section class="again"><h2>To reproduce</h2><pre tabindex="0" role="region" aria-label="commands">'
        yield f"{again}</pre></section>\n"
        yield f'<p class="note">motorlens {version("motorlens")}</p></main>\n'
        yield from _data(plots)
        yield from (f"<script>{asset(*name).decode()}</script>\n" for name in SCRIPTS)
        yield '<script>new Scene(document.querySelector("main"), document);</script></body></html>\n'


def _facts(facts: Sequence[Fact]) -> Iterator[str]:
    if not facts:
        return
    yield '<dl class="facts">\n'
    for fact in facts:
        yield f"<div><dt>{_text(fact.about)}</dt><dd>{_button(_text(fact.text), fact.samples)}</dd></div>\n"
    yield "</dl>\n"


def _paragraphs(summary: Sequence[str]) -> Iterator[str]:
    """The first few as they are; more would push the pictures off the first screen, and are folded away."""
    told = [f"<p>{_text(paragraph)}</p>\n" for paragraph in summary]
    shown = told if len(told) <= SHOWN + 1 else told[:SHOWN]
    yield from shown
    if folded := told[len(shown) :]:
        yield f'<details class="remarks"><summary>{len(folded)} more remarks</summary>\n'
        yield from folded
        yield "</details>\n"


def _data(plots: Sequence[Plot]) -> Iterator[str]:
    specs = []
    for k, plot in enumerate(plots):
        names = {name: f"data-{k}-{j}" for j, name in enumerate(plot.data)}
        specs.append({**plot.spec, "data": names})
        for name, values in plot.data.items():
            kind = "<f8" if name == "time_s" else "<f4"
            yield f'<script type="text/plain" id="{names[name]}">'
            yield packed(values, kind)
            yield "</script>\n"
    # "</" inside a script would end it.
    described = json.dumps(specs, allow_nan=False).replace("</", "<\\/")
    yield f'<script type="application/json" id="pictures">{described}</script>\n'


def write(page: Page, path: Path | str, *, every_sample: bool = False) -> None:
    """Write a page to a file, with every sample of its recordings however large it then is, or as many as can be sent."""
    with Path(path).open("w", encoding="utf-8") as file:
        file.writelines(replace(page, budget_octets=math.inf) if every_sample else page)


def significant(value: Any, digits: int = 4) -> str:
    """A number with so many significant digits, anything else as it is.

    >>> significant(130.04), significant(0.00001234), significant(True), significant(123456.7), significant(195.0, 2)
    ('130', '1.234e-05', 'True', '123500', '200')
    """
    if isinstance(value, bool) or not isinstance(value, int | float | np.floating | np.integer):
        return str(value)
    if isinstance(value, int | np.integer):
        return f"{value:d}"
    short = float(f"{value:.{digits}g}") + 0.0  # no -0
    return f"{short:.0f}" if abs(short) < 1e7 and short == int(short) else f"{short:.{digits}g}"


def unit_text(unit: str) -> str:
    """A unit as it is read.

    >>> unit_text("degC"), unit_text("V*s/rad"), unit_text("W/K"), unit_text("1")
    ('°C', 'V s/rad', 'W/K', '')
    """
    return {"degC": "°C", "1": ""}.get(unit, unit.replace("*", " "))


def _shown(item: Table | Bars | Grid) -> str:
    if isinstance(item, Table):
        return _table(item)
    return _bars(item) if isinstance(item, Bars) else _grid(item)


def _table(item: Table) -> str:
    worded = [_holds_words([row[k] for row in item.rows if k < len(row)]) for k in range(len(item.headings))]
    kinds = [' class="words"' if words else "" for words in worded]
    head = "".join(
        f'<th scope="col"{kind}>{_text(h)}</th>' if h else "<td></td>"
        for h, kind in zip(item.headings, kinds, strict=True)
    )
    rows = []
    for k, row in enumerate(item.rows):
        marks = f' data-name="{html.escape(item.names[k])}"' if item.names else ""
        marks += ' class="chosen"' if k in item.strong else ""
        cells = "".join(
            f"<td{kind}>{_text(significant(cell))}</td>" for cell, kind in zip(row, kinds, strict=True)
        )
        rows.append(f"<tr{marks}>{cells}</tr>")
    body = f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    return f'<div class="scroll" tabindex="0" role="group" aria-label="table">{body}</div>{_caption(item.caption)}'


def _holds_words(cells: Sequence[Any]) -> bool:
    """Whether a column reads as text: nothing in it is a number, or begins with one; a cell may be empty."""
    there = [cell for cell in cells if cell != ""]
    return bool(there) and all(isinstance(cell, str) and cell[:1].isalpha() for cell in there)


def _bars(item: Bars) -> str:
    most = max((bar.value for bar in item.bars if np.isfinite(bar.value)), default=0.0) or 1.0
    rows = []
    for bar in item.bars:
        width = 100 * max(bar.value, 0.0) / most if np.isfinite(bar.value) else 0.0
        # A drawing, not a style: the pages of the workbench allow no style in an element.
        drawn = (
            '<svg viewBox="0 0 100 1" preserveAspectRatio="none" aria-hidden="true">'
            f'<rect class="track" width="100" height="1"/><rect class="{bar.kind}" width="{width:.2f}" height="1"/></svg>'
        )
        name = _button(_text(bar.name), bar.samples)
        rows.append(
            f'<tr><th scope="row">{name}</th><td class="bar">{drawn}</td><td>{_text(significant(bar.value, 3))}</td></tr>'
        )
    unit = f", {unit_text(item.unit)}" if item.unit else ""
    return (
        f'<table class="bars"><caption>{_text(item.heading + unit)}</caption><tbody>{"".join(rows)}</tbody></table>'
        f"{_caption(item.caption)}"
    )


def _grid(item: Grid) -> str:
    there = {(cell.column, cell.row): cell for cell in item.cells}
    rows = []
    for r in reversed(range(len(item.rows))):
        cells = [f'<th scope="row">{_text(item.rows[r])}</th>']
        for c in range(len(item.columns)):
            cell = there.get((c, r))
            if cell is None:
                cells.append('<td class="empty"></td>')
                continue
            note = f' title="{html.escape(cell.note)}"' if cell.note else ""
            heat = bisect_right(list(item.borders), cell.value)
            number = f"{cell.value:.1f}" if cell.value < 99.5 else f"{cell.value:.0f}"
            cells.append(f'<td class="heat-{heat}"{note}>{_button(number, cell.samples)}</td>')
        rows.append(f"<tr>{''.join(cells)}</tr>")
    feet = "".join(f'<th scope="col">{_text(name)}</th>' for name in item.columns)
    steps = ["below " + significant(item.borders[0])]
    steps += [f"from {significant(border)}" for border in item.borders]
    bar = "".join(f'<li class="heat-{k}">{_text(step)}</li>' for k, step in enumerate(steps))
    caption = f"<span>{_text(item.y)}, {_text(item.x)}</span>"
    return (
        f'<div class="scroll" tabindex="0" role="group" aria-label="map"><table class="grid"><caption>{caption}</caption>'
        f"<tbody>{''.join(rows)}</tbody><tfoot><tr><td></td>{feet}</tr></tfoot></table></div>"
        f'<p class="note">{_text(item.legend)}</p><ol class="colours">{bar}</ol>{_caption(item.caption)}'
    )


def _button(text: str, samples: Samples | None) -> str:
    if samples is None:
        return text
    what = html.escape(samples.to_json())
    return f'<button type="button" class="samples" data-samples="{what}" title="show these samples">{text}</button>'


def _caption(text: str) -> str:
    return f'<p class="note">{_text(text)}</p>' if text else ""


def _text(text: str) -> str:
    return html.escape(text.replace("+-", "±"), quote=False)
