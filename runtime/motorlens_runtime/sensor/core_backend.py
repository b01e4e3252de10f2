"""A sensor in the C core: its tables in memory, and the network as a backend beside numpy's and ONNX Runtime's."""

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.gate import GateLimits
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.sensor.core_library import (
    ArgumentTable,
    EnvelopeTable,
    FeatureTable,
    GateTable,
    NetworkTable,
    ObserverTable,
    OperationTable,
    ProgramTable,
    SensorTable,
    StepTable,
    core,
    limits,
)
from motorlens_runtime.sensor.tables import Argument, Program, Tables
from motorlens_runtime.sensor.whole_tables import WholeArgument

Array = NDArray[np.float64]


class CoreBackend:
    """The tables of one sensor where the core reads them; nothing is changed after it is made.

    Attributes:
        library: the loaded core.
        table: the sensor's struct.

    Raises:
        ModelError: there is no core here, or the sensor is larger than it has room for.
    """

    name = "core"

    def __init__(self, tables: Tables) -> None:
        loaded = core()
        if loaded.library is None:
            raise ModelError(f"no C core: {loaded.reason}")
        _check_room(tables)
        self.library = loaded.library
        self._kept: list[Any] = []  # what the struct points at
        self._features, self._outputs = len(tables.mean), len(tables.offset)
        self.table = self._sensor(tables)
        self.address = ctypes.addressof(self.table)

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """See `Backend`."""
        rows = np.ascontiguousarray(features.transpose(0, 2, 1)).reshape(-1, self._features)
        estimate, sigma = (np.empty((self._outputs, len(rows))) for _ in range(2))
        self.library.motorlens_evaluate_features(
            self.address, len(rows), rows.ctypes.data, estimate.ctypes.data, sigma.ctypes.data
        )
        shape = (self._outputs, len(features), TILE)
        return estimate.reshape(shape).transpose(1, 0, 2), sigma.reshape(shape).transpose(1, 0, 2)

    def _array(self, values: Any, dtype: Any) -> int:
        array = np.ascontiguousarray(values, dtype=dtype)
        self._kept.append(array)
        return array.ctypes.data

    def _structures(self, kind: Any, items: list[Any]) -> int:
        array = (kind * max(len(items), 1))(*items)
        self._kept.append(array)
        return ctypes.addressof(array)

    def _sensor(self, t: Tables) -> Any:
        gate = gate_table(t.gate, t.needs_ambient)
        first, second = zip(*t.factors, strict=True) if t.factors else ((), ())
        features = FeatureTable(
            len(t.factors), len(t.tau_s), len(t.plus), self._array(first, np.uint8), self._array(second, np.uint8),
            self._array(t.filter_signals, np.uint8), self._array(t.tau_s, np.float64), self._array(t.plus, np.uint16),
            self._array(t.minus, np.uint16), t.resistance_ohm,
        )  # fmt: skip
        triangle = None
        if t.whitening is not None:
            triangle = self._array(t.triangle, np.float64)
        envelope = EnvelopeTable(self._array(t.mean, np.float64), triangle, t.limit, t.distrust)
        steps = [
            StepTable(
                step.function, 3 if step.shared else len(step.arguments), step.width,
                (ArgumentTable * 2)(*map(self._argument, step.arguments)), *step.limits,
            )
            for step in t.steps
        ]  # fmt: skip
        network = NetworkTable(
            self._structures(StepTable, steps), len(steps), len(t.offset), self._argument(t.estimate),
            self._argument(t.sigma), self._array(t.offset, np.float64),
        )  # fmt: skip
        observer = ObserverTable()
        if (o := t.observer) is not None:
            programs = map(self._program, (o.accumulate, o.correct, o.read))
            observer = ObserverTable(*programs, o.size, o.window, o.time, o.outputs, o.full_s, o.ambient_C)
        return SensorTable(gate, features, envelope, network, observer)

    def _argument(self, argument: Argument | WholeArgument) -> Any:
        assert isinstance(argument, Argument)
        if argument.weights is None:
            return ArgumentTable(None, argument.start, 0)
        return ArgumentTable(
            self._array(argument.weights, np.float64), argument.start, argument.weights.shape[1]
        )

    def _program(self, program: Program) -> Any:
        steps = [
            OperationTable(
                operation, result, (ctypes.c_uint16 * 3)(*arguments, *[arguments[0]] * (3 - len(arguments)))
            )
            for operation, result, arguments in program.steps
        ]
        return ProgramTable(
            self._structures(OperationTable, steps), self._array(program.constants, np.float64),
            self._array(program.outputs, np.uint16), len(steps), program.registers, program.inputs, len(program.outputs),
        )  # fmt: skip


def gate_table(g: GateLimits, needs_ambient: bool) -> Any:
    """The limits of the gate where the core reads them."""
    return GateTable(
        g.warm_up_ns, g.cold_ns, g.first_dt_ns, g.slowest_ns, g.fastest_ns, *g.range, g.absurd_V, g.absurd_A, g.move_V,
        g.flowing_A, g.noise_A, g.slew_A_ns, g.repeats, needs_ambient,
    )  # fmt: skip


def _check_room(tables: Tables) -> None:
    observer = tables.observer
    needed = {
        "FILTERS": len(tables.tau_s), "FEATURES": len(tables.mean), "SIGNALS": len(tables.factors),
        "WIDTH": tables.width, "COLUMNS": tables.columns, "OUTPUTS": len(tables.offset),
        "OBSERVER": max(observer.size, observer.outputs) if observer else 0,
        "REGISTERS": max((program.registers for program in tables.programs), default=0),
    }  # fmt: skip
    for name, count in needed.items():
        if count > limits()[name]:
            raise ModelError(f"the C core has room for {limits()[name]} {name.lower()}, not for {count}")
