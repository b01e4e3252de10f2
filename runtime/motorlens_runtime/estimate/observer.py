"""The physics observer of a sensor, as its file holds it: three straight-line programs and the layout of their state.

`accumulate` runs at every sample, `correct` when a window is full, `read` where a value is asked for; a state of zeros is a
fresh observer. A program is a list of scalar operations from a fixed table. It is turned into a Python function of which
every character comes from that table, so that nothing in a file is ever run that is not arithmetic.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
State = tuple[float, ...]

# Operation -> (number of arguments, how it is written).
_OPERATIONS = {
    "add": (2, "{0} + {1}"), "sub": (2, "{0} - {1}"), "mul": (2, "{0} * {1}"), "div": (2, "{0} / {1}"),
    "neg": (1, "-{0}"), "pow": (2, "power({0}, {1})"), "sqrt": (1, "sqrt({0})"), "exp": (1, "exp({0})"),
    "log": (1, "log({0})"), "tanh": (1, "tanh({0})"), "sin": (1, "sin({0})"), "cos": (1, "cos({0})"),
    "abs": (1, "abs({0})"), "max": (2, "({0} if {0} >= {1} else {1})"), "min": (2, "({0} if {0} <= {1} else {1})"),
    "sign": (1, "(1.0 if {0} > 0.0 else -1.0 if {0} < 0.0 else 0.0)"), "le": (2, "(1.0 if {0} <= {1} else 0.0)"),
    "select": (3, "({1} if {0} != 0.0 else {2})"),
}  # fmt: skip
_FUNCTIONS = {
    "power": math.pow,
    **{name: getattr(math, name) for name in ("sqrt", "exp", "log", "tanh", "sin", "cos")},
}
# A window is full a millionth before its period, for grids that miss it by rounding.
_FULL = 1 - 1e-6
# A rest is taken in steps of so many windows, and of a longer rest than this only so much. So many are a gap to an observer.
_REST_WINDOWS, _GAP_WINDOWS = 40, 60
_FORGOTTEN_S = 4 * 3600.0


class Observer:
    """The observer of a sensor, from `observer` in its specification.

    Attributes:
        document: as it stands in the file.
        outputs: how many numbers `read` gives.
        ambient_C: the ambient temperature where none is measured.
        distrust: the output that is above 0 where the others are not to be believed; -1 is none.
        full_s: a window is full after so many seconds.
        noise: entries of the state that say what noise the signals have.

    Raises:
        KeyError, ValueError, TypeError: the document is not that of an observer this runtime can run.
    """

    def __init__(self, document: dict[str, Any]) -> None:
        self.document = document
        self.outputs = len(document["outputs"])
        self.ambient_C = float(document["ambient_C"])
        self.distrust = int(document.get("distrust", -1))
        self.full_s = float(document["period_s"]) * _FULL
        self._size, self._window, self._time = (int(document[key]) for key in ("size", "window", "time"))
        self.noise = frozenset(int(entry) for entry in document.get("noise", ()))
        if not (0 <= self._time < self._window <= self._size and self.full_s > 0):
            raise ValueError("layout of the observer's state")
        self._accumulate = _compiled(document["accumulate"], 4 + self._window, self._window)
        self._correct = _compiled(document["correct"], 1 + self._size, self._size)
        self._read = _compiled(document["read"], 1 + self._size, self.outputs)

    def start(self) -> State:
        """A fresh observer."""
        return (0.0,) * self._size

    def rest(self, state: State, off_s: float, ambient_C: float | None) -> State:
        """The state after `off_s` seconds without voltage and current, which are known, so that the winding cools; a gap in
        the samples is something else, but for the first moment: while it still turns, an open motor has a voltage that
        nobody knows. In steps that the linearised model can take, and four hours of it at most. Zeros that nobody measured
        tell nothing of the noise."""
        off_s = min(off_s, _FORGOTTEN_S)
        first_s, piece = min(off_s, _GAP_WINDOWS * self.full_s), _REST_WINDOWS * self.full_s
        count = math.ceil((off_s - first_s) / piece) + 1
        zeros, used = np.zeros(count), np.ones(count, dtype=bool)
        ambient = None if ambient_C is None else np.full(count, ambient_C)
        dt_s = np.full(count, (off_s - first_s) / max(count - 1, 1))
        dt_s[0] = first_s
        rested, _ = self.advance(state, zeros, zeros, ambient, dt_s, used, np.zeros(0, dtype=np.intp))
        return tuple(
            before if entry in self.noise else after
            for entry, (before, after) in enumerate(zip(state, rested, strict=True))
        )

    def advance(
        self, state: State, voltage_V: Array, current_A: Array, ambient_C: Array | None, dt_s: Array,
        used: NDArray[np.bool_], rows: NDArray[np.intp] | None,
    ) -> tuple[State, Array]:  # fmt: skip
        """Feed n samples and read the outputs after some of them.

        Args:
            state: where the observer stands.
            voltage_V, current_A, ambient_C, dt_s, used: (n,) the samples; those not `used` are passed over.
            rows: (m,) indices in rising order at which to read; None is all.

        Returns:
            the new state, and the outputs (m, M). Where the arithmetic fails the observer starts afresh and the row is NaN.
        """
        accumulate, correct, full, width, time = (
            self._accumulate,
            self._correct,
            self.full_s,
            self._window,
            self._time,
        )
        n = len(voltage_V)
        if ambient_C is None:
            ambients = [self.ambient_C] * n
        else:
            ambients = np.where(np.isfinite(ambient_C), ambient_C, self.ambient_C).tolist()
        wanted = np.zeros(n, dtype=bool)
        wanted[slice(None) if rows is None else rows] = True
        read = []
        window, memory = state[:width], state[width:]
        for voltage, current, ambient, dt, use, want in zip(
            voltage_V.tolist(),
            current_A.tolist(),
            ambients,
            dt_s.tolist(),
            used.tolist(),
            wanted.tolist(),
            strict=True,
        ):
            try:
                if use:
                    window = accumulate(voltage, current, ambient, dt, *window)
                    if window[time] >= full:
                        whole = correct(ambient, *window, *memory)
                        if not math.isfinite(sum(whole)):
                            raise ArithmeticError
                        window, memory = whole[:width], whole[width:]
                if want:
                    read.append(self._read(ambient, *window, *memory))
            except (ArithmeticError, ValueError):
                whole = self.start()
                window, memory = whole[:width], whole[width:]
                if want:
                    read.append((math.nan,) * self.outputs)
        return (*window, *memory), np.array(read, dtype=np.float64).reshape(len(read), self.outputs)


@dataclass(frozen=True)
class _Text:
    """Names of the registers of a program: inputs, then constants, then one per step."""

    inputs: int
    constants: Sequence[float]

    def name(self, register: int) -> str:
        constant = register - self.inputs
        if 0 <= constant < len(self.constants):
            value = self.constants[constant]
            return f"({value!r})" if math.isfinite(value) else f"({'-' if value < 0 else ''}infinity)"
        return f"r{register}"


def _compiled(document: dict[str, Any], inputs: int, outputs: int) -> Any:
    """The function `(inputs numbers) -> (outputs numbers)` of a program. Raises ValueError if it is not one."""
    if len(document["inputs"]) != inputs or len(document["outputs"]) != outputs:
        raise ValueError(
            f"program of {len(document['inputs'])} inputs and {len(document['outputs'])} outputs"
        )
    constants = [float(value) for value in document["constants"]]
    if any(math.isnan(value) for value in constants):
        raise ValueError("a constant is not a number")
    text = _Text(inputs, constants)
    known = inputs + len(constants)
    lines = []
    for step in document["steps"]:
        operation, arguments = step[0], [int(argument) for argument in step[1:]]
        if operation not in _OPERATIONS:
            raise ValueError(f"unknown operation {operation!r}")
        count, template = _OPERATIONS[operation]
        if len(arguments) != count or any(not 0 <= argument < known for argument in arguments):
            raise ValueError(f"{operation} of {arguments}")
        lines.append(f"    r{known} = {template.format(*map(text.name, arguments))}")
        known += 1
    results = [int(register) for register in document["outputs"]]
    if any(not 0 <= register < known for register in results):
        raise ValueError("output of an unknown register")
    head = f"def run({', '.join(f'r{k}' for k in range(inputs))}):"
    tail = f"    return ({''.join(text.name(register) + ', ' for register in results)})"
    scope: dict[str, Any] = {"__builtins__": {"abs": abs}, "infinity": math.inf, **_FUNCTIONS}
    exec(compile("\n".join((head, *lines, tail)), "<observer>", "exec"), scope)
    return scope["run"]
