"""Two independent ways to evaluate a sensor's network: numpy, with the graph folded, and ONNX Runtime with the file itself.

Both always see tiles of the same shape, (F, 16), with a sample at the column that its index gives it. A matrix product may
add in another order when its shape changes; with one shape, one sample has one result, live or replayed.
"""

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.sensor.folded import Folded, Linear, Step, centred

TILE = 16
# As many tiles in one go as keep the work in the cache.
_AT_ONCE = 64
Array = NDArray[np.float64]


class Backend(Protocol):
    """Evaluates the core graph."""

    name: str

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Estimates and sigmas, each (m, K, 16), of features (m, F, 16)."""
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
            self._in = np.zeros((TILE, features), dtype=dtype)
            self._out = {name: np.zeros((TILE, outputs), dtype=dtype) for name in ("estimate", "sigma")}
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
        shape = (len(features), self._out["estimate"].shape[1], TILE)
        estimate, sigma = np.empty(shape), np.empty(shape)
        for tile in range(len(features)):
            self._in[:] = features[tile].T
            self._session.run_with_iobinding(self._binding)
            estimate[tile] = self._out["estimate"].T
            sigma[tile] = self._out["sigma"].T
        return estimate, sigma


class NumpyBackend:
    """The folded graph in numpy, in float64. `mean` (F,) is what the features lie around, taken away first; None is zero.

    Not for several threads at once: the work is done in memory that is kept. A column that is not finite makes what is
    computed after it not finite, whether it depends on that column or not.
    """

    name = "numpy"

    def __init__(self, folded: Folded, mean: Array | None = None) -> None:
        self._plan = _planned(centred(folded, mean))
        self._mean = np.zeros((folded.features, 1)) if mean is None else mean[:, None]
        # As much as the largest call so far needed: a live line takes a tile at a time, and several sensors may be loaded.
        self._memory: list[Array] = []
        self._spaces: dict[int, _Space] = {}

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """See `Backend`."""
        if len(features) <= _AT_ONCE:
            estimate, sigma = self._run(features)
            return estimate.copy(), sigma.copy()
        parts = [
            [part.copy() for part in self._run(features[start : start + _AT_ONCE])]
            for start in range(0, len(features), _AT_ONCE)
        ]
        first, second = zip(*parts, strict=True)
        return np.concatenate(first), np.concatenate(second)

    @np.errstate(
        over="ignore", invalid="ignore", divide="ignore"
    )  # what is not finite is flagged by the estimator
    def _run(self, features: Array) -> tuple[Array, Array]:
        space = self._spaces.get(len(features))
        if space is None:
            space = self._space_of(len(features))
        np.subtract(features[0] if len(features) == 1 else features, self._mean, out=space.features)
        for call, arguments, out in space.calls:
            call(*arguments, out=out)
        return space.estimate, space.sigma

    def _space_of(self, tiles: int) -> "_Space":
        if not self._memory or len(self._memory[0]) < tiles:
            self._memory, self._spaces = [np.ones((tiles, rows, TILE)) for rows in self._plan.rows], {}
        space = self._spaces[tiles] = _Space(self._plan, self._memory, tiles)
        return space


@dataclass(frozen=True)
class _Use:
    """Rows `start` to `end` of a memory: 0 is the columns, others are products."""

    memory: int
    start: int
    end: int


@dataclass(frozen=True)
class _Plan:
    """Products (rows, C), each with the first C columns and for all arguments that need just these, and when to do what.

    `actions` in order: the memory of a product, or a step with where its arguments stand and its first column.
    """

    features: int
    columns: int
    products: tuple[Array, ...]
    actions: tuple[int | tuple[Step, tuple[_Use, ...], int], ...]
    estimate: _Use
    sigma: _Use

    @property
    def rows(self) -> tuple[int, ...]:
        """Of each memory."""
        return (self.columns, *map(len, self.products))


def _planned(folded: Folded) -> _Plan:
    wanted = [argument for step in folded.steps for argument in step.arguments]
    uses: dict[int, _Use] = {}
    groups: dict[int, list[Array]] = {}
    for linear in (*wanted, folded.estimate, folded.sigma):
        if id(linear) in uses:
            continue
        used = np.flatnonzero(linear.weights.any(axis=0))
        needed, rows = int(used[-1]) + 1 if len(used) else 1, len(linear.weights)
        if len(used) == rows and np.array_equal(linear.weights[:, needed - rows : needed], np.eye(rows)):
            uses[id(linear)] = _Use(0, needed - rows, needed)
            continue
        group = groups.setdefault(needed, [])
        start = sum(map(len, group))
        uses[id(linear)] = _Use(1 + list(groups).index(needed), start, start + rows)
        group.append(_padded(linear, needed))
    actions: list[int | tuple[Step, tuple[_Use, ...], int]] = []

    def need(arguments: tuple[_Use, ...]) -> None:
        actions.extend(use.memory for use in arguments if use.memory and use.memory not in actions)

    column = folded.features + 1
    for step in folded.steps:
        arguments = tuple(dict.fromkeys(uses[id(argument)] for argument in step.arguments))
        need(arguments)
        actions.append((step, tuple(uses[id(argument)] for argument in step.arguments), column))
        column += step.width
    results = uses[id(folded.estimate)], uses[id(folded.sigma)]
    need(tuple(dict.fromkeys(results)))
    products = tuple(np.concatenate(group) for group in groups.values())
    return _Plan(folded.features, column, products, tuple(actions), *results)


def _padded(linear: Linear, columns: int) -> Array:
    weights = linear.weights[:, :columns]
    return np.pad(weights, ((0, 0), (0, columns - weights.shape[1])))


class _Space:
    """A plan on the first tiles of the memory: what to call, with what, into what."""

    def __init__(self, plan: _Plan, memory: list[Array], tiles: int) -> None:
        # A tile alone is a plain matrix, of which numpy makes the same product in half the time.
        product = np.dot if tiles == 1 else np.matmul
        memory = [part[0] if tiles == 1 else part[:tiles] for part in memory]
        columns = memory[0]
        self.features = columns[..., : plan.features, :]
        self.calls: list[tuple[Any, tuple[Array, ...], Array]] = []
        for action in plan.actions:
            if isinstance(action, int):
                matrix = plan.products[action - 1]
                self.calls.append((product, (matrix, columns[..., : matrix.shape[1], :]), memory[action]))
            else:
                step, uses, column = action
                arguments = tuple(memory[use.memory][..., use.start : use.end, :] for use in uses)
                self.calls.append((step.function, arguments, columns[..., column : column + step.width, :]))
        self.estimate, self.sigma = (
            memory[use.memory][..., use.start : use.end, :].reshape(tiles, -1, TILE)
            for use in (plan.estimate, plan.sigma)
        )
