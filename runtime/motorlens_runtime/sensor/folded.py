"""The core graph of a sensor file, folded into a few matrix products.

Every linear step of the graph (products with constants, sums, differences, selections, joinings) becomes a matrix over
*columns*: the features, a one, then the output of each function that is not linear, in the order of the graph. What is left
to compute is, for each such function, one product with the columns so far and the function itself.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.sensor.onnx_file import Node, OnnxFile

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Linear:
    """A tensor of the graph as `weights` (width, C) of the C columns that there were when it was made."""

    weights: Array


@dataclass(frozen=True)
class Step:
    """`width` new columns: a function of what `arguments` give, each a matrix over the columns before.

    `name` is the operation's in ONNX; `limits` are those of Clip.
    """

    function: Callable[..., Any]
    arguments: tuple[Linear, ...]
    width: int
    name: str
    limits: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True)
class Folded:
    """What is computed, in order: `steps`, then two matrices over all columns."""

    features: int
    steps: tuple[Step, ...]
    estimate: Linear
    sigma: Linear


def fold(model: OnnxFile, features: int, where: str) -> Folded:
    """Fold the graph of a sensor.

    Raises:
        ModelError: it has an operation that is not in the tables below, or is not a graph of features to estimate and sigma.
    """
    if model.inputs != ("features",) or set(model.outputs) != {"estimate", "sigma"}:
        raise ModelError(
            f"{where}: graph of {model.inputs} to {model.outputs}, not of features to estimate and sigma"
        )
    unknown = sorted({node.op for node in model.nodes} - {*_LINEAR, *_SELECTIONS, *_FUNCTIONS})
    if unknown:
        raise ModelError(f"{where}: the numpy backend has no {', '.join(unknown)}; install onnxruntime")
    folding = _Folding(features)
    values: dict[str, Any] = dict(model.constants)
    values["features"] = Linear(np.eye(features, features + 1))
    try:
        for node in model.nodes:
            found = folding.take(node, [values[name] if name else None for name in node.inputs])
            values.update(zip(node.outputs, found, strict=False))
        outputs = [folding.linear(values[name]) for name in ("estimate", "sigma")]
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise ModelError(
            f"{where}: the numpy backend does not follow its graph ({type(error).__name__}: {error}); install onnxruntime"
        ) from None
    return Folded(features, tuple(folding.steps), *outputs)


def centred(folded: Folded, mean: Array | None) -> Folded:
    """The same computation over the features' distance from `mean` (F,); as it is where that is None.

    Features that hardly move have weights as large as they are steady: their products cancel to a part in 1e-16 of
    themselves, which may be 1e-11 of the sum. A difference of neighbouring numbers is exact, so what subtracts first loses
    nothing.
    """
    if mean is None:
        return folded
    made: dict[int, Linear] = {}

    def moved(linear: Linear) -> Linear:
        if id(linear) not in made:
            weights = linear.weights.copy()
            weights[:, folded.features] += weights[:, : folded.features] @ mean
            made[id(linear)] = Linear(weights)
        return made[id(linear)]

    steps = tuple(replace(step, arguments=tuple(map(moved, step.arguments))) for step in folded.steps)
    return Folded(folded.features, steps, moved(folded.estimate), moved(folded.sigma))


class _Folding:
    """The columns so far."""

    def __init__(self, features: int) -> None:
        self.one = features
        self.columns = features + 1
        self.steps: list[Step] = []

    def take(self, node: Node, arguments: list[Any]) -> tuple[Any, ...]:
        """The outputs of a node."""
        if not any(isinstance(argument, Linear) for argument in arguments):
            if node.op in _FUNCTIONS and node.op not in _LINEAR:
                raise ValueError(f"{node.op} of constants")
            found = {**_LINEAR, **_SELECTIONS}[node.op](node, *arguments)
            return found if isinstance(found, tuple) else (found,)
        if node.op in _SELECTIONS:
            return self._selected(node, arguments)
        if node.op in _LINEAR and (result := self._linear(node, arguments)) is not None:
            return (result,)
        return (self._function(node, arguments),)

    def linear(self, value: Any) -> Linear:
        """A value as a matrix over the columns; a constant stands in the column of ones."""
        if isinstance(value, Linear):
            return value
        row = np.atleast_1d(np.asarray(value, dtype=np.float64))
        if row.ndim > 1 and row.shape[0] != 1:
            raise ValueError(f"a constant of shape {row.shape}")
        weights = np.zeros((row.size, self.columns))
        weights[:, self.one] = row.reshape(-1)
        return Linear(weights)

    def _selected(self, node: Node, arguments: list[Any]) -> tuple[Linear, ...]:
        """Slices, splits and so on are tried on the numbers of the columns."""
        if node.op == "Concat":
            if node.attributes["axis"] not in (1, -1):
                raise ValueError("Concat of rows")
            return (Linear(np.concatenate(self._aligned([self.linear(a) for a in arguments]), axis=0)),)
        weights = arguments[0].weights
        numbers = np.arange(len(weights))[None]
        found = _SELECTIONS[node.op](node, numbers, *arguments[1:])
        parts = found if isinstance(found, tuple) else (found,)
        if any(part.ndim != 2 or len(part) != 1 for part in parts):
            raise ValueError(f"{node.op} of rows")
        return tuple(Linear(weights[part[0]]) for part in parts)

    def _linear(self, node: Node, arguments: list[Any]) -> Linear | None:
        """The result where it is linear in the columns, else None."""
        op = node.op
        if op in ("Identity", "Cast", "Neg"):
            return Linear(-arguments[0].weights) if op == "Neg" else arguments[0]
        if op in ("Add", "Sub"):
            first, second = self._aligned([self.linear(a) for a in arguments])
            return Linear(first + second if op == "Add" else first - second)
        if op in ("MatMul", "Gemm"):
            product, matrix, *rest = arguments
            if isinstance(matrix, Linear) or node.attributes.get("transA"):
                raise ValueError(f"{op} of two variables")
            matrix = np.asarray(matrix, dtype=np.float64)
            if not node.attributes.get("transB"):
                matrix = matrix.T
            result = Linear(node.attributes.get("alpha", 1.0) * matrix @ product.weights)
            if rest and rest[0] is not None:
                bias = Linear(node.attributes.get("beta", 1.0) * self.linear(rest[0]).weights)
                result = Linear(np.add(*self._aligned([result, bias])))
            return result
        left, right = arguments  # Mul and Div
        if isinstance(left, Linear) and not isinstance(right, Linear):
            factor = np.asarray(right, dtype=np.float64).reshape(-1, 1)
            return Linear(left.weights * factor if op == "Mul" else left.weights / factor)
        if op == "Mul" and not isinstance(left, Linear):
            return Linear(right.weights * np.asarray(left, dtype=np.float64).reshape(-1, 1))
        return None

    def _function(self, node: Node, arguments: list[Any]) -> Linear:
        """New columns."""
        function, given, between = _FUNCTIONS[node.op], arguments, (-math.inf, math.inf)
        if node.op == "Clip":
            limits = [*arguments[1:], None, None]
            # As arrays, which numpy takes as they are.
            low = np.array(-np.inf if limits[0] is None else np.asarray(limits[0]).item())
            high = np.array(np.inf if limits[1] is None else np.asarray(limits[1]).item())
            function, given = partial(_clip, low=low, high=high), arguments[:1]
            between = float(low), float(high)
        linear = [self.linear(argument) for argument in given]
        width = max(len(argument.weights) for argument in linear)
        linear = [
            argument if len(argument.weights) == width else Linear(np.repeat(argument.weights, width, axis=0))
            for argument in linear
        ]
        self.steps.append(Step(function, tuple(linear), width, node.op, between))
        weights = np.zeros((width, self.columns + width))
        weights[:, self.columns :] = np.eye(width)
        self.columns += width
        return Linear(weights)

    def _aligned(self, parts: list[Linear]) -> list[Array]:
        """The matrices over all columns so far."""
        return [np.pad(part.weights, ((0, 0), (0, self.columns - part.weights.shape[1]))) for part in parts]


def _slice(
    node: Node, data: NDArray[Any], starts: NDArray[Any], ends: NDArray[Any], *rest: NDArray[Any]
) -> NDArray[Any]:
    axes = rest[0] if rest else np.arange(len(starts))
    steps = rest[1] if len(rest) > 1 else np.ones(len(starts), dtype=np.int64)
    index = [slice(None)] * data.ndim
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        index[int(axis)] = slice(int(start), int(end), int(step))
    part: NDArray[Any] = data[tuple(index)]
    return part


def _split(node: Node, data: NDArray[Any], sizes: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    return tuple(np.split(data, np.cumsum(sizes)[:-1], axis=node.attributes.get("axis", 0)))


def _gemm(node: Node, a: NDArray[Any], b: NDArray[Any], c: NDArray[Any] | None = None) -> NDArray[Any]:
    alpha, beta = node.attributes.get("alpha", 1.0), node.attributes.get("beta", 1.0)
    a, b = (a.T if node.attributes.get("transA") else a), (b.T if node.attributes.get("transB") else b)
    product: NDArray[Any] = alpha * (a @ b)
    return product if c is None else product + beta * c


def _clip(x: Array, *, low: Array, high: Array, out: Array | None = None) -> Array:
    bounded: Array = np.minimum(np.maximum(x, low, out=out), high, out=out)
    return bounded


def _relu(x: Array, *, out: Array | None = None) -> Array:
    return np.maximum(x, 0.0, out=out)


def _softplus(x: Array, *, out: Array | None = None) -> Array:
    return np.logaddexp(x, 0.0, out=out)


def _sigmoid(x: Array, *, out: Array | None = None) -> Array:
    result: Array = np.add(np.exp(np.negative(x, out=out), out=out), 1.0, out=out)
    return np.reciprocal(result, out=out)


def _plain(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda node, *arguments: function(*arguments)


_CASTS = {1: np.float32, 6: np.int32, 7: np.int64, 11: np.float64}
_Table = Mapping[str, Callable[..., Any]]

# Each on a node and arrays; what they mean for columns is said in `_Folding`.
_LINEAR: _Table = {
    "Constant": lambda node: node.attributes["value"],
    "Gemm": _gemm,
    "Cast": lambda node, data: data.astype(_CASTS[node.attributes["to"]]),
    **{
        op: _plain(function)
        for op, function in {
            "Identity": np.positive, "Neg": np.negative, "MatMul": np.matmul, "Add": np.add, "Sub": np.subtract,
            "Mul": np.multiply, "Div": np.divide,
        }.items()
    },
}  # fmt: skip
_SELECTIONS: _Table = {
    "Slice": _slice,
    "Split": _split,
    "Concat": lambda node, *parts: np.concatenate(parts, axis=node.attributes["axis"]),
    "Gather": lambda node, data, index: np.take(data, index, axis=node.attributes.get("axis", 0)),
}
# These also take `out`.
_FUNCTIONS: _Table = {
    "Clip": _clip, "Softplus": _softplus, "Sigmoid": _sigmoid, "Relu": _relu, "Mul": np.multiply, "Div": np.divide,
    "Abs": np.abs, "Tanh": np.tanh, "Exp": np.exp, "Log": np.log, "Sqrt": np.sqrt, "Pow": np.power,
    "Reciprocal": np.reciprocal, "Max": np.maximum, "Min": np.minimum, "Sin": np.sin, "Cos": np.cos,
}  # fmt: skip
