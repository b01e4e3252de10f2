"""Recorded samples from a CSV file of any length, block by block in constant memory.

A block whose cells are all numbers is parsed in one call, of a large file by the C core, or by pyarrow where that is
installed; anything else is parsed cell by cell, which is slower and says exactly which cell is at fault. Empty cells and NaN
are passed on: the gate leaves them out and flags them.
"""

import codecs
import gzip
import io
import warnings
import zlib
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.arrow_memory import arrow_buffer
from motorlens_runtime.files.decimal_text import read
from motorlens_runtime.files.layout import HEAD_BYTES, is_comment, layout_of, number
from motorlens_runtime.files.moments import Moments
from motorlens_runtime.files.recorded import Block, Reading

Array = NDArray[np.float64]

_BLOCK_BYTES = 3 << 17
# From this size on, a library that reads faster is worth the time it takes to load.
_LARGE_BYTES = 1 << 22
_MAX_LINE_BYTES = 1 << 20


class CsvStream:
    """An open recording.

    Args:
        path: a text file, `.gz` or not; see `layout` for what is understood.
        mapping: the user's own column names, see `columns.parse_mapping`.
        ambient_C: the ambient temperature, for a file without that column.

    Raises:
        DataError: the file is absent or empty, or lacks time, voltage or current.
    """

    def __init__(self, path: str | Path, mapping: Mapping[str, str], ambient_C: float | None = None) -> None:
        self.name = str(path)
        self._file, self._raw = _open(path)
        self.size = Path(path).stat().st_size
        self._large = self.size > _LARGE_BYTES
        self._decoder: codecs.IncrementalDecoder | None = None
        try:
            self._read_heading(mapping, ambient_C)
        except DataError:
            self.close()
            raise
        self.notes: list[str] = []

    @property
    def first_row(self) -> int:
        """The number of the first line of numbers."""
        return self._layout.first_row

    @property
    def duplicates(self) -> int:
        """How many rows so far repeat the time of the row before."""
        return self._reading.duplicates

    def _read_heading(self, mapping: Mapping[str, str], ambient_C: float | None) -> None:
        self._row = 1
        head = self._read(HEAD_BYTES)
        layout = layout_of(head, self.name, len(head) < HEAD_BYTES)
        if layout.encoding not in ("utf-8", "utf-8-sig"):
            self._decoder = codecs.getincrementaldecoder(layout.encoding)(errors="replace")
            head = self._decoder.decode(head).encode()
        at = 0
        for _ in range(layout.first_row - 1):
            at = head.find(b"\n", at) + 1 or len(head)
        self._rest, self._row, self._layout = head[at:], layout.first_row, layout
        self._separator = layout.separator.encode()
        self.headings = list(layout.headings)
        self._reading = Reading(self.name, self.headings, mapping, ambient_C)
        self._used, self._clock = self._reading.used, Moments()

    def __iter__(self) -> Iterator[Block]:
        """All blocks, in order. Raises DataError where a cell is no number or time runs backwards."""
        rest = b""
        while True:
            data, self._rest = self._rest or self._text(_BLOCK_BYTES), b""
            if not data:
                break
            data = rest + data
            cut = data.rfind(b"\n") + 1
            if not cut and len(data) > _MAX_LINE_BYTES:
                raise DataError(
                    f"{self.name}: row {self._row}: longer than {_MAX_LINE_BYTES} bytes; not a CSV file"
                )
            rest = data[cut:]
            if cut:
                yield from self._block(data[:cut])
        if rest.strip():
            if rest.count(self._separator) < len(self.headings) - 1:
                # A recorder that was killed leaves half a line; what it wrote before is good.
                self.notes.append(f"row {self._row} is cut short and was left out")
            else:
                yield from self._block(rest + b"\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()
        self._raw.close()

    def _block(self, text: bytes) -> Iterator[Block]:
        if b"\r" in text:
            text = text.replace(b"\r\n", b"\n")
        plain = self._layout.plain(text)
        table = None
        for parse in (_by_core, _by_arrow) if self._large else ():
            if table is None:
                table = parse(plain, len(self.headings), self._used, self._separator)
        if table is None:
            table = _fast(plain, len(self.headings), self._separator)
        rows = None
        if table is None:
            table, rows = self._careful(text)
        first_row, lines = self._row, text.count(b"\n")
        self._row += lines
        if not len(table):
            return
        numbers = rows if rows is not None else np.arange(first_row, first_row + lines)
        samples = self._reading.samples(lambda index: table[:, index], numbers)
        yield Block(samples, first_row, self._raw.tell())

    def _careful(self, text: bytes) -> tuple[Array, NDArray[np.int64]]:
        """Cell by cell; only the columns that are used."""
        names, used = self._used, sorted(self._used)
        values, rows = [], []
        for row, line in enumerate(text.split(b"\n")[:-1], start=self._row):
            if not line.strip() or is_comment(line.decode(errors="replace")):
                continue
            cells = self._layout.cells(line.decode(errors="replace"))
            if len(cells) <= used[-1]:
                raise DataError(
                    f"{self.name}: row {row}: {len(cells)} cells where the heading has {len(self.headings)}; "
                    "complete or remove the row"
                )
            values.append([self._number(cells[index], index, names[index], row) for index in used])
            rows.append(row)
        table = np.full((len(values), len(self.headings)), np.nan)
        table[:, used] = np.array(values).reshape(len(values), len(used))
        return table, np.array(rows, dtype=np.int64)

    def _number(self, cell: str, index: int, heading: str, row: int) -> float:
        value = number(cell, self._layout.decimal)
        if value is None and index == self._reading.time_at:
            value = self._clock.seconds(cell)
            if value is not None:
                self._reading.time_is_dated()
        if value is None:
            raise DataError(
                f"{self.name}: row {row}, column {heading!r}: {cell[:40]!r} is not a number; "
                "correct it, or leave the cell empty"
            )
        return value

    def _text(self, size: int) -> bytes:
        """The next bytes, in UTF-8; empty at the end."""
        data = self._read(size)
        if self._decoder is None:
            return data
        while data:
            text = self._decoder.decode(data)
            if text:
                return text.encode()
            data = self._read(size)
        return b""

    def _read(self, size: int) -> bytes:
        try:
            return self._file.read(size)
        except (EOFError, OSError, zlib.error) as error:
            raise DataError(
                f"{self.name}: row {self._row}: the compressed file is damaged or cut short ({error})"
            ) from None


def _open(path: str | Path) -> tuple[IO[bytes], IO[bytes]]:
    try:
        raw = Path(path).open("rb")
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}") from None
    magic = raw.read(2)
    raw.seek(0)
    return (io.BufferedReader(gzip.GzipFile(fileobj=raw)), raw) if magic == b"\x1f\x8b" else (raw, raw)


def _by_core(text: bytes, columns: int, used: Iterable[int], separator: bytes) -> Array | None:
    """The used columns (the others are NaN) read by the C core, where there is one and every cell is a plain number."""
    from motorlens_runtime.sensor.core_library import core

    library = core().library
    if library is None:
        return None
    wanted, lines = sorted(used), text.count(b"\n")
    places = np.full(columns, -1, dtype=np.int32)
    places[wanted] = np.arange(len(wanted))
    numbers = np.empty((len(wanted), lines))
    read_lines = library.motorlens_decimal_table(
        text, len(text), columns, separator, places.ctypes.data, lines, numbers.ctypes.data
    )
    if read_lines != lines:
        return None
    table = np.full((columns, lines), np.nan)
    table[wanted] = numbers
    return table.T


def _by_arrow(text: bytes, columns: int, used: Iterable[int], separator: bytes) -> Array | None:
    """The used columns (the others are NaN) read by pyarrow, where it is installed and every cell is a number; else None."""
    try:
        import pyarrow as pa
        from pyarrow import csv as arrow_csv
    except ModuleNotFoundError:
        return None
    names = [str(column) for column in used]
    try:
        found = arrow_csv.read_csv(
            pa.BufferReader(arrow_buffer(text)),
            read_options=arrow_csv.ReadOptions(
                use_threads=False, block_size=len(text) + 1, column_names=[str(k) for k in range(columns)]
            ),
            parse_options=arrow_csv.ParseOptions(delimiter=separator.decode(), quote_char=False),
            convert_options=arrow_csv.ConvertOptions(
                include_columns=names, column_types=dict.fromkeys(names, pa.float64()), null_values=[]
            ),
        )
    except pa.ArrowInvalid:
        return None
    if len(found) != text.count(b"\n"):
        return None
    table = np.full((columns, len(found)), np.nan)
    for name in names:
        # Not by `to_numpy`, which imports pandas wherever that is installed: 40 MB.
        chunks = found[name].chunks
        pieces = [np.frombuffer(c.buffers()[1])[c.offset : c.offset + len(c)] for c in chunks]
        np.concatenate(pieces, out=table[int(name)])
    return table.T


def _fast(text: bytes, columns: int, separator: bytes) -> Array | None:
    """All cells as numbers (rows, columns), or None if any is not one or a row has another number of cells."""
    raw = np.frombuffer(text, dtype=np.uint8)
    ends = raw == 10
    marks = np.flatnonzero(ends | (raw == separator[0]))
    if len(marks) % columns:
        return None
    grid = ends[marks].reshape(-1, columns)
    if not grid[:, -1].all() or grid[:, :-1].any():
        return None
    plain = read(raw, marks)
    if plain is not None:
        return plain.reshape(-1, columns)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            values = np.fromstring(
                text[:-1].replace(b"\n", separator), dtype=np.float64, sep=separator.decode()
            )
        except (ValueError, DeprecationWarning):
            return None
    return values.reshape(-1, columns) if len(values) == len(marks) else None
