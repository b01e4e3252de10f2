"""`pty:///dev/pts/3`: a pseudo-terminal, such as the simulated drive prints; a serial port without a baud rate."""

from urllib.parse import SplitResult

from motorlens_runtime.line.sources import Options
from motorlens_runtime.line.sources.serial import SerialSource
from motorlens_runtime.line.sources.serial import open_url as open_serial


def open_url(parts: SplitResult, options: Options) -> SerialSource:
    """See `sources`."""
    return open_serial(parts, options)
