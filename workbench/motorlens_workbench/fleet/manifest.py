"""Which recordings there are, of which motor, and when they were made.

From a folder: each folder in it is a motor, named like it; a file that lies in the folder itself is a motor of its own. A
date is read from the name of the file, as 2026-03-01 or 2026-03-01_1430. A folder that holds no recording is named too: its
motor is lacking. From a manifest: a CSV with the columns motor, recording and, if known, date, or a TOML with [[recording]]
tables of the same names; paths are relative to the manifest.
"""

import csv
import re
import tomllib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from motorlens_runtime.errors import DataError

# What a recording may be called (motorlens_physics.reading); a packed one ends in .gz besides.
SUFFIXES = (".csv", ".tsv", ".txt", ".parquet", ".mat", ".mf4", ".mdf")
_DATE = re.compile(r"(\d{4}-\d{2}-\d{2})(?:[T_ ]?(\d{2})[:h-]?(\d{2})(?:[:-]?(\d{2}))?)?")
_FIELDS = ("motor", "recording", "date")
_NO_RECORDING = f"holds no recording ({', '.join(SUFFIXES)}, also as .gz)"


@dataclass(frozen=True)
class Entry:
    """One recording.

    Attributes:
        motor: whose it is.
        path: where it lies.
        name: how it is called in what is written: its path, from the folder or the manifest on.
        date: when it was made; None if that is not known.
        lacks: why there is none, of a motor without any; its path is then where one was looked for.
    """

    motor: str
    path: Path
    name: str
    date: datetime | None = None
    lacks: str = ""


def entries(where: Path, output: Path | None = None) -> tuple[Entry, ...]:
    """The recordings of a folder or of a manifest, by motor, date and name.

    Args:
        where: the folder or the manifest.
        output: a folder that may lie in it and is no motor's.

    Raises:
        DataError: nothing there, or a manifest that is not one.
        OSError: it cannot be read.
    """
    if where.is_dir():
        found = list(_of_folder(where))
        if not found:
            raise DataError(f"{where}: {_NO_RECORDING}")
        found += _without(where, {entry.motor for entry in found}, output)
    elif where.suffix.lower() == ".toml":
        found = _of_toml(where)
    else:
        found = _of_csv(where)
    return tuple(sorted(found, key=lambda e: (e.motor, e.date or datetime.min, e.name)))


def date_in(name: str) -> datetime | None:
    """The first date in a name; None if there is none.

    >>> date_in("soak_2026-03-01_1430.csv").isoformat()
    '2026-03-01T14:30:00'
    >>> date_in("soak-12.csv") is None
    True
    """
    for match in _DATE.finditer(name):
        day, *clock = match.groups()
        try:
            return datetime.fromisoformat(f"{day}T{':'.join(part or '00' for part in clock)}")
        except ValueError:
            continue
    return None


def _of_folder(folder: Path) -> Iterable[Entry]:
    for path in sorted(folder.rglob("*")):
        inside = path.relative_to(folder)
        plain = path.name.removesuffix(".gz")
        if not path.is_file() or not plain.lower().endswith(SUFFIXES) or inside.parts[0].startswith("."):
            continue
        motor = inside.parts[0] if len(inside.parts) > 1 else Path(plain).stem
        yield Entry(motor, path, inside.as_posix(), date_in(path.name))


def _without(folder: Path, motors: Collection[str], output: Path | None) -> Iterable[Entry]:
    """The folders of motors of which nothing was recorded."""
    for path in sorted(folder.iterdir()):
        mine = path.is_dir() and not path.name.startswith(".") and path.name not in motors
        if mine and (output is None or path.resolve() not in (output.resolve(), *output.resolve().parents)):
            yield Entry(path.name, path, f"{path.name}/", lacks=_NO_RECORDING)


def _of_csv(path: Path) -> list[Entry]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        reader = csv.DictReader(file)
        if not {"motor", "recording"} <= set(reader.fieldnames or ()):
            raise DataError(f"{path}: a manifest has the columns motor, recording and, if known, date")
        return [_entry(path, number, row) for number, row in enumerate(reader, 2)]


def _of_toml(path: Path) -> list[Entry]:
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8")).get("recording", [])
    except tomllib.TOMLDecodeError as error:
        raise DataError(f"{path}: not a manifest: {error}") from None
    if not isinstance(tables, list) or not tables:
        raise DataError(
            f"{path}: a manifest has [[recording]] tables with motor, recording and, if known, date"
        )
    return [_entry(path, number, table) for number, table in enumerate(tables, 1)]


def _entry(manifest: Path, number: int, row: dict[str, object]) -> Entry:
    motor, recording, date = (row.get(field) for field in _FIELDS)
    if not isinstance(motor, str) or not isinstance(recording, str) or not motor or not recording:
        raise DataError(f"{manifest}, entry {number}: lacks motor or recording")
    when = None
    if date:
        try:
            when = datetime.fromisoformat(str(date)).replace(tzinfo=None)
        except ValueError:
            raise DataError(
                f"{manifest}, entry {number}: date {date!r} is not written as 2026-03-01"
            ) from None
    return Entry(motor, manifest.parent / recording, recording, when or date_in(Path(recording).name))
