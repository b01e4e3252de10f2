"""Files of recordings, one format a file: it names its `SUFFIXES` and reads a `Table`, and is found because it is here."""

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """A file whose headings are known and whose numbers are read on demand.

    Attributes:
        headings: one a column.
        numbers: from the columns asked for, by index, to an array (N,) each, as they stand in the file; missing is NaN.
            Raises DataError where a cell is no number.
        first_row: the line of the first numbers, from 1, for messages.
        notes: what was found and handled, in words; complete once `numbers` was called.
        named: whether the headings stand in the file.
        dated: columns whose cells are dates or times of day, given as seconds since the first; complete with `notes`.
    """

    headings: tuple[str, ...]
    numbers: Callable[[Sequence[int]], Mapping[int, Array]]
    first_row: int
    notes: list[str]
    named: bool = True
    dated: set[int] = field(default_factory=set)


def read_table(path: Path) -> Table:
    """Open a file by its suffix (`.gz` aside); what no format claims is read as text.

    Raises:
        DataError: it is not of its format, a folder, a motor file, or a library is missing, which is named.
        OSError: it cannot be read.
    """
    package = importlib.import_module(__name__)
    suffix = Path(path.name.lower().removesuffix(".gz")).suffix
    if path.is_dir():
        raise DataError(
            f"{path}: a folder; name the recordings in it, as {path}/*.csv, or give it to motorlens fleet"
        )
    if suffix == ".toml":
        raise DataError(f"{path}: no recording; a motor file is given as --motor {path}")
    formats: dict[str, ModuleType] = {}
    for module in pkgutil.iter_modules(package.__path__):
        reader = importlib.import_module(f"{__name__}.{module.name}")
        formats |= dict.fromkeys(getattr(reader, "SUFFIXES", ()), reader)
    chosen = formats.get(suffix, formats[".csv"])
    try:
        table: Table = chosen.read(path)
    except ModuleNotFoundError as error:
        raise DataError(
            f"{path}: needs {error.name}, which is not installed: pip install 'motorlens[{chosen.EXTRA}]'"
        ) from None
    return table
