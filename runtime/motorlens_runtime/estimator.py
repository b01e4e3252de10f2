"""Samples in, estimates with their deviation and quality out. Every sample updates the state; the network is evaluated
where a row is asked for. The result of a row is the same to the last bit however the samples are cut into blocks."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.bank import BLOCK, BankState
from motorlens_runtime.features import Channels
from motorlens_runtime.gate import Gate, GateState, Samples
from motorlens_runtime.quality import Quality, mark
from motorlens_runtime.sensor import Sensor, scales

Array = NDArray[np.float64]

# The second backend looks at every so many canonical blocks of 64 samples, always at the first.
_CHECK_EVERY = 256
_CHECK_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Estimates:
    """m rows: `time_ns` (m,), `values` and `sigma` (m, K) in the units of the sensor's outputs, `quality` words (m,)."""

    time_ns: NDArray[np.int64]
    values: Array
    sigma: Array
    quality: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class EstimatorState:
    """All that the estimator remembers."""

    bank: BankState
    gate: GateState = field(default_factory=GateState)
    mismatch: bool = False
    observer: tuple[float, ...] = ()


class Estimator:
    """One sensor following one stream.

    Args:
        sensor: the verified sensor.
        period_s: expected time between samples; a longer one is a gap.
        state: where to go on; None is a fresh start.

    `state` may be read and replaced between calls.
    """

    def __init__(self, sensor: Sensor, period_s: float, state: EstimatorState | None = None) -> None:
        self.sensor = sensor
        fresh_bank, fresh_observer = sensor.extractor.start()
        self.state = state or EstimatorState(fresh_bank, observer=fresh_observer)
        if len(self.state.observer) != len(fresh_observer):
            self.state = replace(self.state, observer=fresh_observer)
        self._gate = Gate(sensor.specification, period_s)

    def push(self, samples: Samples, rows: NDArray[np.intp] | None = None) -> Estimates:
        """Take in n samples and evaluate the sensor at `rows` of them (indices in rising order; None is all).

        Raises:
            DataError: time runs backwards, or the sensor needs the ambient temperature and there is none.
        """
        gate, gated = self._gate.inspect(self.state.gate, samples)
        sensor = self.sensor
        start = self.state.bank.count
        bank, observer, features = sensor.extractor.advance(
            self.state.bank,
            self.state.observer,
            Channels(gated.voltage_V, gated.current_A, gated.ambient_C),
            gated.dt_s,
            gated.used,
            rows,
        )
        mismatch = self.state.mismatch
        chosen: NDArray[np.intp] | slice = slice(None) if rows is None else rows
        values, sigma, outside, disagree = self._evaluate(features, start, rows)
        quality = gated.quality[chosen].copy()
        mark(quality, outside, Quality.OUTSIDE_ENVELOPE)
        mark(quality, ~(np.isfinite(values) & np.isfinite(sigma)).all(axis=1), Quality.NOT_FINITE)
        # Once two implementations have disagreed, neither is believed until the sensor is loaded again.
        if mismatch:
            mark(quality, slice(None), Quality.BACKEND_MISMATCH)
        elif disagree is not None:
            mark(quality, slice(disagree, None), Quality.BACKEND_MISMATCH)
        self.state = EstimatorState(bank, gate, mismatch or disagree is not None, observer)
        return Estimates(samples.time_ns[chosen], values, sigma, quality)

    def _evaluate(
        self, features: Array, start: int, rows: NDArray[np.intp] | None
    ) -> tuple[Array, Array, NDArray[np.bool_], int | None]:
        """Values and sigmas (m, K), which rows are outside the envelope, and the first row where two backends differ.

        `start` is the number of samples before this call. Each row stands where its index since the very first sample
        puts it in a block of 64; see `backend`.
        """
        outputs = len(self.sensor.specification.outputs)
        if not len(features):
            return np.zeros((0, outputs)), np.zeros((0, outputs)), np.zeros(0, dtype=bool), None
        if rows is None:
            numbers = np.arange(start // BLOCK, (start + len(features) - 1) // BLOCK + 1)
            place: Any = slice(start % BLOCK, start % BLOCK + len(features))
        else:
            number, place = np.divmod(start + rows, BLOCK)
            numbers = number[:1]
            if number[-1] != number[0]:
                new = np.diff(number, prepend=number[0] - 1) != 0
                numbers = number[new]
                place += (np.cumsum(new) - 1) * BLOCK
        table = np.zeros((len(numbers) * BLOCK, features.shape[1]))
        table[place] = features
        blocks = table.reshape(len(numbers), BLOCK, -1)
        estimate, sigma = self.sensor.backend.evaluate(blocks)
        disagree = None
        checked = np.flatnonzero(numbers % _CHECK_EVERY == 0)
        if self.sensor.checker is not None and len(checked):
            second, _ = self.sensor.checker.evaluate(blocks[checked])
            error = np.abs(second - estimate[checked]) / scales(self.sensor.specification)
            wrong = np.zeros(estimate.shape[:2], dtype=bool)
            wrong[checked] = ~(error <= _CHECK_TOLERANCE).all(axis=2)
            at = np.flatnonzero(wrong.reshape(-1)[place])
            disagree = int(at[0]) if len(at) else None
        values, deviations = estimate.reshape(-1, outputs)[place], sigma.reshape(-1, outputs)[place]
        return values, deviations, self._outside(blocks).reshape(-1)[place], disagree

    def _outside(self, blocks: Array) -> NDArray[np.bool_]:
        envelope = self.sensor.specification.envelope
        if envelope.mean is None or envelope.cholesky is None:
            return np.zeros(blocks.shape[:2], dtype=bool)
        distance = np.square((blocks - envelope.mean) @ envelope.cholesky).sum(axis=2)
        outside: NDArray[np.bool_] = distance > envelope.limit
        return outside
