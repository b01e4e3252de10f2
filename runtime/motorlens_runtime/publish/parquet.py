"""`parquet:FILE`: the columns of `csv` in full precision, in row groups. Needs the `publish` extra.

A Parquet file is readable only once its end is written. A recorder that may be killed writes a folder, `parquet:FOLDER/`:
parts of `rows=65536` rows, see `parquet_folder`.
"""

from pathlib import Path
from typing import Any
from urllib.parse import SplitResult

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.files.parquet_folder import ParquetFolder, arrow_of
from motorlens_runtime.publish import Header, Publisher, file_of, options_of

_ROWS_PER_GROUP = 1 << 16


def open_url(url: SplitResult, header: Header) -> Publisher:
    """See `publish`. An existing file is replaced, an existing folder added to."""
    path = file_of(url)
    if not path.endswith("/"):
        options_of(url)
        return ParquetPublisher(path, header)
    rows = options_of(url, rows=65536.0)["rows"]
    if not 1 <= rows <= 1e7:
        raise DataError(f"{url.geturl()}: rows={rows:g}; from 1 to ten million")
    return ParquetFolderPublisher(Path(path), header, int(rows))


def _about(header: Header) -> dict[str, str]:
    return {
        "motorlens.sensor": header.sensor,
        "motorlens.version": header.version,
        "motorlens.sha256": header.digest,
    }


class ParquetFolderPublisher:
    """Writes to a folder by its name."""

    gather_s = 0.02

    def __init__(self, folder: Path, header: Header, rows_per_part: int) -> None:
        headings = [name for output in header.outputs for name in (output.heading, output.sd_heading)]
        self._folder = ParquetFolder(folder, headings, _about(header), rows_per_part)

    def publish(self, estimates: Estimates) -> None:
        """Append the rows to the journal."""
        self._folder.write(estimates)

    def flush(self) -> None:
        """Make what was written outlive this process."""
        self._folder.flush()

    def close(self) -> None:
        """Finish the last part."""
        self._folder.close()


class ParquetPublisher:
    """Writes to a file by its name."""

    gather_s = 0.02

    def __init__(self, path: str, header: Header) -> None:
        headings = [name for output in header.outputs for name in (output.heading, output.sd_heading)]
        fields = [
            ("time_s", pa.float64()),
            *((name, pa.float64()) for name in headings),
            ("quality", pa.uint32()),
        ]
        self._schema = pa.schema(
            [pa.field(name, kind, nullable=False) for name, kind in fields], metadata=_about(header)
        )
        # Noise does not repeat: a dictionary or a compression of such a column only costs time.
        self._writer = pq.ParquetWriter(
            path, self._schema, use_dictionary=["quality"], write_statistics=["time_s", "quality"],
            compression={"time_s": "lz4", **dict.fromkeys(headings, "none"), "quality": "lz4"},
        )  # fmt: skip
        self._waiting: list[Estimates] = []
        self._rows = 0

    def publish(self, estimates: Estimates) -> None:
        """Keep the rows until a row group is full."""
        self._waiting.append(estimates)
        self._rows += len(estimates)
        if self._rows >= _ROWS_PER_GROUP:
            self._write()

    def flush(self) -> None:
        """Nothing: row groups are written when they are full."""

    def close(self) -> None:
        """Write what is left and the end of the file."""
        self._write()
        self._writer.close()

    def _write(self) -> None:
        if not self._rows:
            return
        waiting = self._waiting
        arrays = [_joined([e.time_ns for e in waiting]) / 1e9]
        for output in range(waiting[0].values.shape[1]):
            arrays.append(_joined([e.values[:, output] for e in waiting]))
            arrays.append(_joined([e.sigma[:, output] for e in waiting]))
        arrays.append(_joined([e.quality for e in waiting]))
        self._writer.write_table(pa.table([arrow_of(array) for array in arrays], schema=self._schema))
        self._waiting, self._rows = [], 0


def _joined(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """The parts one after another; one alone is not copied."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
