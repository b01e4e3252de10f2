"""Where estimates go: one URL scheme, one module of this package, found because it is there.

A module has `open_url(url, header) -> Publisher`. `stdout:`, `csv:out.csv`, `jsonl:out.jsonl?rate=10`, `udp://127.0.0.1:9870`.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol
from urllib.parse import SplitResult, parse_qsl, unquote, urlsplit

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.sensor.specification import Output


@dataclass(frozen=True)
class Header:
    """What a publisher says once about what it publishes."""

    sensor: str
    version: str
    digest: str
    outputs: tuple[Output, ...]
    device: str = ""


class Publisher(Protocol):
    """One destination. It may raise OSError; the caller counts that and goes on.

    One that has a word for them also has `event(event)`, for alarms as `alarms.Event.document` has them, `counts(counts)`,
    for what `Service.counts` says once a second, and `dropped`, the number of rows that it was given and could not send. One
    whose readers do not wait for each row has `gather_s`: rows may gather for so long, which spares a wake-up for each.
    One that shows what was measured has `takes_inputs`: its rows have voltage and current as two more columns.
    """

    def publish(self, estimates: Estimates) -> None:
        """Write rows."""
        ...

    def flush(self) -> None:
        """Make what was written visible to others; called at least once a second."""
        ...

    def close(self) -> None:
        """Finish; afterwards nothing is published."""
        ...


def open_publisher(url: str, header: Header) -> Publisher:
    """Open a destination.

    Raises:
        DataError: the scheme is unknown or the URL incomplete.
        DeviceError: the destination cannot be opened.
    """
    parts = urlsplit(url)
    known = sorted(module.name for module in pkgutil.iter_modules(__path__))
    if parts.scheme not in known:
        raise DataError(f"--publish {url}: unknown scheme {parts.scheme!r}; known: {', '.join(known)}")
    publisher: Publisher = importlib.import_module(f"{__name__}.{parts.scheme}").open_url(parts, header)
    return publisher


def options_of(parts: SplitResult, **defaults: float) -> Mapping[str, float]:
    """The numbers behind `?`, with their defaults. Raises DataError for one that is not known or no number."""
    values = dict(defaults)
    for key, text in parse_qsl(parts.query, keep_blank_values=True):
        if key in ("rate", "decimate"):
            continue  # the service's
        if key not in defaults:
            raise DataError(
                f"{parts.geturl()}: unknown option {key!r}; known: {', '.join(defaults) or 'rate, decimate'}"
            )
        try:
            values[key] = float(text)
        except ValueError:
            raise DataError(f"{parts.geturl()}: {key}={text} is not a number") from None
    return values


def file_of(parts: SplitResult) -> str:
    """The file that a URL such as `csv:out.csv` or `csv:///var/log/out.csv` names."""
    path = unquote(parts.netloc + parts.path)
    if not path:
        raise DataError(f"{parts.geturl()}: name a file, for example {parts.scheme}:out.{parts.scheme}")
    return path


def address_of(parts: SplitResult, default_port: int | None = None) -> tuple[str, int]:
    """Host and port of a URL; the host is this machine unless given."""
    try:
        port = parts.port or default_port
    except ValueError:
        port = None
    if port is None:
        raise DataError(f"{parts.geturl()}: give a port, for example {parts.scheme}://127.0.0.1:9870")
    return parts.hostname or "127.0.0.1", port
