"""A line on standard error for work that takes more than two seconds: progress, or that it is at work."""

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Self

_QUIET_S = 2.0
_EVERY_S = 0.2


@contextmanager
def patience(command: str) -> Iterator[None]:
    """Say on a terminal, once, that a command is at work that tells nothing else of itself and takes more than seconds."""
    if not sys.stderr.isatty():
        yield
        return
    words = f"motorlens {command}: at work; the first time on a machine, simulations are compiled for it"
    late = threading.Timer(_QUIET_S, print, [words], {"file": sys.stderr, "flush": True})
    late.daemon = True
    late.start()
    try:
        yield
    finally:
        late.cancel()


class Progress:
    """`with Progress(total, "label") as progress: ... progress.update(done)`.

    Prints nothing before two seconds have passed; on a terminal it redraws one line, elsewhere it prints a line every
    ten percent. `total` may be 0 when it is not known.
    """

    def __init__(self, total: float, label: str) -> None:
        self._total = total
        self._label = label
        self._started = self._printed = time.monotonic()
        self._tenths = 0
        self._wrote = False

    def update(self, done: float, note: str = "") -> None:
        """Say that `done` of `total` is done; `note` is shown behind it."""
        now = time.monotonic()
        if now - self._started < _QUIET_S or now - self._printed < _EVERY_S:
            return
        self._printed = now
        share = min(done / self._total, 1.0) if self._total > 0 else 0.0
        if self._total > 0:
            remaining = (now - self._started) * (1 - share) / share if share > 0 else 0.0
            text = f"{self._label} {100 * share:3.0f} %, {remaining:.0f} s left {note}".rstrip()
        else:
            text = f"{self._label} {done:.0f} {note}".rstrip()
        if sys.stderr.isatty():
            print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
            self._wrote = True
        elif int(10 * share) > self._tenths:
            self._tenths = int(10 * share)
            print(text, file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._wrote:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
