"""Samples from a URL: a line with its decoder, opened again when it breaks, or a recorded file replayed."""

import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol
from urllib.parse import SplitResult, unquote

import numpy as np

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.files.recorded import open_recorded, period_of
from motorlens_runtime.line.dialects import Dialect, make_dialect, recognise
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.line.link import joined, slice_of
from motorlens_runtime.line.sources import Options, Source, number_of, open_source, split

Clock = Callable[[], int]

# Give up on recognising a line after this many bytes.
_RECOGNISE_BYTES = 4096
# A drive that does not announce its rate shows it in this many samples.
_RATE_FROM = 32
_FIRST_RETRY_NS, _LAST_RETRY_NS = 100_000_000, 5_000_000_000

NO_SAMPLES = Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


class Feed(Protocol):
    """Samples, whatever they come from.

    `period_s` is the expected time between samples (None until known), `device` what the device calls itself, `arrival_ns`
    when the last samples came by the clock, `down` why the line is broken (None: it is not). `decoder` decodes a line
    (None: not known yet, or it is no line), to whose samples the feed adds `ambient_C` where they have none. `live` says
    that samples come when they are taken, so that they can be late or stay away; a recording's cannot, however slow the
    machine that replays it.
    """

    live: bool

    period_s: float | None
    device: str
    arrival_ns: int
    down: str | None
    decoder: Dialect | None
    ambient_C: float | None

    def read(self, timeout_s: float) -> Samples | Estimated | None:
        """The samples that have come, after `timeout_s` at the latest, or what was made of them; None at the end."""
        ...

    def report(self) -> dict[str, Any]:
        """Counters, by name."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


def open_feed(
    url: str, mapping: Mapping[str, str], ambient_C: float | None, patience_s: float, clock: Clock
) -> Feed:
    """Open what `--source` names.

    Args:
        url: see `sources`; `file:REC.csv` replays a recording, `?speed=1` in real time.
        mapping: column names of a recording.
        ambient_C: for recordings and drives that do not send it.
        patience_s: how long to try to open a broken line again.
        clock: nanoseconds that never run backwards.

    Raises:
        DataError, DeviceError: the source cannot be opened.
    """
    parts, options = split(url)
    if parts.scheme == "file":
        return FileFeed(parts, options, mapping, ambient_C, clock)
    return LineFeed(parts, options, ambient_C, patience_s, clock)


class LineFeed:
    """A line and what it speaks: frames, or the dialect that `?dialect=` names, or text; the first bytes tell."""

    live = True

    def __init__(
        self, parts: SplitResult, options: Options, ambient_C: float | None, patience_s: float, clock: Clock
    ) -> None:
        self._parts, self._options, self._clock = parts, dict(options), clock
        self.ambient_C = ambient_C
        self._patience_ns = round(min(patience_s, 1e9) * 1e9)
        rest = dict(options)
        dialect = rest.pop("dialect", None)
        self._source: Source | None = open_source(parts, rest)
        self.decoder: Dialect | None = None
        if dialect is not None:
            self.decoder = make_dialect(dialect, rest)
        elif rest:
            self._source.close()
            raise DataError(f"--source {parts.geturl()}: unknown option {next(iter(rest))!r}")
        self._heard = b""
        self._held: Samples | None = NO_SAMPLES
        self._down_since_ns = self._next_try_ns = self._retry_ns = 0
        self._reconnects = 0
        self.period_s: float | None = None
        self.device = ""
        self.arrival_ns = clock()
        self.down: str | None = None

    def read(self, timeout_s: float) -> Samples | Estimated | None:
        """See `Feed.read`. Raises DeviceError when a broken line stays broken for too long."""
        if self._source is None:
            self._try_again(timeout_s)
            return NO_SAMPLES
        decoder = self.decoder
        try:
            if decoder is not None and decoder.asks:
                if question := decoder.request(self._clock()):
                    self._source.write(question)
                timeout_s = min(timeout_s, decoder.patience_s(self._clock()))
            data = self._source.read(timeout_s)
        except DeviceError as error:
            self._lost(error)
            return NO_SAMPLES
        self.arrival_ns = self._clock()
        if data is None:
            return None
        decoder = decoder or self._recognised(data)
        if decoder is None:
            return NO_SAMPLES
        heard, self._heard = self._heard, b""
        samples = decoder.followed(heard or data, self.arrival_ns)
        if isinstance(samples, Estimated):
            return samples
        if self.ambient_C is not None and samples.ambient_C is None:
            samples = Samples(
                samples.time_ns,
                samples.voltage_V,
                samples.current_A,
                np.full(len(samples), self.ambient_C),
                samples.flags,
            )
        return self._timed(decoder, samples)

    def report(self) -> dict[str, Any]:
        """See `Feed.report`."""
        said = {} if self.decoder is None else self.decoder.report()
        return {"reconnects": self._reconnects, **said}

    def close(self) -> None:
        """See `Feed.close`."""
        if self._source is not None:
            self._source.close()
            self._source = None

    def _recognised(self, data: bytes) -> Dialect | None:
        self._heard += data
        spoken = recognise(self._heard)
        if spoken == "text":
            self.decoder = make_dialect("text")
        elif spoken == "frames" or len(self._heard) >= _RECOGNISE_BYTES:
            self.decoder = make_dialect("frames")
        return self.decoder

    def _timed(self, decoder: Dialect, samples: Samples) -> Samples:
        """Hold the first samples back until the rate is known."""
        if decoder.announces:
            self.period_s, self.device = decoder.period_s, decoder.device
            return samples
        if self._held is None:
            return samples
        self._held = joined([self._held, samples]) if len(self._held) else samples
        if len(self._held) < _RATE_FROM:
            return NO_SAMPLES
        self.period_s = period_of(self._held, 0.0) or None
        if self.period_s is None:
            return NO_SAMPLES
        samples, self._held = self._held, None
        return samples

    def _lost(self, error: DeviceError) -> None:
        assert self._source is not None
        lasting = self._source.lasting
        self.close()
        if not lasting or not self._patience_ns:
            raise error
        self.down = str(error)
        now = self._clock()
        self._down_since_ns, self._retry_ns = now, _FIRST_RETRY_NS
        self._next_try_ns = now + self._retry_ns

    def _try_again(self, timeout_s: float) -> None:
        now = self._clock()
        if now < self._next_try_ns:
            time.sleep(min(timeout_s, (self._next_try_ns - now) * 1e-9))
            return
        options = {key: value for key, value in self._options.items() if key != "dialect"}
        try:
            self._source = open_source(self._parts, options)
        except DeviceError as error:
            if now - self._down_since_ns > self._patience_ns:
                raise DeviceError(
                    f"{error}; gave up after {(now - self._down_since_ns) * 1e-9:.0f} s"
                ) from None
            self._retry_ns = min(2 * self._retry_ns, _LAST_RETRY_NS)
            self._next_try_ns = now + self._retry_ns
            return
        self.down = None
        self._reconnects += 1


class FileFeed:
    """A recording, as fast as it can be read, or at `?speed=1` times real time."""

    live = False
    device = ""
    down: str | None = None
    decoder: Dialect | None = None
    ambient_C: float | None = None  # the samples have it

    def __init__(
        self,
        parts: SplitResult,
        options: Options,
        mapping: Mapping[str, str],
        ambient_C: float | None,
        clock: Clock,
    ) -> None:
        self._clock = clock
        self._speed = number_of(options, "speed", 0.0)
        if options:
            raise DataError(
                f"--source {parts.geturl()}: unknown option {next(iter(options))!r}; known: speed"
            )
        path = unquote(parts.netloc + parts.path)
        if not path:
            raise DataError(f"--source {parts.geturl()}: name a file, for example file:recording.csv")
        self._stream = open_recorded(path, mapping, ambient_C)
        self._blocks = iter(self._stream)
        self._waiting: Samples | None = None
        self._first_ns: int | None = None
        self._started_ns = 0
        self.period_s: float | None = None
        self.arrival_ns = clock()

    def read(self, timeout_s: float) -> Samples | None:
        """See `Feed.read`."""
        if self._waiting is None or not len(self._waiting):
            block = next(self._blocks, None)
            if block is None:
                if self._first_ns is None:
                    raise DataError(f"{self._stream.name}: has a heading but no rows")
                return None
            self._waiting = block.samples
            if self._first_ns is None:
                self._first_ns, self._started_ns = int(self._waiting.time_ns[0]), self._clock()
                self.period_s = period_of(self._waiting, 0.0) or None
                if self.period_s is None:
                    raise DataError(f"{self._stream.name}: time does not advance")
        samples, self._waiting = self._waiting, None
        if self._speed > 0:
            assert self._first_ns is not None
            due_ns = self._first_ns + round((self._clock() - self._started_ns) * self._speed)
            n = int(np.searchsorted(samples.time_ns, due_ns, side="right"))
            if n < len(samples):
                self._waiting = slice_of(samples, n, len(samples))
                samples = slice_of(samples, 0, n)
            if not n:
                wait_s = (
                    (int(self._waiting.time_ns[0]) - due_ns) * 1e-9 / self._speed
                    if self._waiting is not None
                    else 0.0
                )
                time.sleep(min(timeout_s, wait_s))
        self.arrival_ns = self._clock()
        return samples

    def report(self) -> dict[str, Any]:
        """See `Feed.report`."""
        return {"duplicates": self._stream.duplicates}

    def close(self) -> None:
        """See `Feed.close`."""
        self._stream.close()
