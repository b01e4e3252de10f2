"""Text lines: CSV under a heading, JSON objects, or `name:value` pairs. What Arduino sketches, loggers and plotters print.

CSV: the heading names the columns as recordings do (`t[s],v[V],i[A]`, `time_ms;voltage_V;current_A`); comma, semicolon, tab
or blanks between; a new heading starts anew. JSON: one object a line, `{"t": 0.001, "v[V]": 12.1, "i[A]": 0.8}`, nested or
not; the innermost names count. Pairs: `voltage_V:12.1 current_A:0.8`, as the Arduino plotter has them.

Duty cycle (`duty` or `duty_%`) and `supply_voltage_V` stand in for a voltage that is not measured. Without a time, `rate_Hz`
says how samples follow one another, or else their arrival does.

Text carries no checksum: a digit changed on the line is a number, and the gate behind judges it.

Options: `columns`, the heading for a line that sends none (`columns=time_us,voltage_mV,current_mA`); `rate_Hz`.
"""

import json
import math
import re
from collections.abc import Iterator, Sequence
from itertools import groupby, islice

import numpy as np

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.files.columns import Column, understand
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.dialects.quantities import Assembler, concatenate, conversion, require_channels
from motorlens_runtime.options import Options

_MAX_LINE = 4096
_MAX_FIELDS = 64
_SPLIT = re.compile(r"\s*[,;\t]\s*|\s+")


def make(options: Options) -> "Text":
    """The dialect with its options."""
    columns = options.text("columns", "")
    rate = options.text("rate_Hz", "")
    heading = None
    if columns:
        heading = heading_of(_SPLIT.split(columns.strip()))
        if heading is None:
            raise DataError(f"{options.where}: columns={columns}: no voltage and current among them")
    rate_Hz = Options({"rate_Hz": rate}, options.where).number("rate_Hz", None, 1e-3, 1e6) if rate else None
    return Text(heading, rate_Hz)


class Text(Dialect):
    """Decoder of text lines. `columns` is the heading in force, None until one has come."""

    def __init__(self, columns: dict[str, Column] | None = None, rate_Hz: float | None = None) -> None:
        super().__init__()
        self.columns = columns
        self._width: int | None = None
        self._names: tuple[str, ...] = ()
        self._named_columns: dict[str, Column] | None = None
        self._rest = b""
        self._overlong = False
        self._assembler = Assembler(rate_Hz=rate_Hz)

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """Samples from the lines that `data` completes."""
        self.bytes_seen += len(data)
        lines = (self._rest + data).split(b"\n")
        self._rest = lines.pop()
        if self._overlong and lines:
            lines[0] = b""  # the end of what was thrown away below
            self._overlong = False
        if len(self._rest) > _MAX_LINE:
            self.bad_frames += not self._overlong
            self._rest, self._overlong = b"", True
        rows: list[dict[str, float]] = []
        for line in lines:
            row = self._row(line.strip(b" \t\r\0\xef\xbb\xbf"))
            if row is not None:
                rows.append(row)
        # Lines of one kind make one block; only a drive that starts anew with another heading makes two.
        blocks = []
        for names, group in groupby(rows, key=tuple):
            table = np.array([tuple(row.values()) for row in group], dtype=np.float64)
            blocks.append(self._assembler.samples(dict(zip(names, table.T, strict=True)), now_ns))
        return concatenate(blocks)

    def _row(self, line: bytes) -> dict[str, float] | None:
        """The quantities of a line in SI; None if it is a heading, a comment or not understood."""
        if not line or line.startswith(b"#"):
            return None
        if len(line) > _MAX_LINE:
            self.bad_frames += 1
            return None
        text = line.decode("utf-8", "replace")
        if text.startswith("{"):
            row = self._named_row(_json_pairs(text))
        elif ":" in text and self.columns is None:
            row = self._named_row(_labelled_pairs(text))
        else:
            row = self._csv_row(text)
        if row is not None and "time" in row and not math.isfinite(row["time"]):
            self.bad_frames += 1
            return None
        return row

    def _csv_row(self, text: str) -> dict[str, float] | None:
        fields = _SPLIT.split(text)
        if len(fields) > _MAX_FIELDS:
            self.bad_frames += 1
            return None
        if self.columns is not None and self._width in (None, len(fields)):
            try:
                row = {
                    quantity: column.factor * number(fields[column.index]) + column.offset
                    for quantity, column in self.columns.items()
                }
            except (ValueError, IndexError):
                pass
            else:
                return row
        heading = heading_of(split_heading(text))
        if heading is None:
            self.bad_frames += 1
        else:
            self.columns, self._width = heading, len(split_heading(text))
        return None

    def _named_row(self, pairs: dict[str, float] | None) -> dict[str, float] | None:
        """A row in which every number has its name; the names of one line mostly are those of the next."""
        if pairs is None:
            self.bad_frames += 1
            return None
        names = tuple(pairs)
        if names != self._names:
            self._names, self._named_columns = names, heading_of(names)
        if self._named_columns is None:
            self.bad_frames += 1
            return None
        values = list(pairs.values())
        return {
            quantity: column.factor * values[column.index] + column.offset
            for quantity, column in self._named_columns.items()
        }


def _json_pairs(text: str) -> dict[str, float] | None:
    try:
        return dict(islice(_leaves(json.loads(text), 0), _MAX_FIELDS))
    except (ValueError, RecursionError, OverflowError):
        return None


def _labelled_pairs(text: str) -> dict[str, float] | None:
    """`voltage_V:12.1,current_A:0.8`, with a comma, blank or tab between."""
    try:
        pieces = [piece.partition(":") for piece in _SPLIT.split(text)]
        return {name: number(value) for name, _, value in pieces}
    except ValueError:
        return None


def number(text: str) -> float:
    """A decimal number; `nan` is one, digits parted by underscores are not. Raises ValueError."""
    if "_" in text:
        raise ValueError(text)
    return float(text)


def split_heading(text: str) -> list[str]:
    """The names in a heading: blanks part them only where nothing else does (`Voltage (V), Current (A)`)."""
    separator = next((mark for mark in ("\t", ";", ",") if mark in text), None)
    return [name.strip() for name in (text.split(separator) if separator else text.split())]


def heading_of(names: Sequence[str]) -> dict[str, Column] | None:
    """Quantity -> column where names hold voltage (or duty and supply) and current; None where they do not."""
    cleaned = [name.strip().strip('"')[:80] for name in names[:_MAX_FIELDS]]
    columns: dict[str, Column] = {}
    try:
        for index, name in enumerate(cleaned):
            special = re.fullmatch(r"(duty|supply_voltage)[_ (\[]*([^)\]]*)[)\]]?", name, re.IGNORECASE)
            if special:
                quantity = special[1].lower()
                factor, offset = conversion(
                    quantity, special[2] or ("1" if quantity == "duty" else "V"), "heading"
                )
                columns[quantity] = Column(index, name, quantity, factor, offset)
        found = understand(cleaned, {}, "heading")
        columns |= {name: found[name] for name in ("time", "voltage", "current", "ambient") if name in found}
        require_channels(list(columns), "heading")
    except DataError:
        return None
    if "voltage" in columns:
        columns = {name: column for name, column in columns.items() if name not in ("duty", "supply_voltage")}
    return columns


def _leaves(value: object, depth: int) -> Iterator[tuple[str, float]]:
    """The innermost names of nested objects and their numbers; `null` is not a number, texts are passed over."""
    if depth > 8 or not isinstance(value, dict):
        return
    for name, inner in value.items():
        if isinstance(inner, dict):
            yield from _leaves(inner, depth + 1)
        elif inner is None:
            yield str(name), math.nan
        elif isinstance(inner, int | float) and not isinstance(inner, bool):
            yield str(name), float(inner)
