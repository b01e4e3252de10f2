"""Samples in, estimates with their deviation and quality out. Every sample updates the state; the network is evaluated
where a row is asked for. The result of a row is the same to the last bit however the samples are cut into blocks."""

from collections.abc import Sequence
from dataclasses import field, replace
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.bank import BankState
from motorlens_runtime.estimate.gate import Gate, GateState, Samples
from motorlens_runtime.estimate.quality import Quality, mark
from motorlens_runtime.records import record
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.sensor.sensor import Sensor, scales, tiled, untiled

Array = NDArray[np.float64]

# The second backend looks at every so many tiles of 16 samples, always at the first.
CHECK_EVERY = 1024
# As many tiles in one go as keep the work in the cache.
_TILES_AT_ONCE = 64
CHECK_TOLERANCE = 1e-3


@record(frozen=True)
class Estimates:
    """m rows: `time_ns` (m,), `values` and `sigma` (m, K) in the units of the sensor's outputs, `quality` words (m,)."""

    time_ns: NDArray[np.int64]
    values: Array
    sigma: Array
    quality: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.time_ns)


@record(frozen=True)
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
        self._distrust = sensor.specification.distrust
        envelope = sensor.specification.envelope
        self._mean = None if envelope.mean is None else np.repeat(envelope.mean[:, None], TILE, axis=1)
        if envelope.cholesky is not None:
            self._whitening, self._limit = np.ascontiguousarray(envelope.cholesky.T), envelope.limit
            # Where a live line's tile becomes its distance from the mean.
            self._apart, self._whitened = (np.empty((n, TILE)) for n in self._whitening.shape[::-1])
        # The tile that a live line fills; what stands in other columns than those asked for does not matter.
        self._tile = np.zeros((1, len(sensor.specification.features), TILE))

    @property
    def last_ns(self) -> int | None:
        """When the last sample was taken that was used, None before the first."""
        return self.state.gate.last_ns

    def push(self, samples: Samples, rows: NDArray[np.intp] | None = None) -> Estimates:
        """Take in n samples and evaluate the sensor at `rows` of them (indices in rising order; None is all).

        Raises:
            DataError: time runs backwards, or the sensor needs the ambient temperature and there is none.
        """
        state = self.state
        gate, gated = self._gate.inspect(state.gate, samples)
        bank, observer, features = self.sensor.extractor.advance(
            state.bank, state.observer, gated, gated.dt_s, gated.used, rows
        )
        mismatch = state.mismatch
        values, sigma, outside, disagree = self._evaluate(features, state.bank.count, rows)
        time_ns, quality = samples.time_ns, gated.quality
        if rows is not None and len(rows) != len(samples):
            time_ns, quality = time_ns[rows], quality[rows]
        if any(outside.tolist()):
            mark(quality, outside, Quality.OUTSIDE_ENVELOPE)
        if self._distrust >= 0:
            mark(quality, features[self._distrust] > 0.0, Quality.UNFORETOLD)
        # One sum tells whether all are finite; where it overflows, each is asked.
        if not isfinite(np.vdot(values, sigma)):
            mark(quality, ~(np.isfinite(values) & np.isfinite(sigma)).all(axis=1), Quality.NOT_FINITE)
        # Once two implementations have disagreed, neither is believed until the sensor is loaded again.
        if mismatch:
            mark(quality, slice(None), Quality.BACKEND_MISMATCH)
        elif disagree is not None:
            mark(quality, slice(disagree, None), Quality.BACKEND_MISMATCH)
        self.state = EstimatorState(bank, gate, mismatch or disagree is not None, observer)
        return Estimates(time_ns, values, sigma, quality)

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
        numbers: Sequence[int] | NDArray[np.intp]
        if rows is None or m == 1:
            first, at = divmod(start if rows is None else start + int(rows[0]), TILE)
            place: Any = slice(at, at + m)
            if at + m <= TILE:
                tiles = self._tile
                tiles[0, :, place] = features
            else:
                tiles = tiled(features, at)
            numbers = range(first, first + len(tiles))
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
        if self.sensor.checker is not None and -int(numbers[0]) % CHECK_EVERY <= numbers[-1] - numbers[0]:
            disagree = self._disagreement(tiles, np.asarray(numbers), place, estimate)
        outside = self._outside(tiles)[place]
        if len(tiles) == 1:
            return estimate[0][:, place].T, sigma[0][:, place].T, outside, disagree
        return untiled(estimate)[:, place].T, untiled(sigma)[:, place].T, outside, disagree

    def _disagreement(
        self, tiles: Array, numbers: NDArray[np.intp], place: Any, estimate: Array
    ) -> int | None:
        """The first row where the second backend differs, among the tiles at which it looks."""
        assert self.sensor.checker is not None
        checked = np.flatnonzero(numbers % CHECK_EVERY == 0)
        second, _ = self.sensor.checker.evaluate(tiles[checked])
        error = np.abs(second - estimate[checked]) / self._scales[:, None]
        wrong = np.zeros((len(tiles), TILE), dtype=bool)
        wrong[checked] = ~(error <= CHECK_TOLERANCE).all(axis=1)
        at = np.flatnonzero(wrong.reshape(-1)[place])
        return int(at[0]) if len(at) else None

    def _outside(self, tiles: Array) -> NDArray[np.bool_]:
        """Which columns of the tiles are outside the envelope, (t * 16,)."""
        if self._mean is None:
            return np.zeros(len(tiles) * TILE, dtype=bool)
        if len(tiles) == 1:
            apart = np.subtract(tiles[0], self._mean, out=self._apart)
            return self._beyond(np.dot(self._whitening, apart, out=self._whitened))
        outside = np.empty((len(tiles), TILE), dtype=bool)
        for start in range(0, len(tiles), _TILES_AT_ONCE):
            part = slice(start, start + _TILES_AT_ONCE)
            outside[part] = self._beyond(self._whitening @ (tiles[part] - self._mean), axis=1)
        return outside.reshape(-1)

    def _beyond(self, whitened: Array, axis: int = 0) -> NDArray[np.bool_]:
        """Where the squared distance from the mean, the sum of squares along `axis`, is above its limit."""
        whitened *= whitened
        beyond: NDArray[np.bool_] = np.add.reduce(whitened, axis) > self._limit
        return beyond
