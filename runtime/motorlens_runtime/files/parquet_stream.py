"""Recorded samples from a Parquet file of any length, in constant memory. Needs pyarrow, of the `publish` extra.

A null is a missing number, as an empty cell of a CSV is. Whole numbers and decimals of any width are read;
columns that are no numbers must not be among those that are used.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.recorded import Block, Reading

Array = NDArray[np.float64]

# So many at a time: what a block costs beside its rows is little, and a few of them stay in the cache.
_ROWS = 1 << 16


class ParquetStream:
    """An open recording, see `recorded.Recorded`; rows count from 1.

    Raises:
        DataError: the file is damaged, lacks time, voltage or current, or pyarrow is not installed.
    """

    first_row = 1

    def __init__(self, path: str | Path, mapping: Mapping[str, str], ambient_C: float | None = None) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ModuleNotFoundError:
            raise DataError(
                f"{path}: a Parquet file needs pyarrow: pip install 'motorlens[publish]'"
            ) from None
        self.name, self._refused = str(path), (pa.ArrowInvalid, pa.ArrowNotImplementedError, OSError)
        self._float64, self._int64 = pa.float64(), pa.int64()
        self._moments: Any = None
        self._first_ns: int | None = None
        try:
            self._file = pq.ParquetFile(path, buffer_size=1 << 18)
        except self._refused as error:
            raise DataError(f"{path}: not a whole Parquet file: {_first_line(error)}") from None
        try:
            self._names = list(self._file.schema_arrow.names)
            self._reading = Reading(self.name, self._names, mapping, ambient_C)
            for index, heading in self._reading.used.items():
                kind = self._file.schema_arrow.types[index]
                if index == self._reading.time_at and pa.types.is_timestamp(kind):
                    self._reading.time_is_dated()
                    self._moments = pa.timestamp("ns", kind.tz)
                    continue
                if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind)):
                    raise DataError(f"{path}: column {heading!r} holds {kind}, not numbers; convert it")
        except DataError:
            self._file.close()
            raise
        self.size = self._file.metadata.num_rows
        self.notes: list[str] = []

    @property
    def duplicates(self) -> int:
        """How many rows so far repeat the time of the row before."""
        return self._reading.duplicates

    def __iter__(self) -> Iterator[Block]:
        """All blocks, in order. Raises DataError where the file is damaged or time runs backwards."""
        row, wanted = self.first_row, list(self._reading.used.values())
        try:
            for batch in self._file.iter_batches(_ROWS, columns=wanted):
                n = len(batch)
                table = {
                    index: self._numbers(batch.column(batch.schema.get_field_index(heading)))
                    for index, heading in self._reading.used.items()
                }
                if n:
                    samples = self._reading.samples(table.__getitem__, np.arange(row, row + n))
                    yield Block(samples, row, row + n - 1)
                row += n
        except self._refused as error:
            raise DataError(f"{self.name}: row {row}: damaged: {_first_line(error)}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _numbers(self, column: Any) -> Array:
        if str(column.type).startswith("timestamp"):
            column = self._elapsed(column)
        if column.type != self._float64:
            column = column.cast(self._float64, safe=False)
        # Not by `to_numpy`, which imports pandas wherever that is installed: 40 MB.
        values = np.frombuffer(column.buffers()[1])[column.offset : column.offset + len(column)]
        if column.null_count:
            missing = np.frombuffer(column.is_null().cast("uint8").buffers()[1], dtype=np.uint8)
            values = np.where(missing[: len(values)] > 0, np.nan, values)
        return values

    def _elapsed(self, column: Any) -> Any:
        """Moments as seconds since the first."""
        import pyarrow.compute as pc

        stamps = column.cast(self._moments, safe=False).cast(self._int64)
        if self._first_ns is None:
            self._first_ns = pc.min(stamps).as_py() or 0
        return pc.multiply(pc.subtract(stamps, self._first_ns).cast(self._float64, safe=False), 1e-9)


def _first_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120]
