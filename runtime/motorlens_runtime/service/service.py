"""The hot loop: samples when they come, every one into the state, an estimate at each publishing instant.

Driven by data, in blocks as large as what has arrived; no tick of the host. When nothing comes from a live line, the last
estimate is published on, marked stale. The host's clock judges nothing of a recording: its time is its own.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates, Estimator, EstimatorState
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.line.feed import Feed
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.sensor.sensor import Sensor
from motorlens_runtime.service.alarms import Watch
from motorlens_runtime.service.core_stream import follow
from motorlens_runtime.service.lag import Lag
from motorlens_runtime.service.memory import Memory
from motorlens_runtime.service.outlet import Grid, Outlet
from motorlens_runtime.service.recorder import Recorder
from motorlens_runtime.service.swap import Swap

_WAIT_S = 0.05
_LATENCIES = 1 << 16
# How much longer than its duration a live stream may take, from opening the port to its first sample.
_GRACE_NS = 1_000_000_000
_COUNT_EVERY_NS = 1_000_000_000
# After a line was lost, the last values stay until this much of the stream has come: the first sample stands for the whole
# gap in every filter, and the fast ones (electrical, mechanical) need a second to forget that; the slow ones hardly move.
_SETTLE_NS = 1_000_000_000


@dataclass(frozen=True)
class Settings:
    """`rate_Hz` of publishing (0: every sample), `duration_s` (inf: until stopped), `stale_s` until a value is old.

    A line that is silent for `lost_s` is lost.
    """

    rate_Hz: float = 100.0
    duration_s: float = float("inf")
    stale_s: float = 0.25
    lost_s: float = 2.0


class Service:
    """One sensor on one feed with its publishers.

    Args:
        feed, sensor, outlets, recorder: opened by the caller and closed by it.
        settings: see `Settings`.
        clock: nanoseconds that never run backwards.
        state: where the estimator goes on; None is a fresh start, or what `memory` recalls.
        watch: the alarms.
        memory: the heat of earlier runs.
        swap: takes a new sensor file into service.
    """

    def __init__(
        self, feed: Feed, sensor: Sensor, outlets: Sequence[Outlet], recorder: Recorder | None, settings: Settings,
        clock: Callable[[], int], state: EstimatorState | None = None, watch: Watch | None = None,
        memory: Memory | None = None, swap: Swap | None = None,
    ) -> None:  # fmt: skip
        self._feed, self._sensor, self._outlets, self._recorder = feed, sensor, outlets, recorder
        self._settings, self._clock, self._state = settings, clock, state
        self._watch, self._memory, self._swap = watch, memory, swap
        self._events: list[dict[str, Any]] = []
        self._grid = Grid(settings.rate_Hz)
        self._estimator: Estimator | None = None
        self._period_s: float | None = None
        self._samples = self._published = 0
        self._first_ns: int | None = None
        self._words = Counter[int]()  # how many estimates had which quality word
        self._latency_ns = np.zeros(_LATENCIES)
        self._started_ns = 0
        self._blocks = 0
        self._largest_block = 0
        self._latest: Estimates | None = None
        self._latest_arrival_ns = 0
        self._stale_tick = 0
        self._lost = False
        self._settled_ns: int | None = None
        self._lag = Lag()
        self._counted_ns = 0

    def run(self, stop: Callable[[], bool]) -> None:
        """Until `stop()`, the end of the feed or the duration. Raises what the feed raises."""
        self._started_ns = self._clock()
        while not stop() and not self._finished():
            asked_ns = self._clock()
            samples = self._feed.read(_WAIT_S)
            if samples is None:
                return
            if len(samples):
                self.take(samples)
            elif self._feed.live:
                # Nothing had come by the time we asked. What comes after that is found by the next read, however long
                # this process has to wait for a processor until then: that is no silence of the line.
                self._stale(asked_ns)
            if self._clock() - self._counted_ns >= _COUNT_EVERY_NS:
                self._count()
            if self._outlets and all([outlet.dead for outlet in self._outlets]):
                return

    def take(self, received: Samples | Estimated) -> None:
        """Samples into the state, estimates to the outlets."""
        arrival_ns = self._feed.arrival_ns
        estimator = self._current_estimator()
        if isinstance(received, Samples):
            received = self._estimated(estimator, received, arrival_ns)
        estimates = received.estimates
        if self._recorder is not None:
            self._recorder.put(received.samples())
        if self._first_ns is None:
            self._first_ns = received.first_ns
        if self._swap is not None:
            estimator, estimates = self._follow(self._swap, estimator, received)
        self._samples += received.count
        self._largest_block = max(self._largest_block, received.count)
        if self._lost:
            self._found_again(received.first_ns, arrival_ns)
        self._latest_arrival_ns = arrival_ns
        if len(estimates):
            estimates = self._held_until_settled(estimates)
            self._latest = estimates
            self._hand_out(estimates, received.inputs)
        if self._memory is not None:
            self._memory.keep(estimator, self._feed.device, arrival_ns)
        self._latency_ns[self._blocks % _LATENCIES] = self._clock() - arrival_ns
        self._blocks += 1

    def _estimated(self, estimator: Estimator, samples: Samples, arrival_ns: int) -> Estimated:
        """What the estimator makes of samples; from the next read on the line's decoder may have it done by itself."""
        first_ns, newest_ns = int(samples.time_ns[0]), int(samples.time_ns[-1])
        if self._feed.live and self._lag.late(arrival_ns, newest_ns):
            flags = np.zeros(len(samples), dtype=np.uint32) if samples.flags is None else samples.flags
            samples = replace(samples, flags=flags | np.uint32(Quality.OVERLOAD))
        marking = False
        if self._memory is not None:
            marking, samples = self._memory.marking, self._memory.mark(samples)
        rows = self._grid.rows(samples.time_ns)
        estimates = estimator.push(samples, rows)
        inputs = np.empty((len(rows), 2))
        chosen = slice(None) if len(rows) == len(samples) else rows
        inputs[:, 0], inputs[:, 1] = samples.voltage_V[chosen], samples.current_A[chosen]
        decoder = self._feed.decoder
        if decoder is not None and decoder.in_core and not marking:
            follow(self._feed, estimator, self._grid, self._lag)
        return Estimated(len(samples), first_ns, newest_ns, estimates, inputs, lambda: samples, lambda: rows)

    def counts(self) -> dict[str, Any]:
        """What publishers are told once a second: samples and estimates so far, what was lost, time to each limit."""
        feed = self._feed.report()
        left_s = {} if self._watch is None else self._watch.time_to_limit_s()
        if self._lost:  # how things go on is not known
            left_s = dict.fromkeys(left_s, np.inf)
        return {
            "device": self._feed.device,
            "samples": self._samples,
            "published": self._published,
            "lost": feed.get("lost_samples", 0),
            "bad_frames": feed.get("bad_frames", 0),
            "reconnects": feed.get("reconnects", 0),
            "line_lost": self._lost,
            "limits": [] if self._watch is None else self._watch.limits(),
            "time_to_limit_s": {
                name: seconds if seconds < np.inf else None for name, seconds in left_s.items()
            },
        }

    def report(self) -> dict[str, Any]:
        """Counters and latencies; `latency_us` is from the arrival of a block to its estimates being handed out."""
        latencies = self._latency_ns[: min(self._blocks, _LATENCIES)] / 1000
        shares = {"p50": 50, "p99": 99, "p999": 99.9, "max": 100}
        feed = self._feed.report()
        flagged = {
            bit.name.lower(): sum(times for word, times in self._words.items() if word & bit)
            for bit in Quality
            if bit.name
        }
        return {
            "schema": "motorlens.run/1",
            "device": self._feed.device,
            "samples": self._samples,
            "lost": feed.get("lost_samples", 0),
            "published": self._published,
            "bridged": flagged["bridged"],
            "largest_block": self._largest_block,
            "latency_us": {k: float(np.percentile(latencies, q)) for k, q in shares.items()}
            if len(latencies)
            else None,
            "quality": {name: count for name, count in flagged.items() if count},
            "feed": feed,
            "events": self._events,
            "memory": None if self._memory is None else self._memory.report(),
            "outlets": [vars(outlet.report()) for outlet in self._outlets],
        }

    @property
    def estimator(self) -> Estimator | None:
        """The estimator, None before the first sample."""
        return self._estimator

    def _current_estimator(self) -> Estimator:
        """The estimator; a new one with the old state when the device has changed its rate."""
        period_s = self._feed.period_s or 1 / self._sensor.specification.rate_Hz
        if self._estimator is None or period_s != self._period_s:
            state = self._state if self._estimator is None else self._estimator.state
            if state is None and self._memory is not None:
                state = self._memory.recall(self._feed.device)
            self._estimator, self._period_s = open_estimator(self._sensor, period_s, state), period_s
        return self._estimator

    def _finished(self) -> bool:
        """Whether the stream is as long as was asked for; the host's clock ends a live one that falls silent."""
        if self._settings.duration_s == np.inf:
            return False
        duration_ns = self._settings.duration_s * 1e9
        last_ns = None if self._estimator is None else self._estimator.last_ns
        if last_ns is not None and self._first_ns is not None and self._period_s is not None:
            if last_ns - self._first_ns + self._period_s * 1e9 >= duration_ns:
                return True
        return self._feed.live and self._clock() - self._started_ns >= duration_ns + _GRACE_NS

    def _hand_out(self, estimates: Estimates, inputs: NDArray[np.float64] | None = None) -> None:
        self._published += len(estimates)
        for word in estimates.quality.tolist():
            self._words[word] += 1
        for outlet in self._outlets:
            outlet.put(estimates, inputs)
        if self._watch is not None:
            for event in self._watch.look(estimates):
                self._tell(event.document())

    def _tell(self, document: dict[str, Any]) -> None:
        """An event to all publishers and into the report."""
        self._events = [*self._events[-99:], document]
        for outlet in self._outlets:
            outlet.put_event(document)

    def _follow(self, swap: Swap, estimator: Estimator, received: Estimated) -> tuple[Estimator, Estimates]:
        assert self._period_s is not None
        following, estimates = swap.follow(
            estimator, self._period_s, received.samples(), received.rows(), received.estimates
        )
        while swap.events:
            self._tell(swap.events.popleft())
        if following is not estimator:
            self._estimator, self._sensor = following, following.sensor
            follow(self._feed, following, self._grid, self._lag)
            if self._memory is not None:
                self._memory.follow(following.sensor)
        return following, estimates

    def _count(self) -> None:
        self._counted_ns = self._clock()
        counts = self.counts()
        for outlet in self._outlets:
            outlet.put_counts(counts)

    def _stale(self, until_ns: int) -> None:
        """Publish the last estimate on, at the publishing rate but not above 10 rows a second, marked stale.

        Args:
            until_ns: nothing had come by then.
        """
        silence_ns = until_ns - self._latest_arrival_ns
        if self._latest is None or silence_ns < self._settings.stale_s * 1e9:
            self._stale_tick = 0
            return
        rate = min(self._settings.rate_Hz, 10.0) if self._settings.rate_Hz > 0 else 10.0
        tick = int(silence_ns * 1e-9 * rate)
        if tick == self._stale_tick:
            return
        self._stale_tick = tick
        last = self._latest
        row = slice(len(last) - 1, len(last))
        if not self._lost and silence_ns >= self._settings.lost_s * 1e9:
            self._lost = True
            why = f": {self._feed.down}" if self._feed.down else ""
            self._tell(
                _line_event("lost", int(last.time_ns[-1]), f"no sample for {silence_ns * 1e-9:.1f} s{why}")
            )
        reason = Quality.STALE | Quality.LINE_LOST if self._lost else Quality.STALE
        quality = last.quality[row] | np.uint32(reason)
        self._hand_out(Estimates(last.time_ns[row] + silence_ns, last.values[row], last.sigma[row], quality))

    def _found_again(self, first_ns: int, arrival_ns: int) -> None:
        """The line is back."""
        self._lost = False
        self._settled_ns = first_ns + _SETTLE_NS
        silence_s = (arrival_ns - self._latest_arrival_ns) * 1e-9
        self._tell(_line_event("back", first_ns, f"samples come again after {silence_s:.1f} s"))

    def _held_until_settled(self, estimates: Estimates) -> Estimates:
        """Rows shortly after the line came back repeat the last values, as those while it was lost do."""
        if self._settled_ns is None or self._latest is None:
            return estimates
        early = estimates.time_ns < self._settled_ns
        if not early.any():
            self._settled_ns = None
            return estimates
        reason = np.uint32(Quality.STALE | Quality.LINE_LOST)
        return Estimates(
            estimates.time_ns,
            np.where(early[:, None], self._latest.values[-1], estimates.values),
            np.where(early[:, None], self._latest.sigma[-1], estimates.sigma),
            estimates.quality | np.where(early, reason, np.uint32(0)),
        )


def _line_event(what: str, time_ns: int, message: str) -> dict[str, Any]:
    """That the line was `lost` or is `back`, as publishers send it."""
    return {"event": f"line_{what}", "timestamp": time_ns / 1e9, "message": f"line {what}: {message}"}
