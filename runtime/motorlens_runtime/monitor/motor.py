"""What the live page knows of one motor: its rows, events, limits and counts, in memory that does not grow."""

import math
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality, names, opc_ua
from motorlens_runtime.monitor.history import BACK_S, BINS_S, History
from motorlens_runtime.publish import Header
from motorlens_runtime.service.alarms import Limit, Watch, plain_limit

# What each reason means to somebody who looks at the page.
WORDS = {
    Quality.WARM_UP: "warming up: less history than the sensor needs",
    Quality.BRIDGED: "samples are missing shortly before",
    Quality.STALE: "no sample comes: these are the last values",
    Quality.SATURATED: "a converter is at its rail",
    Quality.OUTSIDE_ENVELOPE: "outside what the sensor was trained on",
    Quality.NOT_FINITE: "a sample was no number and was left out",
    Quality.RESTORED: "heat remembered from an earlier run, not confirmed yet",
    Quality.OVERLOAD: "this PC is behind the stream",
    Quality.SIMULATED: "simulated drive",
    Quality.BACKEND_MISMATCH: "two implementations of the network disagree",
    Quality.STUCK: "a channel repeats itself",
    Quality.JUMP: "the current jumped faster than the inductance allows",
    Quality.ASSUMED_COLD: "the motor is taken to have started cold: no heat was remembered",
    Quality.UNFORETOLD: "the voltage shows that motor or sensors are likelier others than the file's",
    Quality.LINE_LOST: "the line is lost, or has only just come back",
}
_THROUGHOUT = np.uint32(Quality.SIMULATED | Quality.ASSUMED_COLD)
_EVENTS = 100
# Rows in one answer: writing them as JSON holds up the estimator in the same process, for a millisecond or two.
_AT_ONCE = 200
_MOST_LIMITS = 20
# A recording made from the page ends here: a day at 20 rows a second.
MOST_RECORDED_OCTETS = 1 << 28
# Voltage and current, which follow the sensor's own quantities in every row.
INPUTS = (("voltage", "V", "voltage_V"), ("current", "A", "current_A"))


class Motor:
    """One motor on the page. Several threads may call; each call is short.

    Args:
        header: what is estimated.
        name: what the page calls it.
        clock: seconds that never run backwards.
        wall_clock: seconds since 1970.
    """

    def __init__(
        self, header: Header, name: str, clock: Callable[[], float] = time.monotonic,
        wall_clock: Callable[[], float] = time.time,
    ) -> None:  # fmt: skip
        self.header, self.name = header, name
        self._clock, self._wall_clock = clock, wall_clock
        self._history = History(len(header.outputs) + len(INPUTS))
        self._lock = threading.Lock()
        self._latest: Estimates | None = None
        self._arrived_s = 0.0
        # Since when nothing fresh has come, by the wall clock, and what the wall clock says when the device says 0.
        self._fresh_at_s: float | None = None
        self._offset_s: float | None = None
        self._last_s = 0.0
        self._rows = 0
        self._counts: dict[str, Any] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._active: dict[str, dict[str, Any]] = {}
        self._limits: dict[str, Limit] = {}
        self._watch = Watch([])
        self._recording: IO[bytes] | None = None
        self._recorded = 0
        self._records = False

    def publish(self, estimates: Estimates) -> None:
        """Keep rows, with voltage and current as two more columns or without."""
        if not len(estimates):
            return
        missing = len(self.header.outputs) + len(INPUTS) - estimates.values.shape[1]
        if missing:
            nothing = np.full((len(estimates), missing), np.nan)
            estimates = replace(
                estimates,
                values=np.hstack((estimates.values, nothing)),
                sigma=np.hstack((estimates.sigma, nothing)),
            )
        with self._lock:
            self._history.append(estimates)
            self._latest = estimates
            self._arrived_s = self._clock()
            self._rows += len(estimates)
            wall_s = self._wall_clock()
            if not int(estimates.quality[-1]) & Quality.STALE:
                self._fresh_at_s = wall_s
            # Kept while the stream lasts, also where the device's clock is fast: rows keep their distances.
            time_s = int(estimates.time_ns[-1]) / 1e9
            if self._offset_s is None or time_s < self._last_s - BACK_S:
                self._offset_s = wall_s - time_s
            self._last_s = time_s
            for event in self._watch.look(estimates):
                self._keep(event.document())
            self._record_rows(estimates)

    def event(self, event: dict[str, Any]) -> None:
        """Keep an event; an alarm stays on until it says otherwise."""
        with self._lock:
            self._keep(event)

    def counts(self, counts: dict[str, Any]) -> None:
        """Keep what the service counts; an attached page counts what it can."""
        with self._lock:
            self._counts = counts

    def set_limit(self, heading: str, side: str, limit: float) -> None:
        """Watch a limit from now on.

        Raises:
            DataError: no such quantity or side, no number, or too many.
        """
        alarm = plain_limit(heading, side, limit, self.header.outputs)
        with self._lock:
            if len(self._limits) >= _MOST_LIMITS:
                raise DataError(f"at most {_MOST_LIMITS} limits; remove one first")
            self._limits[alarm.name] = alarm
            self._watch = Watch(list(self._limits.values()))

    def remove_limit(self, name: str) -> None:
        """Watch it no longer; what it said stays among the events."""
        with self._lock:
            self._limits.pop(name, None)
            self._active.pop(name, None)
            self._watch = Watch(list(self._limits.values()))

    def record(self, on: bool) -> None:
        """Begin a new recording of every row, or end the one under way, which is kept until the next begins.

        Raises:
            DataError: there is no room for it.
        """
        with self._lock:
            self._records = on
            if not on:
                return
            try:
                if self._recording is not None:
                    self._recording.close()
                self._recording, self._recorded = tempfile.TemporaryFile(prefix="motorlens-"), 0
                headings = [
                    name for output in self.header.outputs for name in (output.heading, output.sd_heading)
                ]
                columns = ["time_s", *headings, *(heading for *_, heading in INPUTS), "quality"]
                self._recording.write((",".join(columns) + "\n").encode())
            except OSError as error:
                self._records = False
                raise DataError(f"cannot record: {error.strerror}") from None

    def recording(self) -> bytes | None:
        """The recording as CSV, None if there is none."""
        with self._lock:
            if self._recording is None:
                return None
            self._recording.seek(0)
            return self._recording.read()

    def close(self) -> None:
        """Throw the recording away."""
        with self._lock:
            self._records = False
            if self._recording is not None:
                self._recording.close()
                self._recording = None

    def about(self) -> dict[str, Any]:
        """What does not change."""
        header = self.header
        quantities = [
            {
                "name": o.name,
                "unit": o.unit,
                "heading": o.heading,
                "sd_heading": o.sd_heading,
                "scale": o.scale,
            }
            for o in header.outputs
        ]
        inputs = [
            {"name": name, "unit": unit, "heading": heading, "input": True} for name, unit, heading in INPUTS
        ]
        return {
            "schema": "motorlens.monitor/1", "motor": self.name, "sensor": header.sensor, "version": header.version,
            "sha256": header.digest, "outputs": quantities + inputs,
            "reasons": {names(bit)[0]: words for bit, words in WORDS.items()},
            "bins_s": [0.0, *BINS_S],
            "bad_word": sum(bit for bit in Quality if opc_ua(bit).name.startswith("BAD")),
            "throughout_word": int(_THROUGHOUT),
        }  # fmt: skip

    def state(self) -> dict[str, Any]:
        """The newest row and what is amiss, for the list of motors."""
        with self._lock:
            return {"motor": self.name, "latest": self._told(), "alarms": len(self._active)}

    def live(self, window_s: float, level: int = -1, after: int = 0) -> dict[str, Any]:
        """What moves; numbers that are not finite are None."""
        with self._lock:
            view = self._history.view(window_s, level, after, _AT_ONCE)
            own = [{**limit, "own": True} for limit in self._watch.limits()]
            document: dict[str, Any] = {
                "level": view.level, "first": view.first, "after": view.after, "more": view.more,
                "offset_s": self._offset_s, "rows": self._rows,
                "counts": {name: count for name, count in self._counts.items() if name != "limits"},
                "limits": [*self._counts.get("limits", []), *own],
                "events": list(self._events), "alarms": list(self._active.values()),
                "recording": {"on": self._records, "rows": self._recorded, "there": self._recording is not None},
            }  # fmt: skip
            if (latest := self._told()) is not None:
                document["latest"] = latest
        return document | {
            "time_s": (view.rows.time_ns / 1e9).tolist(),
            "values": [[_finite(v) for v in row] for row in view.rows.values.T.tolist()],
            "sigma": [[_finite(v) for v in row] for row in view.rows.sigma.T.tolist()],
            "doubt": _doubt(view.rows.quality),
        }

    def _told(self) -> dict[str, Any] | None:
        if self._latest is None:
            return None
        word = int(self._latest.quality[-1])
        return {
            "time_s": int(self._latest.time_ns[-1]) / 1e9,
            "values": [_finite(v) for v in self._latest.values[-1].tolist()],
            "sigma": [_finite(v) for v in self._latest.sigma[-1].tolist()],
            "reasons": names(word), "status": opc_ua(word).name.partition("_")[0].lower(),
            "age_s": self._clock() - self._arrived_s, "fresh_at": self._fresh_at_s,
        }  # fmt: skip

    def _keep(self, event: dict[str, Any]) -> None:
        event = {**event, "at": self._wall_clock()}
        self._events.append(event)
        if event.get("event") == "alarm":
            self._active.pop(event["alarm"], None)
            if event["active"] and len(self._active) < _EVENTS:
                self._active[event["alarm"]] = event

    def _record_rows(self, rows: Estimates) -> None:
        if not self._records or self._recording is None:
            return
        k = len(self.header.outputs)
        pairs = np.stack((rows.values[:, :k], rows.sigma[:, :k]), axis=2).reshape(len(rows), 2 * k)
        table = np.hstack((pairs, rows.values[:, k:])).tolist()
        lines = [
            ",".join([repr(t), *("" if math.isnan(v) else repr(v) for v in line), str(word)]) + "\n"
            for t, line, word in zip((rows.time_ns / 1e9).tolist(), table, rows.quality.tolist(), strict=True)
        ]
        try:
            self._recording.seek(0, 2)
            if self._recording.tell() > MOST_RECORDED_OCTETS:
                raise OSError
            self._recording.write("".join(lines).encode())
            self._recorded += len(rows)
        except OSError:  # what is there stays; the page shows that it has ended
            self._records = False


def _doubt(words: NDArray[np.uint32]) -> list[int]:
    """0 good, 1 uncertain, 2 bad, a row each; what holds for the whole run is said in words and hides nothing here."""
    severe = {"GOOD": 0, "UNCERTAIN": 1, "BAD": 2}
    there, at = np.unique(words & ~_THROUGHOUT, return_inverse=True)
    codes = np.array([severe[opc_ua(int(word)).name.partition("_")[0]] for word in there.tolist()], dtype=int)
    doubt: list[int] = codes[at].tolist()
    return doubt


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
