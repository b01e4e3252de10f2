"""Files that the page sends: piece by piece, into one folder, within bounds, never over a file that is there."""

import os
import re
import shutil
import threading
from pathlib import Path

from motorlens_runtime.errors import DataError
from motorlens_workbench.web.shelf import RECORDINGS, is_motor

# An hour at 20 kHz of eight channels as text is 6 GB: too long for a page. A tenth of that is not.
MOST_OCTETS = 1 << 30
# What stays free on the disk.
SPARE_OCTETS = 256 << 20
_NAME = re.compile(r"[^\s/\\.\x00-\x1f-][^/\\\x00-\x1f]{0,150}")


class Uploads:
    """Takes files into `folder`, which is made when the first one comes."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()

    def take(self, name: str, offset: int, size: int, piece: bytes) -> str | None:
        """Add a piece to a file; a piece at 0 begins it anew.

        Args:
            name: of the file, without a folder.
            offset: octets that were sent before.
            size: of the whole file.
            piece: the next octets.

        Returns:
            The file's path once it is complete, until then None.

        Raises:
            DataError: the name is none, its end is unknown, it is too large, or the piece does not follow the one before.
        """
        if not _NAME.fullmatch(name) or not name.lower().endswith((*RECORDINGS, ".toml")):
            ends = ", ".join((*RECORDINGS, ".toml"))
            raise DataError(f"{name[:80]!r}: give a plain file name that ends in one of {ends}")
        if not 0 < size <= MOST_OCTETS:
            raise DataError(
                f"{name}: {size / 1e6:.0f} MB; a page takes files up to {MOST_OCTETS / 1e6:.0f} MB that are not empty; "
                "start the workbench with larger ones on its command line"
            )
        with self._lock:
            self._folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if shutil.disk_usage(self._folder).free < size - offset + SPARE_OCTETS:
                raise DataError(f"{name}: the disk is full")
            part = self._folder / f".{name}.part"
            there = part.stat().st_size if offset and part.exists() else 0
            if offset != there or offset + len(piece) > size or not piece:
                raise DataError(f"{name}: a piece is missing; send the file again")
            with part.open("ab" if offset else "wb") as file:
                file.write(piece)
            if offset + len(piece) < size:
                return None
            return self._finished(part, name)

    def _finished(self, part: Path, name: str) -> str:
        if name.lower().endswith(".toml") and not is_motor(part):
            part.unlink()
            raise DataError(f"{name}: is no motor file")
        stem, suffix = _split(name)
        for number in range(1, 10_000):
            path = self._folder / (f"{stem}{suffix}" if number == 1 else f"{stem}_{number}{suffix}")
            if not os.path.lexists(path):
                part.rename(path)
                return str(path)
        raise DataError(f"{name}: there are too many of that name")


def _split(name: str) -> tuple[str, str]:
    lower = name.lower()
    suffix = next(end for end in sorted((*RECORDINGS, ".toml"), key=len, reverse=True) if lower.endswith(end))
    return name[: -len(suffix)], name[-len(suffix) :]
