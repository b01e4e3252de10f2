"""The source `sim:` of `motorlens run`: the simulated drive without a line, its bytes handed over as they would come.

`sim:mellah2016?scenario=duty&rate=1000&duration=60&seed=0&speedup=1`; everything behind `?`, and the
motor file too, may be left out. `speedup=0` hands over all there is at once.
"""

import time
from collections.abc import Callable, Iterator
from urllib.parse import SplitResult

from motorlens_firmware_sim.bench import Setup, prepare
from motorlens_firmware_sim.telemetry import Sending, sendings
from motorlens_runtime.errors import DataError

# At full speed, how much is handed over in one call.
_BLOCK_BYTES = 65_536


def open_url(parts: SplitResult, options: dict[str, str]) -> "SimulatedLine":
    """Prepare the bench that a URL describes; takes what it understands out of `options`.

    Raises:
        DataError: an option is not a number, or a setting is out of range.
        ModelError: the motor file.
    """

    def take(name: str, default: float) -> float:
        text = options.pop(name, str(default))
        try:
            return float(text)
        except ValueError:
            raise DataError(f"--source {parts.geturl()}: {name}={text} is not a number") from None

    standard = Setup()
    setup = Setup(
        motor=(parts.netloc + parts.path) or standard.motor,
        scenario=options.pop("scenario", standard.scenario),
        duration_s=take("duration", standard.duration_s),
        rate_Hz=int(take("rate", standard.rate_Hz)),
        seed=int(take("seed", standard.seed)),
    )
    speedup = take("speedup", 1.0)
    bench = prepare(setup)
    return SimulatedLine(sendings(bench.drive, bench.codes), speedup, parts.geturl())


class SimulatedLine:
    """Bytes that become readable when the drive would have sent them. See `motorlens_runtime.line.sources.Source`."""

    lasting = False

    def __init__(
        self,
        stream: Iterator[Sending],
        speedup: float,
        name: str,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.name = name
        self._stream, self._next = stream, next(stream, None)
        self._speedup, self._clock, self._sleep = speedup, clock, sleep
        self._began = clock()

    def read(self, timeout_s: float) -> bytes | None:
        """What has been sent by now, waiting for it no longer than `timeout_s`; None at the end."""
        if self._next is None:
            return None
        wait = self._due(self._next) - self._clock()
        if wait > 0:
            self._sleep(min(wait, timeout_s))
        now, data = self._clock(), bytearray()
        while self._next is not None and self._due(self._next) <= now and len(data) < _BLOCK_BYTES:
            data += self._next.data
            self._next = next(self._stream, None)
        return bytes(data)

    def write(self, data: bytes) -> None:
        """The drive only transmits."""

    def close(self) -> None:
        """Nothing to let go of."""

    def _due(self, sending: Sending) -> float:
        return self._began + (sending.at_s / self._speedup if self._speedup > 0 else 0.0)
