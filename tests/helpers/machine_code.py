"""numba's cache, shared by the workers of a run: what one has compiled, the others load.

numba reads the index of a function, adds to it and writes it without a lock, and writes the code after the index that names
it (numba.core.caching.IndexDataCacheFile): two processes at once can leave an index that points at the wrong code. Workers
take turns here. Programs that tests start know of no lock; they are given a folder of their worker's own, with a copy of
what the worker has used.
"""

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def share(folder: Path, own: Path) -> None:
    """Have numba keep what it compiles in a folder that other workers use, and programs use `own`."""
    # Read by numba when it is imported, and by the programs that tests start.
    os.environ["NUMBA_CACHE_DIR"] = str(own)
    from numba.core import caching, config

    config.CACHE_DIR = str(folder)
    file: Any = caching.IndexDataCacheFile
    load, save = file.load, file.save

    @contextmanager
    def turn(self: Any) -> Iterator[None]:
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
            _copy(Path(self._index_path), folder, own)

    def load_in_turn(self: Any, key: Any) -> Any:
        with turn(self):
            return load(self, key)

    def save_in_turn(self: Any, key: Any, data: Any) -> None:
        with turn(self):
            save(self, key, data)

    file.load, file.save = load_in_turn, save_in_turn


def _copy(index: Path, folder: Path, own: Path) -> None:
    """The index of a function and its code, where they have changed: code first, for whoever reads the copy."""
    if not index.is_relative_to(folder) or not index.exists():
        return
    place = own / index.parent.relative_to(folder)
    place.mkdir(parents=True, exist_ok=True)
    for path in (*index.parent.glob(f"{index.stem}.*.nbc"), index):
        copy = place / path.name
        if not copy.exists() or copy.stat().st_mtime_ns != path.stat().st_mtime_ns:
            aside = copy.with_name(f"{copy.name}.{os.getpid()}")
            shutil.copy2(path, aside)
            os.replace(aside, copy)
