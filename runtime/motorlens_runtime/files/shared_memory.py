"""The newest estimates in shared memory, for a control process beside the runtime: a ring of rows, one writer, many readers.

    from motorlens_runtime.files.shared_memory import Reader
    reader = Reader("/dev/shm/motorlens")
    row = reader.latest()
    if row is not None and row.quality == 0: control(row.values[0])

Each row carries its number and a CRC-32, so that a reader takes no row that is half written, whatever the processor does
to the order of stores. The writer never waits; a reader that is slower than the ring is long sees which rows it missed.

Layout, little-endian: `HEADER`, then the JSON that names the columns, then `capacity` rows of `row_type(outputs)`.
"""

import fcntl
import json
import mmap
import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.line.crc32 import crc32_rows

# magic, version, number of outputs, capacity in rows, offset of the first row, length of the JSON, process of the writer
HEADER = struct.Struct("<8sIIIIII")
MAGIC = b"motorlns"
VERSION = 1
# Where the number of rows written so far stands: aligned, and alone in its cache line.
COUNT_AT = 64
_JSON_AT = 128


def row_type(outputs: int) -> np.dtype[Any]:
    """One row: its number from 1, time, values, standard deviations, quality word, CRC-32 of all before it."""
    return np.dtype(
        [("number", "<u8"), ("time_ns", "<i8"), ("values", "<f8", (outputs,)), ("sigma", "<f8", (outputs,)),
         ("quality", "<u4"), ("crc", "<u4")]
    )  # fmt: skip


@dataclass(frozen=True)
class Row:
    """One row. `values` and `sigma` have shape (K,)."""

    number: int
    time_ns: int
    values: NDArray[np.float64]
    sigma: NDArray[np.float64]
    quality: int


class Writer:
    """The one who writes. The file appears complete, and is replaced, never changed in size, by a later writer."""

    def __init__(self, path: str | Path, columns: dict[str, Any], outputs: int, capacity: int = 4096) -> None:
        self._path = Path(path)
        self._layout = row_type(outputs)
        self._capacity = capacity
        self._count = 0
        _refuse_if_taken(self._path)
        text = json.dumps(columns).encode()
        start = -(-(_JSON_AT + len(text)) // 64) * 64
        draft = self._path.with_name(f".{self._path.name}.{os.getpid()}")
        try:
            self._file = draft.open("w+b")
            self._file.truncate(start + capacity * self._layout.itemsize)
            self._map = mmap.mmap(self._file.fileno(), 0)
        except OSError as error:
            raise DeviceError(f"{self._path}: {error.strerror}") from None
        HEADER.pack_into(self._map, 0, MAGIC, VERSION, outputs, capacity, start, len(text), os.getpid())
        self._map[_JSON_AT : _JSON_AT + len(text)] = text
        self._rows = np.frombuffer(self._map, dtype=self._layout, count=capacity, offset=start)
        self._counter = np.frombuffer(self._map, dtype="<u8", count=1, offset=COUNT_AT)
        fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.replace(draft, self._path)

    def write(
        self,
        time_ns: NDArray[np.int64],
        values: NDArray[np.float64],
        sigma: NDArray[np.float64],
        quality: NDArray[np.uint32],
    ) -> None:
        """Append n rows: (n,), (n, K), (n, K), (n,). Of more rows than the ring holds, the last ones are kept."""
        n = len(time_ns)
        kept = min(n, self._capacity)
        rows = np.zeros(kept, dtype=self._layout)
        rows["number"] = np.arange(self._count + n - kept + 1, self._count + n + 1)
        rows["time_ns"], rows["values"], rows["sigma"] = (
            time_ns[n - kept :],
            values[n - kept :],
            sigma[n - kept :],
        )
        rows["quality"] = quality[n - kept :]
        octets = rows.view(np.uint8).reshape(kept, self._layout.itemsize)
        rows["crc"] = crc32_rows(octets[:, :-4])
        place = (self._count + n - kept) % self._capacity
        first = min(kept, self._capacity - place)
        self._rows[place : place + first] = rows[:first]
        self._rows[: kept - first] = rows[first:]
        self._count += n
        self._counter[0] = self._count

    def close(self) -> None:
        """Take the file away; readers that have it open see that nothing more comes."""
        if self._file.closed:
            return
        if _same_file(self._path, self._file.fileno()):
            self._path.unlink()
        # Readers' maps stay; ours goes with its last view.
        del self._rows, self._counter
        self._map.close()
        self._file.close()


class Reader:
    """One who reads.

    Attributes:
        columns: what the writer says the columns are.

    Raises:
        DeviceError: nobody publishes there.
        DataError: the file is something else.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        try:
            with self._path.open("rb") as file:
                self._inode = os.fstat(file.fileno()).st_ino
                self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise DeviceError(f"{self._path}: {reason}; is a runtime publishing with shm: there?") from None
        if len(self._map) < _JSON_AT or self._map[:8] != MAGIC:
            raise DataError(f"{self._path}: is not the shared memory of a motorlens runtime")
        _, version, outputs, capacity, start, length, self.writer_pid = HEADER.unpack_from(self._map)
        if version != VERSION:
            raise DataError(f"{self._path}: layout version {version}; this reader knows {VERSION}")
        self.columns: dict[str, Any] = json.loads(self._map[_JSON_AT : _JSON_AT + length])
        self._layout = row_type(outputs)
        self._capacity = capacity
        self._start = start
        self._seen = 0

    def latest(self) -> Row | None:
        """The newest complete row; None before the first."""
        for _ in range(8):
            count = self._count()
            if count == 0:
                return None
            row = self._row(count)
            if row is not None:
                return row
        return None

    def since_last(self) -> tuple[NDArray[Any], int]:
        """The rows (structured, of `row_type`) that are new since the last call, and how many were overwritten unread."""
        count = self._count()
        first = max(self._seen + 1, count - self._capacity + 1)
        index = (np.arange(first, count + 1) - 1) % self._capacity
        ring = np.frombuffer(self._map, dtype=self._layout, count=self._capacity, offset=self._start)
        rows = ring[index]
        octets = rows.view(np.uint8).reshape(len(rows), self._layout.itemsize)
        whole = (crc32_rows(octets[:, :-4]) == rows["crc"]) & (rows["number"] == np.arange(first, count + 1))
        lost = first - self._seen - 1 + int((~whole).sum())
        self._seen = count
        return rows[whole], lost

    def replaced(self) -> bool:
        """Whether the writer has gone or a new one has taken its place: then open another reader."""
        try:
            return os.stat(self._path).st_ino != self._inode
        except OSError:
            return True

    def close(self) -> None:
        """Let go of the memory."""
        self._map.close()

    def _count(self) -> int:
        return int.from_bytes(self._map[COUNT_AT : COUNT_AT + 8], "little")

    def _row(self, number: int) -> Row | None:
        size = self._layout.itemsize
        at = self._start + (number - 1) % self._capacity * size
        octets = self._map[at : at + size]
        row = np.frombuffer(octets, dtype=self._layout)[0]
        if int(row["number"]) != number or zlib.crc32(octets[:-4]) != int(row["crc"]):
            return None
        return Row(number, int(row["time_ns"]), row["values"], row["sigma"], int(row["quality"]))


def _refuse_if_taken(path: Path) -> None:
    try:
        with path.open("rb") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
            except OSError:
                head = file.read(HEADER.size)
                owner = (
                    f"process {HEADER.unpack(head)[-1]}" if len(head) == HEADER.size else "another process"
                )
                raise DeviceError(f"{path}: {owner} publishes there already; choose another name") from None
            head = file.read(8)
    except FileNotFoundError:
        return
    except OSError as error:
        raise DeviceError(f"{path}: {error.strerror}") from None
    if head != MAGIC:
        raise DeviceError(f"{path}: is a file of another kind; it is not replaced")


def _same_file(path: Path, descriptor: int) -> bool:
    try:
        return os.stat(path).st_ino == os.fstat(descriptor).st_ino
    except OSError:
        return False
