"""numba's cache, shared by the workers of a run: what one compiles, the others wait for and load.

Workers begin with tests of one kind: without waiting, each would compile what all of them need.

numba reads the index of a function, adds to it and writes it without a lock, and writes the code after the index that names
it (numba.core.caching.IndexDataCacheFile): two processes at once can leave an index that points at the wrong code. Workers
take turns here. Programs that tests start know of no lock; they are given a folder of their worker's own, with a copy of
what all workers have compiled until then.
"""

import fcntl
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path
from typing import Any


def share(folder: Path, own: Path) -> None:
    """Have numba keep what it compiles in a folder that other workers use, and programs use `own`."""
    # Read by numba when it is imported, and by the programs that tests start.
    os.environ["NUMBA_CACHE_DIR"] = str(own)
    from numba.core import caching, config
    from numba.core.compiler_lock import global_compiler_lock
    from numba.core.dispatcher import Dispatcher

    config.CACHE_DIR = str(folder)
    file: Any = caching.IndexDataCacheFile
    load, save = file.load, file.save

    @contextmanager
    def turn() -> Iterator[None]:
        with (folder / "lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield

    def load_in_turn(self: Any, key: Any) -> Any:
        with turn():
            return load(self, key)

    def save_in_turn(self: Any, key: Any, data: Any) -> None:
        with turn():
            save(self, key, data)

    def before_a_program(event: str, arguments: object) -> None:
        if event == "subprocess.Popen":
            with turn():
                for index in folder.rglob("*.nbi"):
                    _copy(index, folder, own)

    file.load, file.save = load_in_turn, save_in_turn
    compile_, compiling = Dispatcher.compile, set[str]()

    def compile_once(self: Any, signature: Any) -> Any:
        """Load or compile a function while no other worker does; what it calls is compiled within, and never calls it."""
        own_file = getattr(self._cache, "_cache_file", None)
        # Numba's own lock first: of the threads of a worker one waits for another worker, not for each other.
        with global_compiler_lock:
            if own_file is None or own_file._index_path in compiling:
                return compile_(self, signature)
            compiling.add(own_file._index_path)
            name = sha256(own_file._index_path.encode()).hexdigest()
            try:
                with (folder / f"{name}.compiles").open("w") as lock:
                    fcntl.flock(lock, fcntl.LOCK_EX)
                    return compile_(self, signature)
            finally:
                compiling.discard(own_file._index_path)

    Dispatcher.compile = compile_once
    sys.addaudithook(before_a_program)


def _copy(index: Path, folder: Path, own: Path) -> None:
    """The index of a function and its code, where they have changed: code first, for whoever reads the copy."""
    place = own / index.parent.relative_to(folder)
    place.mkdir(parents=True, exist_ok=True)
    for path in (*index.parent.glob(f"{index.stem}.*.nbc"), index):
        copy = place / path.name
        if not copy.exists() or copy.stat().st_mtime_ns != path.stat().st_mtime_ns:
            aside = copy.with_name(f"{copy.name}.{os.getpid()}")
            shutil.copy2(path, aside)
            os.replace(aside, copy)
