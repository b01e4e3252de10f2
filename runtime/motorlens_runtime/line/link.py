"""One device at the other end of a line that speaks frames: what HELLO says, which sample was taken when, what was lost.

Time is the device's: its 32-bit microsecond stamps made continuous. While stamps agree with the announced rate, samples lie
exactly on its grid; a later stamp is a gap; a restart goes on by the time that the host saw pass, after one sample of rest.
"""

from collections import deque
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.columns import understand
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.framing import (
    SAMPLE_TYPES,
    Decoder,
    Flag,
    FrameRun,
    Hello,
    HelloAssembler,
    Kind,
    Status,
)
from motorlens_runtime.line.scaling import SATURATED, Scaling

# Runs of frames kept until HELLO tells what they mean.
_KEPT_RUNS = 4096
# Stamps are whole microseconds; closer than this is on the grid.
_ON_GRID_NS = 1_500
# A stamp this far in the past is a restarted clock, not a frame that comes late.
_RESTART_NS = 1_000_000_000
_WRAP_NS = (1 << 32) * 1000
_ONE = np.ones(1, dtype=bool)
_SAMPLES = int(Kind.SAMPLES)


@dataclass(frozen=True)
class Counters:
    """What happened on the line so far."""

    samples: int = 0
    lost_samples: int = 0
    lost_frames: int = 0
    late_frames: int = 0
    unknown_frames: int = 0
    gaps: int = 0
    restarts: int = 0
    device_overruns: int = 0


class Link(Dialect):
    """Frames in, samples out.

    Attributes:
        hello: what the device said of itself, None before.
        status: its last counters, None before.
        complaint: why the last HELLO was of no use, None if it was.
    """

    announces = True

    def __init__(self) -> None:
        super().__init__()
        self.hello: Hello | None = None
        self.status: Status | None = None
        self.complaint: str | None = None
        self._decoder = Decoder()
        self._assembler = HelloAssembler()
        self._scaling: Scaling | None = None
        self._early: deque[FrameRun] = deque(maxlen=_KEPT_RUNS)
        self._sequence: int | None = None
        # The grid: its anchor on the continuous time, and how many samples since; the raw stamp expected next.
        self._anchor_ns = 0
        self._count = 0
        self._rate = 1, 0  # HELLO's, with nanoseconds over its denominator
        self._offset_ns = 0
        self._started = False
        self._restarted = False
        self._last_arrival_ns = 0
        self._count_of = dict.fromkeys(Counters.__dataclass_fields__, 0)

    @property
    def counters(self) -> Counters:
        """What happened on the line so far."""
        return Counters(**self._count_of)

    def report(self) -> dict[str, Any]:
        """See `Dialect.report`."""
        counters = asdict(self.counters)
        del counters["samples"]
        report = super().report() | counters
        if self.complaint is not None:
            report["complaint"] = self.complaint
        elif self.hello is None and self.bytes_seen:
            report["complaint"] = "frames come, but no HELLO that says what they mean"
        return report

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """See `Dialect.feed`; stamps are the device's."""
        self.bytes_seen += len(data)
        expected = self._expected(data, now_ns)
        if expected is not None:
            return expected
        parts: list[Samples] = []
        for run in self._decoder.feed(data):
            self._follow_sequence(run)
            kinds = run.kind
            start = 0
            for end in (
                [*(np.flatnonzero(kinds[1:] != kinds[:-1]) + 1).tolist(), len(run)] if len(run) > 1 else (1,)
            ):
                self._take(_part(run, start, end), parts, now_ns)
                start = end
        self.bad_frames = self._decoder.bad_frames
        return joined(parts)

    def _expected(self, data: bytes, now_ns: int) -> Samples | None:
        """The samples where `data` is just the frame that comes next, as nearly always on a live line; else None.

        What it returns is what the long way round would; it only costs a third.
        """
        scaling, sequence = self._scaling, self._sequence
        if scaling is None or sequence is None or (frame := self._decoder.whole(data)) is None:
            return None
        payload = frame.payload
        if (
            frame.kind != _SAMPLES
            or frame.flags
            or frame.sequence != (sequence + 1) & 0xFFFF
            or len(payload) < 2
            or payload[0] != scaling.schema
            or not 0 < (n := payload[1]) * scaling.width == len(payload) - 2
            or not self._on_grid(frame.t0_us)
        ):
            return None
        times = np.array([self._time_ns(k) for k in range(self._count, self._count + n)], dtype=np.int64)
        self._sequence = frame.sequence
        self._count += n
        self._count_of["samples"] += n
        self._last_arrival_ns = now_ns
        few = scaling.few(payload, times)
        if few is None:
            return scaling.samples(np.frombuffer(payload, scaling.layout, offset=2).reshape(n, -1), times)
        return few

    def _take(self, run: FrameRun, parts: list[Samples], now_ns: int) -> None:
        kind = int(run.kind[0])
        if kind == Kind.SAMPLES:
            if self.hello is None:
                self._count_of["unknown_frames"] += len(run) if len(self._early) == _KEPT_RUNS else 0
                self._early.append(run)
            else:
                self._samples(run, parts, now_ns)
        elif kind == Kind.HELLO:
            for frame in run.frames():
                try:
                    hello = self._assembler.feed(frame)
                    if hello is not None:
                        self._greet(hello)
                except DataError as error:
                    self.complaint = str(error)
            while self.hello is not None and self._early:
                self._samples(self._early.popleft(), parts, now_ns)
        elif kind == Kind.STATUS:
            try:
                self.status = Status.from_bytes(run.payload[-1].tobytes())
            except DataError:
                self._count_of["unknown_frames"] += len(run)
        else:
            self._count_of["unknown_frames"] += len(run)

    def _greet(self, hello: Hello) -> None:
        columns = understand(
            [f"{c.name} ({c.unit})" for c in hello.channels], {}, f"HELLO of {hello.device[:40]!r}"
        )
        for quantity in ("voltage", "current"):
            if quantity not in columns:
                raise DataError(f"HELLO of {hello.device[:40]!r} has no {quantity} channel")
        if self.hello is not None and hello.boot != self.hello.boot:
            self._restarted = True
        if self.hello is not None and hello.rate_Hz != self.hello.rate_Hz:
            self._anchor_ns, self._count = self._next_ns(), 0
        self.hello, self.complaint, self._scaling = hello, None, Scaling(hello, columns)
        self._rate = hello.rate_Hz[0], 10**9 * hello.rate_Hz[1]
        self.period_s, self.device = hello.rate_Hz[1] / hello.rate_Hz[0], hello.device

    def _follow_sequence(self, run: FrameRun) -> None:
        if len(run) == 1:
            number = int(run.sequence[0])
            step = 1 if self._sequence is None else (number - self._sequence) & 0xFFFF
            self._count_of["lost_frames"] += step - 1 if 1 < step < 0x8000 else 0
            self._sequence = number
            return
        numbers = run.sequence.astype(np.int64)
        steps = (
            np.diff(numbers, prepend=numbers[0] - 1 if self._sequence is None else self._sequence) & 0xFFFF
        )
        # A step of more than half the range is a frame that comes late or twice, not 32768 lost ones.
        self._count_of["lost_frames"] += int((steps[(steps > 1) & (steps < 0x8000)] - 1).sum())
        self._sequence = int(numbers[-1])

    def _samples(self, run: FrameRun, parts: list[Samples], now_ns: int) -> None:
        hello = self.hello
        assert hello is not None
        width = len(hello.channels) * SAMPLE_TYPES[hello.channels[0].type].itemsize
        payload = run.payload
        known = np.zeros(len(run), dtype=bool)
        if payload.shape[1] >= 2 and (payload.shape[1] - 2) % width == 0:
            n = (payload.shape[1] - 2) // width
            known = (payload[:, 0] == hello.schema) & (payload[:, 1] == n) & (n > 0)
        self._count_of["unknown_frames"] += int(len(run) - known.sum())
        if not known.any():
            return
        run = run if known.all() else _chosen(run, known)
        self._count_of["device_overruns"] += int((run.flags & Flag.OVERRUN > 0).sum())
        times, keep, rests = self._times(run, n, now_ns)
        self._last_arrival_ns = now_ns
        if not keep.any():
            return
        if not keep.all():
            run = _chosen(run, keep)
        assert self._scaling is not None
        codes = np.ascontiguousarray(run.payload[:, 2:]).view(self._scaling.layout).reshape(len(run) * n, -1)
        samples = self._scaling.samples(codes, times)
        if samples.flags is not None and not self._scaling.rails_known:
            samples.flags[np.repeat(run.flags & Flag.SATURATED > 0, n)] |= SATURATED
        self._count_of["samples"] += len(samples)
        parts.extend(_with_rests(samples, rests))

    def _times(
        self, run: FrameRun, n: int, now_ns: int
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_], list[int]]:
        """Times (kept frames * n,), which frames are kept, and where (in ns) a sample of rest belongs."""
        frames = len(run)
        if frames == 1 and self._on_grid(int(run.t0_us[0])):
            self._count += n
            return self._grid(np.arange(self._count - n, self._count)), _ONE, []
        raw_ns = run.t0_us.astype(np.int64) * 1000
        keep = np.ones(frames, dtype=bool)
        expected = self._grid(self._count + n * np.arange(frames))
        ahead = (raw_ns - self._offset_ns - expected + _WRAP_NS // 2) % _WRAP_NS - _WRAP_NS // 2
        if self._started and not self._restarted and (np.abs(ahead) <= _ON_GRID_NS).all():
            self._count += frames * n
            return self._grid(self._count - frames * n + np.arange(frames * n)), keep, []
        times, rests = [], []
        for frame in range(frames):
            usable, rest = self._place(int(raw_ns[frame]), bool(run.flags[frame] & Flag.RESTART), now_ns)
            self._last_arrival_ns = now_ns
            keep[frame] = usable
            if usable:
                if rest is not None:
                    rests.append(rest)
                times.append(self._grid(self._count + np.arange(n)))
                self._count += n
        return np.concatenate(times) if times else np.zeros(0, dtype=np.int64), keep, rests

    def _on_grid(self, t0_us: int) -> bool:
        """Whether a stamp is the one expected next."""
        if not self._started or self._restarted:
            return False
        ahead = (1000 * t0_us - self._offset_ns - self._next_ns() + _WRAP_NS // 2) % _WRAP_NS - _WRAP_NS // 2
        return abs(ahead) <= _ON_GRID_NS

    def _place(self, raw_ns: int, says_restart: bool, now_ns: int) -> tuple[bool, int | None]:
        """Move the grid to where a frame says it is; whether the frame is of use, and the time of a rest before it."""
        assert self.hello is not None
        period_ns = 10**9 * self.hello.rate_Hz[1] // self.hello.rate_Hz[0]
        if not self._started:
            self._started = True
            self._anchor_ns, self._count, self._offset_ns = raw_ns, 0, 0
            return True, None
        expected = self._next_ns()
        ahead = (raw_ns - self._offset_ns - expected + _WRAP_NS // 2) % _WRAP_NS - _WRAP_NS // 2
        if self._restarted or ahead < -_RESTART_NS or (says_restart and ahead < -period_ns // 2):
            self._restarted = False
            self._count_of["restarts"] += 1
            away_ns = max(now_ns - self._last_arrival_ns, period_ns)
            self._anchor_ns, self._count = expected - period_ns + away_ns, 0
            self._offset_ns = raw_ns - self._anchor_ns
            # Without power there is no voltage and no current: say so just before the first new sample.
            return True, self._anchor_ns - period_ns if away_ns >= 2 * period_ns else None
        if abs(ahead) <= _ON_GRID_NS:
            return True, None
        if ahead < -period_ns // 2:
            self._count_of["late_frames"] += 1
            return False, None
        self._anchor_ns, self._count = expected + ahead, 0
        if ahead > period_ns // 2:
            self._count_of["gaps"] += 1
            self._count_of["lost_samples"] += round(ahead / period_ns)
        return True, None

    def _next_ns(self) -> int:
        return self._time_ns(self._count)

    def _time_ns(self, count: int) -> int:
        """Time of a sample by its number since the anchor."""
        numerator, step_ns = self._rate
        return self._anchor_ns + count * step_ns // numerator

    def _grid(self, count: NDArray[np.int64]) -> NDArray[np.int64]:
        """Times of samples by their number since the anchor, without a product that overflows."""
        numerator, step_ns = self._rate
        whole, part = np.divmod(count, numerator)
        times: NDArray[np.int64] = self._anchor_ns + whole * step_ns + part * step_ns // numerator
        return times


def _chosen(run: FrameRun, rows: NDArray[np.bool_]) -> FrameRun:
    return FrameRun(run.kind[rows], run.flags[rows], run.sequence[rows], run.t0_us[rows], run.payload[rows])


def _part(run: FrameRun, start: int, end: int) -> FrameRun:
    if start == 0 and end == len(run):
        return run
    rows = slice(start, end)
    return FrameRun(run.kind[rows], run.flags[rows], run.sequence[rows], run.t0_us[rows], run.payload[rows])


def _with_rests(samples: Samples, rests: list[int]) -> list[Samples]:
    """The samples cut at each rest, with a sample of 0 V and 0 A put in."""
    pieces, start = [], 0
    for rest in rests:
        at = int(np.searchsorted(samples.time_ns, rest, side="right"))
        pieces.append(slice_of(samples, start, at))
        ambient = None if samples.ambient_C is None else samples.ambient_C[at : at + 1]
        flags = np.array([Quality.BRIDGED], dtype=np.uint32)
        pieces.append(Samples(np.array([rest]), np.zeros(1), np.zeros(1), ambient, flags))
        start = at
    return [*pieces, slice_of(samples, start, len(samples))]


def slice_of(samples: Samples, start: int, end: int) -> Samples:
    """Samples `start` to `end`."""
    rows = slice(start, end)
    return Samples(
        samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows],
        None if samples.ambient_C is None else samples.ambient_C[rows],
        None if samples.flags is None else samples.flags[rows],
    )  # fmt: skip


def joined(parts: list[Samples]) -> Samples:
    """Samples one after another."""
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
    ambients = [part.ambient_C for part in parts]
    return Samples(
        np.concatenate([part.time_ns for part in parts]),
        np.concatenate([part.voltage_V for part in parts]),
        np.concatenate([part.current_A for part in parts]),
        None if any(a is None for a in ambients) else np.concatenate([a for a in ambients if a is not None]),
        np.concatenate(
            [np.zeros(len(part), dtype=np.uint32) if part.flags is None else part.flags for part in parts]
        ),
    )
