"""What a core without double computes with: filters, features and the network's sums in whole numbers.

A sum of products in float loses a place for every few products; in whole numbers of 32 bits, added up in 64, nothing is
rounded until the sum is complete. What is bounded can be kept so: z, a one, and the outputs of tanh and sigmoid. The rest of
the network's columns are float.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.features import NO_COLUMN, FeatureMap
from motorlens_runtime.estimate.gate import limits_of
from motorlens_runtime.sensor.folded import Folded, Linear
from motorlens_runtime.sensor.specification import Specification

Array = NDArray[np.float64]

# The functions whose outputs are kept in whole numbers, in which 2^27 is one: as fine as z.
BOUNDED_FUNCTIONS = ("Tanh", "Sigmoid")
BOUNDED = 2.0**27
# Bits of the weights of an estimate, all together: sums over columns within one stay below 2^55, and their conversion to
# float, high and low half apart, rounds once.
_WIDE = 28
# Sums that the core adds up together, MOTORLENS_SUMS of arithmetic.h.
SIDE_BY_SIDE = 3
# What a power of two in single precision can be.
_MOST_PLACES = 120


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
        places: (F,) from sums with it to the 32 bits in which z is kept, 1 to 31; empty without an envelope.
        unit: (F,) 2 to this is one of z; without an envelope, of the distance from the mean.
    """

    units: Array
    mean: tuple[int, ...]
    shift: tuple[int, ...]
    observed: Array
    whitening: NDArray[np.int64]
    places: tuple[int, ...]
    unit: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class WholeArgument:
    """What a step works on in single precision: `width` sums over whole columns and over real ones.

    Attributes:
        weights: (width, C) whole numbers, for the whole columns from `start` on; C may be 0.
        narrow: whether 16 bits hold them.
        units: (width,) 2 to this is what one of such a sum is worth.
        reals: (width, R) weights of the real columns from `real_start` on, R may be 0; None is the unit matrix.
    """

    weights: NDArray[np.int64]
    narrow: bool
    units: NDArray[np.int64]
    start: int
    reals: Array | None
    real_start: int


class WholeColumns:
    """The columns of a folded graph in single precision, and arguments over them.

    Args:
        folded: the graph, over the features' distance from their mean.
        whole: the tables of its sensor.
        whitening: (F, F) lower triangular, which the network's matrices are taken to; None without an envelope.
    """

    def __init__(self, folded: Folded, whole: WholeTables, whitening: Array | None) -> None:
        self._whitening, F = whitening, folded.features
        is_whole = [whitening is not None] * F + [True]
        for step in folded.steps:
            is_whole += [step.name in BOUNDED_FUNCTIONS] * step.width
        worth = [*2.0**whole.unit, *[1 / BOUNDED] * (len(is_whole) - F)]
        self._worth, self._is_whole = np.array(worth), np.array(is_whole)
        multiplied = {id(linear) for step in folded.steps if step.name == "Mul" for linear in step.arguments}
        self._may_be_narrow = multiplied - _ancestors_of_the_estimate(folded)

    def argument(self, linear: Linear) -> WholeArgument:
        """The tables of one matrix over the columns.

        16 bits are enough for what is only multiplied, and only in a deviation: a small share of it stays a small share. Of
        what is exponentiated, and of an estimate, it does not.
        """
        weights = linear.weights.copy()
        if self._whitening is not None:
            F = len(self._whitening)
            weights[:, :F] = np.linalg.solve(self._whitening, weights[:, :F].T).T
        is_whole = self._is_whole[: weights.shape[1]]
        start, over = _used(weights[:, is_whole])
        worth = self._worth[: weights.shape[1]][is_whole][start : start + over.shape[1]]
        real_start, reals = _used(weights[:, ~is_whole])
        scaled = over * worth
        narrow = id(linear) in self._may_be_narrow
        most = np.abs(scaled).max(axis=1, initial=0.0) if narrow else np.abs(scaled).sum(axis=1)
        places = np.minimum((15 if narrow else _WIDE) - np.frexp(most)[1].astype(np.int64), _MOST_PLACES)
        numbers = np.round(np.ldexp(scaled, places[:, None]))
        if narrow:
            numbers = np.clip(numbers, -32767, 32767)
        square = reals.shape[0] == reals.shape[1] and np.array_equal(reals, np.eye(len(reals)))
        direct = square and not over.shape[1]
        return WholeArgument(
            numbers.astype(np.int64), narrow, -places, start, None if direct else reals, real_start
        )


def _ancestors_of_the_estimate(folded: Folded) -> set[int]:
    """The matrices on which the estimate depends, by identity."""
    ends = folded.features + 1 + np.cumsum([step.width for step in folded.steps])
    found, waiting = set(), [folded.estimate]
    while waiting:
        linear = waiting.pop()
        if id(linear) in found:
            continue
        found.add(id(linear))
        used = np.flatnonzero(linear.weights.any(axis=0))
        for step, end in zip(folded.steps, ends, strict=True):
            if ((used >= end - step.width) & (used < end)).any():
                waiting.extend(step.arguments)
    return found


def _used(weights: Array) -> tuple[int, Array]:
    """The columns from the first to the last that are used, and where they begin."""
    used = np.flatnonzero(weights.any(axis=0))
    start, end = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 0)
    return start, np.ascontiguousarray(weights[:, start:end])


# What a signal is a product of, at most: within the trained range, and before a number is taken for rubbish.
_AMBIENT_C = 100.0
# The same for an output of the observer where features have no envelope.
_UNLIMITED = 65536.0
# A feature is kept as far as so many times where the envelope ends; what is further away is outside by far.
_BEYOND = 16.0
# And z, which the network reads and which is to have as many places as can be.
_FURTHEST_Z = 4.0


def whole_tables_of(
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
    unit, furthest = np.zeros(F, dtype=np.int64), np.full(F, np.inf)
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
        unit[k] = exponents[signal] - 60
    units = np.array([2.0 ** (28 - e) for e in exponents])
    if whitening is None:
        return WholeTables(
            units, tuple(means), tuple(shifts), observed, np.zeros((0, 0), dtype=np.int64), (), unit
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
    # z in 32 bits, as far as any sensor is believed, or as far as it can come: 2^(61 - places), see above.
    reach = math.frexp(_FURTHEST_Z * math.sqrt(min(specification.envelope.limit, 2.0**60)))[1]
    left_out = np.clip(places - 31 + reach, 1, 30)
    return WholeTables(
        units, tuple(means), tuple(shifts), observed, numbers, tuple(left_out.tolist()),
        (left_out - places).astype(np.int64),
    ), kept  # fmt: skip
