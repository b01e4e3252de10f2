"""A folder of Parquet files that survives being killed: finished parts, and a journal of the rows since the last one.

A Parquet file is readable only once its end is written. So rows go to `part-000007.journal` as they are, each with a CRC-32,
which costs one append. A full journal becomes `part-000007.parquet` (written under another name, synced, renamed) and is
removed then. Whoever opens the folder next does the same with a journal that was left behind.
"""

import fcntl
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.line.crc32 import crc32_rows


class ParquetFolder:
    """One writer of a folder.

    Args:
        folder: made if absent.
        headings: of values and standard deviations, alternating.
        about: metadata of each part.
        rows_per_part: a part is finished when it holds so many rows, and at the end.

    Raises:
        DeviceError: the folder cannot be written, or another process writes it.
    """

    def __init__(
        self, folder: Path, headings: Sequence[str], about: dict[str, str], rows_per_part: int = 1 << 16
    ) -> None:
        self._folder = folder
        self._headings = list(headings)
        self._about = about
        self._rows_per_part = rows_per_part
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for journal in sorted(folder.glob("part-*.journal")):
                with journal.open("rb") as file:
                    _lock(file, folder)
                _finish(journal)
            self._number = max((int(path.stem[5:]) for path in folder.glob("part-*.parquet")), default=0)
            self._journal = self._next_journal()
        except OSError as error:
            raise DeviceError(f"{folder}: {error.strerror or error}") from None

    def write(self, estimates: Estimates) -> None:
        """Append rows."""
        rows = np.zeros(len(estimates), dtype=_row_type(len(self._headings)))
        rows["time_s"] = estimates.time_ns / 1e9
        rows["numbers"] = np.stack((estimates.values, estimates.sigma), axis=2).reshape(
            len(rows), len(self._headings)
        )
        rows["quality"] = estimates.quality
        rows["crc"] = crc32_rows(_octets(rows)[:, :-4])
        while len(rows):
            now, rows = np.split(rows, [self._rows_per_part - self._count])
            self._journal.write(now.tobytes())
            self._count += len(now)
            if self._count >= self._rows_per_part:
                self.close()
                self._journal = self._next_journal()

    def flush(self) -> None:
        """Make the rows outlive this process."""
        self._journal.flush()

    def close(self) -> None:
        """Finish the last part."""
        if not self._journal.closed:
            self._journal.close()
            _finish(self._folder / f"part-{self._number:06d}.journal")

    def _next_journal(self) -> IO[bytes]:
        self._number += 1
        self._count = 0
        journal = (self._folder / f"part-{self._number:06d}.journal").open("xb")
        _lock(journal, self._folder)
        # One line says what the rows are, for whoever has to finish this part.
        journal.write(json.dumps({"headings": self._headings, "about": self._about}).encode() + b"\n")
        return journal


def _row_type(numbers: int) -> np.dtype[Any]:
    return np.dtype([("time_s", "<f8"), ("numbers", "<f8", (numbers,)), ("quality", "<u4"), ("crc", "<u4")])


def _octets(rows: NDArray[Any]) -> NDArray[np.uint8]:
    return rows.view(np.uint8).reshape(len(rows), rows.dtype.itemsize)


def _lock(file: IO[bytes], folder: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise DeviceError(f"{folder}: another process writes there; name another folder") from None


def _finish(journal: Path) -> None:
    """Turn a journal into its part, as far as its rows are whole; nothing is left of an empty one."""
    line, _, data = journal.read_bytes().partition(b"\n")
    try:
        head = json.loads(line)
        headings, about = head["headings"], head["about"]
    except (ValueError, KeyError, TypeError):
        headings, about, data = [], {}, b""  # killed before its first line was on disk
    layout = _row_type(len(headings))
    rows = np.frombuffer(bytearray(data[: len(data) // layout.itemsize * layout.itemsize]), dtype=layout)
    damaged = np.flatnonzero(crc32_rows(_octets(rows)[:, :-4]) != rows["crc"])
    rows = rows[: int(damaged[0])] if len(damaged) else rows
    part = journal.with_suffix(".parquet")
    if len(rows) and not part.exists():
        draft = journal.with_suffix(".draft")
        with draft.open("wb") as file:
            # Noise does not repeat: a dictionary per column only costs time.
            pq.write_table(_table(rows, headings, about), file, use_dictionary=["quality"], compression="lz4")
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, part)
    journal.unlink()


def _table(rows: NDArray[Any], headings: Sequence[str], about: dict[str, str]) -> pa.Table:
    fields = [
        ("time_s", pa.float64()),
        *((name, pa.float64()) for name in headings),
        ("quality", pa.uint32()),
    ]
    columns = [rows["time_s"], *rows["numbers"].T, rows["quality"]]
    arrays = [arrow_of(column) for column in columns]
    return pa.table(arrays, schema=pa.schema(fields, metadata=about))


def arrow_of(column: NDArray[Any]) -> pa.Array:
    """The same numbers for pyarrow, not copied. `pyarrow.array` would import pandas wherever that is installed."""
    column = np.ascontiguousarray(column)
    kind = pa.from_numpy_dtype(column.dtype)
    return pa.Array.from_buffers(kind, len(column), [None, pa.py_buffer(column)])
