"""The estimator in the C core: the same samples, words and states as `estimator.Estimator`, in one call a block."""

import ctypes
from typing import Any

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

Array = NDArray[np.float64]

# Of this many samples, the first tile of 16 is looked at by a second backend.
LOOK_EVERY = CHECK_EVERY * TILE
# Up to so many samples go through arrays that are kept.
_FEW = 64


def open_estimator(sensor: Sensor, period_s: float, state: EstimatorState | None = None) -> Estimator:
    """The estimator for a sensor: in the C core where that computes its network, else in Python."""
    kind = CoreEstimator if isinstance(sensor.backend, CoreBackend) else Estimator
    return kind(sensor, period_s, state)


class CoreEstimator(Estimator):
    """See `Estimator`.

    Attributes:
        core: the sensor's tables, its `backend`.
        address: where the core finds the state.
    """

    def __init__(self, sensor: Sensor, period_s: float, state: EstimatorState | None = None) -> None:
        backend = sensor.backend
        assert isinstance(backend, CoreBackend)
        self.sensor, self.core = sensor, backend
        self._needs_ambient = sensor.specification.needs_ambient
        self._outputs, self._features = len(sensor.specification.outputs), len(sensor.specification.features)
        self._scales = scales(sensor.specification)
        self._filters = len(sensor.specification.filters)
        observer = sensor.specification.observer
        self._observer = 0 if observer is None else len(observer.start())
        self._mismatch = False
        self._few: _Few | None = None
        self._memory = StateMemory()
        self._bank = self._memory.bank  # once: a look at a structure within one makes an object
        self.address = ctypes.addressof(self._memory)
        backend.library.motorlens_start(backend.address, self.address, round(period_s * 1e9))
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
        memory, n = self._memory, self._filters
        return EstimatorState(
            BankState(int(memory.bank.count), np.array(memory.bank.before[:n]),
                      np.array([memory.bank.inside[:n], memory.bank.reach[:n]])),
            gate_state_of(memory.gate),
            self._mismatch,
            tuple(memory.observer[: self._observer]),
        )  # fmt: skip

    @state.setter
    def state(self, state: EstimatorState) -> None:
        memory, n = self._memory, self._filters
        memory.bank.count = state.bank.count
        memory.bank.before[:n] = state.bank.before.tolist()
        memory.bank.inside[:n], memory.bank.reach[:n] = state.bank.within.tolist()
        memory.bank.dt_s = -1.0  # the decays are another sensor's, or not known
        put_gate_state(memory.gate, state.gate)
        if len(state.observer) == self._observer:
            memory.observer[: self._observer] = state.observer
        self._mismatch = state.mismatch

    def push(self, samples: Samples, rows: NDArray[np.intp] | None = None) -> Estimates:
        """See `Estimator.push`."""
        if not self.takes(samples.ambient_C is not None):
            raise DataError(
                "the sensor needs the ambient temperature: give an ambient column, or --ambient DEGREES_C"
            )
        n, count = len(samples), self._bank.count
        if rows is not None and len(rows) == n:
            rows = None
        looked = None
        if self.sensor.checker is not None and (count % LOOK_EVERY < TILE or -count % LOOK_EVERY < n):
            looked = looked_at(count, n, rows)
        if looked is None and n <= _FEW:
            return self.judged(self._few_pushed(samples, rows), None, None)
        return self._many_pushed(samples, rows, looked)

    @property
    def count(self) -> int:
        """Samples so far."""
        return int(self._bank.count)

    def takes(self, ambient_known: bool) -> bool:
        """Whether samples can be pushed: not without the ambient temperature where the sensor needs it."""
        return ambient_known or not self._needs_ambient

    def judged(
        self, estimates: Estimates, looked: NDArray[np.intp] | None, features: Array | None
    ) -> Estimates:
        """The estimates, marked where two implementations do not agree; `features` (looked, F) are what the second looks at.

        Once they have disagreed, neither is believed until the sensor is loaded again.
        """
        if self._mismatch:
            mark(estimates.quality, slice(None), Quality.BACKEND_MISMATCH)
        elif looked is not None and len(looked):
            assert self.sensor.checker is not None and features is not None
            second, _ = self.sensor.checker.evaluate(tiled(features.T, 0))
            apart = np.abs(untiled(second)[:, : len(looked)].T - estimates.values[looked]) / self._scales
            wrong = np.flatnonzero(~(apart <= CHECK_TOLERANCE).all(axis=1))
            if len(wrong):
                mark(estimates.quality, slice(int(looked[wrong[0]]), None), Quality.BACKEND_MISMATCH)
                self._mismatch = True
        return estimates

    def _few_pushed(self, samples: Samples, rows: NDArray[np.intp] | None) -> Estimates:
        """A live line's samples, through arrays that are kept: finding the address of new ones takes as long as the rest."""
        if self._few is None:
            self._few = _Few(self._outputs)
        return self._few.push(self.core, self.address, samples, rows)

    def _many_pushed(
        self, samples: Samples, rows: NDArray[np.intp] | None, looked: NDArray[np.intp] | None
    ) -> Estimates:
        n = len(samples)
        given: list[NDArray[Any] | None] = [
            _as(samples.time_ns, np.int64), _as(samples.voltage_V, np.float64), _as(samples.current_A, np.float64),
            _as(samples.ambient_C, np.float64), _as(samples.flags, np.uint32), _as(rows, np.int64),
        ]  # fmt: skip
        m = n if rows is None else len(rows)
        values, sigma = np.empty((2, self._outputs, m))
        quality = np.empty(m, dtype=np.uint32)
        features = np.empty((0 if looked is None else len(looked), self._features))
        table = BlockTable(
            n, m, 0 if looked is None else LOOK_EVERY, TILE, 0, *(None if a is None else a.ctypes.data for a in given),
            values.ctypes.data, sigma.ctypes.data, quality.ctypes.data, features.ctypes.data,
        )  # fmt: skip
        _run(self.core, self.address, table, samples)
        estimates = Estimates(
            samples.time_ns if rows is None else samples.time_ns[rows], values.T, sigma.T, quality
        )
        return self.judged(estimates, looked, features)


def looked_at(count: int, n: int, rows: NDArray[np.intp] | None) -> NDArray[np.intp]:
    """Which of `rows` of `n` samples after `count` (None: of all) the second backend looks at."""
    if rows is not None:
        return np.flatnonzero((count + rows) % LOOK_EVERY < TILE)
    tiles = np.arange(-(count % LOOK_EVERY), n, LOOK_EVERY)
    looked = (tiles[:, None] + np.arange(TILE)).reshape(-1)
    return looked[(looked >= 0) & (looked < n)]


def gate_state_of(gate: Any) -> GateState:
    """What the core's gate remembers, as Python's holds it."""
    ambient_C = float(gate.ambient_C)
    return GateState(
        int(gate.first_ns) if gate.begun else None, int(gate.last_ns) if gate.begun else None, gate.voltage_V,
        gate.current_A, 0.0 if np.isnan(ambient_C) else ambient_C, gate.bridged_until_ns, gate.count,
        gate.current_since, gate.first_move, gate.dead_since, bool(gate.remembered),
    )  # fmt: skip


def put_gate_state(into: Any, gate: GateState) -> None:
    """The same the other way."""
    into.begun = gate.last_ns is not None
    into.first_ns, into.last_ns = gate.first_ns or 0, gate.last_ns or 0
    into.remembered = gate.remembered
    for name in ("voltage_V", "current_A", "ambient_C", "bridged_until_ns", "count", "current_since", "first_move",
                 "dead_since"):  # fmt: skip
        setattr(into, name, getattr(gate, name))


def _as(values: NDArray[Any] | None, kind: Any) -> NDArray[Any] | None:
    return None if values is None else np.ascontiguousarray(values, dtype=kind)


def _run(core: CoreBackend, state: int, table: Any, samples: Samples) -> None:
    """One call of the core. Raises DataError where time runs backwards; the state is then as before."""
    wrong = core.library.motorlens_push(core.address, state, ctypes.addressof(table))
    if wrong:
        raise DataError(f"time runs backwards at {samples.time_ns[wrong - 1] * 1e-9:.6f} s")


class _Few:
    """Arrays for a few samples and rows of K outputs, and where the core finds them."""

    def __init__(self, outputs: int) -> None:
        self.time_ns = np.empty(_FEW, dtype=np.int64)
        self.voltage_V, self.current_A, self.ambient_C = np.empty((3, _FEW))
        self.flags, self.rows = np.empty(_FEW, dtype=np.uint32), np.empty(_FEW, dtype=np.int64)
        self._outputs = outputs
        self.values, self.sigma = np.empty((2, outputs * _FEW))
        self.quality = np.empty(_FEW, dtype=np.uint32)
        self._at_ambient, self._at_flags, self._at_rows = (
            array.ctypes.data for array in (self.ambient_C, self.flags, self.rows)
        )
        self._table = BlockTable(
            0, 0, 0, TILE, 0, self.time_ns.ctypes.data, self.voltage_V.ctypes.data, self.current_A.ctypes.data, None, None,
            None, self.values.ctypes.data, self.sigma.ctypes.data, self.quality.ctypes.data, None,
        )  # fmt: skip

    def push(
        self, core: CoreBackend, state: int, samples: Samples, rows: NDArray[np.intp] | None
    ) -> Estimates:
        """The estimates, in memory of their own."""
        time_ns, table = samples.time_ns, self._table
        n = len(time_ns)
        m = n if rows is None else len(rows)
        self.time_ns[:n] = time_ns
        self.voltage_V[:n] = samples.voltage_V
        self.current_A[:n] = samples.current_A
        if samples.ambient_C is not None:
            self.ambient_C[:n] = samples.ambient_C
        if samples.flags is not None:
            self.flags[:n] = samples.flags
        if rows is not None:
            self.rows[:m] = rows
        table.ambient_C = None if samples.ambient_C is None else self._at_ambient
        table.flags = None if samples.flags is None else self._at_flags
        table.rows = None if rows is None else self._at_rows
        table.n, table.m = n, m
        _run(core, state, table, samples)
        K = self._outputs
        return Estimates(
            time_ns if rows is None else time_ns[rows], self.values[: K * m].copy().reshape(K, m).T,
            self.sigma[: K * m].copy().reshape(K, m).T, self.quality[:m].copy(),
        )  # fmt: skip
