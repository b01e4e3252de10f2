"""Samples in, estimates with their deviation and quality out. Every sample updates the state; the network is evaluated
where a row is asked for. The result of a row is the same to the last bit however the samples are cut into blocks."""

from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.backend import TILE
from motorlens_runtime.bank import BankState
from motorlens_runtime.features import Channels
from motorlens_runtime.gate import Gate, GateState, Samples
from motorlens_runtime.quality import Quality, mark
from motorlens_runtime.sensor import Sensor, scales, tiled, untiled

Array = NDArray[np.float64]

# The second backend looks at every so many tiles of 16 samples, always at the first.
_CHECK_EVERY = 1024
# As many tiles in one go as keep the work in the cache.
_TILES_AT_ONCE = 64
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
        self._outputs, self._scales = len(sensor.specification.outputs), scales(sensor.specification)
        envelope = sensor.specification.envelope
        self._mean = None if envelope.mean is None else envelope.mean[:, None]
        if envelope.cholesky is not None:
            self._whitening, self._limit = np.ascontiguousarray(envelope.cholesky.T), envelope.limit

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
        quality = gated.quality[chosen] if rows is not None else gated.quality
        if outside.any():
            mark(quality, outside, Quality.OUTSIDE_ENVELOPE)
        if not isfinite(values.sum() + sigma.sum()):
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

        `features` (F, m); `start` is the number of samples before this call. Each row stands where its index since the very
        first sample puts it in a tile; see `backend`.
        """
        m = features.shape[1]
        if not m:
            empty = np.zeros((0, self._outputs))
            return empty, empty, np.zeros(0, dtype=bool), None
        if rows is None:
            first = start // TILE
            place: Any = slice(start % TILE, start % TILE + m)
            tiles = tiled(features, start % TILE)
            numbers = np.arange(first, first + len(tiles))
        elif m == 1:
            alone, at = divmod(start + int(rows[0]), TILE)
            numbers, place = np.array((alone,)), slice(at, at + 1)
            tiles = np.zeros((1, len(features), TILE))
            tiles[0, :, at] = features[:, 0]
        else:
            number, place = np.divmod(start + rows, TILE)
            new = np.diff(number, prepend=number[0] - 1) != 0
            numbers = number[new]
            place += (np.cumsum(new) - 1) * TILE
            table = np.zeros((len(features), len(numbers) * TILE))
            table[:, place] = features
            tiles = tiled(table, 0)
        estimate, sigma = self.sensor.backend.evaluate(tiles)
        disagree = None
        if self.sensor.checker is not None and -int(numbers[0]) % _CHECK_EVERY <= numbers[-1] - numbers[0]:
            disagree = self._disagreement(tiles, numbers, place, estimate)
        outside = self._outside(tiles)[place]
        if len(tiles) == 1:
            return estimate[0][:, place].T, sigma[0][:, place].T, outside, disagree
        return untiled(estimate)[:, place].T, untiled(sigma)[:, place].T, outside, disagree

    def _disagreement(
        self, tiles: Array, numbers: NDArray[np.intp], place: Any, estimate: Array
    ) -> int | None:
        """The first row where the second backend differs, among the tiles at which it looks."""
        assert self.sensor.checker is not None
        checked = np.flatnonzero(numbers % _CHECK_EVERY == 0)
        second, _ = self.sensor.checker.evaluate(tiles[checked])
        error = np.abs(second - estimate[checked]) / self._scales[:, None]
        wrong = np.zeros((len(tiles), TILE), dtype=bool)
        wrong[checked] = ~(error <= _CHECK_TOLERANCE).all(axis=1)
        at = np.flatnonzero(wrong.reshape(-1)[place])
        return int(at[0]) if len(at) else None

    def _outside(self, tiles: Array) -> NDArray[np.bool_]:
        """Which columns of the tiles are outside the envelope, (t * 16,)."""
        outside = np.zeros((len(tiles), TILE), dtype=bool)
        if self._mean is not None:
            for start in range(0, len(tiles), _TILES_AT_ONCE):
                part = slice(start, start + _TILES_AT_ONCE)
                distance = self._whitening @ (tiles[part] - self._mean)
                distance *= distance
                np.greater(np.add.reduce(distance, axis=1), self._limit, out=outside[part])
        return outside.reshape(-1)
