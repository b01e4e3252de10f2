"""`shm:motorlens`: the newest rows in shared memory (/dev/shm/motorlens) for a control process; see `shared_memory`.

Option `rows`: how many the ring holds, default 4096. A name with a slash is a path.
"""

from pathlib import Path
from urllib.parse import SplitResult

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.files.shared_memory import Writer
from motorlens_runtime.publish import Header, file_of, options_of


def open_url(url: SplitResult, header: Header) -> "SharedMemoryPublisher":
    """See `publish`."""
    rows = options_of(url, rows=4096.0)["rows"]
    if not 2 <= rows <= 1e6:
        raise DataError(f"{url.geturl()}: rows={rows:g}; from 2 to a million")
    name = file_of(url)
    return SharedMemoryPublisher(Path(name) if "/" in name else Path("/dev/shm") / name, header, int(rows))


class SharedMemoryPublisher:
    """Writes to a ring."""

    def __init__(self, path: Path, header: Header, rows: int = 4096) -> None:
        columns = {
            "sensor": header.sensor,
            "version": header.version,
            "sha256": header.digest,
            "values": [output.heading for output in header.outputs],
            "sigma": [output.sd_heading for output in header.outputs],
        }
        self._writer = Writer(path, columns, len(header.outputs), rows)

    def publish(self, estimates: Estimates) -> None:
        """Append the rows."""
        if len(estimates):
            self._writer.write(estimates.time_ns, estimates.values, estimates.sigma, estimates.quality)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Take the memory away."""
        self._writer.close()
