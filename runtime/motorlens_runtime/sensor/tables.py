"""A sensor as the tables that the C core computes with: for the shared object of the PC, and printed by `motorlens export`.

The distance from the training data is the length of z = L' (x - mean), with L of the envelope. In single precision filters
and z are computed in whole numbers (`WholeTables`), and the network reads z: the matrices of the folded graph become those
over z. In double it reads x - mean: there the change of basis would cost more (1e-10 of scale with the shipped observer)
than it gains.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.features import NO_COLUMN, FeatureMap
from motorlens_runtime.estimate.gate import GateLimits, limits_of
from motorlens_runtime.sensor.folded import Folded, Linear, centred
from motorlens_runtime.sensor.specification import Specification

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
    arguments: tuple[Argument, ...]
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
class WholeTables:
    """How a core without double keeps filters and features: a signal of exponent e as its value times 2^(60 - e), 60 bits
    for what lies within 2^e; a feature's distance from its mean in 32 bits, 2^(31 - r) to one.

    Attributes:
        units: (U,) 2^(28 - e) of each signal.
        mean: (F,) of the features, in the unit of their signal, half a place of the 32 bits lower; 0 for the observer's.
        shift: (F,) from that unit to 32 bits, 1 to 31.
        observed: (M, 2) mean and 2^(31 - r) of each output of the observer.
        whitening: (F, F) lower triangular, whole numbers; empty without an envelope.
        unit: (F,) of z; without an envelope, of the distance from the mean.
    """

    units: Array
    mean: tuple[int, ...]
    shift: tuple[int, ...]
    observed: Array
    whitening: NDArray[np.int64]
    unit: Array


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
    estimate: Argument
    sigma: Argument
    offset: Array
    observer: ObserverTables | None

    @property
    def columns(self) -> int:
        """Of the network: what it reads, a one and what its steps add."""
        return len(self.mean) + 1 + sum(step.width for step in self.steps)

    @property
    def triangle(self) -> Array:
        """The columns of the whitening's lower triangle, one after another; empty without one."""
        matrix = self.whitening if self.whole is None else self.whole.whitening
        if matrix is None or not len(matrix):
            return np.zeros(0)
        return np.concatenate([column[k:] for k, column in enumerate(matrix.T)])

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
        whole, whitening = _whole(specification, feature_map, mean, whitening)
    folded = centred(folded, envelope.mean)
    basis = _Basis(F, whitening if single else None)
    made: dict[int, Argument] = {}

    def argument(linear: Linear) -> Argument:
        if id(linear) not in made:
            made[id(linear)] = _argument(basis.over(linear.weights), F)
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
    estimate = basis.over(folded.estimate.weights)
    offset = estimate[:, F].copy()
    estimate[:, F] = 0.0
    return Tables(
        gate=limits_of(specification), needs_ambient=specification.needs_ambient,
        resistance_ohm=specification.resistance_ohm,
        factors=feature_map.factors, filter_signals=feature_map.filter_signals,
        tau_s=tuple(f.tau_s for f in specification.filters),
        plus=tuple(map(placed, feature_map.plus)), minus=feature_map.minus,
        mean=mean, whitening=whitening, limit=envelope.limit, whole=whole, distrust=specification.distrust,
        steps=tuple(steps), estimate=_argument(estimate, F), sigma=argument(folded.sigma), offset=offset,
        observer=_observer(specification),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Basis:
    features: int
    whitening: Array | None

    def over(self, weights: Array) -> Array:
        """Weights (width, C) over features, a one and steps as those over what the network reads, the one and steps."""
        result = weights.copy()
        if self.whitening is not None:
            result[:, : self.features] = np.linalg.solve(self.whitening, weights[:, : self.features].T).T
        return result


# What a signal is a product of, at most: within the trained range, and before a number is taken for rubbish.
_AMBIENT_C = 100.0
# The same for an output of the observer where features have no envelope.
_UNLIMITED = 65536.0
# A feature is kept as far as so many times where the envelope ends; what is further away is outside by far.
_BEYOND = 16.0


def _whole(
    specification: Specification, feature_map: FeatureMap, mean: Array, whitening: Array | None
) -> tuple[WholeTables, Array | None]:
    """Whole-number tables, and the whitening that they hold in fact. Raises ModelError if a feature has no place in them."""
    limits = limits_of(specification)
    trained, absurd = (
        (1.0, volts, amperes, volts + abs(specification.resistance_ohm) * amperes, _AMBIENT_C)
        for volts, amperes in (
            (max(map(abs, limits.range[:2])), max(map(abs, limits.range[2:]))), (limits.absurd_V, limits.absurd_A),
        )
    )  # fmt: skip
    signals, filters = len(feature_map.factors), feature_map.filter_signals
    first = len(filters) + (signals if feature_map.uses_signals else 0)

    def signal_of(column: int) -> int:
        return filters[column] if column < len(filters) else column - len(filters)

    exponents = [math.frexp(absurd[a] * absurd[b])[1] for a, b in feature_map.factors]
    pairs = [
        (signal_of(p), signal_of(m))
        for p, m in zip(feature_map.plus, feature_map.minus, strict=True)
        if m != NO_COLUMN
    ]
    for _ in pairs:  # signals of which differences are taken share a unit
        for one, other in pairs:
            exponents[one] = exponents[other] = max(exponents[one], exponents[other])
    F = len(mean)
    means, shifts, ranges = [0] * F, [0] * F, [0] * F
    observed = np.zeros((0 if specification.observer is None else specification.observer.outputs, 2))
    unit, furthest = np.ones(F), np.full(F, np.inf)
    if whitening is not None:
        sd = np.linalg.norm(np.linalg.inv(whitening), axis=0)
        furthest = _BEYOND * math.sqrt(specification.envelope.limit) * sd
    for k, (plus, minus) in enumerate(zip(feature_map.plus, feature_map.minus, strict=True)):
        if plus >= first:
            ranges[k] = math.frexp(min(furthest[k], _UNLIMITED))[1]
            observed[plus - first] = mean[k], 2.0 ** (31 - ranges[k])
            continue
        signal = signal_of(plus)
        a, b = feature_map.factors[signal]
        reach = trained[a] * trained[b] * (1.0 if minus == NO_COLUMN else 2.0)
        # Twice what the trained range gives, about the mean.
        ranges[k] = math.frexp(min(2.0 * reach + abs(mean[k]), furthest[k]))[1]
        shifts[k] = min(max(29 - exponents[signal] + ranges[k], 1), 31)
        half = 0 if whitening is None else 1 << (shifts[k] - 1)
        means[k] = round(mean[k] * 2.0 ** (60 - exponents[signal])) - half
        ranges[k] = shifts[k] - 29 + exponents[signal]
        unit[k] = 2.0 ** (exponents[signal] - 60)
    units = np.array([2.0 ** (28 - e) for e in exponents])
    if whitening is None:
        return WholeTables(
            units, tuple(means), tuple(shifts), observed, np.zeros((0, 0), dtype=np.int64), unit
        ), None
    scaled = whitening * (2.0 ** (np.array(ranges) - 31))[:, None]
    # Sums of products with 32-bit numbers stay below 2^63.
    places = 30 - np.frexp(np.abs(scaled).sum(axis=0))[1]
    numbers = np.round(scaled * 2.0**places).astype(np.int64)
    if not np.diag(numbers).all():
        raise ModelError(
            "its features are too different in size for single precision; export it with --double"
        )
    kept = (
        numbers
        * 2.0 ** (-places.astype(np.float64))
        * (2.0 ** (31 - np.array(ranges, dtype=np.float64)))[:, None]
    )
    return WholeTables(
        units, tuple(means), tuple(shifts), observed, numbers, 2.0 ** (-places.astype(np.float64))
    ), kept


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
