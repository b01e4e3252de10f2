"""The live page: a publisher whose rows, events and counts a browser asks for; of one motor or of several."""

import json
import math
import time
from collections.abc import Callable
from typing import Any

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.monitor.motor import Motor
from motorlens_runtime.publish import Header
from motorlens_runtime.web import asset
from motorlens_runtime.web.loopback import Answer, LoopbackServer, Request, refusal

_OWN, _SHARED = "motorlens_runtime.monitor", "motorlens_runtime.web"
_SCRIPT, _STYLE = "text/javascript; charset=utf-8", "text/css; charset=utf-8"
# What the page is made of: path, package and name of the file, its type.
FILES = {
    "/": (_OWN, "page.html", "text/html; charset=utf-8"),
    "/page.js": (_OWN, "page.js", _SCRIPT),
    "/plots.js": (_OWN, "plots.js", _SCRIPT),
    "/files.js": (_OWN, "files.js", _SCRIPT),
    "/words.js": (_OWN, "words.js", _SCRIPT),
    "/page.css": (_OWN, "page.css", _STYLE),
    "/style.css": (_SHARED, "style.css", _STYLE),
    "/uPlot.js": (f"{_SHARED}.uplot", "uPlot.iife.min.js", _SCRIPT),
    "/uPlot.css": (f"{_SHARED}.uplot", "uPlot.min.css", _STYLE),
}
# Window that a page may ask for, at most.
_DAY_S = 86_400.0


class MonitorPage:
    """Serves the page at `url` from the moment it is made until `close`; as a publisher it is that of its first motor.

    `GET /motors` is the list. `GET /about?motor=K` is what does not change, `/live?motor=K&window=SECONDS&level=L&after=N`
    everything that moves; level and number of the next row, as the last answer gave them, ask for new rows only; while there
    is `more`, it is asked again at once. `GET /recording.csv?motor=K` is what was recorded. `POST /limit` takes
    `{"motor": K, "quantity": HEADING, "side": ">", "limit": NUMBER}` or `{"motor": K, "remove": NAME}`, `POST /record` takes
    `{"motor": K, "on": true}`.
    """

    takes_inputs = True

    def __init__(
        self, header: Header, port: int = 0, token: str | None = None, clock: Callable[[], float] = time.monotonic,
        name: str = "", wall_clock: Callable[[], float] = time.time,
    ) -> None:  # fmt: skip
        self._clocks = clock, wall_clock
        self._motors: list[Motor] = []
        self.add(header, name)
        self._server = LoopbackServer(self.answer, port, token)

    def add(self, header: Header, name: str) -> Motor:
        """One more motor on the page; it is fed through what is returned."""
        motor = Motor(header, name or header.device or header.sensor, *self._clocks)
        self._motors.append(motor)
        return motor

    @property
    def motor(self) -> Motor:
        """The first motor."""
        return self._motors[0]

    @property
    def url(self) -> str:
        """Where the page is, key included."""
        return self._server.url

    def url_for_once(self) -> str:
        """An address that opens the page one time."""
        return self._server.url_for_once()

    def publish(self, estimates: Estimates) -> None:
        """Keep rows."""
        self.motor.publish(estimates)

    def event(self, event: dict[str, Any]) -> None:
        """Keep an event."""
        self.motor.event(event)

    def counts(self, counts: dict[str, Any]) -> None:
        """Keep counts."""
        self.motor.counts(counts)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Stop serving."""
        self._server.close()
        for motor in self._motors:
            motor.close()

    def answer(self, request: Request) -> Answer:
        """What the server sends."""
        if request.path in FILES and request.method == "GET":
            package, name, kind = FILES[request.path]
            return Answer(asset(package, name), kind)
        try:
            return self._post(request) if request.method == "POST" else self._get(request)
        except (ValueError, TypeError, KeyError, RecursionError):
            return refusal(400, "not understood: motor, window, level, after and limit are numbers")
        except DataError as error:
            return refusal(400, str(error))

    def _get(self, request: Request) -> Answer:
        if request.path == "/motors":
            return _json({"motors": [motor.state() for motor in self._motors]})
        if request.path == "/about":
            return _json(self._asked(request.query).about())
        if request.path == "/live":
            window_s = float(request.query.get("window", "60"))
            if not math.isfinite(window_s):
                raise ValueError
            level, after = int(request.query.get("level", "-1")), int(request.query.get("after", "0"))
            return _json(self._asked(request.query).live(min(max(window_s, 1.0), _DAY_S), level, after))
        if request.path == "/recording.csv":
            recorded = self._asked(request.query).recording()
            if recorded is None:
                return refusal(404)
            name = {"Content-Disposition": 'attachment; filename="recording.csv"'}
            return Answer(recorded, "text/csv; charset=utf-8", headers=name)
        return refusal(404)

    def _post(self, request: Request) -> Answer:
        if request.path not in ("/limit", "/record"):
            return refusal(404)
        asked = json.loads(request.body)
        if not isinstance(asked, dict):
            raise ValueError
        motor = self._asked(asked)
        if request.path == "/record":
            motor.record(asked["on"] is True)
        elif "remove" in asked:
            motor.remove_limit(str(asked["remove"]))
        else:
            motor.set_limit(str(asked["quantity"]), str(asked["side"]), float(asked["limit"]))
        return _json({})

    def _asked(self, query: Any) -> Motor:
        number = int(query.get("motor", 0))
        if not 0 <= number < len(self._motors):
            raise DataError(f"there is no motor {number}")
        return self._motors[number]


def _json(document: dict[str, Any]) -> Answer:
    return Answer(json.dumps(document, allow_nan=False).encode())
