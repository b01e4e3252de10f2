"""What stands in a report: bars, maps and tables in HTML, and plots that the browser draws from all the data.

A plot is described by plain data (`Plot.spec`) and its series, which stand in the page as float32; uPlot draws them, and
thins them to the pixels of each view, so that a zoom ends at the samples. What can be clicked to show its samples in the
plots against time carries a `Samples`.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Series = NDArray[np.float64] | NDArray[np.float32]

# Stamps that are further than this share of a period from an even grid are kept one by one.
EVEN = 1e-3


@dataclass(frozen=True)
class Samples:
    """Which samples something is about.

    Attributes:
        label: what they are called.
        within: state, or `time` -> range; all of them hold.
        lacks: an equation; the tenth of the samples at which it lacks most.
        recording: of which recording; empty is all.
    """

    label: str
    within: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    lacks: str = ""
    recording: str = ""

    def to_json(self) -> str:
        """For the script of the page."""
        return json.dumps(
            {"label": self.label, "within": {q: list(span) for q, span in self.within.items()}, "lacks": self.lacks,
             "recording": self.recording}
        )  # fmt: skip


@dataclass(frozen=True)
class Fact:
    """What stands at the head of a report: what it is about, and a line about it."""

    about: str
    text: str
    samples: Samples | None = None


@dataclass(frozen=True)
class Table:
    """A table; numbers are shown with four significant digits. `names`, one for each row, are what a page may act on."""

    headings: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    names: Sequence[str] = ()
    strong: Sequence[int] = ()


@dataclass(frozen=True)
class Bar:
    """One bar. `kind` is its colour: predicted, lacking or noise."""

    name: str
    value: float
    kind: str = "predicted"
    samples: Samples | None = None


@dataclass(frozen=True)
class Bars:
    """Horizontal bars, the first on top, with their values beside them."""

    heading: str
    unit: str
    bars: Sequence[Bar]
    caption: str = ""


@dataclass(frozen=True)
class Cell:
    """A cell of a `Grid`: its column and row (0 is left, 0 is the bottom), its value, and what it is called."""

    column: int
    row: int
    value: float
    note: str = ""
    samples: Samples | None = None


@dataclass(frozen=True)
class Grid:
    """A map in colours with its numbers.

    Attributes:
        x, y: labels of the axes, with the way in which they run.
        columns, rows: names along them, rows from the bottom.
        cells: those that hold something.
        borders: (8,) values at which the next of nine colours begins; the last is what is worst, or most.
        legend: what the colours mean.
        caption: the sentence below.
    """

    x: str
    y: str
    columns: Sequence[str]
    rows: Sequence[str]
    cells: Sequence[Cell]
    borders: Sequence[float]
    legend: str
    caption: str = ""


@dataclass(frozen=True)
class Plot:
    """A picture drawn in the browser: `spec` for the script `plots.js`, and the series (N,) that it names."""

    spec: Mapping[str, Any]
    data: Mapping[str, Series] = field(default_factory=dict)
    caption: str = ""


@dataclass(frozen=True)
class Line:
    """A series of a plot against time: `data` less `less`, in the colour of `role` (a colour of the style sheet)."""

    name: str
    role: str
    data: str
    less: str = ""


@dataclass(frozen=True)
class Axes:
    """One plot against time; `band` is shaded on both sides of zero."""

    title: str
    unit: str
    lines: Sequence[Line]
    band: float = 0.0
    height: int = 190


def time_plots(
    name: str,
    time_s: Array,
    axes: Sequence[Axes],
    data: Mapping[str, Series],
    states: Mapping[str, str],
    lacks: Mapping[str, str] | None = None,
    caption: str = "",
) -> Plot:
    """Plots of one recording over each other, with one time axis and one cursor.

    Args:
        name: of the recording.
        time_s: (N,) increasing.
        axes: the plots, the first on top.
        data: (N,) series by name; NaN is a gap.
        states: speed, current, temperature -> the series by which `Samples.within` is judged.
        lacks: equation -> the series of what it lacks.
        caption: the sentence below.
    """
    plots = [
        {"title": a.title, "unit": a.unit, "band": a.band, "height": a.height, "lines": [vars(line) for line in a.lines]}
        for a in axes
    ]  # fmt: skip
    start, step = float(time_s[0]), float(time_s[-1] - time_s[0]) / max(len(time_s) - 1, 1)
    even = np.abs(time_s - start - step * np.arange(len(time_s))).max() <= EVEN * step
    spec: dict[str, Any] = {
        "kind": "time", "name": name, "plots": plots, "states": dict(states), "lacks": dict(lacks or {}),
        "time": {"start": start, "step": step, "count": len(time_s)} if even else {"data": "time_s"},
    }  # fmt: skip
    return Plot(spec, data if even else {**data, "time_s": time_s}, caption)


def curves(
    x: str, y: str, at: Array, lines: Mapping[str, tuple[str, Array]], *, logarithmic: bool = False,
    band: tuple[Array, Array] | None = None, marks: Mapping[str, float] | None = None, caption: str = "",
) -> Plot:  # fmt: skip
    """Curves over one axis.

    Args:
        x, y: labels of the axes.
        at: (K,) increasing.
        lines: name -> colour of the style sheet and (K,) values; NaN is a gap.
        logarithmic: the x axis.
        band: (K,) lower and upper edge of a shaded band.
        marks: what is written at which x, with a dotted line.
        caption: the sentence below.
    """
    spec = {
        "kind": "curves", "x": x, "y": y, "at": _numbers(at), "logarithmic": logarithmic, "marks": dict(marks or {}),
        "lines": [{"name": name, "role": role, "y": _numbers(values)} for name, (role, values) in lines.items()],
        "band": [_numbers(edge) for edge in band] if band else [],
    }  # fmt: skip
    return Plot(spec, {}, caption)


def cloud(x: str, y: str, state: str, equation: str, caption: str = "") -> Plot:
    """What an equation lacks, against a state: a point for each sample of the plots against time of the same page."""
    return Plot({"kind": "cloud", "x": x, "y": y, "state": state, "lacks": equation}, {}, caption)


def packed(values: Series, kind: str = "<f4") -> str:
    """A series as text, base64 of little-endian numbers.

    >>> packed(np.array([1.0, -2.0]))
    'AACAPwAAAMA='
    """
    return base64.b64encode(np.ascontiguousarray(values, dtype=kind).tobytes()).decode("ascii")


def _numbers(values: Array) -> list[float | None]:
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in np.asarray(values).tolist()]
