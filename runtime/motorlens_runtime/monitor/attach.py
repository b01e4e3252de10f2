"""Attaching to a runtime that runs already: `shm:NAME`, `http://127.0.0.1:9464` (what `prometheus:` serves) or `udp://:9870`.

Nothing is asked of the runtime but what it publishes anyway. A line that falls silent is waited for.
"""

import json
import math
import re
import select
import socket
import time
import urllib.error
import urllib.request
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import urlsplit

import numpy as np

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.shared_memory import Reader
from motorlens_runtime.publish import Header, address_of, file_of
from motorlens_runtime.publish.prometheus import DEFAULT_PORT, metric_names
from motorlens_runtime.publish.udp import PLOTJUGGLER_PORT
from motorlens_runtime.sensor.specification import HEADINGS, Output

_OUTPUTS = {heading: Output(name, unit, 1.0) for (name, unit), (heading, _) in HEADINGS.items()}
_COUNTS = {
    "motorlens_samples_total": "samples", "motorlens_lost_samples_total": "lost", "motorlens_bad_frames_total": "bad_frames",
    "motorlens_reconnects_total": "reconnects", "motorlens_rows_total": "published",
}  # fmt: skip
_ALL_BITS = sum(Quality)
# How long to wait for the first words of a runtime, for an answer once it has said something, and between two questions to
# its /metrics. Where a PC is busy the first words take seconds; later, others that are watched wait as well.
_FIRST_S, _ANSWER_S, _ASK_S = 30.0, 2.0, 0.2
_SAMPLE = re.compile(r"(\w+)(?:\{(.*)\})? (\S+)")
_LABEL = re.compile(r'(\w+)="((?:[^"\\]|\\.)*)"')


@dataclass(frozen=True)
class News:
    """What has come: rows, events as publishers send them, and what is counted (None: as before)."""

    rows: Estimates | None = None
    events: list[dict[str, Any]] = field(default_factory=list)
    counts: dict[str, Any] | None = None


class Attachment(Protocol):
    """One runtime that is watched."""

    @property
    def header(self) -> Header:
        """What it estimates."""
        ...

    def read(self, wait_s: float) -> News:
        """What is new; waits for it, at most about `wait_s`."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


def named(text: str) -> tuple[str, str]:
    """Name and URL of `NAME=URL`, or of a URL, whose name is then what it says.

    >>> named("press 7=shm:press")
    ('press 7', 'shm:press')
    >>> named("udp://127.0.0.1:9870")
    ('udp://127.0.0.1:9870', 'udp://127.0.0.1:9870')
    """
    match = re.fullmatch(r"([^:=/]+)=(.+)", text)
    return (match[1].strip(), match[2]) if match else (text, text)


def attach(url: str, first_s: float = _FIRST_S) -> Attachment:
    """Attach to what `--attach` names.

    Raises:
        DataError: the URL is not understood, or what is there is no runtime.
        DeviceError: nothing is there, or it says nothing within `first_s`.
    """
    parts = urlsplit(url)
    if parts.scheme == "shm":
        name = file_of(parts)
        return _Memory(Path(name) if "/" in name else Path("/dev/shm") / name)
    if parts.scheme in ("http", "prometheus"):
        return _Metrics(*address_of(parts, DEFAULT_PORT), url)
    if parts.scheme == "udp":
        return _Datagrams(*address_of(parts, PLOTJUGGLER_PORT), first_s)
    raise DataError(
        f"--attach {url}: unknown scheme {parts.scheme!r}; known: shm:NAME, http://HOST:PORT, udp://HOST:PORT"
    )


def _outputs(headings: list[str], where: str) -> tuple[Output, ...]:
    found = tuple(_OUTPUTS[heading] for heading in headings if heading in _OUTPUTS)
    if not found or len(found) != len(headings):
        raise DataError(f"{where}: publishes none of the quantities that a motorlens runtime estimates")
    return found


class _Memory:
    """Every row, from the ring of `--publish shm:NAME`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._reader = Reader(path)
        columns = self._reader.columns
        outputs = _outputs(list(columns["values"]), str(path))
        self.header = Header(str(columns["sensor"]), str(columns["version"]), str(columns["sha256"]), outputs)
        self._seen = self._missed = 0

    def read(self, wait_s: float) -> News:
        """See `Attachment`."""
        rows, missed = self._reader.since_last()
        if not len(rows):
            if self._reader.replaced():
                self._open_again()
            time.sleep(min(wait_s, 0.05))
            return News()
        if self._seen:  # what was overwritten before we came was not missed
            self._missed += missed
        self._seen += len(rows)
        estimates = Estimates(*(np.array(rows[name]) for name in ("time_ns", "values", "sigma", "quality")))
        return News(estimates, counts={"published": self._seen, "missed": self._missed})

    def _open_again(self) -> None:
        try:
            reader = Reader(self._path)
        except (DeviceError, DataError):
            return  # not there yet
        if reader.columns["values"] == [output.heading for output in self.header.outputs]:
            self._reader.close()
            self._reader = reader

    def close(self) -> None:
        """See `Attachment`."""
        self._reader.close()


class _Metrics:
    """The newest row a few times a second, from `--publish prometheus:`."""

    def __init__(self, host: str, port: int, where: str) -> None:
        self._url, self._where = f"http://{host}:{port}/metrics", where
        self._alarms: dict[str, bool] = {}
        self._last_s: float | None = None
        samples = self._ask(_FIRST_S)
        if samples is None:
            raise DeviceError(
                f"{where}: no answer from /metrics; is a runtime publishing with prometheus: there?"
            )
        about = dict(next((labels for name, labels, _ in samples if name == "motorlens_info"), {}))
        if not about:
            raise DataError(f"{where}: /metrics is not that of a motorlens runtime")
        end = time.monotonic() + _FIRST_S
        while not (there := self._there(samples)):
            if time.monotonic() > end:
                raise DeviceError(f"{where}: the runtime has no estimate yet; is its drive on?")
            time.sleep(_ASK_S)
            samples = self._ask() or []
        self.header = Header(
            about.get("sensor", ""),
            about.get("version", ""),
            about.get("sha256", ""),
            tuple(there),
            about.get("device", ""),
        )

    @staticmethod
    def _there(samples: list[tuple[str, Mapping[str, str], float]]) -> list[Output]:
        names = {name for name, _, _ in samples}
        return [output for output in _OUTPUTS.values() if metric_names(output)[0] in names]

    def read(self, wait_s: float) -> News:
        """See `Attachment`."""
        time.sleep(min(wait_s, _ASK_S))
        samples = self._ask()
        if samples is None:
            return News()
        plain = {name: value for name, labels, value in samples if not labels}
        counts: dict[str, Any] = {key: int(plain[name]) for name, key in _COUNTS.items() if name in plain}
        left = {
            labels["alarm"]: value if value < math.inf else None
            for name, labels, value in samples
            if name == "motorlens_time_to_limit_seconds" and "alarm" in labels
        }
        if left:
            counts["time_to_limit_s"] = left
        time_s = plain.get("motorlens_sample_timestamp_seconds")
        if time_s is None or not math.isfinite(time_s):
            return News(counts=counts)
        events = self._changes(samples, time_s)
        if time_s == self._last_s:
            return News(None, events, counts)
        self._last_s = time_s
        names = [metric_names(output) for output in self.header.outputs]
        row = Estimates(
            np.array([round(time_s * 1e9)], dtype=np.int64),
            np.array([[plain.get(name, math.nan) for name, _ in names]]),
            np.array([[plain.get(name, math.nan) for _, name in names]]),
            np.array([int(plain.get("motorlens_quality", 0)) & _ALL_BITS], dtype=np.uint32),
        )
        return News(row, events, counts)

    def _changes(
        self, samples: list[tuple[str, Mapping[str, str], float]], time_s: float
    ) -> list[dict[str, Any]]:
        now = {
            ls["alarm"]: v > 0
            for name, ls, v in samples
            if name == "motorlens_alarm_active" and "alarm" in ls
        }
        changed = [name for name, active in now.items() if active != self._alarms.get(name, False)]
        self._alarms = now
        return [
            {"event": "alarm", "alarm": name, "active": now[name], "timestamp": time_s,
             "message": f"the runtime says it went {'on' if now[name] else 'off'}"}
            for name in changed
        ]  # fmt: skip

    def _ask(self, patience_s: float = _ANSWER_S) -> list[tuple[str, Mapping[str, str], float]] | None:
        try:
            # No proxy: the runtime is where its address says.
            opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
            with opener.open(self._url, timeout=patience_s) as answer:
                text = answer.read(1 << 20).decode("utf-8", "replace")
        except (OSError, ValueError, urllib.error.URLError):
            return None
        return _metrics(text)

    def close(self) -> None:
        """See `Attachment`."""


def _metrics(text: str) -> list[tuple[str, Mapping[str, str], float]]:
    """Name, labels and value of each sample of a Prometheus text; what is not understood is left out."""
    found: list[tuple[str, Mapping[str, str], float]] = []
    for line in text.splitlines():
        match = _SAMPLE.fullmatch(line)
        if match is None or line.startswith("#"):
            continue
        labels = {
            key: value.replace(r"\"", '"').replace(r"\n", "\n").replace(r"\\", "\\")
            for key, value in _LABEL.findall(match[2] or "")
        }
        try:
            found.append((match[1], labels, float(match[3])))
        except ValueError:
            continue
    return found


class _Datagrams:
    """Every row that arrives, from `--publish udp://`; nobody knows of those that do not."""

    def __init__(self, host: str, port: int, first_s: float) -> None:
        where = f"udp://{host}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceError(f"{where}: cannot listen there: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self._seen = 0
        self._waiting: list[dict[str, Any]] = []
        end = time.monotonic() + first_s
        while not (rows := [d for d in self._waiting if "timestamp" in d and "event" not in d]):
            if time.monotonic() > end:
                self._socket.close()
                raise DeviceError(
                    f"{where}: nothing comes; run with --publish {where}, and no other reader on that port"
                )
            self._waiting += self._documents(0.25)
        outputs = _outputs([key for key in rows[0] if key in _OUTPUTS], where)
        self.header = Header("", "", "", outputs)

    def read(self, wait_s: float) -> News:
        """See `Attachment`."""
        documents, self._waiting = self._waiting or self._documents(wait_s), []
        events = [event for document in documents if (event := _event(document)) is not None]
        rows = [d for d in documents if "event" not in d and _number(d.get("timestamp")) < math.inf]
        if not rows:
            return News(None, events)
        self._seen += len(rows)
        outputs = self.header.outputs
        estimates = Estimates(
            np.array([round(_number(d["timestamp"]) * 1e9) for d in rows], dtype=np.int64),
            np.array([[_number(d.get(o.heading)) for o in outputs] for d in rows]),
            np.array([[_number(d.get(o.sd_heading)) for o in outputs] for d in rows]),
            np.array(
                [int(d["quality"]) & _ALL_BITS if isinstance(d.get("quality"), int) else 0 for d in rows],
                dtype=np.uint32,
            ),
        )
        return News(estimates, events, {"published": self._seen})

    def _documents(self, wait_s: float) -> list[dict[str, Any]]:
        """Datagrams as JSON objects; anything else that comes is left out."""
        if not select.select([self._socket], [], [], wait_s)[0]:
            return []
        found = []
        for _ in range(1000):
            try:
                data = self._socket.recv(65536)
            except OSError:
                break
            try:
                document = json.loads(data)
            except (ValueError, RecursionError):
                continue
            if isinstance(document, dict):
                found.append(document)
        return found

    def close(self) -> None:
        """See `Attachment`."""
        self._socket.close()


def _event(document: dict[str, Any]) -> dict[str, Any] | None:
    """What an event says, of the types it must have; None if it is none."""
    kind, message, alarm = (document.get(key) for key in ("event", "message", "alarm"))
    if not isinstance(kind, str) or not isinstance(message, str):
        return None
    found: dict[str, Any] = {"event": kind[:100], "message": message[:500]}
    time_s = _number(document.get("timestamp"))
    if math.isfinite(time_s):
        found["timestamp"] = time_s
    if kind != "alarm":
        return found
    if not isinstance(alarm, str) or not isinstance(document.get("active"), bool):
        return None
    return {**found, "alarm": alarm[:100], "active": document["active"]}


def _number(value: Any) -> float:
    """A JSON number of reasonable size, NaN for anything else."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 9e9
    return float(value) if is_number else math.nan
