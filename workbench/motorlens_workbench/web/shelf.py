"""The files that the page may use: those the user named or sent, and the motor files and recordings of one folder."""

import os
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from motorlens_runtime.errors import DataError

# Files that are named or sent; in a folder, only those that are hardly anything else.
_SURE = (".csv", ".csv.gz", ".tsv", ".parquet", ".mat", ".mf4", ".mdf")
RECORDINGS = (*_SURE, ".txt", ".dat", ".log", ".asc")
# More files than anybody scrolls through: a folder of that many is the wrong one.
MOST = 2000
_OUTPUT = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]*\.toml")


@dataclass(frozen=True)
class MotorEntry:
    """A motor file: its name, the effects and sensor models that are in it, and those of them of which every value is
    stated (a deviation of 0) and never fitted, such as that a commanded voltage has no sensor."""

    name: str
    parts: tuple[str, ...]
    stated: tuple[str, ...] = ()


@dataclass(frozen=True)
class Shelf:
    """Names as they are typed in a command, relative to where the workbench was started.

    Attributes:
        named: files the user named.
        folder: whose files can be chosen too; None: none.
        sent: the folder of the files that the page has sent.
    """

    named: tuple[str, ...]
    folder: str | None
    sent: str | None = None

    def motors(self) -> list[MotorEntry]:
        """Motor files, in alphabetical order."""
        entries = []
        for name in self._names((".toml",)):
            entry = _entry(Path(name), name)
            if entry is not None:
                entries.append(entry)
        return entries

    def recordings(self) -> list[str]:
        """Recordings, in alphabetical order."""
        return self._names(RECORDINGS)

    def motor(self, name: str) -> MotorEntry:
        """The motor file of that name. Raises DataError if there is none on the shelf."""
        found = next((entry for entry in self.motors() if entry.name == name), None)
        if found is None:
            raise DataError(f"{name or 'no motor file'}: is none of the motor files here; choose one")
        return found

    def chosen(self, names: Sequence[str]) -> list[str]:
        """Recordings by name. Raises DataError for one that is not on the shelf."""
        there = self.recordings()
        for name in names:
            if name not in there:
                raise DataError(f"{name}: is none of the recordings here")
        return list(names)

    def new_motor(self, name: str) -> str:
        """Where a new motor file of that name goes. Raises DataError if it is no plain name or there already."""
        if not _OUTPUT.fullmatch(name):
            raise DataError(f"{name or 'no name'}: give the new motor file a plain name that ends in .toml")
        path = os.path.normpath(os.path.join(self.folder or ".", name))
        if os.path.lexists(path):
            raise DataError(f"{path}: is there already; motor files are kept, give another name")
        return _typed(path)

    def with_file(self, name: str) -> "Shelf":
        """With a file that was written."""
        return replace(self, named=(*self.named, name)) if name not in self.named else self

    def path(self, name: str) -> Path:
        """A file on the shelf. Raises DataError for any other."""
        if name not in self.recordings():
            self.motor(name)
        return Path(name)

    def _names(self, suffixes: tuple[str, ...]) -> list[str]:
        found = {_typed(name) for name in self.named if name.lower().endswith(suffixes)}
        if self.folder is not None:
            found |= set(_walk(self.folder, tuple(end for end in suffixes if end in (*_SURE, ".toml"))))
        if self.sent is not None:
            found |= set(_walk(self.sent, suffixes))
        return sorted(found)


def _walk(folder: str, suffixes: tuple[str, ...]) -> list[str]:
    """Files below a folder, nothing hidden, nothing that a link takes out of it."""
    root = Path(folder).resolve()
    found: list[str] = []
    for place, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name != "node_modules")
        for name in sorted(files):
            path = os.path.normpath(os.path.join(place, name))
            if name.startswith(".") or not name.lower().endswith(suffixes):
                continue
            if Path(path).resolve().is_relative_to(root):
                found.append(_typed(path))
            if len(found) >= MOST:
                return found
    return found


def _typed(path: str) -> str:
    """A path such that no command takes it for an option."""
    return f"./{path}" if path.startswith("-") else path


def is_motor(path: Path) -> bool:
    """Whether a file is a motor file."""
    return _entry(path, "") is not None


def _entry(path: Path, name: str) -> MotorEntry | None:
    """What is in a motor file; None if it is none."""
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    if not str(document.get("schema", "")).startswith("motorlens.motor/"):
        return None
    tables = [document.get(section, {}) for section in ("effects", "sensors")]
    parts = {part: values for table in tables if isinstance(table, dict) for part, values in table.items()}
    return MotorEntry(name, tuple(parts), tuple(part for part, values in parts.items() if _is_stated(values)))


def _is_stated(values: Any) -> bool:
    entries = list(values.values()) if isinstance(values, dict) else []
    return bool(entries) and all(isinstance(one, dict) and one.get("sd") == 0 for one in entries)
