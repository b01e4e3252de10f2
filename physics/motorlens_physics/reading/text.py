"""Recordings as text: CSV and its relatives, zipped or not; see `motorlens_runtime.files.layout` for what is understood."""

import gzip
import zlib
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_physics.reading import Array, Table
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import WORDS
from motorlens_runtime.files.layout import HEAD_BYTES, MISSING, Layout, is_comment, layout_of, number, split

SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log", ".asc")
EXTRA = "workbench"
# What a word means in a column that holds words.
_CODES = {word: float(code) for words in WORDS.values() for code, word in enumerate(words)}


def read(path: Path) -> Table:
    """Read a text file whole; its numbers are parsed when they are asked for."""
    raw = path.read_bytes()
    if raw.startswith(b"\x1f\x8b"):
        try:
            raw = gzip.decompress(raw)
        except (EOFError, OSError, zlib.error) as error:
            raise DataError(f"{path}: the compressed file is damaged or cut short ({error})") from None
    layout = layout_of(raw[:HEAD_BYTES], str(path), len(raw) <= HEAD_BYTES)
    if layout.encoding not in ("utf-8", "utf-8-sig"):
        raw = raw.decode(layout.encoding, errors="replace").encode()
    if b"\r" in raw[:HEAD_BYTES] and b"\n" not in raw[:HEAD_BYTES]:
        raw = raw.replace(b"\r", b"\n")
    at = 0
    for _ in range(layout.first_row - 1):
        at = raw.find(b"\n", at) + 1 or len(raw)
    # A large file is not held twice.
    body = memoryview(layout.plain(raw[at:])) if layout.separator == " " else memoryview(raw)[at:]
    notes: list[str] = []

    def numbers(used: Sequence[int]) -> Mapping[int, Array]:
        if not (bytes(body[:HEAD_BYTES]).strip() or bytes(body).strip()):
            raise DataError(f"{path}: 0 rows of data; a recording needs at least two")
        fast = _by_arrow(body, layout, used, notes)
        return fast if fast is not None else _by_cell(body, layout, used, path, notes)

    return Table(layout.headings, numbers, layout.first_row, notes, layout.named)


def _by_arrow(
    body: memoryview, layout: Layout, used: Sequence[int], notes: list[str]
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

    try:
        found = csv.read_csv(
            pa.BufferReader(body),
            read_options=csv.ReadOptions(column_names=list(names.values()), block_size=1 << 24),
            parse_options=csv.ParseOptions(delimiter=layout.separator, invalid_row_handler=skip),
            convert_options=csv.ConvertOptions(
                include_columns=[names[k] for k in used],
                column_types={names[k]: pa.float64() for k in used},
                null_values=sorted(words),
                decimal_point=layout.decimal,
            ),
        )
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):
        return None
    last = bytes(body[-HEAD_BYTES:]).rstrip().rpartition(b"\n")[2].decode(errors="replace").strip()
    comments = [row for row in short if is_comment(row.text)]
    cut = [row for row in short if row.text.strip() == last and row not in comments]
    if len(comments) + len(cut) < len(short):
        return None
    notes += _left_out(len(comments), bool(cut))
    table = {}
    for k in used:
        # Not by `to_numpy`, which imports pandas wherever that is installed.
        chunks = found[names[k]].chunks
        table[k] = np.concatenate([np.asarray(chunk.fill_null(np.nan)) for chunk in chunks] or [np.empty(0)])
    return table


def _by_cell(
    body: memoryview, layout: Layout, used: Sequence[int], path: Path, notes: list[str]
) -> Mapping[int, Array]:
    """Line by line: slower, and says exactly which cell is at fault. A date and time becomes seconds since the first."""
    table: dict[int, list[float]] = {k: [] for k in used}
    lines = bytes(body).decode("utf-8", errors="replace").splitlines()
    origin: dict[int, datetime] = {}
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
                value = _seconds(cell, k, origin)
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


def _seconds(cell: str, column: int, origin: dict[int, datetime]) -> float | None:
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return None
    try:
        return (moment - origin.setdefault(column, moment)).total_seconds()
    except TypeError:  # one with a time zone, one without
        return None
