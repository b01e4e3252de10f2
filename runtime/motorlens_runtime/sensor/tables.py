"""A sensor as the tables that the C core computes with: for the shared object of the PC, and printed by `motorlens export`.

The distance from the training data is the length of z = L' (x - mean), with L of the envelope. In single precision the
network reads z, and both are computed in whole numbers (`whole_tables`). In double it reads x - mean: there the change of
basis would cost more (1e-10 of scale with the shipped observer) than it gains.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.features import FeatureMap
from motorlens_runtime.estimate.gate import GateLimits, limits_of
from motorlens_runtime.sensor.folded import Folded, Linear, centred
from motorlens_runtime.sensor.specification import Specification
from motorlens_runtime.sensor.whole_tables import (
    BOUNDED_FUNCTIONS,
    SIDE_BY_SIDE,
    WholeArgument,
    WholeColumns,
    WholeTables,
    whole_tables_of,
)

Array = NDArray[np.float64]

# In the order of the enumerations in motorlens.h.
FUNCTIONS = (
    "Tanh", "Exp", "Sqrt", "Clip", "Mul", "Sigmoid", "Relu", "Softplus", "Log", "Div", "Abs", "Reciprocal", "Max", "Min",
)  # fmt: skip
OPERATIONS = (
    "add", "sub", "mul", "div", "neg", "pow", "sqrt", "exp", "log", "tanh", "sin", "cos", "abs", "max", "min", "sign", "le",
    "select",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Argument:
    """What a step works on: `weights` (width, columns) over the columns from `start` on, or, without, those themselves."""

    start: int
    weights: Array | None


@dataclass(frozen=True, eq=False)
class NetworkStep:
    """`width` new columns: FUNCTIONS[function] of `arguments`; `shared` where two of them are the same."""

    function: int
    width: int
    arguments: tuple[Argument | WholeArgument, ...]
    shared: bool
    limits: tuple[float, float]


@dataclass(frozen=True)
class Program:
    """A straight-line program on `registers` registers, of which the first `inputs` are its inputs at the start. From
    `registers` on an index is that of a constant. A step is an operation, its result and its arguments."""

    inputs: int
    registers: int
    constants: tuple[float, ...]
    steps: tuple[tuple[int, int, tuple[int, ...]], ...]
    outputs: tuple[int, ...]


@dataclass(frozen=True)
class ObserverTables:
    """The observer's programs and layout."""

    accumulate: Program
    correct: Program
    read: Program
    size: int
    window: int
    time: int
    outputs: int
    full_s: float
    ambient_C: float


@dataclass(frozen=True, eq=False)
class Tables:
    """F features, S filters, U signals, K outputs. `mean` (F,), `whitening` (F, F) lower triangular or None, `offset` (K,)
    is added to the estimate last; `distrust` is the feature above 0 where the observer is not to be believed, -1 none."""

    gate: GateLimits
    needs_ambient: bool
    resistance_ohm: float
    factors: tuple[tuple[int, int], ...]
    filter_signals: tuple[int, ...]
    tau_s: tuple[float, ...]
    plus: tuple[int, ...]
    minus: tuple[int, ...]
    mean: Array
    whitening: Array | None
    limit: float
    whole: WholeTables | None
    distrust: int
    steps: tuple[NetworkStep, ...]
    estimate: Argument | WholeArgument
    sigma: Argument | WholeArgument
    offset: Array
    observer: ObserverTables | None

    @property
    def columns(self) -> int:
        """Of the network: what it reads, a one and what its steps add."""
        return len(self.mean) + 1 + sum(step.width for step in self.steps)

    @property
    def reals(self) -> int:
        """Of these, in single precision, those that are no whole numbers."""
        read = 0 if self.whitening is not None else len(self.mean)
        return read + sum(
            step.width for step in self.steps if FUNCTIONS[step.function] not in BOUNDED_FUNCTIONS
        )

    @property
    def triangle(self) -> Array:
        """The columns of the whitening's lower triangle, so many at a time as the core adds up side by side (MOTORLENS_SUMS)
        and all of them from the diagonal of the first. Empty without one."""
        matrix, together = (self.whitening, 4) if self.whole is None else (self.whole.whitening, SIDE_BY_SIDE)
        if matrix is None or not len(matrix):
            return np.zeros(0)
        return np.concatenate([column[k // together * together :] for k, column in enumerate(matrix.T)])

    @property
    def width(self) -> int:
        """Of its widest step or output."""
        return max([len(self.offset), *(step.width for step in self.steps)])

    @property
    def programs(self) -> tuple[Program, ...]:
        """Of the observer."""
        o = self.observer
        return () if o is None else (o.accumulate, o.correct, o.read)


def tables_of(specification: Specification, folded: Folded, single: bool = False) -> Tables:
    """The tables of a sensor.

    Args:
        specification: what runs before the core graph.
        folded: the core graph.
        single: whether the core computes its network in single precision; its matrices then fit the rounded whitening.

    Raises:
        ModelError: the graph has a function that the core does not have.
    """
    unknown = sorted({step.name for step in folded.steps} - set(FUNCTIONS))
    if unknown:
        raise ModelError(f"the C core has no {', '.join(unknown)}")
    feature_map, envelope, F = FeatureMap(specification), specification.envelope, folded.features
    mean, whitening = np.zeros(F), None
    if envelope.mean is not None and envelope.cholesky is not None:
        mean, whitening = envelope.mean, np.tril(envelope.cholesky)
    whole = None
    if single:
        # The basis is that of the rounded numbers, so rounding them costs nothing.
        whole, whitening = whole_tables_of(specification, feature_map, mean, whitening)
    folded = centred(folded, envelope.mean)
    made: dict[int, Argument | WholeArgument] = {}
    columns = None if whole is None else WholeColumns(folded, whole, whitening)

    def argument(linear: Linear) -> Argument | WholeArgument:
        if id(linear) not in made:
            made[id(linear)] = _argument(linear.weights, F) if columns is None else columns.argument(linear)
        return made[id(linear)]

    def placed(column: int) -> int:
        """The core keeps the signals between filters and observer whether features use them or not."""
        filters = len(specification.filters)
        skipped = 0 if feature_map.uses_signals or column < filters else len(feature_map.factors)
        return column + skipped

    steps = []
    for step in folded.steps:
        given = tuple(argument(linear) for linear in step.arguments)
        shared = len(given) == 2 and given[0] is given[1]
        steps.append(NetworkStep(FUNCTIONS.index(step.name), step.width, given, shared, step.limits))
    # A constant is added last in double; in whole numbers it is one more product.
    offset = folded.estimate.weights[:, F].copy()
    if columns is None:
        weights = folded.estimate.weights.copy()
        weights[:, F] = 0.0
        estimate: Argument | WholeArgument = _argument(weights, F)
    else:
        estimate = argument(folded.estimate)
    return Tables(
        gate=limits_of(specification), needs_ambient=specification.needs_ambient,
        resistance_ohm=specification.resistance_ohm,
        factors=feature_map.factors, filter_signals=feature_map.filter_signals,
        tau_s=tuple(f.tau_s for f in specification.filters),
        plus=tuple(map(placed, feature_map.plus)), minus=feature_map.minus,
        mean=mean, whitening=whitening, limit=envelope.limit, whole=whole, distrust=specification.distrust,
        steps=tuple(steps), estimate=estimate, sigma=argument(folded.sigma), offset=offset,
        observer=_observer(specification),
    )  # fmt: skip


def _argument(weights: Array, one: int) -> Argument:
    used = np.flatnonzero(weights.any(axis=0))
    if not len(used):
        return Argument(one, np.zeros((len(weights), 1)))
    start, end = int(used[0]), int(used[-1]) + 1
    part = weights[:, start:end]
    if part.shape[0] == part.shape[1] and np.array_equal(part, np.eye(len(part))):
        return Argument(start, None)
    return Argument(start, np.ascontiguousarray(part))


def _observer(specification: Specification) -> ObserverTables | None:
    observer = specification.observer
    if observer is None:
        return None
    document = observer.document
    accumulate, correct, read = (allocated(document[key]) for key in ("accumulate", "correct", "read"))
    size, window, time = (int(document[key]) for key in ("size", "window", "time"))
    return ObserverTables(
        accumulate, correct, read, size, window, time, observer.outputs, observer.full_s, observer.ambient_C
    )


def allocated(document: dict[str, Any]) -> Program:
    """A program of a sensor file on as few registers as one pass finds: a value gives its place up after its last use."""
    inputs, constants = len(document["inputs"]), [float(value) for value in document["constants"]]
    first = inputs + len(constants)
    last_use = {int(output): len(document["steps"]) for output in document["outputs"]}
    for index, step in reversed(list(enumerate(document["steps"]))):
        for register in step[1:]:
            last_use.setdefault(int(register), index)
    # Until all is placed, constants are negative: -1 is the first.
    place: dict[int, int] = {k: k for k in range(inputs)} | {
        inputs + k: -1 - k for k in range(len(constants))
    }
    free = sorted((k for k in range(inputs) if k not in last_use), reverse=True)
    registers, steps = inputs, []
    for index, (operation, *arguments) in enumerate(document["steps"]):
        taken = [place[int(register)] for register in arguments]
        for register in {int(register) for register in arguments}:
            if last_use[register] == index and place[register] >= 0:
                free.append(place[register])
        if free:
            result = free.pop()
        else:
            result, registers = registers, registers + 1
        place[first + index] = result
        if first + index not in last_use:
            free.append(result)
        steps.append((OPERATIONS.index(operation), result, taken))

    def index_of(register: int) -> int:
        return register if register >= 0 else registers - 1 - register

    return Program(
        inputs, registers, tuple(constants),
        tuple((operation, result, tuple(map(index_of, taken))) for operation, result, taken in steps),
        tuple(index_of(place[int(register)]) for register in document["outputs"]),
    )  # fmt: skip
