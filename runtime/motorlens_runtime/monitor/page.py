"""The live page: a publisher whose rows, events and counts a browser asks for."""

import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality, names, opc_ua
from motorlens_runtime.monitor.history import BINS_S, History
from motorlens_runtime.publish import Header
from motorlens_runtime.web import asset
from motorlens_runtime.web.loopback import Answer, LoopbackServer, Request, refusal

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
}
_THROUGHOUT = np.uint32(Quality.SIMULATED | Quality.ASSUMED_COLD)
# What the page is made of: path, package and name of the file, its type.
FILES = {
    "/": ("motorlens_runtime.monitor", "page.html", "text/html; charset=utf-8"),
    "/page.js": ("motorlens_runtime.monitor", "page.js", "text/javascript; charset=utf-8"),
    "/page.css": ("motorlens_runtime.monitor", "page.css", "text/css; charset=utf-8"),
    "/style.css": ("motorlens_runtime.web", "style.css", "text/css; charset=utf-8"),
}
_EVENTS = 100
# Rows in one answer: writing them as JSON holds up the estimator in the same process, for a millisecond or two.
_AT_ONCE = 200
# Window that a page may ask for, at most.
_DAY_S = 86_400.0


class MonitorPage:
    """Serves the page at `url` from the moment it is made until `close`.

    `GET /live?window=SECONDS&level=L&after=N` is everything that moves; level and number of the next row, as the last answer
    gave them, ask for new rows only; while there is `more`, it is asked again at once.
    """

    def __init__(
        self,
        header: Header,
        port: int = 0,
        token: str | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._header, self._clock = header, clock
        self._history = History(len(header.outputs))
        self._lock = threading.Lock()
        self._latest: Estimates | None = None
        self._arrived_s = 0.0
        self._rows = 0
        self._counts: dict[str, Any] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._active: dict[str, dict[str, Any]] = {}
        self._server = LoopbackServer(self.answer, port, token)

    @property
    def url(self) -> str:
        """Where the page is, key included."""
        return self._server.url

    def url_for_once(self) -> str:
        """An address that opens the page one time."""
        return self._server.url_for_once()

    def publish(self, estimates: Estimates) -> None:
        """Keep rows."""
        if len(estimates):
            with self._lock:
                self._history.append(estimates)
                self._latest = estimates
                self._arrived_s = self._clock()
                self._rows += len(estimates)

    def event(self, event: dict[str, Any]) -> None:
        """Keep an event; an alarm stays on until it says otherwise."""
        with self._lock:
            self._events.append(event)
            if event.get("event") == "alarm":
                self._active.pop(event["alarm"], None)
                if event["active"] and len(self._active) < _EVENTS:
                    self._active[event["alarm"]] = event

    def counts(self, counts: dict[str, Any]) -> None:
        """Keep what the service counts; an attached page counts what it can."""
        with self._lock:
            self._counts = counts

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Stop serving."""
        self._server.close()

    def answer(self, request: Request) -> Answer:
        """What the server sends."""
        if request.method != "GET":
            return refusal(405)
        if request.path in FILES:
            package, name, kind = FILES[request.path]
            return Answer(asset(package, name), kind)
        if request.path == "/about":
            return _json(self.about())
        if request.path == "/live":
            try:
                window_s = float(request.query.get("window", "60"))
                if not math.isfinite(window_s):
                    raise ValueError
                window_s = min(max(window_s, 1.0), _DAY_S)
                level, after = int(request.query.get("level", "-1")), int(request.query.get("after", "0"))
            except ValueError:
                return refusal(400, "window, level and after are numbers")
            return _json(self.live(window_s, level, after))
        return refusal(404)

    def about(self) -> dict[str, Any]:
        """What does not change."""
        header = self._header
        return {
            "schema": "motorlens.monitor/1", "sensor": header.sensor, "version": header.version, "sha256": header.digest,
            "outputs": [{"name": o.name, "unit": o.unit, "heading": o.heading} for o in header.outputs],
            "reasons": {names(bit)[0]: words for bit, words in WORDS.items()},
            "bins_s": [0.0, *BINS_S],
        }  # fmt: skip

    def live(self, window_s: float, level: int = -1, after: int = 0) -> dict[str, Any]:
        """What moves; numbers that are not finite are None."""
        with self._lock:
            view = self._history.view(window_s, level, after, _AT_ONCE)
            latest, counts = self._latest, dict(self._counts)
            events, active = list(self._events), list(self._active.values())
            age_s, published = self._clock() - self._arrived_s, self._rows
        document: dict[str, Any] = {
            "level": view.level, "first": view.first, "after": view.after, "more": view.more,
            "time_s": (view.rows.time_ns / 1e9).tolist(),
            "values": [[_finite(v) for v in row] for row in view.rows.values.T.tolist()],
            "sigma": [[_finite(v) for v in row] for row in view.rows.sigma.T.tolist()],
            "doubt": _doubt(view.rows.quality),
            "rows": published, "counts": counts, "events": events, "alarms": active,
        }  # fmt: skip
        if latest is not None:
            word = int(latest.quality[-1])
            document["latest"] = {
                "time_s": int(latest.time_ns[-1]) / 1e9,
                "values": [_finite(v) for v in latest.values[-1].tolist()],
                "sigma": [_finite(v) for v in latest.sigma[-1].tolist()],
                "reasons": names(word), "status": opc_ua(word).name.partition("_")[0].lower(), "age_s": age_s,
            }  # fmt: skip
        return document


def _doubt(words: NDArray[np.uint32]) -> list[int]:
    """0 good, 1 uncertain, 2 bad, a row each; what holds for the whole run is said in words and hides nothing here."""
    severe = {"GOOD": 0, "UNCERTAIN": 1, "BAD": 2}
    there, at = np.unique(words & ~_THROUGHOUT, return_inverse=True)
    codes = np.array([severe[opc_ua(int(word)).name.partition("_")[0]] for word in there.tolist()], dtype=int)
    found: list[int] = codes[at].tolist()
    return found


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _json(document: dict[str, Any]) -> Answer:
    return Answer(json.dumps(document, allow_nan=False).encode())
