"""Writes the samples of a live run to a CSV from which `infer` gives the same estimates, bit for bit."""

import queue
import threading
from pathlib import Path

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples

_MAX_BLOCKS = 1 << 14
HEADING = "time_s,voltage_V,current_A,link_flags"


class Recorder:
    """A CSV file behind a queue of its own; numbers are written so that reading them gives the same bits.

    Raises:
        DataError: the file cannot be written.
    """

    def __init__(self, path: str) -> None:
        try:
            self._file = Path(path).open("w", encoding="ascii", newline="")
        except OSError as error:
            raise DataError(f"--record {path}: {error.strerror}") from None
        self._path = path
        self._queue: queue.Queue[Samples | None] = queue.Queue(_MAX_BLOCKS)
        self._with_ambient: bool | None = None
        self.lost = 0
        self.error: str | None = None
        self._thread = threading.Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def put(self, samples: Samples) -> None:
        """Hand over samples; returns at once, and counts what the disk cannot take."""
        try:
            self._queue.put_nowait(samples)
        except queue.Full:
            self.lost += len(samples)

    def close(self) -> None:
        """Write the rest and close."""
        self._queue.put(None)
        self._thread.join(10.0)

    def _work(self) -> None:
        while (samples := self._queue.get()) is not None:
            self._attempt(samples)
        try:
            self._file.close()
        except OSError as error:
            self.error = f"{self._path}: {error.strerror}"

    def _attempt(self, samples: Samples) -> None:
        try:
            if self._with_ambient is None:
                self._with_ambient = samples.ambient_C is not None
                self._file.write(HEADING + (",ambient_C\n" if self._with_ambient else "\n"))
            columns = [
                (samples.time_ns / 1e9).tolist(),
                samples.voltage_V.tolist(),
                samples.current_A.tolist(),
            ]
            columns.append([0] * len(samples) if samples.flags is None else samples.flags.tolist())
            if self._with_ambient and samples.ambient_C is not None:
                columns.append(samples.ambient_C.tolist())
            self._file.write("".join([",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True)]))
            if self._queue.empty():
                self._file.flush()
        except OSError as error:
            self.lost += len(samples)
            self.error = f"{self._path}: {error.strerror}"
