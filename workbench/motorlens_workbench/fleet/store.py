"""Results as files named by what they follow from: the recording, the motor file, how it is read, and the code.

A result that is there is never computed again, one that is half written never exists, and who runs second finds the same
bytes: a run that was killed goes on where it was.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import motorlens_physics
import motorlens_runtime.files


def digest(*parts: bytes) -> str:
    """SHA-256 of parts, each with its length, so that what ends the one cannot begin the other."""
    whole = hashlib.sha256()
    for part in parts:
        whole.update(len(part).to_bytes(8, "little") + part)
    return whole.hexdigest()


@cache
def code_version(*more: ModuleType) -> str:
    """The version of the distribution, and a hash of the sources on which the result of a recording depends.

    Args:
        more: packages on which it depends besides.
    """
    sources = hashlib.sha256()
    here = Path(__file__).parent
    for package in (motorlens_physics, motorlens_runtime.files, *more):
        root = Path(package.__path__[0])
        for path in sorted(root.rglob("*.py")):
            sources.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for name in ("work.py", "summary.py"):
        sources.update((here / name).read_bytes())
    return f"{version('motorlens')}+{sources.hexdigest()[:16]}"


def canonical(document: Mapping[str, Any]) -> bytes:
    """A document as bytes: the same ones for the same content."""
    text = json.dumps(document, sort_keys=True, allow_nan=False, ensure_ascii=False, indent=1)
    return text.encode() + b"\n"


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file that is there in full or not at all, whenever the process or the machine ends."""
    path.parent.mkdir(parents=True, exist_ok=True)
    half = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with half.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(half, path)
    finally:
        half.unlink(missing_ok=True)


@dataclass(frozen=True)
class Store:
    """A folder of results, by key."""

    folder: Path

    def path(self, key: str) -> Path:
        """Where the result of a key is, or would be."""
        return self.folder / key[:2] / f"{key}.json"

    def read(self, key: str) -> dict[str, Any] | None:
        """A result; None if there is none, or none that can be read."""
        try:
            found = json.loads(self.path(key).read_bytes())
        except (FileNotFoundError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def write(self, key: str, document: Mapping[str, Any]) -> None:
        """Keep a result."""
        write_atomically(self.path(key), canonical(document))

    def clear_halves(self) -> None:
        """Remove what killed processes have left half written."""
        for half in self.folder.glob("*/.*.json.*"):
            half.unlink(missing_ok=True)
