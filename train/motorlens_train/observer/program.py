"""Straight-line programs: a computation as a list of scalar operations, from which every implementation is printed.

The observer of a sensor is recorded once, by running its Python description on `Value`s, and the record is then run by
numpy or numba, printed as C99, written into an ONNX graph and stored in the sensor file. Equal operations are recorded
once, and products with zero or one are not recorded at all, so matrices with few entries cost what their entries cost.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from motorlens_physics.compile.native import Native

# name -> (number of arguments, what it does to float64 arrays). `le` is 1 or 0; `select` is its second argument where the
# first is not 0. A runtime that meets another name must refuse the file.
OPERATIONS: dict[str, tuple[int, Callable[..., Any]]] = {
    "add": (2, np.add), "sub": (2, np.subtract), "mul": (2, np.multiply), "div": (2, np.divide),
    "neg": (1, np.negative), "sqrt": (1, np.sqrt), "exp": (1, np.exp), "log": (1, np.log), "tanh": (1, np.tanh),
    "sin": (1, np.sin), "cos": (1, np.cos), "abs": (1, np.abs), "sign": (1, np.sign), "pow": (2, np.power),
    "max": (2, np.maximum), "min": (2, np.minimum), "le": (2, lambda a, b: np.less_equal(a, b) * 1.0),
    "select": (3, lambda c, a, b: np.where(np.asarray(c) != 0, a, b)),
}  # fmt: skip
_PYTHON = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}", "neg": "-{0}", "pow": "{0} ** {1}",
    "sqrt": "math.sqrt({0})", "exp": "math.exp({0})", "log": "math.log({0})", "tanh": "math.tanh({0})",
    "sin": "math.sin({0})", "cos": "math.cos({0})", "abs": "abs({0})", "max": "max({0}, {1})", "min": "min({0}, {1})",
    "sign": "(1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else 0.0)", "le": "(1.0 if {0} <= {1} else 0.0)",
    "select": "({1} if {0} != 0.0 else {2})",
}  # fmt: skip


@dataclass(frozen=True)
class Program:
    """Scalar operations in order; registers are numbered: inputs first, then constants, then one per operation.

    Attributes:
        inputs: names, for readers.
        constants: float64 values.
        steps: (operation, argument registers).
        outputs: registers.
    """

    inputs: tuple[str, ...]
    constants: tuple[float, ...]
    steps: tuple[tuple[str, tuple[int, ...]], ...]
    outputs: tuple[int, ...]

    def __call__(self, *inputs: Any) -> list[Any]:
        """Run on floats or arrays of one shape; the outputs in their order."""
        registers: list[Any] = [*inputs, *self.constants]
        for name, arguments in self.steps:
            registers.append(OPERATIONS[name][1](*(registers[a] for a in arguments)))
        return [registers[r] for r in self.outputs]

    def document(self) -> dict[str, Any]:
        """As it stands in a sensor file; JSON keeps every bit of a float64."""
        return {
            "inputs": list(self.inputs), "constants": list(self.constants),
            "steps": [[name, *arguments] for name, arguments in self.steps], "outputs": list(self.outputs),
        }  # fmt: skip

    @staticmethod
    def from_document(document: Mapping[str, Any]) -> "Program":
        """The inverse of `document`.

        Raises:
            KeyError, ValueError: it is not one.
        """
        steps = tuple((str(step[0]), tuple(int(a) for a in step[1:])) for step in document["steps"])
        first = len(document["inputs"]) + len(document["constants"])
        for k, (name, arguments) in enumerate(steps):
            if OPERATIONS[name][0] != len(arguments) or any(not 0 <= a < first + k for a in arguments):
                raise ValueError(f"step {k}: {name} of {arguments}")
        numbers = tuple(float(value) for value in document["constants"])
        return Program(tuple(document["inputs"]), numbers, steps, tuple(int(r) for r in document["outputs"]))

    def lines(self, templates: Mapping[str, str], register: str, number: Callable[[float], str]) -> list[str]:
        """One assignment a step, in the syntax of `templates`; inputs and results are named `register` + number."""
        first = len(self.inputs) + len(self.constants)

        def name(index: int) -> str:
            constant = index - len(self.inputs)
            return (
                number(self.constants[constant])
                if 0 <= constant < len(self.constants)
                else f"{register}{index}"
            )

        return [
            f"{register}{first + k} = {templates[step].format(*map(name, arguments))}"
            for k, (step, arguments) in enumerate(self.steps)
        ]

    def result(self, k: int, register: str, number: Callable[[float], str]) -> str:
        """How output k is spelled beside `lines`."""
        constant = self.outputs[k] - len(self.inputs)
        if 0 <= constant < len(self.constants):
            return number(self.constants[constant])
        return f"{register}{self.outputs[k]}"

    def giving(self, outputs: Sequence[int]) -> "Program":
        """The program that gives some of its outputs, by number, with the operations that these need."""
        first = len(self.inputs)
        wanted = [self.outputs[k] for k in outputs]
        needed, stack = set(range(first)), list(wanted)
        while stack:
            register = stack.pop()
            if register not in needed:
                needed.add(register)
                step = register - first - len(self.constants)
                stack += self.steps[step][1] if step >= 0 else ()
        number = {register: k for k, register in enumerate(sorted(needed))}
        constants = tuple(c for k, c in enumerate(self.constants, first) if k in needed)
        steps = tuple(
            (name, tuple(number[a] for a in arguments))
            for k, (name, arguments) in enumerate(self.steps, first + len(self.constants))
            if k in needed
        )
        return Program(self.inputs, constants, steps, tuple(number[register] for register in wanted))

    def compiled(self) -> "Native":
        """Machine code `(inputs (n,), outputs (m,)) -> None` that fills the second array, for numba's functions to call.

        Each operation is rounded as it is written, so that every implementation comes to the same numbers.
        """
        from numba import types

        from motorlens_physics.compile import cache_folder
        from motorlens_physics.compile.native import native

        lines = [f"r{k} = x[{k}]" for k in range(len(self.inputs))]
        lines += self.lines(_PYTHON, "r", _python_number)
        lines += [f"y[{k}] = {self.result(k, 'r', _python_number)}" for k in range(len(self.outputs))]
        source = "def run(x, y):\n" + "\n".join("    " + line for line in lines or ["pass"])
        vector = types.float64[::1]
        return native(source, {"run": types.void(vector, vector)}, cache_folder(), flags=())["run"]


def _python_number(value: float) -> str:
    return f"({value!r})" if math.isfinite(value) else f"({'-' if value < 0 else ''}math.inf)"


class Recorder:
    """Records the operations on its `Value`s."""

    def __init__(self) -> None:
        self._names: list[str] = []
        self._constants: dict[float, Value] = {}
        self._steps: dict[tuple[str, tuple[int, ...]], Value] = {}
        self._order: list[Value] = []

    def input(self, name: str) -> "Value":
        """A further input."""
        value = Value(self, len(self._order), ("input", len(self._names)))
        self._names.append(name)
        self._order.append(value)
        return value

    def inputs(self, names: Sequence[str]) -> list["Value"]:
        """Further inputs."""
        return [self.input(name) for name in names]

    def constant(self, number: float) -> "Value":
        """A number."""
        key = float(number) + 0.0  # no negative zero
        if key not in self._constants:
            self._constants[key] = Value(self, len(self._order), ("constant", key))
            self._order.append(self._constants[key])
        return self._constants[key]

    def apply(self, name: str, *arguments: Any) -> "Value":
        """Record an operation, unless its result is known already."""
        values = [a if isinstance(a, Value) else self.constant(a) for a in arguments]
        numbers = [value.number for value in values]
        known = [number for number in numbers if number is not None]
        if len(known) == len(numbers):
            with np.errstate(all="ignore"):
                return self.constant(float(OPERATIONS[name][1](*known)))
        simple = _simplified(name, values, numbers)
        if simple is not None:
            return simple if isinstance(simple, Value) else self.constant(simple)
        if name in ("add", "mul"):
            values.sort(key=lambda value: value.index)
        key = (name, tuple(value.index for value in values))
        if key not in self._steps:
            self._steps[key] = Value(self, len(self._order), ("step", key))
            self._order.append(self._steps[key])
        return self._steps[key]

    def program(self, outputs: Sequence[Any]) -> Program:
        """The operations that `outputs` need, renumbered."""
        wanted = [value if isinstance(value, Value) else self.constant(value) for value in outputs]
        needed: set[int] = set()
        stack = [value.index for value in wanted]
        while stack:
            index = stack.pop()
            if index not in needed:
                needed.add(index)
                kind, what = self._order[index].origin
                stack += what[1] if kind == "step" else ()
        inputs = [value for value in self._order if value.origin[0] == "input"]
        constants = [v for v in self._order if v.origin[0] == "constant" and v.index in needed]
        steps = [value for value in self._order if value.origin[0] == "step" and value.index in needed]
        number = {value.index: k for k, value in enumerate([*inputs, *constants, *steps])}
        return Program(
            tuple(self._names),
            tuple(value.origin[1] for value in constants),
            tuple((v.origin[1][0], tuple(number[a] for a in v.origin[1][1])) for v in steps),
            tuple(number[value.index] for value in wanted),
        )


def _simplified(name: str, values: list["Value"], numbers: list[float | None]) -> "Value | float | None":
    if name == "add":
        return values[1] if numbers[0] == 0 else values[0] if numbers[1] == 0 else None
    if name == "sub" and numbers[1] == 0:
        return values[0]
    if name == "mul":
        if 0 in numbers:
            return 0.0
        return values[1] if numbers[0] == 1 else values[0] if numbers[1] == 1 else None
    if name == "div":
        return 0.0 if numbers[0] == 0 else values[0] if numbers[1] == 1 else None
    return None


@dataclass(frozen=True, eq=False)
class Value:
    """A number that is not known yet; arithmetic on it is recorded."""

    recorder: Recorder = field(repr=False)
    index: int
    origin: tuple[str, Any]

    @property
    def number(self) -> float | None:
        """The number, if it is a constant."""
        return self.origin[1] if self.origin[0] == "constant" else None

    def __add__(self, other: Any) -> "Value":
        return self.recorder.apply("add", self, other)

    def __sub__(self, other: Any) -> "Value":
        return self.recorder.apply("sub", self, other)

    def __mul__(self, other: Any) -> "Value":
        return self.recorder.apply("mul", self, other)

    def __truediv__(self, other: Any) -> "Value":
        return self.recorder.apply("div", self, other)

    def __rsub__(self, other: Any) -> "Value":
        return self.recorder.apply("sub", other, self)

    def __rtruediv__(self, other: Any) -> "Value":
        return self.recorder.apply("div", other, self)

    def __neg__(self) -> "Value":
        return self.recorder.apply("neg", self)

    __radd__ = __add__
    __rmul__ = __mul__

    def __le__(self, other: Any) -> "Value":
        return self.recorder.apply("le", self, other)

    def __ge__(self, other: Any) -> "Value":
        return self.recorder.apply("le", other, self)

    def __getattr__(self, name: str) -> Any:
        """Functions by their names: `value.sqrt()`, `value.max(other)`, `condition.select(a, b)`."""
        if name not in OPERATIONS:
            raise AttributeError(name)
        return lambda *others: self.recorder.apply(name, self, *others)


def record(expression: Any, values: Mapping[Any, Any], recorder: Recorder) -> Any:
    """Record a SymPy expression whose symbols have the given values (numbers or `Value`s).

    Raises:
        TypeError: a function that no operation stands for.
    """
    import sympy as sp

    known: dict[Any, Any] = dict(values)

    def visit(e: Any) -> Any:
        if e not in known:
            known[e] = _record_node(e, visit, recorder, sp)
        return known[e]

    return visit(sp.sympify(expression))


def _record_node(e: Any, visit: Callable[[Any], Any], recorder: Recorder, sp: Any) -> Any:
    if e.is_number:
        return float(e)
    if e.is_Add or e.is_Mul or isinstance(e, (sp.Max, sp.Min)):
        name = {sp.Add: "add", sp.Mul: "mul", sp.Max: "max", sp.Min: "min"}[e.func]
        total = visit(e.args[0])
        for part in e.args[1:]:
            total = recorder.apply(name, total, visit(part))
        return total
    if e.is_Pow:
        return _power(visit(e.base), e.exp, visit, recorder)
    if isinstance(e, sp.Piecewise):
        result = visit(e.args[-1].expr)
        for branch in reversed(e.args[:-1]):
            result = recorder.apply(
                "select", _condition(branch.cond, visit, recorder, sp), visit(branch.expr), result
            )
        return result
    if e.func == sp.Heaviside:
        # The derivative of max and min; what it is at the corner decides nothing.
        return recorder.apply("le", 0.0, visit(e.args[0]))
    names = {
        sp.exp: "exp",
        sp.tanh: "tanh",
        sp.sin: "sin",
        sp.cos: "cos",
        sp.Abs: "abs",
        sp.sign: "sign",
        sp.log: "log",
    }
    if e.func not in names:
        raise TypeError(f"no operation for {e.func.__name__}({', '.join(map(str, e.args))})")
    return recorder.apply(names[e.func], visit(e.args[0]))


def _condition(condition: Any, visit: Callable[[Any], Any], recorder: Recorder, sp: Any) -> Any:
    sides = visit(condition.lhs), visit(condition.rhs)
    # Equality decides nothing in a computation on measured numbers, so < and <= are one.
    return recorder.apply("le", *(sides if isinstance(condition, (sp.Lt, sp.Le)) else sides[::-1]))


def _power(base: Any, exponent: Any, visit: Callable[[Any], Any], recorder: Recorder) -> Any:
    if exponent.is_Integer and abs(int(exponent)) <= 8:
        result = base
        for _ in range(abs(int(exponent)) - 1):
            result = recorder.apply("mul", result, base)
        return result if exponent > 0 else recorder.apply("div", 1.0, result)
    if exponent.is_number and float(abs(exponent)) == 0.5:  # a Rational equals no float
        root = recorder.apply("sqrt", base)
        return root if exponent > 0 else recorder.apply("div", 1.0, root)
    return recorder.apply("pow", base, visit(exponent))
