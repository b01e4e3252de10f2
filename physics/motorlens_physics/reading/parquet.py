"""Recordings as Parquet."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from motorlens_physics.reading import Array, Table
from motorlens_runtime.errors import DataError

SUFFIXES = (".parquet",)
EXTRA = "workbench"


def read(path: Path) -> Table:
    """Open a Parquet file; only the columns asked for are read."""
    import pyarrow as pa
    import pyarrow.parquet

    try:
        file = pyarrow.parquet.ParquetFile(path)
    except pa.ArrowInvalid as error:
        raise DataError(f"{path}: not a Parquet file ({error})") from None
    headings = tuple(file.schema_arrow.names)
    dated: set[int] = set()

    def numbers(used: Sequence[int]) -> Mapping[int, Array]:
        content = file.read(columns=[headings[k] for k in used])
        table = {}
        for k in used:
            try:
                values = np.asarray(content.column(headings[k]).to_numpy())
                if values.dtype.kind in "mM":  # moments, or times since some moment
                    dated.add(k)
                    values = (values - values[:1]) / np.timedelta64(1, "s")
                table[k] = values.astype(np.float64)
            except (TypeError, ValueError):
                raise DataError(f"{path}: column {headings[k]!r} does not hold numbers") from None
        return table

    return Table(headings, numbers, 1, [], dated=dated)
