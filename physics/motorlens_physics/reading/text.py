"""Recordings as text: CSV and its relatives, zipped or not; see `motorlens_runtime.files.layout` for what is understood."""

import codecs
import gzip
import io
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from motorlens_physics.large_arrays import give_back, sweep
from motorlens_physics.reading import Array, Table
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.arrow_memory import arrow_buffer, blocks_of_lines
from motorlens_runtime.files.layout import HEAD_BYTES, MISSING, Layout, is_comment, layout_of, number, split
from motorlens_runtime.files.moments import Moments
from motorlens_runtime.files.words import WORDS

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc")
EXTRA = "workbench"
# What a word means in a column that holds words.
_CODES = {word: float(code) for words in WORDS.values() for code, word in enumerate(words)}


@dataclass(frozen=True)
class _Body:
    """What follows the headings: in the file from octet `at` on, or here where it had to be written anew to be read."""

    path: Path
    at: int
    anew: bytes | None = None

    def opened(self) -> BinaryIO:
        """To be read from its beginning, piece by piece: a large file is not held in memory."""
        if self.anew is not None:
            return io.BytesIO(self.anew)
        file = self.path.open("rb")
        file.seek(self.at)
        return file

    def whole(self) -> bytes:
        """All of it."""
        with self.opened() as file:
            return file.read()

    def end(self) -> bytes:
        """Its last octets."""
        with self.opened() as file:
            begin, size = file.tell(), file.seek(0, io.SEEK_END)
            file.seek(max(begin, size - HEAD_BYTES))
            return file.read()

    def is_utf8(self) -> bool:
        """Whether it is all UTF-8: Arrow cannot tell us of a row that is not."""
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            with self.opened() as file:
                for piece in iter(lambda: file.read(1 << 20), b""):
                    decoder.decode(piece)
        except UnicodeDecodeError:
            return False
        return True

    def is_empty(self) -> bool:
        """Whether nothing but blanks is in it."""
        with self.opened() as file:
            return not any(piece.strip() for piece in iter(lambda: file.read(HEAD_BYTES), b""))


def read(path: Path) -> Table:
    """Open a text file; its numbers are parsed when they are asked for."""
    with _Body(path, 0).opened() as file:
        head = file.read(HEAD_BYTES)
        short = not file.read(1)
    raw = None
    if head.startswith(b"\x1f\x8b"):
        try:
            raw = gzip.decompress(path.read_bytes())
        except (EOFError, OSError, zlib.error) as error:
            raise DataError(f"{path}: the compressed file is damaged or cut short ({error})") from None
        head, short = raw[:HEAD_BYTES], len(raw) <= HEAD_BYTES
    layout = layout_of(head, str(path), short)
    if layout.encoding not in ("utf-8", "utf-8-sig"):
        raw = (path.read_bytes() if raw is None else raw).decode(layout.encoding, errors="replace").encode()
        head = raw[:HEAD_BYTES]
    if b"\r" in head and b"\n" not in head:
        raw = (path.read_bytes() if raw is None else raw).replace(b"\r", b"\n")
    with _Body(path, 0, raw).opened() as file:
        for _ in range(layout.first_row - 1):
            file.readline()
        at = file.tell()
        blanks = layout.separator == " "
        body = _Body(path, at, file.read() if blanks or raw is not None else None)
    if blanks and body.anew is not None:
        body = replace(body, anew=layout.plain(body.anew))
    notes: list[str] = []
    dated: set[int] = set()

    def numbers(used: Sequence[int]) -> Mapping[int, Array]:
        if body.is_empty():
            raise DataError(f"{path}: 0 rows of data; a recording needs at least two")
        fast = _by_arrow(body, layout, used, notes)
        return fast if fast is not None else _by_cell(body.whole(), layout, used, path, notes, dated)

    return Table(layout.headings, numbers, layout.first_row, notes, layout.named, dated)


def _by_arrow(
    body: _Body, layout: Layout, used: Sequence[int], notes: list[str]
) -> Mapping[int, Array] | None:
    """The columns asked for where every cell of them is a number or missing; None where some are not."""
    try:
        import pyarrow as pa
        from pyarrow import csv
    except ModuleNotFoundError:
        return None
    names = {k: str(k) for k in range(len(layout.headings))}
    words = {form for word in MISSING for form in (word, word.upper(), word.title())} | {"NaN"}
    short: list[Any] = []

    def skip(row: Any) -> str:
        short.append(row)
        return "skip"

    if not body.is_utf8():
        return None
    parts: dict[int, list[Array]] = {k: [] for k in used}
    give_back()
    try:
        with body.opened() as file:
            for block in blocks_of_lines(file):
                if block.isspace():
                    continue
                batch = csv.read_csv(
                    pa.BufferReader(arrow_buffer(block)),
                    read_options=csv.ReadOptions(
                        column_names=list(names.values()), use_threads=False, block_size=len(block) + 1
                    ),
                    parse_options=csv.ParseOptions(delimiter=layout.separator, invalid_row_handler=skip),
                    convert_options=csv.ConvertOptions(
                        include_columns=[names[k] for k in used],
                        column_types={names[k]: pa.float64() for k in used},
                        null_values=sorted(words),
                        decimal_point=layout.decimal,
                    ),
                )
                for k in used:
                    parts[k] += [_numbers(chunk) for chunk in batch.column(names[k]).chunks]
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    last = body.end().rstrip().rpartition(b"\n")[2].decode(errors="replace").strip()
    comments = [row for row in short if is_comment(row.text)]
    cut = [row for row in short if row.text.strip() == last and row not in comments]
    if len(comments) + len(cut) < len(short):
        return None
    notes += _left_out(len(comments), bool(cut))
    # A part is given back as soon as it stands in its column, and by Arrow, which would keep it for other tables.
    columns = {k: np.concatenate(parts.pop(k) or [np.empty(0)]) for k in used}
    pa.default_memory_pool().release_unused()
    sweep()
    return columns


def _numbers(column: Any) -> Array:
    """(n,) of an Arrow column of float64, NaN where null; without Arrow's own functions, which load 40 MB."""
    values = np.frombuffer(column.buffers()[1])[column.offset : column.offset + len(column)]
    if not column.null_count:
        return values.copy()
    there = np.unpackbits(np.frombuffer(column.buffers()[0], dtype=np.uint8), bitorder="little")
    return np.where(there[column.offset : column.offset + len(column)] > 0, values, np.nan)


def _by_cell(
    body: bytes, layout: Layout, used: Sequence[int], path: Path, notes: list[str], dated: set[int]
) -> Mapping[int, Array]:
    """Line by line: slower, and says exactly which cell is at fault. A date and time becomes seconds since the first."""
    table: dict[int, list[float]] = {k: [] for k in used}
    lines = body.decode("utf-8", errors="replace").splitlines()
    clocks = {k: Moments() for k in used}
    comments = 0
    while lines and not lines[-1].strip():
        lines.pop()
    for row, line in enumerate(lines, start=layout.first_row):
        if not line.strip():
            continue
        if is_comment(line):
            comments += 1
            continue
        cells = split(line, layout.separator)
        if len(cells) < len(layout.headings) and row == layout.first_row + len(lines) - 1:
            # A recorder that was killed leaves half a line; what it wrote before is good.
            notes += _left_out(0, True)
            break
        for k in used:
            cell = cells[k] if k < len(cells) else ""
            value = number(cell, layout.decimal)
            if value is None:
                value = _CODES.get(cell.strip().lower())
            if value is None:
                value = clocks[k].seconds(cell)
                if value is not None:
                    dated.add(k)
            if value is None:
                raise DataError(
                    f"{path}: row {row}, column {layout.headings[k]!r}: {cell[:40]!r} is not a number; "
                    "correct it, or leave the cell empty"
                )
            table[k].append(value)
    notes += _left_out(comments, False)
    return {k: np.array(column) for k, column in table.items()}


def _left_out(comments: int, cut: bool) -> list[str]:
    said = [f"{comments} comment lines between the numbers left out"] if comments else []
    return said + (["the last line is cut short and was left out"] if cut else [])
