"""What is in a recording, before it is used: columns, quantities, gaps, plots."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_physics.reading import Table as File
from motorlens_physics.reading import read_table
from motorlens_physics.recording import Recording, read_recording, under
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import understand, units_offered
from motorlens_runtime.files.formula import ROW, index_of
from motorlens_runtime.files.headings import QUANTITIES
from motorlens_runtime.files.words import WORDS
from motorlens_workbench.report.page import Page, Section, significant, unit_text
from motorlens_workbench.report.pictures import Axes, Line, Plot, Table, time_plots

# Values of a column that are shown.
SAMPLES = 3
_UNITS = {"rad_s": "rad/s", "C": "degC", "Nm": "N*m"}


@dataclass(frozen=True)
class Heading:
    """A column of the file: its heading, its first values, and the quantity that it is taken for ("" if none)."""

    heading: str
    samples: tuple[str, ...]
    quantity: str

    @property
    def shown(self) -> str:
        """The first values, where there are numbers among them.

        >>> Heading("message", ("nan", "nan"), "").shown
        'no numbers'
        >>> Heading("current_A", ("nan", "1.5"), "current").shown
        '-, 1.5'
        """
        if all(sample == "nan" for sample in self.samples):
            return "no numbers"
        return ", ".join("-" if sample == "nan" else sample for sample in self.samples)


@dataclass(frozen=True)
class Sight:
    """A recording as it is read; `recording` is None if it cannot be, and `error` says why."""

    name: str
    headings: tuple[Heading, ...]
    recording: Recording | None
    error: str


def look(
    path: str,
    columns: Sequence[str],
    no_values: Sequence[float] | None = None,
    terminal: str | None = None,
    shaft: str | None = None,
) -> Sight:
    """Read a file for what is in it.

    Args:
        path: the file.
        columns: arguments of `--column`.
        no_values: numbers that stand for a missing value; None looks for them.
        terminal: what the terminals are tied to throughout.
        shaft: what the shaft is tied to throughout.

    Raises:
        DataError: it is no table at all.
        OSError: it cannot be read.
    """
    # First, so that its numbers are gone before the recording's come: a long one is large.
    headings = _headings(read_table(Path(path)), columns)
    recording, error = None, ""
    try:
        recording = under(read_recording(path, columns, no_values, terminal), shaft=shaft)
    except DataError as found:
        error = str(found)
    return Sight(path, headings, recording, error)


def to_json(sight: Sight) -> dict[str, Any]:
    """The document of `--json`, schema motorlens.look/1; `choices` is what a column can be mapped to, with its units."""
    recording = sight.recording
    found: dict[str, Any] = {
        "schema": "motorlens.look/1", "recording": sight.name, "error": sight.error,
        "columns": [
            {"heading": h.heading, "samples": list(h.samples), "quantity": h.quantity} for h in sight.headings
        ],
        "choices": {quantity: list(units_offered(quantity)) for quantity in QUANTITIES},
    }  # fmt: skip
    if recording is not None:
        found |= {
            "rows": len(recording), "seconds": recording.duration_s, "period_s": recording.period_s,
            "channels": {q: {"unit": _unit(q), "min": low, "max": high} for q, (low, high) in _extremes(recording).items()},
            "notes": list(recording.notes),
        }  # fmt: skip
    return found


def sentence(sight: Sight) -> str:
    """What it is, or why it cannot be read."""
    recording = sight.recording
    if recording is None:
        return sight.error
    channels = ", ".join(q.replace("_", " ") for q in recording.channels)
    return (
        f"{recording.name}: {len(recording)} samples in {significant(recording.duration_s)} s, "
        f"{significant(1 / recording.period_s)} a second, of {channels}."
    )


def to_text(sight: Sight) -> str:
    """What the terminal shows."""
    rows = [sentence(sight), ""] if sight.recording is not None else []
    wide = max(32, *(2 + len(heading.heading) for heading in sight.headings))
    rows.append(f"{'column':<{wide}}{'taken for':<14}first values")
    rows += [f"{h.heading:<{wide}}{h.quantity or '-':<14}{h.shown}" for h in sight.headings]
    if sight.recording is not None:
        rows += ["", f"{'quantity':<14}{'smallest':>12}{'largest':>12}"]
        for quantity, (low, high) in _extremes(sight.recording).items():
            if quantity in WORDS:
                rows.append(f"{quantity:<14}{_words(quantity, sight.recording.channels[quantity]):>12}")
            else:
                rows.append(f"{quantity:<14}{low:>12.5g}{high:>12.5g} {_unit(quantity)}")
        rows += ["", *sight.recording.notes] if sight.recording.notes else []
    return "\n".join(rows)


def to_html(sight: Sight, command: str) -> Page:
    """The page of `--html`."""
    recording = sight.recording
    columns = Table(
        ["column", "taken for", "first values"],
        [[h.heading, h.quantity.replace("_", " ") or "-", h.shown] for h in sight.headings],
        names=[h.heading for h in sight.headings],
    )
    sections = [Section("Columns", [columns])]
    notes: Sequence[str] = ()
    if recording is not None:
        notes = recording.notes
        sections.insert(0, Section("Samples", [_plot(recording)]))
    return Page(f"motorlens look: {sight.name}", sentence(sight), notes, sections, [command])


def _plot(recording: Recording) -> Plot:
    axes = [
        Axes(q.replace("_", " "), _unit(q), [Line(q.replace("_", " "), "predicted", q)], height=150)
        for q in recording.channels
    ]
    states = {q: q for q in ("speed", "current", "temperature") if recording.has(q)}
    caption = "Drag to zoom, double-click for all of it. Time runs from the first sample."
    time = recording.time_s - recording.time_s[0]
    return time_plots(recording.name, time, axes, recording.channels, states, caption=caption)


def _words(quantity: str, codes: np.ndarray) -> str:
    """Which words of a quantity that is no number occur."""
    return ", ".join(WORDS[quantity][int(code)] for code in np.unique(codes[np.isfinite(codes)]))


def _unit(quantity: str) -> str:
    unit = QUANTITIES[quantity][0]
    return unit_text(_UNITS.get(unit, unit))


def _extremes(recording: Recording) -> dict[str, tuple[float, float]]:
    found = {}
    for quantity, values in recording.channels.items():
        there = values[np.isfinite(values)]
        if len(there):
            # No -0, which a negated channel's 0 is.
            found[quantity] = (float(there.min()) + 0.0, float(there.max()) + 0.0)
    return found


def _headings(table: File, columns: Sequence[str]) -> tuple[Heading, ...]:
    every = range(len(table.headings))
    cells: Mapping[int, Any] = {}
    try:
        cells = table.numbers(every)
    except DataError:
        # One of them is text: the others are shown all the same.
        cells = {k: found[k] for k in every if (found := _one(table, k)) is not None}
    taken: dict[str, str] = {}
    for heading in table.headings:
        try:
            taken |= {column.heading: quantity for quantity, column in understand([heading], {}, "").items()}
        except DataError:
            continue
    for column in columns:
        key, _, named = column.partition("=")
        index = index_of(named, table.headings)
        heading = named if index is None or index == ROW else table.headings[index]
        quantity = next(
            (q for q in sorted(QUANTITIES, key=len, reverse=True) if key == q or key.startswith(q + "_")), ""
        )
        taken = {h: q for h, q in taken.items() if q != quantity} | {heading: quantity}
    shown = []
    for k, heading in enumerate(table.headings):
        samples = tuple(significant(float(v)) for v in cells[k][:SAMPLES]) if k in cells else ("text",)
        shown.append(Heading(heading, samples, taken.get(heading, "")))
    return tuple(shown)


def _one(table: File, k: int) -> Mapping[int, Any] | None:
    try:
        return table.numbers([k])
    except DataError:
        return None
