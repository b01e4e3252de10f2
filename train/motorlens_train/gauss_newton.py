"""Sums over the data that training needs, in chunks: memory is bounded by the network, never by the data.

Three facts keep them cheap:

- The output layer is linear, so its block of the Gauss-Newton matrix is the Gram matrix of what it reads,
  shared by all outputs, and its best weights for given hidden weights are a ridge solution: it is eliminated
  (variable projection; Golub and Pereyra 1973, in Kaufman's form).
- The Jacobian by the weight of unit u on column a is `delta_u z_a`. Hence the Gauss-Newton matrix is made of
  `sum_n (sum_k beta_k delta_ku delta_ku') (z_a z_a')`: one product of two thin matrices, pairs of units by
  pairs of columns, instead of one product of Jacobians per output. Pairs are stored once, in the nested order
  (0,0) (0,1) (1,1) (0,2) ..., in which the pairs of the first m columns come first, so a layer that reads
  fewer columns uses a leading part of the same table.
- Products run in the type of the data (float32 in training), their sums are kept in float64.

Throughout, blocks are feature-major: inputs `[F, n]`, targets `[K, n]`.
"""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from motorlens_train.cascade import Architecture, deltas, dense, forward

Columns = tuple[Tensor, Tensor]


@dataclass(frozen=True)
class OutputMoments:
    """What the best output layer is computed from.

    Attributes:
        gram: `sum z z^T` of the columns the output layer reads, `[Z, Z]`.
        cross: `sum z y^T`, `[Z, K]`.
        square: `sum y^2`, `[K]`.
        rows: number of samples.
    """

    gram: Tensor
    cross: Tensor
    square: Tensor
    rows: int

    def solve(self, precision: Tensor, alpha: Tensor) -> Tensor:
        """Output weights `[K, Z]` that minimise `precision_k SSE_k + sum alpha w^2`.

        Args:
            precision: weight of each output's squared errors, `[K]`.
            alpha: prior precision of each output weight, `[K, Z]`.
        """
        system = precision[:, None, None] * self.gram + torch.diag_embed(alpha)
        return torch.cholesky_solve((precision[:, None] * self.cross.T)[..., None], cholesky(system))[..., 0]

    def squared_error(self, output: Tensor) -> Tensor:
        """Sum of squared errors of each output for output weights `[K, Z]`."""
        # Summed as w.(Gw - 2c): the relative rounding of float64 is far below any noise floor of measured
        # data.
        return (self.square + (output * (output @ self.gram - 2 * self.cross.T)).sum(1)).clamp_min(0)


@dataclass(frozen=True)
class Curvature:
    """Gauss-Newton matrix of `1/2 sum_k precision_k SSE_k` and its gradient by the hidden weights.

    Attributes:
        hidden: `[P_h, P_h]`.
        cross: hidden weights by output weights of each output, `[K, P_h, Z]`.
        gradient: by the hidden weights, `[P_h]`.
    """

    hidden: Tensor
    cross: Tensor
    gradient: Tensor


def output_moments(architecture: Architecture, hidden: Tensor, blocks: Iterable[Columns]) -> OutputMoments:
    """One forward pass over the data: everything the best output layer and its errors follow from."""
    size, outputs, rows = len(architecture.output_reads), architecture.outputs, 0
    total = torch.zeros(size + outputs, size + outputs, dtype=torch.float64)
    for x, y in blocks:
        z = forward(architecture, dense(architecture, hidden.to(x.dtype)), x)
        stacked = torch.cat([architecture.read_by_output(z), y]).double()
        total += stacked @ stacked.T
        rows += x.shape[1]
    return OutputMoments(total[:size, :size], total[:size, size:], total.diagonal()[size:].clone(), rows)


def curvature(
    architecture: Architecture, hidden: Tensor, output: Tensor, precision: Tensor, blocks: Iterable[Columns]
) -> Curvature:
    """Gauss-Newton matrix and gradient at the given weights.

    Args:
        architecture: the structure.
        hidden: hidden weights `[P_h]`.
        output: output weights `[K, Z]`.
        precision: weight of each output's squared errors, `[K]`.
        blocks: the data.
    """
    units, pairs = sum(architecture.hidden), _pairs(architecture.columns)
    firsts = [0, *itertools.accumulate(architecture.hidden)]
    rows = [slice(_pairs(first), _pairs(last)) for first, last in itertools.pairwise(firsts)]
    reads = [_pairs(architecture.start(layer)) for layer in range(architecture.layers)]
    hidden_tables = [_Sum(row.stop - row.start, read) for row, read in zip(rows, reads, strict=True)]
    cross_table, slope = _Sum(architecture.outputs * units, pairs), _Sum(units, architecture.columns)
    for x, y in blocks:
        weights = dense(architecture, hidden.to(x.dtype))
        z = forward(architecture, weights, x)
        v = output.to(x.dtype)
        delta = deltas(architecture, weights, v, z)
        weighted = delta * precision.to(x.dtype)[:, None, None]
        error = v @ architecture.read_by_output(z) - y
        slope.add(_over_outputs(weighted, error) @ z.T)
        columns = _nested_products(z[None], z[None])
        products = _nested_products(weighted, delta)
        for table, row, read in zip(hidden_tables, rows, reads, strict=True):
            table.add(products[row] @ columns[:read].T)
        cross_table.add(weighted.flatten(0, 1) @ columns.T)
    size = architecture.hidden_parameters
    tables = torch.cat([slope.total[:0, 0], *(table.total.view(-1) for table in hidden_tables)])
    crossed = cross_table.total.view(architecture.outputs, -1).index_select(1, _cross_places(architecture))
    return Curvature(
        tables.index_select(0, _hidden_places(architecture)).view(size, size),
        crossed.view(architecture.outputs, size, len(architecture.output_reads)),
        slope.total[architecture.unit, architecture.column],
    )


def gradient(
    architecture: Architecture, hidden: Tensor, output: Tensor, precision: Tensor, blocks: Iterable[Columns]
) -> Tensor:
    """Gradient of `1/2 sum_k precision_k SSE_k` by the hidden weights, `[P_h]`."""
    slope = torch.zeros(sum(architecture.hidden), architecture.columns, dtype=torch.float64)
    for x, y in blocks:
        weights = dense(architecture, hidden.to(x.dtype))
        z = forward(architecture, weights, x)
        v = output.to(x.dtype)
        error = precision.to(x.dtype)[:, None] * (v @ architecture.read_by_output(z) - y)
        slope += _over_outputs(deltas(architecture, weights, v, z), error) @ z.T
    return slope[architecture.unit, architecture.column]


def acceleration(
    architecture: Architecture,
    hidden: Tensor,
    output: Tensor,
    step: tuple[Tensor, Tensor],
    precision: Tensor,
    blocks: Iterable[Columns],
) -> tuple[Tensor, Tensor]:
    """`J^T precision y''` with y'' the second derivative of the outputs along a step.

    It is the right-hand side of the geodesic acceleration (Transtrum and Sethna 2012, eq. 8).

    Args:
        architecture: the structure.
        hidden: hidden weights `[P_h]`.
        output: output weights `[K, Z]`.
        step: direction in the hidden weights `[P_h]` and in the output weights `[K, Z]`.
        precision: weight of each output, `[K]`.
        blocks: the data.

    Returns:
        Its part by the hidden weights `[P_h]` and by the output weights `[K, Z]`.
    """
    by_hidden = torch.zeros(sum(architecture.hidden), architecture.columns, dtype=torch.float64)
    by_output = torch.zeros_like(output)
    for x, _ in blocks:
        weights = dense(architecture, hidden.to(x.dtype))
        turns = dense(architecture, step[0].to(x.dtype))
        v, dv = output.to(x.dtype), step[1].to(x.dtype)
        z = forward(architecture, weights, x)
        first, second = torch.zeros_like(z), torch.zeros_like(z)
        for layer, (weight, turn) in enumerate(zip(weights, turns, strict=True)):
            read, written = slice(architecture.start(layer)), architecture.writes(layer)
            slope = architecture.function.slope(z[written])
            net_first = turn @ z[read] + weight @ first[read]
            net_second = 2 * (turn @ first[read]) + weight @ second[read]
            first[written] = slope * net_first
            second[written] = architecture.function.curvature(z[written]) * net_first**2 + slope * net_second
        bend = 2 * (dv @ architecture.read_by_output(first)) + v @ architecture.read_by_output(second)
        bend *= precision.to(x.dtype)[:, None]
        by_output += bend @ architecture.read_by_output(z).T
        by_hidden += _over_outputs(deltas(architecture, weights, v, z), bend) @ z.T
    return by_hidden[architecture.unit, architecture.column], by_output


def cholesky(matrix: Tensor) -> Tensor:
    """Lower Cholesky factor; a relative jitter is raised until the matrix is positive definite."""
    scale = matrix.diagonal(dim1=-2, dim2=-1).abs().amax(-1)
    for jitter in (0.0, 1e-14, 1e-12, 1e-10, 1e-8, 1e-6):
        shift = torch.diag_embed((jitter * scale)[..., None].expand(matrix.shape[:-1]))
        factor: Tensor
        factor, info = torch.linalg.cholesky_ex(matrix + shift)
        if not bool(info.any()):
            return factor
    raise FloatingPointError(
        "a Gauss-Newton matrix is not positive definite, even with a relative jitter of 1e-6"
    )


def _pairs(count: int) -> int:
    return count * (count + 1) // 2


class _Sum:
    """A float64 sum of products in the type of the data; the first takes no pass over zeros."""

    def __init__(self, rows: int, columns: int) -> None:
        self.shape = rows, columns
        self.parts: Tensor | None = None

    def add(self, part: Tensor) -> None:
        self.parts = part.double() if self.parts is None else self.parts.add_(part)

    @property
    def total(self) -> Tensor:
        return torch.zeros(self.shape, dtype=torch.float64) if self.parts is None else self.parts


def _over_outputs(delta: Tensor, error: Tensor) -> Tensor:
    """`sum_k delta[k, u] error[k]`: `[K, U, n]`, `[K, n]` -> `[U, n]`."""
    result = delta[0] * error[0]
    for k in range(1, len(error)):
        result.addcmul_(delta[k], error[k])
    return result


def _nested_products(left: Tensor, right: Tensor) -> Tensor:
    """`sum_k left[k, i] right[k, j]` for i <= j in the nested order: `[K, m, n]` -> `[m (m + 1) / 2, n]`."""
    count = left.shape[1]
    result = left.new_empty(_pairs(count), left.shape[2])
    for j in range(count):
        rows = result[_pairs(j) : _pairs(j + 1)]
        torch.mul(left[0, : j + 1], right[0, j], out=rows)
        for k in range(1, left.shape[0]):
            rows.addcmul_(left[k, : j + 1], right[k, j])
    return result


@lru_cache(maxsize=8)
def _hidden_places(architecture: Architecture) -> Tensor:
    """Where the entries of the hidden weights' matrix stand in the layers' tables, one after the other."""
    firsts = [0, *itertools.accumulate(architecture.hidden)]
    units = np.zeros((firsts[-1], firsts[-1]), np.int64)
    before = 0
    for layer, (first, last) in enumerate(itertools.pairwise(firsts)):
        # A pair of units stands in the table of the later one.
        reads, pairs = _pairs(architecture.start(layer)), _pair_places(last)[first:]
        units[first:last, :last] = before + (pairs - _pairs(first)) * reads
        units[:last, first:last] = units[first:last, :last].T
        before += (_pairs(last) - _pairs(first)) * reads
    unit, column = architecture.unit.numpy(), architecture.column.numpy()
    columns = _pair_places(architecture.columns)
    return torch.from_numpy(units[np.ix_(unit, unit)] + columns[np.ix_(column, column)]).view(-1)


@lru_cache(maxsize=8)
def _cross_places(architecture: Architecture) -> Tensor:
    unit, column = architecture.unit.numpy(), architecture.column.numpy()
    columns = _pair_places(architecture.columns)[np.ix_(column, architecture.output_reads.numpy())]
    return torch.from_numpy(unit[:, None] * _pairs(architecture.columns) + columns).view(-1)


def _pair_places(count: int) -> np.ndarray:
    """Place of every unordered pair in the nested order, `[count, count]`."""
    place = np.arange(count)
    high, low = np.maximum(place[:, None], place), np.minimum(place[:, None], place)
    return np.asarray(high * (high + 1) // 2 + low)
