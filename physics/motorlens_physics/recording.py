"""Recordings: measured or simulated channels over time, in SI, with what was found wrong with them in words.

Columns are recognised and converted by `motorlens_runtime.files.columns`. Time and voltage are required; every other
channel is optional, and what is absent limits what can be concluded.
"""

import csv
import gzip
import io
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import Column, canonical_name, parse_mapping, require, understand

Array = NDArray[np.float64]

# Up to this share of rows with a backward stamp or a missing input is repaired, in files long enough to spare them.
REPAIRABLE_SHARE = 0.005


@dataclass(frozen=True)
class Recording:
    """One run of one motor.

    Attributes:
        name: the file's name, or that of the scenario.
        time_s: (N,) strictly increasing.
        channels: quantity ("voltage", "current", "speed", "temperature", "load_torque", "ambient", "angle") to (N,) in
            the units of `motorlens_runtime.files.columns`; temperatures in degC. A missing sample of a measured output is
            NaN; voltage, load torque and ambient have none.
        notes: what was found and handled while reading, in words.
    """

    name: str
    time_s: Array
    channels: Mapping[str, Array]
    notes: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def period_s(self) -> float:
        """The median sampling period."""
        return float(np.median(np.diff(self.time_s)))

    @property
    def duration_s(self) -> float:
        """From the first to the last sample."""
        return float(self.time_s[-1] - self.time_s[0])

    def has(self, quantity: str) -> bool:
        """Whether the channel was recorded."""
        return quantity in self.channels

    def part(self, rows: slice) -> "Recording":
        """Some consecutive rows, as a recording."""
        return replace(
            self, time_s=self.time_s[rows], channels={q: y[rows] for q, y in self.channels.items()}
        )


def read_recording(path: Path | str, mapping: Mapping[str, str] | Sequence[str] = ()) -> Recording:
    """Read a CSV (optionally gzipped) or Parquet recording.

    Args:
        path: the file; `NAME.columns.toml` beside it may hold a `[columns]` table with the mapping.
        mapping: quantity to heading, or the arguments of `--column`; see `motorlens_runtime.files.columns.understand`.

    Raises:
        DataError: empty, a required column missing, an unknown unit, text in a number, too many missing or backward
            rows; the message names file, row and column.
        OSError: the file cannot be read.
    """
    path = Path(path)
    chosen = dict(mapping) if isinstance(mapping, Mapping) else parse_mapping(mapping)
    beside = path.with_name(path.name + ".columns.toml")
    if beside.exists():
        chosen = tomllib.loads(beside.read_text(encoding="utf-8")).get("columns", {}) | chosen
    if path.suffix == ".parquet":
        columns, table = _read_parquet(path, chosen)
    else:
        columns, table = _read_csv(path, chosen)
    if len(table["time"]) < 2:
        raise DataError(f"{path}: {len(table['time'])} rows of data; a recording needs at least two")
    return _checked(path.name, path, columns, table)


def write_recording(recording: Recording, path: Path | str) -> None:
    """Write a recording as CSV with canonical headings; numbers read back to nine digits."""
    quantities = [q for q in recording.channels]
    headings = [canonical_name(q) for q in ("time", *quantities)]
    table = np.column_stack([recording.time_s, *(recording.channels[q] for q in quantities)])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(headings), comments="")


def _read_csv(path: Path, chosen: Mapping[str, str]) -> tuple[dict[str, Column], dict[str, Array]]:
    raw = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise DataError(
            f"{path}: not a text file; a recording is CSV with a heading line, or Parquet"
        ) from None
    first, _, body = text.lstrip("\r\n").partition("\n")
    if not first.strip():
        raise DataError(f"{path}: empty; a recording needs a heading line and rows of numbers")
    delimiter = next((mark for mark in (",", ";", "\t") if mark in first), ",")
    headings = next(csv.reader([first.rstrip("\r")], delimiter=delimiter))
    columns = understand(headings, chosen, str(path))
    require(columns, ("time", "voltage"), headings, str(path))
    if not body.strip():
        raise DataError(f"{path}: 0 rows of data; a recording needs at least two")
    used = [column.index for column in columns.values()]
    try:
        numbers = np.loadtxt(io.StringIO(body), delimiter=delimiter, usecols=used, ndmin=2)
    except ValueError:
        # An empty cell, text, or a short row: find out which, at leisure.
        numbers = _parse_slowly(body, delimiter, columns, path)
    table = {q: numbers[:, k] * c.factor + c.offset for k, (q, c) in enumerate(columns.items())}
    return columns, table


def _parse_slowly(body: str, delimiter: str, columns: Mapping[str, Column], path: Path) -> Array:
    rows = []
    for line, cells in enumerate(csv.reader(io.StringIO(body), delimiter=delimiter), start=2):
        if not cells:
            continue
        row = []
        for column in columns.values():
            cell = cells[column.index].strip() if column.index < len(cells) else ""
            try:
                row.append(float(cell) if cell else float("nan"))
            except ValueError:
                raise DataError(
                    f"{path}: row {line}, column {column.heading!r}: {cell!r} is not a number"
                ) from None
        rows.append(row)
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(columns))


def _read_parquet(path: Path, chosen: Mapping[str, str]) -> tuple[dict[str, Column], dict[str, Array]]:
    import pyarrow.parquet

    content = pyarrow.parquet.read_table(path)
    columns = understand(content.column_names, chosen, str(path))
    require(columns, ("time", "voltage"), content.column_names, str(path))
    table = {}
    for quantity, column in columns.items():
        try:
            numbers = content.column(column.index).to_numpy().astype(np.float64)
        except (TypeError, ValueError):
            raise DataError(f"{path}: column {column.heading!r} does not hold numbers") from None
        table[quantity] = numbers * column.factor + column.offset
    return columns, table


def _checked(name: str, path: Path, columns: Mapping[str, Column], table: dict[str, Array]) -> Recording:
    notes: list[str] = []
    time = table["time"]
    if not np.isfinite(time).all():
        row = int(np.argmin(np.isfinite(time)))
        raise DataError(f"{path}: row {row + 2}, column {columns['time'].heading!r}: time is missing")
    # A stamp not above all before it (a test stand's first row, a repeated frame) is dropped; many are a broken clock.
    forward = np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]]
    if time[0] > time[1]:
        forward = np.r_[False, True, time[2:] > np.maximum.accumulate(time[1:])[:-1]]
    dropped = int(np.sum(~forward))
    if dropped:
        row = int(np.argmin(forward))
        _repairable(
            dropped,
            len(time),
            f"{path}: row {row + 2}: time does not increase ({time[row]:g} s); sort or split the file",
        )
        notes.append(
            f"{dropped} of {len(time)} rows dropped because their time does not increase (first: row {row + 2})"
        )
        table = {q: y[forward] for q, y in table.items()}
        time = table["time"]
    channels = {q: y for q, y in table.items() if q != "time"}
    for quantity, y in channels.items():
        column, missing = columns[quantity], ~np.isfinite(y)
        if not missing.any():
            continue
        row = int(np.argmax(missing))
        where = f"{path}: row {row + 2}, column {column.heading!r}"
        if missing.all():
            raise DataError(f"{path}: column {column.heading!r} holds no numbers")
        if quantity in ("voltage", "load_torque", "ambient"):
            _repairable(
                int(missing.sum()),
                len(y),
                f"{where}: a missing value in an input; fill it or cut the recording",
            )
            channels[quantity] = np.interp(time, time[~missing], y[~missing])
            notes.append(
                f"{int(missing.sum())} missing values of {quantity} interpolated (first: row {row + 2})"
            )
        else:
            channels[quantity] = np.where(missing, np.nan, y)
            notes.append(f"{int(missing.sum())} missing values of {quantity} left out (first: row {row + 2})")
    notes += _suspicions(time, channels)
    return Recording(name, time, channels, tuple(notes))


def _repairable(count: int, rows: int, complaint: str) -> None:
    if count > REPAIRABLE_SHARE * rows:
        raise DataError(complaint)


def _suspicions(time: Array, channels: Mapping[str, Array]) -> list[str]:
    """What looks wrong but may be meant: gaps, dead and clipped channels."""
    notes = []
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > 10 * np.median(steps))
    if len(gaps):
        notes.append(
            f"{len(gaps)} gaps in time, the longest {steps.max():.3g} s after {time[np.argmax(steps)]:.6g} s"
        )
    for quantity in ("voltage", "current", "speed", "temperature"):
        y = channels.get(quantity)
        if y is None:
            continue
        if np.nanmin(y) == np.nanmax(y):
            notes.append(f"{quantity} never changes ({y[0]:g}): a dead channel?")
            continue
        for limit in (np.nanmin(y), np.nanmax(y)):
            at_limit = y == limit
            runs = np.sum(at_limit[1:] & at_limit[:-1])
            # A commanded voltage rests at its levels, and a motor rests at zero; a measured signal does not rest at a peak.
            if quantity in ("current", "speed") and limit != 0 and runs > 0.02 * len(y):
                notes.append(
                    f"{quantity} stays at its extreme value {limit:g} for {int(runs)} samples: clipped?"
                )
    return notes
