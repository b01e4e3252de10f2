"""One Levenberg-Marquardt step on the hidden weights, with the output layer eliminated and the path's bend
corrected.

The step solves `(S + lambda D) v = -g` with the reduced matrix `S = H_hh - sum_k H_ho (H_oo)^-1 H_oh` (variable projection,
Kaufman's form) and `D = diag(S)` (Marquardt). Several lambda are tried from one curvature until one leads downhill; each
step is corrected by half its geodesic acceleration (Transtrum and Sethna 2012), limited to a share of the step. After a
trial the output layer is solved anew, exactly. The same S tells how many weights the data determine.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motorlens_train.cascade import Architecture, Network
from motorlens_train.evidence import Hyperparameters, well_determined
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

# Damping values tried from one curvature until one leads downhill, as multiples of the last one that worked.
TRIALS = (0.1, 10.0, 300.0, 1e4, 1e6)
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
    """What a step achieved.

    Attributes:
        point: where it led.
        damping: with which it was taken.
        accepted: whether the point is an improvement.
        reduced: the curvature it was taken from.
    """

    point: Point
    damping: float
    accepted: bool
    reduced: "Reduced"


def step(point: Point, hyper: Hyperparameters, damping: float, batch: Batch, curving: Batch) -> Step:
    """Take one step from `point`.

    Args:
        point: where to start, evaluated on `batch` with `hyper`.
        hyper: regularisation.
        damping: lambda of the last step that worked.
        batch: all data of this stage: objective and gradient are its own.
        curving: the data for curvature and trials, `batch` itself or a part of it.

    Returns:
        The first point found downhill; not accepted if no damping led there.
    """
    whole = curving is batch
    network, architecture = point.network, point.network.architecture
    # A part of the data stands for all of them: its errors count for as many rows as there are.
    part = replace(hyper, beta=batch.rows / curving.rows * hyper.beta)
    sums = curvature(architecture, network.hidden, network.output, part.precision, curving.blocks())
    slope = sums.gradient
    local = point
    if not whole:
        slope = gradient(architecture, network.hidden, network.output, hyper.precision, batch.blocks())
        local = locate(architecture, network.hidden, part, curving)
    # Curvature of hidden and of output weights must come from the same rows, or their sum need not be positive definite.
    reduced = Reduced.of(network, sums, slope, local.moments, part)
    for factor in TRIALS if architecture.hidden_parameters else ():
        trial = min(max(factor * max(damping, 1e-8), DAMPING_RANGE[0]), DAMPING_RANGE[1])
        moved = reduced.solve(trial, network, part.precision, curving)
        if moved is None or not bool(torch.isfinite(moved).all()):
            continue
        there = locate(architecture, network.hidden + moved, part, curving)
        if there.objective >= local.objective:
            continue
        if not whole:
            there = locate(architecture, there.network.hidden, hyper, batch)
        if there.objective < point.objective:
            return Step(there, trial, accepted=True, reduced=reduced)
    return Step(point, damping, accepted=False, reduced=reduced)


@dataclass(frozen=True)
class Reduced:
    """The system for the hidden weights after elimination of the output layer.

    Attributes:
        matrix: S, `[P_h, P_h]`.
        slope: gradient by the hidden weights, with the prior's, `[P_h]`.
        inner: Cholesky factors of the output weights' own blocks, `[K, Z, Z]`.
        followers: how the output weights follow a step of the hidden ones, `[K, Z, P_h]`.
    """

    matrix: Tensor
    slope: Tensor
    inner: Tensor
    followers: Tensor

    @staticmethod
    def of(
        network: Network, sums: Curvature, slope: Tensor, moments: OutputMoments, hyper: Hyperparameters
    ) -> "Reduced":
        """Eliminate the output layer; `sums` and `moments` come from the same rows."""
        architecture = network.architecture
        prior = hyper.alpha_hidden(architecture)
        own = hyper.precision[:, None, None] * moments.gram + torch.diag_embed(
            hyper.alpha_output(architecture)
        )
        inner = cholesky(own)
        halves = torch.linalg.solve_triangular(inner, sums.cross.transpose(1, 2), upper=False)
        tied = halves.flatten(0, 1).T @ halves.flatten(0, 1)
        followers = torch.linalg.solve_triangular(inner.transpose(1, 2), halves, upper=True)
        matrix = sums.hidden - tied
        matrix.diagonal().add_(prior)
        return Reduced(matrix, slope + prior * network.hidden, inner, followers)

    def solve(self, damping: float, network: Network, precision: Tensor, batch: Batch) -> Tensor | None:
        """The step `[P_h]` for one damping with its geodesic correction; None if it takes more damping."""
        diagonal = self.matrix.diagonal()
        scale = diagonal.clamp_min(1e-6 * float(diagonal.max()))
        system = self.matrix.clone()
        system.diagonal().add_(scale, alpha=damping)
        factor: Tensor
        factor, failed = torch.linalg.cholesky_ex(system)
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

    def determined(self, network: Network, hyper: Hyperparameters) -> tuple[Tensor, float]:
        """Well-determined parameters of each layer `[L + 1]` and log det H, as `motorlens_train.evidence` defines them.

        By the block inverse: `(H^-1)_hh = S^-1` and `(H^-1)_oo = (H_oo)^-1 + F S^-1 F^T` with F the followers.
        """
        factor: Tensor
        factor, failed = torch.linalg.cholesky_ex(self.matrix)
        if bool(failed):
            # Rounding has pushed S below the prior, which is the least it can be.
            values, basis = torch.linalg.eigh(self.matrix)
            least = torch.maximum(hyper.alpha[:-1].min(), 1e-10 * values[-1])
            factor = cholesky((basis * torch.maximum(values, least)) @ basis.T)
        inverse, followers = torch.cholesky_inverse(factor), self.followers.flatten(0, 1)
        spread = ((followers @ inverse) * followers).sum(1)
        identity = torch.eye(self.inner.shape[1], dtype=factor.dtype).expand_as(self.inner)
        own = torch.linalg.solve_triangular(self.inner, identity, upper=False).square().sum(1)
        variance = torch.cat([inverse.diagonal(), own.reshape(-1) + spread])
        log_det = 2 * (factor.diagonal().log().sum() + self.inner.diagonal(dim1=1, dim2=2).log().sum())
        return well_determined(network.architecture, variance, hyper), float(log_det)
