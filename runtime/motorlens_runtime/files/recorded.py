"""Recorded samples block by block, whatever the file: columns by quantity, time in nanoseconds that never runs backwards.

`open_recorded` tells a Parquet file by its first bytes; everything else is read as text.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.files.columns import Column, in_seconds, require, understand
from motorlens_runtime.files.formula import ROW
from motorlens_runtime.files.guesses import refuse_counts

Array = NDArray[np.float64]

_MAX_TIME_S = 9e9  # int64 nanoseconds end there
# Written by the live recorder: what the line knew of each sample.
_FLAGS = "link_flags"
_PARQUET_MAGIC = b"PAR1"


@dataclass(frozen=True)
class Block:
    """Samples, the row of the file in which the first stands, and how much of the file is read."""

    samples: Samples
    first_row: int
    position: int


class Recorded(Protocol):
    """An open recording.

    Attributes:
        name: of the file.
        size: in the unit of `Block.position`.
        first_row: the number of the first row of numbers, as the user counts rows.
        notes: what is to be said when all is read.
        duplicates: how many rows so far repeat the time of the row before.
    """

    name: str
    size: int
    notes: list[str]

    @property
    def first_row(self) -> int:
        """See above."""
        ...

    @property
    def duplicates(self) -> int:
        """See above."""
        ...

    def __iter__(self) -> Iterator[Block]:
        """All blocks, in order. Raises DataError where the file is at fault."""
        ...

    def close(self) -> None:
        """Close the file."""
        ...


class Reading:
    """From columns of numbers to samples, a table at a time.

    Args:
        name: of the file, for messages.
        headings: of its columns.
        mapping: the user's own column names, see `columns.parse_mapping`.
        ambient_C: the ambient temperature, for a file without that column.

    Attributes:
        used: heading of each column that is needed, by index.
        duplicates: how many rows so far repeat the time of the row before.

    Raises:
        DataError: time, voltage or current is not there.
    """

    def __init__(
        self, name: str, headings: list[str], mapping: Mapping[str, str], ambient_C: float | None
    ) -> None:
        self._name, self._ambient_C = name, ambient_C
        self._columns: dict[str, Column] = understand(headings, mapping, name)
        require(self._columns, ("time", "voltage", "current"), headings, name)
        self._flags_at = headings.index(_FLAGS) if _FLAGS in headings else None
        self.used = {
            index: headings[index]
            for quantity, column in self._columns.items()
            if quantity in ("time", "voltage", "current", "ambient")
            for index in column.uses
            if index != ROW
        }
        if self._flags_at is not None:
            self.used[self._flags_at] = _FLAGS
        self._last_ns: int | None = None
        self._rows = 0
        self.duplicates = 0

    @property
    def time_at(self) -> int | None:
        """The index of the column that holds the time; None where it is computed."""
        time = self._columns["time"]
        return None if time.formula else time.index

    def time_is_dated(self) -> None:
        """The cells of the time hold dates or times of day, given as seconds, whatever the heading says."""
        self._columns["time"] = in_seconds(self._columns["time"])

    def samples(self, cells: Callable[[int], Array], rows: NDArray[np.int64]) -> Samples:
        """The samples of a table: `cells` gives a column (n,) by its index, `rows` (n,) are its rows in the file.

        Raises:
            DataError: a time is none or runs backwards, or the numbers look like counts of a converter.
        """

        first, self._rows = self._rows, self._rows + len(rows)

        def numbers(index: int) -> Array:
            return np.arange(first, self._rows, dtype=np.float64) if index == ROW else cells(index)

        def channel(quantity: str) -> Array:
            return np.ascontiguousarray(self._columns[quantity].values(numbers))

        if self._last_ns is None:
            refuse_counts(self._columns, channel, self._name)
        time_ns = self._time(channel("time"), numbers, rows)
        ambient = None if self._ambient_C is None else np.full(len(time_ns), self._ambient_C)
        if "ambient" in self._columns:
            ambient = channel("ambient")
        flags = None
        if self._flags_at is not None:
            words = np.nan_to_num(cells(self._flags_at), posinf=0.0, neginf=0.0)
            flags = words.astype(np.int64).astype(np.uint32)
        return Samples(time_ns, channel("voltage"), channel("current"), ambient, flags)

    def _time(
        self, time_s: Array, cells: Callable[[int], Array], rows: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        column = self._columns["time"]
        if not (time_s.max() < _MAX_TIME_S and time_s.min() > -_MAX_TIME_S):
            at = int(np.argmax(~(np.abs(time_s) < _MAX_TIME_S)))
            raise DataError(
                f"{self._name}: row {rows[at]}, column {column.heading!r}: {cells(column.index)[at]} is no time; "
                "correct or remove the row"
            )
        time_ns = np.rint(time_s * 1e9).astype(np.int64)
        steps = np.empty_like(time_ns)
        np.subtract(time_ns[1:], time_ns[:-1], out=steps[1:])
        steps[0] = 0 if self._last_ns is None else time_ns[0] - self._last_ns
        least = steps.min()
        if least < 0:
            at = int(np.argmax(steps < 0))
            raise DataError(
                f"{self._name}: row {rows[at]}, column {column.heading!r}: time runs backwards by {-steps[at] * 1e-9:g} s; "
                "sort the file, or split it where the recorder restarted"
            )
        if least == 0:
            self.duplicates += int(np.count_nonzero(steps == 0)) - (self._last_ns is None)
        self._last_ns = int(time_ns[-1])
        return time_ns


def open_recorded(path: str | Path, mapping: Mapping[str, str], ambient_C: float | None = None) -> Recorded:
    """Open a recording.

    Args:
        path: Parquet, or a text file, `.gz` or not.
        mapping: the user's own column names, see `columns.parse_mapping`.
        ambient_C: the ambient temperature, for a file without that column.

    Raises:
        DataError: the file is absent, empty or damaged, or lacks time, voltage or current.
    """
    from motorlens_runtime.files.csv_stream import CsvStream

    try:
        with Path(path).open("rb") as file:
            magic = file.read(len(_PARQUET_MAGIC))
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    if magic == _PARQUET_MAGIC:
        from motorlens_runtime.files.parquet_stream import ParquetStream

        return ParquetStream(path, mapping, ambient_C)
    return CsvStream(path, mapping, ambient_C)


def period_of(samples: Samples, otherwise_s: float) -> float:
    """The usual time between samples: the median of the first steps that are not zero."""
    steps = np.diff(samples.time_ns[:4096])
    steps = steps[steps > 0]
    return float(np.median(steps)) * 1e-9 if len(steps) else otherwise_s
