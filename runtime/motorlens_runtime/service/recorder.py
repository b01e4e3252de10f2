"""Writes the samples of a live run to a CSV from which `infer` gives the same estimates, bit for bit."""

from contextlib import suppress
from pathlib import Path

import numpy as np

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.worker import Worker

_MAX_SAMPLES = 1 << 18
_PATIENCE_S = 10.0
HEADING = "time_s,voltage_V,current_A,link_flags"


class Recorder:
    """A CSV file behind a queue of its own; numbers are written so that reading them gives the same bits.

    What the disk does not take is missing as a whole: no row is cut.

    Raises:
        DataError: the file cannot be written.
    """

    def __init__(self, path: str) -> None:
        try:
            self._file = Path(path).open("wb", buffering=0)
        except OSError as error:
            raise DataError(f"--record {path}: {error.strerror}") from None
        self._path = path
        self._with_ambient = False
        self._whole = 0
        self._worker: Worker[Samples] = Worker(
            "recorder", self._write, _MAX_SAMPLES, weight=len, finish=self._file.close
        )

    @property
    def lost(self) -> int:
        """Samples that the disk did not take."""
        return self._worker.lost

    @property
    def error(self) -> str | None:
        """What was last wrong with the disk, in one line."""
        error = self._worker.error
        return None if error is None else f"{self._path}: {getattr(error, 'strerror', None) or error}"

    def put(self, samples: Samples) -> None:
        """Hand over samples; returns at once, and counts what the disk cannot take."""
        self._worker.put(samples)

    def close(self) -> None:
        """Write the rest and close."""
        self._worker.close(_PATIENCE_S)

    def _write(self, samples: Samples) -> None:
        heading = ""
        if not self._whole:
            self._with_ambient = samples.ambient_C is not None
            heading = HEADING + (",ambient_C\n" if self._with_ambient else "\n")
        columns = [(samples.time_ns / 1e9).tolist(), samples.voltage_V.tolist(), samples.current_A.tolist()]
        # That this machine was late is nothing of the line, and nothing of a replay.
        flags = None if samples.flags is None else samples.flags & ~np.uint32(Quality.OVERLOAD)
        columns.append([0] * len(samples) if flags is None else flags.tolist())
        if self._with_ambient and samples.ambient_C is not None:
            columns.append(samples.ambient_C.tolist())
        rows = "".join([",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True)])
        rest = memoryview((heading + rows).encode("ascii"))
        size = len(rest)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError:
            with suppress(OSError):  # a device has no end to cut off
                self._file.truncate(self._whole)
                self._file.seek(self._whole)
            raise
        self._whole += size
