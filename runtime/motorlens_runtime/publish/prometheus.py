"""`prometheus://127.0.0.1:9464`: `/metrics` in the Prometheus text format 0.0.4 and `/health` for supervisors; read only.

Listens on this machine unless another address is given. The newest row is what is served, however often it is asked for.
Names follow prometheus.io/docs/practices/naming: base units, spelled out.
"""

import json
import math
import threading
import time
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any
from urllib.parse import SplitResult

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import OpcUa, Quality, names, opc_ua
from motorlens_runtime.publish import Header, address_of, options_of
from motorlens_runtime.sensor.specification import Output

DEFAULT_PORT = 9464
_UNITS = {"rad/s": "radians_per_second", "K": "kelvin", "degC": "celsius", "ohm": "ohms"}
_COUNTERS = {
    "samples": "Samples that came.",
    "lost": "Samples that were sent and did not come.",
    "bad_frames": "Damaged frames.",
    "reconnects": "Times the line was opened again.",
}
_TEXT = "text/plain; version=0.0.4; charset=utf-8"


def open_url(url: SplitResult, header: Header) -> "PrometheusPublisher":
    """See `publish`. Option `stale` is after how many seconds without a row `/health` says so, default 5.

    Where rows come further apart (a slow `--rate`, a recording that is replayed), it is twice the time between them: the
    shorter of the last two, for the other may be an outage.
    """
    options = options_of(url, stale=5.0)
    return PrometheusPublisher(address_of(url, DEFAULT_PORT), header, options["stale"])


def metric_names(output: Output) -> tuple[str, str]:
    """What an output and its standard deviation are called."""
    name, unit = output.heading.removesuffix(_suffix(output.heading)), _UNITS[output.unit]
    return f"motorlens_{name}_{unit}", f"motorlens_{name}_standard_deviation_{unit}"


class PrometheusPublisher:
    """Serves the newest row. `address` is where it listens."""

    def __init__(
        self,
        address: tuple[str, int],
        header: Header,
        stale_s: float = 5.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._header = header
        self._stale_s = stale_s
        self._clock = clock
        self._latest: tuple[float, float, list[float], list[float], int] | None = None
        self._rows = 0
        self._apart_s = (0.0, 0.0)
        self._events: dict[str, bool] = {}
        self._counts: dict[str, Any] = {}
        try:
            self._server = _Server(address, _handler(self))
        except OSError as error:
            raise DeviceError(
                f"prometheus://{address[0]}:{address[1]}: cannot listen there: {error.strerror or error}"
            ) from None
        self.address: tuple[str, int] = self._server.server_address[:2]  # type: ignore[assignment]
        self._thread = threading.Thread(
            target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, name="prometheus", daemon=True
        )
        self._thread.start()

    def publish(self, estimates: Estimates) -> None:
        """Keep the last row."""
        if not len(estimates):
            return
        self._rows += len(estimates)
        now = self._clock()
        self._apart_s = (self._apart_s[1], 0.0 if self._latest is None else now - self._latest[0])
        self._latest = (
            now,
            int(estimates.time_ns[-1]) / 1e9,
            estimates.values[-1].tolist(),
            estimates.sigma[-1].tolist(),
            int(estimates.quality[-1]),
        )

    def event(self, event: dict[str, Any]) -> None:
        """Remember which alarms are on."""
        self._events = {**self._events, str(event.get("alarm", "")): bool(event.get("active"))}

    def counts(self, counts: dict[str, Any]) -> None:
        """Keep what the service counts."""
        self._counts = counts

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Stop listening."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(2.0)

    def metrics(self) -> str:
        """The text of `/metrics`."""
        header, latest = self._header, self._latest
        about = {"sensor": header.sensor, "version": header.version, "sha256": header.digest}
        lines = [
            _gauge(
                "motorlens_info", "The sensor that estimates.", [({**about, "device": header.device}, 1.0)]
            )
        ]
        lines.append(_family("motorlens_rows_total", "counter", "Rows published.", [({}, float(self._rows))]))
        if latest is not None:
            arrived, time_s, values, sigma, word = latest
            for column, output in enumerate(header.outputs):
                name, sd_name = metric_names(output)
                lines.append(_gauge(name, f"Estimated {output.name}.", [({}, values[column])]))
                about_sd = f"Standard deviation of the estimated {output.name}."
                lines.append(_gauge(sd_name, about_sd, [({}, sigma[column])]))
            reasons = [({"reason": names(bit)[0]}, float(bool(word & bit))) for bit in Quality]
            lines.append(_gauge("motorlens_quality", "Quality word; 0 is good.", [({}, float(word))]))
            lines.append(_gauge("motorlens_quality_reason", "Which reasons to doubt apply.", reasons))
            lines.append(_gauge("motorlens_sample_timestamp_seconds", "Time of the sample.", [({}, time_s)]))
            lines.append(
                _gauge("motorlens_age_seconds", "Time since the row came.", [({}, self._clock() - arrived)])
            )
        for key, meaning in _COUNTERS.items():
            if key in self._counts:
                name = f"motorlens_{key}_total" if key != "lost" else "motorlens_lost_samples_total"
                lines.append(_family(name, "counter", meaning, [({}, float(self._counts[key]))]))
        left = self._counts.get("time_to_limit_s", {})
        if left:
            seconds = [({"alarm": name}, math.inf if s is None else s) for name, s in sorted(left.items())]
            lines.append(_gauge("motorlens_time_to_limit_seconds", "Until the limit, as things go.", seconds))
        if self._events:
            alarms = [({"alarm": name}, float(active)) for name, active in sorted(self._events.items())]
            lines.append(_gauge("motorlens_alarm_active", "Alarms that are on.", alarms))
        return "".join(lines)

    def health(self) -> tuple[bool, dict[str, Any]]:
        """Whether all is well, and the document of `/health`."""
        latest = self._latest
        alarms = sorted(name for name, active in self._events.items() if active)
        if latest is None:
            return False, {"status": "waiting", "rows": 0, "alarms": alarms}
        arrived, _, _, _, word = latest
        age_s = self._clock() - arrived
        code = opc_ua(word)
        stale = age_s > max(self._stale_s, 2 * min(self._apart_s))
        status = "stale" if stale else code.name.partition("_")[0].lower()
        document = {"status": status, "age_s": round(age_s, 3), "rows": self._rows, "quality": word}
        good = status not in ("stale", OpcUa.BAD_SENSOR_FAILURE.name.partition("_")[0].lower())
        return good, {**document, "reasons": names(word), "alarms": alarms}


class _Server(HTTPServer):
    # One request at a time, each with a short patience: a client that hangs holds no more than one.
    request_queue_size = 16

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that went away is no concern of ours."""


def _handler(publisher: PrometheusPublisher) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        timeout = 1.0

        def do_GET(self) -> None:
            path = self.path.partition("?")[0]
            if path == "/metrics":
                self._answer(200, _TEXT, publisher.metrics())
            elif path in ("/health", "/healthz"):
                good, document = publisher.health()
                self._answer(200 if good else 503, "application/json", json.dumps(document) + "\n")
            else:
                self._answer(404, "text/plain; charset=utf-8", "there are /metrics and /health\n")

        def _answer(self, status: int, kind: str, text: str) -> None:
            body = text.encode()
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *arguments: object) -> None:
            pass

    return Handler


def _suffix(heading: str) -> str:
    """The unit at the end of a column's name."""
    return next(end for end in ("_rad_s", "_K", "_C", "_ohm") if heading.endswith(end))


def _gauge(name: str, about: str, samples: list[tuple[dict[str, str], float]]) -> str:
    return _family(name, "gauge", about, samples)


def _family(name: str, kind: str, about: str, samples: list[tuple[dict[str, str], float]]) -> str:
    lines = [f"# HELP {name} {about}", f"# TYPE {name} {kind}"]
    for labels, value in samples:
        inside = ",".join(f'{key}="{_escaped(text)}"' for key, text in labels.items())
        number = {"inf": "+Inf", "-inf": "-Inf", "nan": "NaN"}.get(repr(value), repr(value))
        lines.append(f"{name}{'{' + inside + '}' if inside else ''} {number}")
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n").replace('"', r"\"")
