"""Dialects: what drives already say of their own accord, turned into samples. One dialect, one module.

A dialect is a decoder from bytes to samples. It may be fed bytes cut anywhere, and garbage; it does not raise, holds
a bounded number of bytes, and finds its place again. What it could not use it counts. Some drives speak only when
spoken to; for them a dialect also says what to send (`request`), and nothing it sends changes the drive's state.
"""

import importlib
import math
import pkgutil
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.options import Options, nearest


class Dialect(ABC):
    """One stream of one drive.

    Attributes:
        bytes_seen: all bytes fed so far.
        bad_frames: pieces that looked like a message and were damaged or not understood.
        asks: whether the drive must be asked; `request` and `patience_s` are of use only then.
        announces: whether the drive says itself how often it samples; else its samples show it.
        in_core: whether it is the C core's, which can go on to estimates in the same call; see `service.core_stream`.
        period_s: time between samples, None where that is not announced, or not yet.
        device: what the drive calls itself.
    """

    asks = False
    announces = False
    in_core = False
    period_s: float | None = None
    device = ""

    def __init__(self) -> None:
        self.bytes_seen = 0
        self.bad_frames = 0

    @abstractmethod
    def feed(self, data: bytes, now_ns: int) -> Samples:
        """The samples that `data` completes, in order.

        Args:
            data: the bytes that came, in any portions.
            now_ns: when they came, by a clock that never runs backwards. The stamps of the samples are of this clock,
                and never run backwards either, even where the device's own clock does.
        """

    def followed(self, data: bytes, now_ns: int) -> Samples | Estimated:
        """As `feed`, or what was made of the samples, where the dialect can go on to that."""
        return self.feed(data, now_ns)

    def request(self, now_ns: int) -> bytes:
        """What to send to the drive now: nothing unless the drive must be asked, and not before it is due."""
        return b""

    def patience_s(self, now_ns: int) -> float:
        """How long to wait for bytes before `request` wants to be asked again; for ever if it never has anything to send."""
        return math.inf

    def report(self) -> dict[str, Any]:
        """Counters, by name; a `complaint` in words where nothing can be made of what comes."""
        return {"bytes": self.bytes_seen, "bad_frames": self.bad_frames}


def make_dialect(name: str, options: Mapping[str, str] | None = None) -> Dialect:
    """The dialect called `name`, with options as in `serial:///dev/ttyACM0?dialect=vesc&poll_Hz=200`.

    Raises:
        DataError: there is no such dialect or option, or a value is not usable; the message says which there are.
    """
    if name not in dialect_names():
        raise DataError(f"no dialect {name!r}{nearest(name, dialect_names())}")
    module = importlib.import_module(f"{__name__}.{name}")
    reader = Options(options or {}, f"dialect {name}")
    dialect = module.make(reader)
    reader.finish()
    assert isinstance(dialect, Dialect)
    return dialect


def dialect_names() -> list[str]:
    """The names that `make_dialect` knows: the modules of this package that are not helpers."""
    return sorted(
        info.name for info in pkgutil.iter_modules(__path__) if info.name not in ("quantities", "stamps")
    )


def recognise(data: bytes) -> str | None:
    """What a line speaks, from the first bytes heard on it: "frames" (motorlens), "text", or None: cannot say yet.

    A frame ends with a zero, which text never holds; text ends its lines, and has no bytes but printable ones.
    """
    line_end = data.rfind(b"\n")
    printable = sum(byte in _TEXT for byte in data)
    if line_end >= 0 and data.count(b"\0") == 0 and printable >= 0.95 * len(data) and len(data) >= 16:
        return "text"
    return "frames" if data.count(b"\0") >= 2 and printable < 0.95 * len(data) else None


_TEXT = frozenset(range(32, 127)) | frozenset(b"\t\r\n") | frozenset("°µμºΩ·".encode())
