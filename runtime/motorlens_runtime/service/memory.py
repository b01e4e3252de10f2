"""The memory of heat of a running service: recalled at the first sample, kept every few seconds, kept once more at the end.

The hot loop only takes the snapshot; writing it, which waits for the disk, is done by a thread. One that is still at it when
the next is due skips that one.
"""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from motorlens_runtime.estimate.estimator import Estimator, EstimatorState
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor.sensor import Sensor
from motorlens_runtime.service import snapshot

_EVERY_NS = 10_000_000_000


class Memory:
    """One file for one sensor and device.

    Args:
        path: the snapshot.
        sensor: whose state it is.
        wall_clock: nanoseconds since 1970; only it tells how long the motor was off.
    """

    def __init__(
        self, path: str | Path, sensor: Sensor, wall_clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._path = Path(path)
        self._sensor = sensor
        self._wall_clock = wall_clock
        self._warm_up_ns = round(sensor.specification.warm_up_s * 1e9)
        self._restored = False
        self._restored_until_ns: int | None = None
        self._next_ns: int | None = None
        self._saved = self._failed = 0
        self._message: str | None = None
        self._thread: threading.Thread | None = None

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
        self._message, self._restored = result.message, True
        return result.state

    def mark(self, samples: Samples) -> Samples:
        """The samples, said to rest on remembered heat until as much history as the warm-up asks for is their own."""
        if not self._restored or not len(samples):
            return samples
        if self._restored_until_ns is None:
            self._restored_until_ns = int(samples.time_ns[0]) + self._warm_up_ns
        return snapshot.flagged(samples, self._restored_until_ns)

    def keep(self, estimator: Estimator, device: str, now_ns: int) -> None:
        """Keep its state when it is due; returns at once."""
        if self._next_ns is None:
            self._next_ns = now_ns + _EVERY_NS
        if now_ns < self._next_ns or (self._thread is not None and self._thread.is_alive()):
            return
        self._next_ns = now_ns + _EVERY_NS
        taken = snapshot.take(self._sensor, device, estimator.state, self._wall_clock())
        self._thread = threading.Thread(target=self._save, args=(taken,), name="memory", daemon=True)
        self._thread.start()

    def close(self, state: EstimatorState | None, device: str) -> None:
        """Keep the last state, if there was one."""
        if self._thread is not None:
            self._thread.join(5.0)
        if state is not None:
            self._save(snapshot.take(self._sensor, device, state, self._wall_clock()))

    def follow(self, sensor: Sensor) -> None:
        """Keep the state of another sensor from now on."""
        self._sensor = sensor

    def report(self) -> dict[str, Any]:
        """Whether heat was remembered, what was said about it, and how often it was kept."""
        return {
            "restored": self._restored,
            "message": self._message,
            "saved": self._saved,
            "failed": self._failed,
        }

    def _save(self, taken: snapshot.Snapshot) -> None:
        try:
            snapshot.save(self._path, taken)
        except OSError as error:
            self._failed += 1
            self._message = f"{self._path}: {error.strerror}; heat is not remembered"
        else:
            self._saved += 1
