"""A new sensor file taken into service without losing a sample, and left again if it does not behave.

A thread watches the file and verifies what it finds (hash, schema, golden values). The verified candidate then runs beside
the sensor in service, on the same samples, and takes over at the edge of a block if its estimates agree within three
standard deviations. For as long again the old one keeps running beside it, ready to take over.
"""

import os
import threading
from collections import deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates, Estimator, EstimatorState
from motorlens_runtime.estimate.gate import GateState, Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import Sensor, load_sensor

_POLL_S = 0.5
_SIGMAS = 3.0
_BROKEN = np.uint32(Quality.NOT_FINITE | Quality.BACKEND_MISMATCH)


@dataclass(frozen=True)
class _Beside:
    """A second estimator that runs along: a candidate, or the one that was replaced. `until_ns` is stream time."""

    estimator: Estimator
    until_ns: int
    is_candidate: bool


class Swap:
    """Follows one sensor file.

    Args:
        path: the file of the sensor in service.
        backend: as for `load_sensor`.
        shadow_s: how long a candidate runs beside before it takes over, and the old one after.

    Attributes:
        events: what happened, as documents for publishers; the caller takes them out.
    """

    def __init__(self, path: str, backend: str = "auto", shadow_s: float = 5.0) -> None:
        self._path, self._backend, self._shadow_ns = path, backend, round(shadow_s * 1e9)
        self._offers: deque[Sensor | str] = deque(maxlen=1)
        self._beside: _Beside | None = None
        self._closing = threading.Event()
        self._seen = _signature(path)
        self.events: deque[dict[str, Any]] = deque(maxlen=100)

    def start(self) -> None:
        """Begin to watch the file."""
        threading.Thread(target=self._watch, name="sensor file", daemon=True).start()

    def close(self) -> None:
        """Stop watching."""
        self._closing.set()

    def offer(self, sensor: Sensor | str) -> None:
        """A verified sensor to take into service, or the line that says why there is none."""
        self._offers.append(sensor)

    def follow(
        self,
        estimator: Estimator,
        period_s: float,
        samples: Samples,
        rows: NDArray[np.intp] | None,
        estimates: Estimates,
    ) -> tuple[Estimator, Estimates]:
        """To be called with each block after the estimator in service has taken it.

        Returns:
            the estimator in service from the next block on, and the estimates of this block to publish.
        """
        now_ns = int(samples.time_ns[-1])
        if self._beside is None:
            if self._offers:
                self._begin(estimator, period_s, self._offers.popleft(), now_ns)
            return estimator, estimates
        beside = self._beside
        second = beside.estimator.push(samples, rows)
        if not len(second):
            return estimator, estimates
        if beside.is_candidate:
            return self._judge(estimator, beside, second, estimates, now_ns), estimates
        if (estimates.quality & ~second.quality & _BROKEN).any():
            self._beside = None
            self._say(
                now_ns,
                beside.estimator.sensor,
                "the new sensor gave no usable value; the old one is back in service",
            )
            return beside.estimator, second
        if now_ns >= beside.until_ns:
            self._beside = None
        return estimator, estimates

    def _begin(self, estimator: Estimator, period_s: float, offer: Sensor | str, now_ns: int) -> None:
        old = estimator.sensor
        if isinstance(offer, str):
            self._say(now_ns, old, f"not taken into service: {offer}")
        elif offer.digest == old.digest:
            pass
        elif [(o.name, o.unit) for o in offer.specification.outputs] != [
            (o.name, o.unit) for o in old.specification.outputs
        ]:
            self._say(now_ns, old, "not taken into service: it promises other outputs; restart to use it")
        else:
            state, complete = carried(estimator.state, old, offer)
            warm_up_ns = 0 if complete else round(offer.specification.warm_up_s * 1e9)
            self._beside = _Beside(
                open_estimator(offer, period_s, state), now_ns + max(self._shadow_ns, warm_up_ns), True
            )

    def _judge(
        self, estimator: Estimator, beside: _Beside, second: Estimates, estimates: Estimates, now_ns: int
    ) -> Estimator:
        """The estimator for the next block: the candidate once it has run beside long enough and agrees."""
        if (second.quality & ~estimates.quality & _BROKEN).any():
            self._beside = None
            self._say(now_ns, estimator.sensor, "not taken into service: it gives no usable value")
        elif now_ns >= beside.until_ns:
            spread = np.hypot(second.sigma[-1], estimates.sigma[-1])
            apart = float(np.max(np.abs(second.values[-1] - estimates.values[-1]) / spread))
            if apart <= _SIGMAS:
                self._beside = _Beside(estimator, now_ns + self._shadow_ns, False)
                self._say(
                    now_ns,
                    beside.estimator.sensor,
                    f"taken into service, {apart:.1f} standard deviations from the old",
                )
                return beside.estimator
            self._beside = None
            self._say(
                now_ns,
                estimator.sensor,
                f"not taken into service: {apart:.1f} standard deviations from the old",
            )
        return estimator

    def _say(self, now_ns: int, sensor: Sensor, message: str) -> None:
        self.events.append(
            {
                "event": "sensor", "timestamp": now_ns / 1e9, "message": f"{self._path}: {message}",
                "in_service": {"name": sensor.name, "version": sensor.version, "sha256": sensor.digest},
            }
        )  # fmt: skip

    def _watch(self) -> None:
        changed: tuple[int, ...] | None = None
        while not self._closing.wait(_POLL_S):
            signature = _signature(self._path)
            if signature is None or signature == self._seen:
                changed = None
            elif signature != changed:
                changed = signature  # look again, lest it is still being written
            else:
                self._seen, changed = signature, None
                try:
                    self.offer(load_sensor(self._path, self._backend))
                except ModelError as error:
                    self.offer(str(error))


def carried(state: EstimatorState, old: Sensor, new: Sensor) -> tuple[EstimatorState, bool]:
    """What a new sensor takes over of the state of the old, and whether that is all it needs.

    The same filters and observer go on to the bit. Otherwise each filter starts at the value of its namesake (same signal
    and time constant), or at zero, and the sensor warms up.
    """
    same_emf = old.specification.resistance_ohm == new.specification.resistance_ohm
    same_observer = _document(old) == _document(new)
    if old.specification.filters == new.specification.filters and same_emf and same_observer:
        return replace(state, mismatch=False), True
    values = dict(zip(old.specification.filters, old.bank.values(state.bank).tolist(), strict=True))
    usable = {f: value for f, value in values.items() if same_emf or not f.signal.startswith("emf")}
    start = [usable.get(f, 0.0) for f in new.specification.filters]
    gate = GateState()
    observer = state.observer if same_observer else new.extractor.start()[1]
    return EstimatorState(new.bank.start(np.array(start)), gate, False, observer), False


def _document(sensor: Sensor) -> Any:
    return None if sensor.extractor.observer is None else sensor.extractor.observer.document


def _signature(path: str) -> tuple[int, ...] | None:
    try:
        status = os.stat(path)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
