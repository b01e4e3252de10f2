"""Two independent ways to evaluate a sensor's network: ONNX Runtime, and numpy reading the same file itself.

Both always see blocks of the same shape, (64, F), with a sample at the row that its index gives it. A matrix product may
add in another order when its shape changes; with one shape, one sample has one result, live or replayed.
"""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.bank import BLOCK
from motorlens_runtime.errors import ModelError
from motorlens_runtime.onnx_file import Node, OnnxFile

Array = NDArray[np.float64]


class Backend(Protocol):
    """Evaluates the core graph."""

    name: str

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Estimates and sigmas, each (m, 64, K), of features (m, 64, F)."""
        ...


class OrtBackend:
    """ONNX Runtime on one thread, its inputs and outputs bound once."""

    name = "onnxruntime"

    def __init__(self, data: bytes, features: int, outputs: int, where: str) -> None:
        import onnxruntime as ort

        options = ort.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
            kinds = {
                port.name: port.type for port in (*self._session.get_inputs(), *self._session.get_outputs())
            }
            dtype = {"tensor(float)": np.float32, "tensor(double)": np.float64}[kinds["features"]]
            self._in = np.zeros((BLOCK, features), dtype=dtype)
            self._out = {name: np.zeros((BLOCK, outputs), dtype=dtype) for name in ("estimate", "sigma")}
            self._binding = self._session.io_binding()
            self._binding.bind_input("features", "cpu", 0, dtype, self._in.shape, self._in.ctypes.data)
            for name, array in self._out.items():
                self._binding.bind_output(name, "cpu", 0, dtype, array.shape, array.ctypes.data)
            self._session.run_with_iobinding(self._binding)
        except Exception as error:  # ONNX Runtime has an exception class for each of its own reasons
            raise ModelError(
                f"{where}: ONNX Runtime does not run it: {' '.join(str(error).split())[:200]}"
            ) from None

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """See `Backend`."""
        shape = (*features.shape[:2], self._out["estimate"].shape[1])
        estimate, sigma = np.empty(shape), np.empty(shape)
        for block in range(len(features)):
            self._in[:] = features[block]
            self._session.run_with_iobinding(self._binding)
            estimate[block] = self._out["estimate"]
            sigma[block] = self._out["sigma"]
        return estimate, sigma


class NumpyBackend:
    """The graph, node by node, in numpy.

    Raises:
        ModelError: the graph has an operation that is not in the table below.
    """

    name = "numpy"

    def __init__(self, model: OnnxFile, where: str) -> None:
        unknown = sorted({node.op for node in model.nodes} - set(_OPERATIONS))
        if unknown:
            raise ModelError(f"{where}: the numpy backend has no {', '.join(unknown)}; install onnxruntime")
        if model.inputs != ("features",) or set(model.outputs) != {"estimate", "sigma"}:
            raise ModelError(
                f"{where}: graph of {model.inputs} to {model.outputs}, not of features to estimate and sigma"
            )
        self._nodes = model.nodes
        self._constants = model.constants
        self._dtype = model.input_types[0]

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """See `Backend`."""
        shape = (*features.shape[:2], -1)
        estimates, sigmas = [], []
        for block in features.astype(self._dtype):
            values: dict[str, NDArray[Any]] = {**self._constants, "features": block}
            for node in self._nodes:
                arguments = [values[name] for name in node.inputs if name]
                results = _OPERATIONS[node.op](node, *arguments)
                values.update(
                    zip(node.outputs, results if isinstance(results, tuple) else (results,), strict=False)
                )
            estimates.append(values["estimate"])
            sigmas.append(values["sigma"])
        return (
            np.array(estimates, dtype=np.float64).reshape(shape),
            np.array(sigmas, dtype=np.float64).reshape(shape),
        )


def _gemm(node: Node, a: NDArray[Any], b: NDArray[Any], c: NDArray[Any] | None = None) -> NDArray[Any]:
    alpha, beta = node.attributes.get("alpha", 1.0), node.attributes.get("beta", 1.0)
    a, b = (a.T if node.attributes.get("transA") else a), (b.T if node.attributes.get("transB") else b)
    product: NDArray[Any] = a @ b if alpha == 1.0 else a.dtype.type(alpha) * (a @ b)
    if c is None:
        return product
    result: NDArray[Any] = product + (c if beta == 1.0 else c.dtype.type(beta) * c)
    return result


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


def _elementwise(function: Callable[..., Any]) -> Callable[..., Any]:
    return lambda node, *arguments: function(*arguments)


_CASTS = {1: np.float32, 6: np.int32, 7: np.int64, 11: np.float64}

_OPERATIONS: dict[str, Callable[..., Any]] = {
    "Gemm": _gemm,
    "Slice": _slice,
    "Split": _split,
    "Concat": lambda node, *parts: np.concatenate(parts, axis=node.attributes["axis"]),
    "Gather": lambda node, data, index: np.take(data, index, axis=node.attributes.get("axis", 0)),
    "Cast": lambda node, data: data.astype(_CASTS[node.attributes["to"]]),
    "Clip": lambda node, data, *limits: np.clip(data, *(*limits, None, None)[:2]),
    "Constant": lambda node: node.attributes["value"],
    "Softplus": _elementwise(lambda x: np.logaddexp(x, x.dtype.type(0))),
    "Sigmoid": _elementwise(lambda x: 1 / (1 + np.exp(-x))),
    "Relu": _elementwise(lambda x: np.maximum(x, 0)),
    **{
        op: _elementwise(function)
        for op, function in {
            "Identity": np.positive, "MatMul": np.matmul, "Add": np.add, "Sub": np.subtract, "Mul": np.multiply,
            "Div": np.divide, "Neg": np.negative, "Abs": np.abs, "Tanh": np.tanh, "Exp": np.exp, "Log": np.log,
            "Sqrt": np.sqrt, "Pow": np.power, "Reciprocal": np.reciprocal, "Max": np.maximum, "Min": np.minimum,
            "Sin": np.sin, "Cos": np.cos,
        }.items()
    },
}  # fmt: skip
