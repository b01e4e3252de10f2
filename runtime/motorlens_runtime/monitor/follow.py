"""Feeding a motor of the page from a runtime it is attached to: rows, events, alarms of its own, and the end of the line."""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from motorlens_runtime.monitor.attach import Attachment
from motorlens_runtime.monitor.motor import Motor
from motorlens_runtime.service.alarms import Alarm, Watch

# A runtime repeats its last estimate ten times a second when its line is silent: one that says nothing at all is gone.
LOST_S = 3.0
_EVENTS = 100


class Follower:
    """One attachment and the motor it feeds; `clock` is in seconds and never runs backwards."""

    def __init__(
        self, there: Attachment, motor: Motor, alarms: Sequence[Alarm], clock: Callable[[], float]
    ) -> None:
        self._there, self._motor, self._clock = there, motor, clock
        self._watch = Watch(alarms)
        self._counts: dict[str, Any] = {}
        self._events: deque[dict[str, Any]] = deque(maxlen=_EVENTS)
        self._heard_s = clock()
        self._heard_ns: int | None = None
        self._lost = False

    def look(self, wait_s: float) -> None:
        """Take what is new; waits for it, at most about `wait_s`."""
        news = self._there.read(wait_s)
        now_s = self._clock()
        for event in news.events:
            self._tell(event)
        if news.rows is not None and len(news.rows):
            if self._lost:
                self._lost = False
                self._say(
                    "back", int(news.rows.time_ns[0]), f"rows come again after {now_s - self._heard_s:.1f} s"
                )
            self._heard_s, self._heard_ns = now_s, int(news.rows.time_ns[-1])
            self._motor.publish(news.rows)
            for change in self._watch.look(news.rows):
                self._tell(change.document())
        elif not self._lost and self._heard_ns is not None and now_s - self._heard_s >= LOST_S:
            self._lost = True
            self._say(
                "lost", self._heard_ns, f"the runtime has said nothing for {now_s - self._heard_s:.1f} s"
            )
        if news.counts is not None:
            left_s = {
                name: s if s < float("inf") else None for name, s in self._watch.time_to_limit_s().items()
            }
            self._counts = {
                **news.counts, "limits": self._watch.limits(),
                "time_to_limit_s": {**news.counts.get("time_to_limit_s", {}), **left_s},
            }  # fmt: skip
            self._motor.counts(self._counts)

    def report(self) -> dict[str, Any]:
        """The last counts and events."""
        return {"counts": self._counts, "events": list(self._events)}

    def _say(self, what: str, time_ns: int, message: str) -> None:
        self._tell(
            {"event": f"line_{what}", "timestamp": time_ns / 1e9, "message": f"line {what}: {message}"}
        )

    def _tell(self, event: dict[str, Any]) -> None:
        self._events.append(event)
        self._motor.event(event)
