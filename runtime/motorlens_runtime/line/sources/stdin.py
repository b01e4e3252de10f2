"""`stdin:`: whatever is piped in."""

import os
import select
import sys
from urllib.parse import SplitResult

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.line.sources import Options


def open_url(parts: SplitResult, options: Options) -> "StdinSource":
    """See `sources`."""
    return StdinSource()


class StdinSource:
    """Standard input."""

    name = "stdin"
    lasting = False

    def read(self, timeout_s: float) -> bytes | None:
        """See `Source.read`."""
        fd = sys.stdin.fileno()
        if not select.select([fd], [], [], timeout_s)[0]:
            return b""
        return os.read(fd, 1 << 16) or None

    def write(self, data: bytes) -> None:
        """Nobody is there to hear."""
        if data:
            raise DeviceError(
                "stdin: this drive must be asked, and a pipe cannot ask it; use its port as the source"
            )

    def close(self) -> None:
        """Nothing to let go."""
