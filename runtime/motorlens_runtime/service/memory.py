"""The memory of heat of a running service: recalled at the first sample, kept every few seconds, kept once more at the end.

The hot loop only takes the snapshot; writing it, which waits for the disk, is done by a worker. Where the disk is slow, the
newest snapshot waits and those before it are skipped.
"""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from motorlens_runtime.estimate.estimator import Estimator, EstimatorState
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor.sensor import Sensor
from motorlens_runtime.service import snapshot
from motorlens_runtime.worker import Worker

_EVERY_NS = 10_000_000_000
_PATIENCE_S = 10.0


class Memory:
    """One file for one sensor and device.

    Args:
        path: the snapshot.
        sensor: whose state it is.
        wall_clock: nanoseconds since 1970; only it tells how long the motor was off.

    Attributes:
        marking: whether samples still rest on remembered heat, see `mark`.
    """

    def __init__(
        self, path: str | Path, sensor: Sensor, wall_clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._path = Path(path)
        self._sensor = sensor
        self._wall_clock = wall_clock
        self._warm_up_ns = round(sensor.specification.warm_up_s * 1e9)
        self._restored = self.marking = False
        self._restored_until_ns: int | None = None
        self._next_ns: int | None = None
        self._message: str | None = None
        # Where the disk is slow, the newest state waits for it.
        self._worker: Worker[snapshot.Snapshot] = Worker("memory", self._save, 1)

    def recall(self, device: str) -> EstimatorState | None:
        """The state to go on from, None for a cold start; `report` says why."""
        loaded = snapshot.load(self._path)
        if loaded is None or isinstance(loaded, str):
            self._message = loaded
            return None
        result = snapshot.restore(loaded, self._sensor, device, self._wall_clock())
        if isinstance(result, str):
            self._message = result
            return None
        self._message, self._restored, self.marking = result.message, True, True
        return result.state

    def mark(self, samples: Samples) -> Samples:
        """The samples, said to rest on remembered heat until as much history as the warm-up asks for is their own."""
        if not self.marking or not len(samples):
            return samples
        if self._restored_until_ns is None:
            self._restored_until_ns = int(samples.time_ns[0]) + self._warm_up_ns
        self.marking = int(samples.time_ns[0]) < self._restored_until_ns
        return snapshot.flagged(samples, self._restored_until_ns)

    def keep(self, estimator: Estimator, device: str, now_ns: int) -> None:
        """Keep its state when it is due; returns at once."""
        if self._next_ns is None:
            self._next_ns = now_ns + _EVERY_NS
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + _EVERY_NS
        self._worker.put(snapshot.take(self._sensor, device, estimator.state, self._wall_clock()))

    def close(self, state: EstimatorState | None, device: str) -> None:
        """Keep the last state, if there was one; a disk that does not answer is not waited for longer than some seconds."""
        if state is not None:
            self._worker.put(snapshot.take(self._sensor, device, state, self._wall_clock()))
        self._worker.close(_PATIENCE_S)

    def follow(self, sensor: Sensor) -> None:
        """Keep the state of another sensor from now on."""
        self._sensor = sensor

    def report(self) -> dict[str, Any]:
        """Whether heat was remembered, what was said about it, and how often it was kept."""
        return {
            "restored": self._restored,
            "message": self._message,
            "saved": self._worker.done,
            "failed": self._worker.errors,
        }

    def _save(self, taken: snapshot.Snapshot) -> None:
        try:
            snapshot.save(self._path, taken)
        except OSError as error:
            self._message = f"{self._path}: {error.strerror}; heat is not remembered"
            raise
