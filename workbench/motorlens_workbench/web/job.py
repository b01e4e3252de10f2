"""One step of the workbench: a command of motorlens in a process of its own, followed line by line, stopped when asked."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

_PATIENCE_S = 3.0
# Lines of progress that are kept; a command that says more than that is not read line by line.
_LINES = 500


class Job:
    """Runs `motorlens WORDS...` from the moment it is made; calls `done` once, from another thread, when it has ended.

    Attributes:
        progress: what it said on standard error, line by line.
        output: what it said on standard output, complete once it has ended.
        status: exit status; None while it runs.
        cancelled: whether it was told to stop.
        seconds: how long it ran, or has been running.
    """

    def __init__(self, words: Sequence[str], done: Callable[["Job"], None]) -> None:
        self.progress: list[str] = []
        self.output = ""
        self.status: int | None = None
        self.cancelled = False
        self._begun, self._ended = time.monotonic(), 0.0
        # In a session of its own, so that whatever it starts ends with it.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "motorlens_runtime", *words],
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            text=True, encoding="utf-8", errors="replace", start_new_session=True,
        )  # fmt: skip
        self._readers = [
            threading.Thread(target=read, daemon=True) for read in (self._read_progress, self._read_output)
        ]
        for reader in self._readers:
            reader.start()
        self._waiter = threading.Thread(target=self._wait, args=(done,), daemon=True)
        self._waiter.start()

    @property
    def seconds(self) -> float:
        """See the class."""
        return (self._ended or time.monotonic()) - self._begun

    def cancel(self) -> None:
        """Stop it; returns when it has stopped."""
        if self.status is not None:
            return
        self.cancelled = True
        self._signal(signal.SIGTERM)
        self._waiter.join(_PATIENCE_S)
        if self._waiter.is_alive():
            self._signal(signal.SIGKILL)
            self._waiter.join()

    def join(self) -> None:
        """Wait until it has ended and `done` has been called."""
        self._waiter.join()

    def _signal(self, number: int) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, number)

    def _read_progress(self) -> None:
        assert self._process.stderr is not None
        with self._process.stderr as lines:
            for line in lines:
                self.progress = [*self.progress[-_LINES:], line.rstrip("\n")]

    def _read_output(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as text:
            self.output = text.read()

    def _wait(self, done: Callable[["Job"], None]) -> None:
        status = self._process.wait()
        for reader in self._readers:
            reader.join()
        self._ended = time.monotonic()
        self.status = status
        done(self)
