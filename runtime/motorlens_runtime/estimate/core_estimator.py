"""The estimator in the C core: the same samples, words and states as `estimator.Estimator`, in one call a block."""

import ctypes

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.bank import BankState
from motorlens_runtime.estimate.estimator import (
    CHECK_EVERY,
    CHECK_TOLERANCE,
    Estimates,
    Estimator,
    EstimatorState,
)
from motorlens_runtime.estimate.gate import GateState, Samples
from motorlens_runtime.estimate.quality import Quality, mark
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.sensor.core_backend import CoreBackend
from motorlens_runtime.sensor.core_library import BlockTable, StateMemory
from motorlens_runtime.sensor.sensor import Sensor, scales, tiled, untiled

# Of this many samples, the first tile of 16 is looked at by a second backend.
_PERIOD = CHECK_EVERY * TILE
# Up to so many samples go through arrays that are kept.
_FEW = 64


def open_estimator(sensor: Sensor, period_s: float, state: EstimatorState | None = None) -> Estimator:
    """The estimator for a sensor: in the C core where that computes its network, else in Python."""
    kind = CoreEstimator if isinstance(sensor.backend, CoreBackend) else Estimator
    return kind(sensor, period_s, state)


class CoreEstimator(Estimator):
    """See `Estimator`; `sensor.backend` is a `CoreBackend`."""

    def __init__(self, sensor: Sensor, period_s: float, state: EstimatorState | None = None) -> None:
        backend = sensor.backend
        assert isinstance(backend, CoreBackend)
        self.sensor, self._core = sensor, backend
        self._needs_ambient = sensor.specification.needs_ambient
        self._outputs, self._features = len(sensor.specification.outputs), len(sensor.specification.features)
        self._scales = scales(sensor.specification)
        self._filters = len(sensor.specification.filters)
        observer = sensor.specification.observer
        self._observer = 0 if observer is None else len(observer.start())
        self._mismatch = False
        self._few: _Block | None = None
        self._memory = StateMemory()
        self._address = ctypes.addressof(self._memory)
        backend.library.motorlens_start(backend.address, self._address, round(period_s * 1e9))
        if state is not None:
            self.state = state

    @property
    def last_ns(self) -> int | None:
        """See `Estimator.last_ns`."""
        gate = self._memory.gate
        return int(gate.last_ns) if gate.begun else None

    @property
    def state(self) -> EstimatorState:
        """All that is remembered, as Python's estimator holds it."""
        memory, gate, n = self._memory, self._memory.gate, self._filters
        ambient_C = float(gate.ambient_C)
        return EstimatorState(
            BankState(int(memory.bank.count), np.array(memory.bank.before[:n]),
                      np.array([memory.bank.inside[:n], memory.bank.reach[:n]])),
            GateState(
                int(gate.first_ns) if gate.begun else None, int(gate.last_ns) if gate.begun else None, gate.voltage_V,
                gate.current_A, 0.0 if np.isnan(ambient_C) else ambient_C, gate.bridged_until_ns, gate.count,
                gate.current_since, gate.first_move, gate.dead_since, bool(gate.remembered),
            ),
            self._mismatch,
            tuple(memory.observer[: self._observer]),
        )  # fmt: skip

    @state.setter
    def state(self, state: EstimatorState) -> None:
        memory, gate, n = self._memory, state.gate, self._filters
        memory.bank.count = state.bank.count
        memory.bank.before[:n] = state.bank.before.tolist()
        memory.bank.inside[:n], memory.bank.reach[:n] = state.bank.within.tolist()
        memory.bank.dt_s = -1.0  # the decays are another sensor's, or not known
        into = memory.gate
        into.begun = gate.last_ns is not None
        into.first_ns, into.last_ns = gate.first_ns or 0, gate.last_ns or 0
        into.remembered = gate.remembered
        for name in ("voltage_V", "current_A", "ambient_C", "bridged_until_ns", "count", "current_since", "first_move",
                     "dead_since"):  # fmt: skip
            setattr(into, name, getattr(gate, name))
        if len(state.observer) == self._observer:
            memory.observer[: self._observer] = state.observer
        self._mismatch = state.mismatch

    def push(self, samples: Samples, rows: NDArray[np.intp] | None = None) -> Estimates:
        """See `Estimator.push`."""
        if self._needs_ambient and samples.ambient_C is None:
            raise DataError(
                "the sensor needs the ambient temperature: give an ambient column, or --ambient DEGREES_C"
            )
        n, count = len(samples), self._memory.bank.count
        looked_at = self.sensor.checker is not None and (count % _PERIOD < TILE or -count % _PERIOD < n)
        estimates, features = self._pushed(samples, rows, looked_at)
        disagree = None if features is None else self._disagreement_of(features, estimates, rows, count)
        # Once two implementations have disagreed, neither is believed until the sensor is loaded again.
        if self._mismatch:
            mark(estimates.quality, slice(None), Quality.BACKEND_MISMATCH)
        elif disagree is not None:
            mark(estimates.quality, slice(disagree, None), Quality.BACKEND_MISMATCH)
            self._mismatch = True
        return estimates

    def _pushed(
        self, samples: Samples, rows: NDArray[np.intp] | None, with_features: bool
    ) -> tuple[Estimates, NDArray[np.float64] | None]:
        n = len(samples)
        m = n if rows is None else len(rows)
        if n <= _FEW and not with_features:
            return self._few_pushed(samples, rows, n, m), None
        block = _Block(n, m, self._outputs, self._features if with_features else 0)
        estimates = block.push(self._core, self._address, samples, rows, n, m)
        return estimates, block.features

    def _few_pushed(self, samples: Samples, rows: NDArray[np.intp] | None, n: int, m: int) -> Estimates:
        """A live line's samples, through arrays that are kept: finding the address of new ones takes as long as the rest."""
        if self._few is None:
            self._few = _Block(_FEW, _FEW, self._outputs, 0)
        few = self._few.push(self._core, self._address, samples, rows, n, m)
        return Estimates(few.time_ns.copy(), few.values.copy(), few.sigma.copy(), few.quality.copy())

    def _disagreement_of(
        self, features: NDArray[np.float64], estimates: Estimates, rows: NDArray[np.intp] | None, count: int
    ) -> int | None:
        """The first row where the second backend differs, among those at which it looks."""
        assert self.sensor.checker is not None
        number = count + (np.arange(len(features)) if rows is None else rows)
        looked = np.flatnonzero(number % _PERIOD < TILE)
        if not len(looked):
            return None
        second, _ = self.sensor.checker.evaluate(tiled(features[looked].T, 0))
        apart = np.abs(untiled(second)[:, : len(looked)].T - estimates.values[looked]) / self._scales
        wrong = np.flatnonzero(~(apart <= CHECK_TOLERANCE).all(axis=1))
        return int(looked[wrong[0]]) if len(wrong) else None


class _Block:
    """Arrays for `n` samples and `m` rows of K outputs, and where the core finds them."""

    def __init__(self, n: int, m: int, outputs: int, features: int) -> None:
        self.time_ns = np.empty(n, dtype=np.int64)
        self.voltage_V, self.current_A, self.ambient_C = np.empty((3, n))
        self.flags, self.rows = np.empty(n, dtype=np.uint32), np.empty(m, dtype=np.int64)
        self.values, self.sigma = np.empty((2, m, outputs))
        self.quality = np.empty(m, dtype=np.uint32)
        self.features = np.empty((m, features)) if features else None
        self._addresses = {name: getattr(self, name).ctypes.data for name in ("ambient_C", "flags", "rows")}
        self._table = BlockTable(
            self.time_ns.ctypes.data, self.voltage_V.ctypes.data, self.current_A.ctypes.data, None, None, None,
            self.values.ctypes.data, self.sigma.ctypes.data, self.quality.ctypes.data,
            None if self.features is None else self.features.ctypes.data,
        )  # fmt: skip
        self._address = ctypes.addressof(self._table)

    def push(
        self, core: CoreBackend, state: int, samples: Samples, rows: NDArray[np.intp] | None, n: int, m: int
    ) -> Estimates:
        """The estimates, in this block's memory. Raises DataError where time runs backwards; the state is then as before."""
        table, addresses = self._table, self._addresses
        self.time_ns[:n], self.voltage_V[:n], self.current_A[:n] = (
            samples.time_ns, samples.voltage_V, samples.current_A,
        )  # fmt: skip
        for name, given in (("ambient_C", samples.ambient_C), ("flags", samples.flags)):
            if given is not None:
                getattr(self, name)[:n] = given
            setattr(table, name, None if given is None else addresses[name])
        if rows is not None:
            self.rows[:m] = rows
        table.rows = None if rows is None else addresses["rows"]
        wrong = core.library.motorlens_push_block(core.address, state, self._address, n, m)
        if wrong:
            raise DataError(f"time runs backwards at {samples.time_ns[wrong - 1] * 1e-9:.6f} s")
        time_ns = self.time_ns[:n] if rows is None else samples.time_ns[rows]
        return Estimates(time_ns, self.values[:m], self.sigma[:m], self.quality[:m])
