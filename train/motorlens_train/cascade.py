"""Cascade-forward networks: structure, forward pass and layer-wise derivatives, without autograd.

All columns a layer can read stand in one buffer, feature-major: `z = [1 | x | h_1 | ... | h_L]`, one column
of the buffer an instant. Layer l computes `h_l = f(W_l z_read)`; the output layer is linear, `y = V z_read`.

- In a *cascade* every layer reads all that stands before it (inputs and all previous layers: MATLAB's
  cascadeforwardnet).
- In a plain *feed-forward* network a layer reads the constant and the layer before it.

The only difference is which entries of the weight matrices are free, so everything else is written once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from motorlens_train.activations import Activation, activation


@dataclass(frozen=True)
class Architecture:
    """Sizes of a network and which columns each of its layers reads.

    Attributes:
        inputs: number of inputs F.
        hidden: width of each hidden layer, first to last; empty for a linear model.
        outputs: number of outputs K.
        activation: name of the hidden units' activation.
        skips: a cascade (True), or a plain feed-forward network (False).
    """

    inputs: int
    hidden: tuple[int, ...]
    outputs: int
    activation: str = "tanh"
    skips: bool = True

    def __str__(self) -> str:
        kind = "cascade" if self.skips else "feed-forward"
        return f"{kind} {'-'.join(map(str, (self.inputs, *self.hidden, self.outputs)))} {self.activation}"

    @property
    def layers(self) -> int:
        """Number of hidden layers L; the output layer has index L."""
        return len(self.hidden)

    @property
    def columns(self) -> int:
        """Rows of the buffer z: constant, inputs and all hidden units."""
        return 1 + self.inputs + sum(self.hidden)

    def start(self, layer: int) -> int:
        """Number of columns that stand before `layer` (all of them for the output layer)."""
        return 1 + self.inputs + sum(self.hidden[:layer])

    def writes(self, layer: int) -> slice:
        """Columns that hidden layer `layer` fills."""
        return slice(self.start(layer), self.start(layer + 1))

    def reads(self, layer: int) -> tuple[int, ...]:
        """Columns that `layer` reads, ascending; the constant is column 0."""
        if self.skips or layer == 0:
            return tuple(range(self.start(layer)))
        return (0, *range(self.start(layer - 1), self.start(layer)))

    @cached_property
    def hidden_parameters(self) -> int:
        """Number of weights and biases of all hidden layers."""
        return sum(width * len(self.reads(layer)) for layer, width in enumerate(self.hidden))

    @cached_property
    def output_reads(self) -> Tensor:
        """Columns that the output layer reads, `[Z]` int64."""
        return torch.tensor(self.reads(self.layers))

    def read_by_output(self, z: Tensor) -> Tensor:
        """Rows of the buffer z that the output layer reads, `[Z, N]`; z itself where it reads them all."""
        return z if len(self.output_reads) == len(z) else z[self.output_reads]

    @property
    def output_parameters(self) -> int:
        """Number of weights and biases of the output layer, all outputs."""
        return self.outputs * len(self.reads(self.layers))

    @property
    def parameters(self) -> int:
        """Number of weights and biases."""
        return self.hidden_parameters + self.output_parameters

    @cached_property
    def unit(self) -> Tensor:
        """Hidden unit (0 .. U-1) that each hidden parameter belongs to, `[P_h]`."""
        return torch.from_numpy(self._entries[0])

    @cached_property
    def column(self) -> Tensor:
        """Column of z that each hidden parameter multiplies, `[P_h]`."""
        return torch.from_numpy(self._entries[1])

    @cached_property
    def layer_of(self) -> Tensor:
        """Hidden layer that each hidden parameter belongs to, `[P_h]`."""
        widths = [width * len(self.reads(layer)) for layer, width in enumerate(self.hidden)]
        return torch.repeat_interleave(torch.arange(self.layers), torch.tensor(widths, dtype=torch.int64))

    @cached_property
    def _entries(self) -> tuple[np.ndarray, np.ndarray]:
        units, columns, first = [], [], 0
        for layer, width in enumerate(self.hidden):
            reads = self.reads(layer)
            units.append(np.repeat(np.arange(first, first + width), len(reads)))
            columns.append(np.tile(reads, width))
            first += width
        empty = [np.zeros(0, np.int64)]
        return np.concatenate(units or empty), np.concatenate(columns or empty).astype(np.int64)

    @cached_property
    def function(self) -> Activation:
        """The hidden units' activation."""
        return activation(self.activation)


@dataclass(frozen=True)
class Network:
    """A network with its weights, in float64.

    Attributes:
        architecture: the structure.
        hidden: weights of the hidden layers, flat `[P_h]`; layer after layer, unit after unit, in the order
        of `reads`.
        output: weights of the output layer `[K, Z]`, Z = number of columns it reads.
    """

    architecture: Architecture
    hidden: Tensor
    output: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        """Outputs `[N, K]` for inputs `[N, F]`, in the type of x."""
        z = forward(self.architecture, dense(self.architecture, self.hidden.to(x.dtype)), x.T)
        return (self.output.to(x.dtype) @ self.architecture.read_by_output(z)).T

    def parameters(self) -> Tensor:
        """All weights as one vector `[P]`: hidden layers, then the output layer row by row."""
        return torch.cat([self.hidden, self.output.reshape(-1)])


def dense(architecture: Architecture, hidden: Tensor) -> list[Tensor]:
    """Weight matrix `[width, start(layer)]` of each hidden layer; entries that are not read are zero."""
    table = hidden.new_zeros(sum(architecture.hidden), architecture.columns)
    table[architecture.unit, architecture.column] = hidden
    first, matrices = 0, []
    for layer, width in enumerate(architecture.hidden):
        matrices.append(table[first : first + width, : architecture.start(layer)])
        first += width
    return matrices


def forward(architecture: Architecture, weights: Sequence[Tensor], x: Tensor) -> Tensor:
    """Fill the buffer z `[columns, N]` from inputs x `[F, N]`."""
    z = x.new_empty(architecture.columns, x.shape[1])
    z[0] = 1
    z[1 : 1 + architecture.inputs] = x
    for layer, weight in enumerate(weights):
        z[architecture.writes(layer)] = architecture.function.value(weight @ z[: architecture.start(layer)])
    return z


def deltas(architecture: Architecture, weights: Sequence[Tensor], output: Tensor, z: Tensor) -> Tensor:
    """Derivative of every output by every hidden unit's net input.

    Args:
        architecture: the structure.
        weights: matrices from `dense`.
        output: output weights `[K, Z]`.
        z: the buffer from `forward`, `[columns, N]`.

    Returns:
        `[K, U, N]`; the Jacobian by the weight of unit u on column c is `deltas[:, u] * z[c]`.
    """
    seed = z.new_zeros(architecture.outputs, architecture.columns)
    seed[:, architecture.output_reads] = output
    units = sum(architecture.hidden)
    delta = z.new_empty(architecture.outputs, units, z.shape[1])
    last = units
    for layer in reversed(range(architecture.layers)):
        written = architecture.writes(layer)
        slope = architecture.function.slope(z[written])
        first = last - architecture.hidden[layer]
        for k in range(architecture.outputs):
            inflow = seed[k, written, None].expand_as(slope)
            if last < units:
                # Every later layer that reads this one passes its own deltas back through its weights.
                inflow = inflow + _later(architecture, weights, layer).T @ delta[k, last:]
            torch.mul(inflow, slope, out=delta[k, first:last])
        last = first
    return delta


def _later(architecture: Architecture, weights: Sequence[Tensor], layer: int) -> Tensor:
    """Weights of all later hidden units on the units of `layer`, `[later units, width]`."""
    return torch.cat([weight[:, architecture.writes(layer)] for weight in weights[layer + 1 :]])


def jacobian(network: Network, x: Tensor) -> Tensor:
    """Derivative of each output by each weight, `[N, K, P]`, for inputs `[N, F]`; for checks, not for training."""
    architecture = network.architecture
    weights = dense(architecture, network.hidden.to(x.dtype))
    z = forward(architecture, weights, x.T)
    delta = deltas(architecture, weights, network.output.to(x.dtype), z)
    rows, outputs = x.shape[0], architecture.outputs
    result = x.new_zeros(rows, outputs, architecture.parameters)
    hidden = architecture.hidden_parameters
    result[:, :, :hidden] = (delta[:, architecture.unit] * z[architecture.column]).permute(2, 0, 1)
    read = architecture.read_by_output(z).T
    for k in range(outputs):
        first = hidden + k * read.shape[1]
        result[:, k, first : first + read.shape[1]] = read
    return result


def initial(architecture: Architecture, generator: np.random.Generator) -> Tensor:
    """Starting weights of the hidden layers, for inputs of unit variance, `[P_h]` float64.

    Weights are normal with a standard deviation that gives each net input a variance near one, biases spread
    the units' active regions over the data (in the spirit of Nguyen and Widrow, 1990).
    """
    fan_in = np.concatenate(
        [np.full(width * len(architecture.reads(layer)), len(architecture.reads(layer)) - 1)
         for layer, width in enumerate(architecture.hidden)] or [np.zeros(0)]
    )  # fmt: skip
    weights = generator.standard_normal(architecture.hidden_parameters)
    return torch.from_numpy(
        np.where(architecture.column.numpy() == 0, weights, weights / np.sqrt(np.maximum(fan_in, 1)))
    )
