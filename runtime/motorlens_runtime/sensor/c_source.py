"""A sensor as C99 source: its tables and the core that computes with them, as `motorlens export` writes them."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.sensor.core_library import source_folder
from motorlens_runtime.sensor.tables import Argument, Program, Tables
from motorlens_runtime.sensor.whole_tables import WholeArgument

Array = NDArray[np.float64]

# What the PC's shared object has beyond the core.
_NOT_EXPORTED = ("shared.c", "decimal_text.c", "stream.c", "stream.h", "motorlens_config.h")
_PER_LINE = 8


@dataclass(frozen=True)
class Golden:
    """A short sequence from a fresh state, `time_ns` and samples (n,), and what must come of it, both (n, K).

    `tolerance` is a share of each output's `scale` (K,).
    """

    time_ns: NDArray[np.int64]
    voltage_V: Array
    current_A: Array
    ambient_C: Array | None
    estimate: Array
    sigma: Array
    scale: Array
    tolerance: float


def core_files() -> dict[str, str]:
    """The files of the core, by name."""
    return {
        path.name: path.read_text(encoding="utf-8")
        for path in sorted(source_folder().glob("*.[ch]"))
        if path.name not in _NOT_EXPORTED
    }


def config(tables: Tables, single: bool) -> str:
    """motorlens_config.h with exactly the room that a sensor needs, one row at a time."""
    observer, programs = tables.observer, tables.programs
    largest = max((p.registers + len(p.constants) for p in programs), default=1)
    room = {
        "LANES": 1, "FILTERS": len(tables.tau_s), "FEATURES": len(tables.mean), "SIGNALS": len(tables.factors),
        "WIDTH": tables.width, "COLUMNS": tables.columns - (tables.reals if single else 0),
        "REALS": tables.reals if single else 0, "OUTPUTS": len(tables.offset),
        "OBSERVER": max(observer.size, observer.outputs) if observer else 1,
        "REGISTERS": max((p.registers for p in programs), default=1),
    }  # fmt: skip
    functions = sum(1 << number for number in {step.function for step in tables.steps})
    operations = sum(1 << number for number in {step[0] for program in programs for step in program.steps})
    lines = "\n".join(f"#define MOTORLENS_{name} {max(value, 1)}" for name, value in room.items())
    return f"""/* motorlens_config.h - written by `motorlens export`: what the core is compiled for. */
#ifndef MOTORLENS_CONFIG_H
#define MOTORLENS_CONFIG_H

#define MOTORLENS_SINGLE {int(single)} /* 1: single precision, and filters in whole numbers of 64 bits */
typedef {"float" if single else "double"} motorlens_real; /* of measurements and network; the observer is double */

{lines}
#define MOTORLENS_COLUMN {"uint8_t" if tables.columns <= 256 else "uint16_t"}
#define MOTORLENS_REGISTER {"uint8_t" if largest <= 256 else "uint16_t"}
#define MOTORLENS_WHITENED {int(len(tables.triangle) > 0)}
#define MOTORLENS_FUNCTIONS {functions:#x}u
#define MOTORLENS_OPERATIONS {operations:#x}u

#endif
"""


def sensor_header(name: str, title: str, outputs: Iterable[tuple[str, str]]) -> str:
    """sensor.h: the sensor's name, and what it gives in which units."""
    promised = ", ".join(f"{quantity} ({unit})" for quantity, unit in outputs)
    return f"""/* {title}: written by `motorlens export`. Estimates, in this order: {promised}. */
#ifndef {name.upper()}_SENSOR_H
#define {name.upper()}_SENSOR_H

#include "motorlens.h"

extern const motorlens_sensor {name}_sensor;

#endif
"""


def sensor_source(name: str, tables: Tables, single: bool) -> str:
    """sensor.c: the tables."""
    return _Printer(name, single).source(tables)


def golden_header(golden: Golden) -> str:
    """golden.h: samples and what must come out."""
    ambient = np.full(len(golden.time_ns), np.nan) if golden.ambient_C is None else golden.ambient_C
    rows = len(golden.time_ns)
    return f"""/* golden.h - written by `motorlens export`: samples, and what must come out. */
#ifndef GOLDEN_H
#define GOLDEN_H

#include <math.h>
#include <stdint.h>

#define GOLDEN_ROWS {rows}
#define GOLDEN_OUTPUTS {len(golden.scale)}
#define GOLDEN_TOLERANCE {golden.tolerance!r}

{_table("int64_t", "golden_time_ns", (f"INT64_C({int(t)})" for t in golden.time_ns))}
{_table("double", "golden_voltage_V", map(_double, golden.voltage_V))}
{_table("double", "golden_current_A", map(_double, golden.current_A))}
{_table("double", "golden_ambient_C", map(_double, ambient))}
{_table("double", "golden_estimate", map(_double, golden.estimate.reshape(-1)))}
{_table("double", "golden_sigma", map(_double, golden.sigma.reshape(-1)))}
{_table("double", "golden_scale", map(_double, golden.scale))}

#endif
"""


def programs(name: str) -> dict[str, str]:
    """The test of the golden values and the example, by file."""
    return {
        path.name: path.read_text(encoding="utf-8").replace("SENSOR", f"{name}_sensor")
        for path in sorted((source_folder() / "export").glob("*.c"))
    }


class _Printer:
    """Prints the tables of one sensor; names begin with the sensor's."""

    def __init__(self, name: str, single: bool) -> None:
        self._name, self._single = name, single
        self._real = _float if single else _double
        self._tables: list[str] = []
        self._arguments: dict[int, str] = {}

    def source(self, t: Tables) -> str:
        name, observer = self._name, t.observer
        first, second = zip(*t.factors, strict=True) if t.factors else ((0,), (0,))
        features = [
            self._put("uint8_t", "first", map(str, first)), self._put("uint8_t", "second", map(str, second)),
            self._put("uint8_t", "filter_signal", map(str, t.filter_signals)),
            *self._filters(t), self._put("uint16_t", "plus", map(str, t.plus)),
            self._put("uint16_t", "minus", map(str, t.minus)),
        ]  # fmt: skip
        envelope = [*self._envelope(t), self._real(t.limit), str(t.distrust)]
        if t.whole is not None:
            network = self._whole_network(t)
        else:
            network = self._network(t)
        watching = "{0, 0, 0, 0}"
        if observer is not None:
            programs = [
                self._program(label, program)
                for label, program in zip(("accumulate", "correct", "read"), t.programs, strict=True)
            ]
            watching = (
                f"{{{', '.join(programs)}, {observer.size}, {observer.window}, {observer.time}, {observer.outputs}, "
                f"{_double(observer.full_s)}, {_double(observer.ambient_C)}}}"
            )
        g = t.gate
        gate = [
            *map(_whole, (g.warm_up_ns, g.cold_ns, g.first_dt_ns, g.slowest_ns, g.fastest_ns)),
            *map(self._real, (*g.range, g.absurd_V, g.absurd_A, g.move_V, g.flowing_A, g.noise_A, g.slew_A_ns)),
            str(g.repeats), str(int(t.needs_ambient)),
        ]  # fmt: skip
        tables = "\n\n".join(self._tables)
        return f"""/* sensor.c - written by `motorlens export`: the tables of the sensor. */
#include <math.h>

#include "sensor.h"

{tables}

const motorlens_sensor {name}_sensor = {{
    {{{", ".join(gate)}}},
    {{{len(t.factors)}, {len(t.tau_s)}, {len(t.plus)}, {", ".join(features)}, {self._real(t.resistance_ohm)}}},
    {{{", ".join(envelope)}}},
    {{{", ".join(network)}}},
    {watching}}};
"""

    def _network(self, t: Tables) -> list[str]:
        steps = [
            f"{{{step.function}, {3 if step.shared else len(step.arguments)}, {step.width}, "
            f"{{{', '.join(self._argument(a) for a in (*step.arguments, *step.arguments)[:2])}}}, "
            f"{self._real(step.limits[0])}, {self._real(step.limits[1])}}}"
            for step in t.steps
        ]
        return [
            self._put("motorlens_step", "steps", steps), str(len(t.steps)), str(len(t.offset)), self._argument(t.estimate),
            self._argument(t.sigma), self._put("motorlens_real", "offset", map(self._real, t.offset)),
        ]  # fmt: skip

    def _whole_network(self, t: Tables) -> list[str]:
        """In single precision: arguments in a table of their own, each once."""
        listed: list[WholeArgument] = []
        for argument in (*(a for step in t.steps for a in step.arguments), t.estimate, t.sigma):
            assert isinstance(argument, WholeArgument)
            if not any(argument is other for other in listed):
                listed.append(argument)
        self._put(
            "motorlens_argument", "arguments", [self._whole_argument(a, k) for k, a in enumerate(listed)]
        )

        def pointer(argument: object) -> str:
            at = next(k for k, other in enumerate(listed) if other is argument)
            return f"{self._name}_arguments + {at}"

        steps = [
            f"{{{step.function}, {step.width}, {{{pointer(step.arguments[0])}, {pointer(step.arguments[-1])}}}, "
            f"{self._real(step.limits[0])}, {self._real(step.limits[1])}}}"
            for step in t.steps
        ]
        return [
            self._put("motorlens_step", "steps", steps), str(len(t.steps)), str(len(t.offset)), pointer(t.estimate),
            pointer(t.sigma),
        ]  # fmt: skip

    def _whole_argument(self, a: WholeArgument, number: int) -> str:
        weights = units = reals = "0"
        if a.weights.size:
            kind = "int16_t" if a.narrow else "int32_t"
            weights = self._put(kind, f"weights_{number}", map(str, a.weights.reshape(-1).tolist()))
            units = self._put("int8_t", f"units_{number}", map(str, a.units.tolist()))
        if a.reals is not None and (a.reals.size or not a.weights.size):
            reals = self._put("float", f"reals_{number}", map(_float, a.reals.reshape(-1)))
        count = 0 if a.reals is None else a.reals.shape[1]
        return f"{{{weights}, {units}, {reals}, {a.start}, {a.weights.shape[1]}, {a.real_start}, {count}, {int(a.narrow)}}}"

    def _filters(self, t: Tables) -> list[str]:
        if t.whole is None:
            return [self._put("double", "tau_s", map(_double, t.tau_s))]
        return [
            self._put("float", "per_ns", (_float(1e-9 / tau_s) for tau_s in t.tau_s)),
            self._put("float", "units", map(_float, t.whole.units)),
        ]

    def _envelope(self, t: Tables) -> list[str]:
        triangle = "0"
        if len(t.triangle):
            kind, text = ("motorlens_real", _double) if t.whole is None else ("int32_t", str)
            triangle = self._put(kind, "whitening", map(text, t.triangle.tolist()))
        if t.whole is None:
            return [self._put("double", "mean", map(_double, t.mean)), triangle]
        observed = [
            self._put("double", label, map(_double, column))
            for label, column in zip(("observed_mean", "observed_scale"), t.whole.observed.T, strict=True)
        ] if len(t.whole.observed) else ["0", "0"]  # fmt: skip
        return [
            self._put("int64_t", "mean", map(_whole, t.whole.mean)), self._put("uint8_t", "shift", map(str, t.whole.shift)),
            *observed, triangle, self._put("uint8_t", "places", map(str, t.whole.places)),
            self._put("int8_t", "unit", map(str, t.whole.unit.tolist())),
        ]  # fmt: skip

    def _put(self, kind: str, label: str, values: Iterable[str]) -> str:
        self._tables.append(_table(kind, f"{self._name}_{label}", values))
        return f"{self._name}_{label}"

    def _argument(self, argument: Argument | WholeArgument) -> str:
        assert isinstance(argument, Argument)
        if argument.weights is None:
            return f"{{0, {argument.start}, 0}}"
        if id(argument) not in self._arguments:
            label = f"weights_{len(self._arguments)}"
            flat = argument.weights.reshape(-1)
            self._arguments[id(argument)] = self._put("motorlens_real", label, map(self._real, flat))
        return f"{{{self._arguments[id(argument)]}, {argument.start}, {argument.weights.shape[1]}}}"

    def _program(self, label: str, program: Program) -> str:
        steps = (
            f"{{{operation}, {result}, {{{', '.join(map(str, (*arguments, *[arguments[0]] * (3 - len(arguments)))))}}}}}"
            for operation, result, arguments in program.steps
        )
        parts = [
            self._put("motorlens_operation", f"{label}_steps", steps),
            self._put("double", f"{label}_constants", map(_double, program.constants)),
            self._put("MOTORLENS_REGISTER", f"{label}_outputs", map(str, program.outputs)),
        ]
        counts = len(program.steps), program.registers, program.inputs, len(program.outputs)
        return f"{{{', '.join((*parts, *map(str, counts)))}}}"


def _table(kind: str, name: str, values: Iterable[str]) -> str:
    listed = list(values) or ["0"]
    lines = [", ".join(listed[k : k + _PER_LINE]) for k in range(0, len(listed), _PER_LINE)]
    return f"static const {kind} {name}[] = {{\n    " + ",\n    ".join(lines) + "};"


def _whole(value: int) -> str:
    return f"INT64_C({value})"


def _double(value: Any) -> str:
    number = float(value)
    return repr(number) if np.isfinite(number) else f"(double){_special(number)}"


def _float(value: Any) -> str:
    with np.errstate(over="ignore"):
        number = np.float32(value)
    return f"{float(str(number))!r}f" if np.isfinite(number) else _special(float(number))


def _special(number: float) -> str:
    return "NAN" if np.isnan(number) else "INFINITY" if number > 0 else "-INFINITY"


def written(name: str, title: str, tables: Tables, golden: Golden, single: bool,
            outputs: Iterable[tuple[str, str]]) -> Mapping[str, str]:  # fmt: skip
    """All files of an export, by name."""
    return {
        **core_files(),
        "motorlens_config.h": config(tables, single),
        "sensor.h": sensor_header(name, title, outputs),
        "sensor.c": sensor_source(name, tables, single),
        "golden.h": golden_header(golden),
        **programs(name),
    }
