"""One Levenberg-Marquardt step on the hidden weights, with the output layer eliminated and the path's bend
corrected.

The step solves `(S + lambda D) v = -g` with the reduced matrix `S = H_hh - sum_k H_ho (H_oo)^-1 H_oh` (variable projection,
Kaufman's form) and `D = diag(S)` (Marquardt). Several lambda are tried from one curvature; each step is
corrected by half its geodesic acceleration (Transtrum and Sethna 2012), limited to a share of the step. After
a trial the output layer is solved anew, exactly.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motorlens_train.cascade import Architecture, Network
from motorlens_train.evidence import Hyperparameters
from motorlens_train.gauss_newton import (
    Columns,
    Curvature,
    OutputMoments,
    acceleration,
    cholesky,
    curvature,
    gradient,
    output_moments,
)

# Damping values tried from one curvature, as multiples of the last one that worked.
TRIALS = (0.03, 0.3, 3.0)
DAMPING_RANGE = (1e-10, 1e8)
# The geodesic correction may be at most this share of the step it corrects.
BEND = 0.4


@dataclass(frozen=True)
class Batch:
    """Scaled data as columns; iterated as often as needed.

    Attributes:
        blocks: begins a pass over inputs `[F, n]` and targets `[K, n]`.
        rows: number of samples.
    """

    blocks: Callable[[], Iterable[Columns]]
    rows: int


@dataclass(frozen=True)
class Point:
    """A place in weight space, with the best output layer for its hidden weights.

    Attributes:
        network: the weights.
        moments: of the batch at these hidden weights.
        objective: regularised error; see `motorlens_train.evidence`.
    """

    network: Network
    moments: OutputMoments
    objective: float


def locate(architecture: Architecture, hidden: Tensor, hyper: Hyperparameters, batch: Batch) -> Point:
    """Evaluate hidden weights on a batch: one forward pass."""
    return settle(architecture, hidden, hyper, output_moments(architecture, hidden, batch.blocks()))


def settle(
    architecture: Architecture, hidden: Tensor, hyper: Hyperparameters, moments: OutputMoments
) -> Point:
    """The best output layer and the objective for known moments: no pass over the data."""
    output = moments.solve(hyper.precision, hyper.alpha_output(architecture))
    error = hyper.precision @ moments.squared_error(output)
    penalty = hyper.alpha_hidden(architecture) @ hidden.square() + hyper.alpha[-1] * output.square().sum()
    return Point(Network(architecture, hidden, output), moments, float(0.5 * (error + penalty)))


@dataclass(frozen=True)
class Step:
    """What a step achieved: where it led, with which damping, and whether that is an improvement."""

    point: Point
    damping: float
    accepted: bool


def step(point: Point, hyper: Hyperparameters, damping: float, batch: Batch, curving: Batch) -> Step:
    """Take one step from `point`.

    Args:
        point: where to start, evaluated on `batch` with `hyper`.
        hyper: regularisation.
        damping: lambda of the last step that worked.
        batch: all data of this stage: objective and gradient are its own.
        curving: the data for curvature and trials, `batch` itself or a part of it.

    Returns:
        The best point found; not accepted if no damping led downhill.
    """
    whole = curving is batch
    network, architecture = point.network, point.network.architecture
    if architecture.hidden_parameters == 0:
        return Step(point, damping, accepted=False)
    # A part of the data stands for all of them: its errors count for as many rows as there are.
    part = replace(hyper, beta=batch.rows / curving.rows * hyper.beta)
    sums = curvature(architecture, network.hidden, network.output, part.precision, curving.blocks())
    slope = sums.gradient
    local = point
    if not whole:
        slope = gradient(architecture, network.hidden, network.output, hyper.precision, batch.blocks())
        local = locate(architecture, network.hidden, part, curving)
    # Curvature of hidden and of output weights must come from the same rows, or their sum need not be positive definite.
    reduced = _Reduced.of(network, sums, slope, local.moments, part)
    for _ in range(5):
        dampings = [min(max(factor * damping, DAMPING_RANGE[0]), DAMPING_RANGE[1]) for factor in TRIALS]
        trials = []
        for trial in dampings:
            moved = reduced.solve(trial, network, part.precision, curving)
            if moved is not None and bool(torch.isfinite(moved).all()):
                trials.append((locate(architecture, network.hidden + moved, part, curving), trial))
        best, chosen = min(trials, key=lambda pair: pair[0].objective, default=(local, damping))
        if best.objective < local.objective:
            confirmed = best if whole else locate(architecture, best.network.hidden, hyper, batch)
            if confirmed.objective < point.objective:
                return Step(confirmed, chosen, accepted=True)
        damping = 30 * max(damping, 1e-6)
        if damping > DAMPING_RANGE[1]:
            break
    return Step(point, min(damping, DAMPING_RANGE[1]), accepted=False)


@dataclass(frozen=True)
class _Reduced:
    """The system for the hidden weights after elimination of the output layer."""

    matrix: Tensor
    slope: Tensor
    followers: Tensor  # how the output weights follow a step of the hidden ones, [K, Z, P_h]

    @staticmethod
    def of(
        network: Network, sums: Curvature, slope: Tensor, moments: OutputMoments, hyper: Hyperparameters
    ) -> "_Reduced":
        architecture = network.architecture
        prior = hyper.alpha_hidden(architecture)
        inner = hyper.precision[:, None, None] * moments.gram + torch.diag_embed(
            hyper.alpha_output(architecture)
        )
        followers = torch.cholesky_solve(sums.cross.transpose(1, 2), cholesky(inner))
        size = architecture.hidden_parameters
        tied = sums.cross.transpose(0, 1).reshape(size, -1) @ followers.reshape(-1, size)
        matrix = sums.hidden + torch.diag(prior) - tied
        return _Reduced(0.5 * (matrix + matrix.T), slope + prior * network.hidden, followers)

    def solve(self, damping: float, network: Network, precision: Tensor, batch: Batch) -> Tensor | None:
        """The step `[P_h]` for one damping with its geodesic correction; None if it takes more damping."""
        diagonal = self.matrix.diagonal()
        scale = diagonal.clamp_min(1e-6 * float(diagonal.max()))
        factor: Tensor
        factor, failed = torch.linalg.cholesky_ex(self.matrix + damping * torch.diag(scale))
        if bool(failed):
            return None
        velocity = -torch.cholesky_solve(self.slope[:, None], factor)[:, 0]
        turns = (velocity, -(self.followers @ velocity))
        bend_hidden, bend_output = acceleration(
            network.architecture, network.hidden, network.output, turns, precision, batch.blocks()
        )
        bend = bend_hidden - torch.einsum("kzp,kz->p", self.followers, bend_output)
        correction = -0.5 * torch.cholesky_solve(bend[:, None], factor)[:, 0]
        share = float(correction.norm() / velocity.norm().clamp_min(1e-300))
        return velocity + correction * min(1.0, BEND / max(share, 1e-300))
