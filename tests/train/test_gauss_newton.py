"""Jacobians and Gauss-Newton sums against torch.func, and their independence of chunks and order."""

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.func import jacfwd

from motorlens_train.cascade import Architecture, Network, dense, forward, initial, jacobian
from motorlens_train.gauss_newton import acceleration, curvature, gradient, output_moments
from motorlens_train.source import Arrays, Stream

# torch.func itself still calls torch.jit.script.
pytestmark = pytest.mark.filterwarnings("ignore:.*torch.jit.script.* is deprecated:DeprecationWarning")

ARCHITECTURES = [
    Architecture(4, (5, 3), 2),
    Architecture(4, (5, 3), 2, skips=False),
    Architecture(3, (4, 2, 3), 3, "logistic"),
    Architecture(3, (4, 2, 3), 1, "logistic", skips=False),
    Architecture(5, (6,), 3, "rectifier"),
    Architecture(3, (2, 2), 2, "linear"),
    Architecture(4, (), 2),
]
ids = [str(a) for a in ARCHITECTURES]


def problem(architecture: Architecture, rows: int = 37) -> tuple[Network, Tensor, Tensor, Tensor]:
    generator = np.random.default_rng(7)
    network = Network(
        architecture,
        initial(architecture, generator),
        torch.from_numpy(generator.standard_normal((architecture.outputs, len(architecture.output_reads)))),
    )
    x = torch.from_numpy(generator.standard_normal((rows, architecture.inputs)))
    y = torch.from_numpy(generator.standard_normal((rows, architecture.outputs)))
    return network, x, y, torch.from_numpy(generator.uniform(0.5, 4.0, architecture.outputs))


def textbook(architecture: Architecture, parameters: Tensor, x: Tensor) -> Tensor:
    """The network as a loop over layers with its own bookkeeping: nothing shared with the code under test."""
    f = {"tanh": torch.tanh, "logistic": torch.sigmoid, "linear": lambda a: a, "rectifier": torch.relu}[
        architecture.activation
    ]
    known, first = [x], 0
    ones = torch.ones(len(x), 1, dtype=x.dtype)
    for width in (*architecture.hidden, architecture.outputs):
        reads = torch.cat([ones, *known] if architecture.skips else [ones, known[-1]], dim=1)
        weight = parameters[first : first + width * reads.shape[1]].reshape(width, -1)
        first += weight.numel()
        net = reads @ weight.T
        known.append(net if len(known) > len(architecture.hidden) else f(net))
    assert first == len(parameters)
    return known[-1]


def relative(a: Tensor, b: Tensor) -> float:
    return float((a - b).abs().max() / b.abs().max().clamp_min(1e-300))


@pytest.mark.parametrize("architecture", ARCHITECTURES, ids=ids)
def test_outputs_and_jacobian_are_those_of_torch_func(architecture: Architecture) -> None:
    network, x, _, _ = problem(architecture)
    theirs = jacfwd(lambda p: textbook(architecture, p, x))(network.parameters())
    assert relative(network(x), textbook(architecture, network.parameters(), x)) < 1e-12
    assert relative(jacobian(network, x), theirs) < 1e-9


@pytest.mark.parametrize("architecture", ARCHITECTURES, ids=ids)
def test_gauss_newton_matrix_and_gradient_are_those_of_torch_func(architecture: Architecture) -> None:
    network, x, y, precision = problem(architecture)
    j = jacfwd(lambda p: textbook(architecture, p, x))(network.parameters())
    full = torch.einsum("nkp,k,nkq->pq", j, precision, j)
    residual = textbook(architecture, network.parameters(), x) - y
    slope = torch.einsum("nkp,k,nk->p", j, precision, residual)
    blocks = [(x[:20].T.contiguous(), y[:20].T), (x[20:].T, y[20:].T)]
    ours = curvature(architecture, network.hidden, network.output, precision, blocks)
    moments = output_moments(architecture, network.hidden, blocks)
    hidden, outputs, reads = (
        architecture.hidden_parameters,
        architecture.outputs,
        len(architecture.output_reads),
    )
    assert relative(moments.squared_error(network.output), (residual**2).sum(0)) < 1e-9
    if hidden == 0:
        return
    assert relative(ours.hidden, full[:hidden, :hidden]) < 1e-9
    assert relative(ours.gradient, slope[:hidden]) < 1e-9
    assert (
        relative(gradient(architecture, network.hidden, network.output, precision, blocks), slope[:hidden])
        < 1e-9
    )
    for k in range(outputs):
        mine = slice(hidden + k * reads, hidden + (k + 1) * reads)
        assert relative(ours.cross[k], full[:hidden, mine]) < 1e-9
        assert relative(precision[k] * moments.gram, full[mine, mine]) < 1e-9


@pytest.mark.fit
@pytest.mark.parametrize(
    "architecture", [a for a in ARCHITECTURES if a.activation in ("tanh", "logistic")], ids=str
)
def test_second_directional_derivative_is_that_of_torch_func(architecture: Architecture) -> None:
    network, x, _, precision = problem(architecture)
    if architecture.hidden_parameters == 0:
        return
    direction = torch.from_numpy(np.random.default_rng(3).standard_normal(architecture.parameters))
    hidden = architecture.hidden_parameters
    step = (direction[:hidden], direction[hidden:].reshape(network.output.shape))

    def along(t: Tensor) -> Tensor:
        return textbook(architecture, network.parameters() + t * direction, x)

    bend = jacfwd(jacfwd(along))(torch.zeros((), dtype=torch.float64))
    j = jacfwd(lambda p: textbook(architecture, p, x))(network.parameters())
    theirs = torch.einsum("nkp,k,nk->p", j, precision, bend)
    by_hidden, by_output = acceleration(
        architecture, network.hidden, network.output, step, precision, [(x.T, x.T)]
    )
    assert relative(torch.cat([by_hidden, by_output.reshape(-1)]), theirs) < 1e-9


@pytest.mark.fit
def test_sums_do_not_depend_on_chunks_or_order() -> None:
    architecture = Architecture(6, (7, 4), 3)
    network, x, y, precision = problem(architecture, rows=5000)
    order = torch.from_numpy(np.random.default_rng(1).permutation(5000))

    def sums(rows: int, x: Tensor, y: Tensor) -> Tensor:
        blocks = [(a.T, b.T) for a, b in Arrays(x, y).blocks(rows)]  # type: ignore[arg-type]
        c = curvature(architecture, network.hidden, network.output, precision, blocks)
        m = output_moments(architecture, network.hidden, blocks)
        return torch.cat(
            [part.reshape(-1) for part in (c.hidden, c.cross, c.gradient, m.gram, m.cross, m.square)]
        )

    whole = sums(5000, x, y)
    for rows in (1, 17, 1024, 4096):
        if rows > 1:
            assert relative(sums(rows, x, y), whole) < 1e-10
    assert relative(sums(640, x[order], y[order]), whole) < 1e-10


def test_a_generator_is_cut_into_the_same_blocks_as_an_array() -> None:
    generator = np.random.default_rng(5)
    x, y = generator.standard_normal((1000, 3)), generator.standard_normal((1000, 2))

    def pieces():  # type: ignore[no-untyped-def]
        first = 0
        for size in (1, 3, 400, 0, 596):
            yield x[first : first + size], y[first : first + size]
            first += size

    stream, arrays = Stream(pieces, 1000, 3, 2), Arrays(x, y)
    for (a, b), (c, d) in zip(stream.blocks(128), arrays.blocks(128), strict=True):
        assert torch.equal(a, c) and torch.equal(b, d)
    ours, theirs = stream.sample(100, np.random.default_rng(2)), arrays.sample(100, np.random.default_rng(2))
    assert torch.equal(ours[0], theirs[0]) and torch.equal(ours[1], theirs[1])


def test_forward_reads_only_what_the_structure_allows() -> None:
    architecture = Architecture(2, (3, 2), 1, skips=False)
    network, x, _, _ = problem(architecture)
    weights = dense(architecture, network.hidden)
    assert bool((weights[1][:, 1:3] == 0).all()), "a feed-forward layer must not see the inputs again"
    assert forward(architecture, weights, x.T).shape == (1 + 2 + 5, len(x))
