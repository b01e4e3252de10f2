"""Where bytes come from: one URL scheme, one module of this package, found because it is there.

`serial:///dev/ttyUSB0?baud=921600`, `pty:///dev/pts/3`, `tcp://host:port`, `udp://:port`, `stdin:`; a bare path such as
/dev/ttyACM0 is a serial port. Other packages add schemes through the entry points `motorlens.sources`. A module has
`open_url(url, options) -> Source`, where `options` are the numbers and words behind `?` that it must take or leave.
"""

import importlib
import pkgutil
from collections.abc import Callable
from typing import Protocol
from urllib.parse import SplitResult, parse_qsl, urlsplit

from motorlens_runtime.errors import DataError, DeviceError

Options = dict[str, str]


class Source(Protocol):
    """An open line.

    `name` is what messages call it. `lasting` tells a line worth opening again when it breaks from one that just ends.
    """

    name: str
    lasting: bool

    def read(self, timeout_s: float) -> bytes | None:
        """All bytes that are there, at the latest after `timeout_s`; b"" when none came, None at the end.

        Raises:
            DeviceError: the line broke.
        """
        ...

    def write(self, data: bytes) -> None:
        """Send to the device. Raises DeviceError if the line broke."""
        ...

    def close(self) -> None:
        """Let go of the line."""
        ...


def split(url: str) -> tuple[SplitResult, Options]:
    """A source's URL and the options behind its `?`."""
    parts = urlsplit(url if ":" in url.partition("/")[0] else f"serial://{url}")
    return parts, dict(parse_qsl(parts.query, keep_blank_values=True))


def open_source(parts: SplitResult, options: Options) -> Source:
    """Open a line; takes what it understands out of `options`.

    Raises:
        DataError: the scheme is unknown or the URL incomplete.
        DeviceError: the port is absent or taken.
    """
    built_in = {module.name: f"{__name__}.{module.name}" for module in pkgutil.iter_modules(__path__)}
    if parts.scheme in built_in:
        opener: Callable[[SplitResult, Options], Source] = importlib.import_module(
            built_in[parts.scheme]
        ).open_url
        return opener(parts, options)
    # Imported here: it reads what every installed distribution says of itself.
    from importlib.metadata import entry_points

    added = {point.name: point for point in entry_points(group="motorlens.sources")}
    if parts.scheme not in added:
        known = ", ".join(sorted({*built_in, *added, "file"}))
        raise DataError(f"--source {parts.geturl()}: unknown scheme {parts.scheme!r}; known: {known}")
    opener = added[parts.scheme].load()
    return opener(parts, options)


def number_of(options: Options, name: str, default: float) -> float:
    """Take a number out of `options`. Raises DataError if it is none."""
    text = options.pop(name, str(default))
    try:
        return float(text)
    except ValueError:
        raise DataError(f"source option {name}={text} is not a number") from None


def address(parts: SplitResult, default_host: str) -> tuple[str, int]:
    """Host and port. Raises DataError if there is no port."""
    try:
        port = parts.port
    except ValueError:
        port = None
    if port is None:
        raise DataError(
            f"--source {parts.geturl()}: give a port, for example {parts.scheme}://{default_host}:5555"
        )
    return parts.hostname or default_host, port


def broken(name: str, error: OSError) -> DeviceError:
    """The error of a line that broke."""
    return DeviceError(f"{name}: the line broke: {error.strerror or error}; is the device still plugged in?")
