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

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache

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
        stacked = torch.cat([z[architecture.output_reads], y]).double()
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
    unit_table = torch.zeros(_pairs(units), pairs, dtype=torch.float64)
    cross_table = torch.zeros(architecture.outputs, units, pairs, dtype=torch.float64)
    slope = torch.zeros(units, architecture.columns, dtype=torch.float64)
    for x, y in blocks:
        weights = dense(architecture, hidden.to(x.dtype))
        z = forward(architecture, weights, x)
        v = output.to(x.dtype)
        delta = deltas(architecture, weights, v, z)
        weighted = delta * precision.to(x.dtype)[:, None, None]
        error = v @ z[architecture.output_reads] - y
        slope += (weighted * error[:, None]).sum(0) @ z.T
        columns = _nested_products(z[None], z[None])
        _add_unit_pairs(architecture, _nested_products(weighted, delta), columns, unit_table)
        cross_table += (weighted.flatten(0, 1) @ columns.T).view_as(cross_table)
    return Curvature(
        _gather_hidden(architecture, unit_table),
        _gather_cross(architecture, cross_table),
        slope[architecture.unit, architecture.column],
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
        error = precision.to(x.dtype)[:, None] * (v @ z[architecture.output_reads] - y)
        slope += (deltas(architecture, weights, v, z) * error[:, None]).sum(0) @ z.T
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
    reads = architecture.output_reads
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
        bend = precision.to(x.dtype)[:, None] * (2 * (dv @ first[reads]) + v @ second[reads])
        by_output += bend @ z[reads].T
        by_hidden += (deltas(architecture, weights, v, z) * bend[:, None]).sum(0) @ z.T
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


def _pair_index(first: Tensor, second: Tensor) -> Tensor:
    """Place of an unordered pair in the nested order."""
    high, low = torch.maximum(first, second), torch.minimum(first, second)
    return high * (high + 1) // 2 + low


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


def _add_unit_pairs(architecture: Architecture, units: Tensor, columns: Tensor, table: Tensor) -> None:
    first = 0
    for layer, width in enumerate(architecture.hidden):
        rows, read = slice(_pairs(first), _pairs(first + width)), slice(_pairs(architecture.start(layer)))
        table[rows, read] += units[rows] @ columns[read].T
        first += width


def _gather_hidden(architecture: Architecture, table: Tensor) -> Tensor:
    size = architecture.hidden_parameters
    return table.view(-1).index_select(0, _hidden_places(architecture)).view(size, size)


def _gather_cross(architecture: Architecture, table: Tensor) -> Tensor:
    rows = table.flatten(1).index_select(1, _cross_places(architecture))
    return rows.view(architecture.outputs, architecture.hidden_parameters, len(architecture.output_reads))


@lru_cache(maxsize=8)
def _hidden_places(architecture: Architecture) -> Tensor:
    unit, column = architecture.unit, architecture.column
    columns = _pairs(architecture.columns)
    return (_pair_index(unit[:, None], unit) * columns + _pair_index(column[:, None], column)).view(-1)


@lru_cache(maxsize=8)
def _cross_places(architecture: Architecture) -> Tensor:
    unit, column = architecture.unit[:, None], architecture.column[:, None]
    return (unit * _pairs(architecture.columns) + _pair_index(column, architecture.output_reads)).view(-1)
