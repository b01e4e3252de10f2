"""The evidence framework: how strongly to regularise and how noisy the targets are, read from the training
data alone.

Objective in weights w, for targets of unit variance:

    E(w) = 1/2 sum_k (beta_k / tau_k) SSE_k(w) + 1/2 sum_g alpha_g |w_g|^2

- `alpha_g`: prior precision of the weights of layer g (a single alpha, as in MATLAB's trainbr, would punish
  output biases and input weights alike).
- `beta_k`: inverse noise variance of output k.
- `tau_k`: autocorrelation time of output k's errors in samples, 1 if they are independent: recordings are
  time series, and n correlated samples carry only n / tau of information.

Laplace's approximation around the minimum has the precision matrix `H = sum_k beta_k / tau_k J_k^T J_k + A`.
Sources: MacKay (1992), "A practical Bayesian framework for backpropagation networks", eqs. 2.8-2.22;
Foresee and Hagan (1997), "Gauss-Newton approximation to Bayesian learning".
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from motorlens_train.cascade import Architecture, Network, jacobian
from motorlens_train.gauss_newton import Curvature, OutputMoments, cholesky

# Guards: how far one update may move alpha or beta, and how far they may go at all (targets have unit
# variance).
STEP = 10.0
ALPHA_RANGE = (1e-6, 1e8)
BETA_RANGE = (1e-6, 1e14)


@dataclass(frozen=True)
class Hyperparameters:
    """The quantities that the evidence sets.

    Attributes:
        alpha: prior precision of each layer's weights, hidden layers first, then the output layer, `[L + 1]`.
        beta: inverse noise variance of each output, `[K]`.
        tau: autocorrelation time of each output's errors, in samples, `[K]`, at least 1.
    """

    alpha: Tensor
    beta: Tensor
    tau: Tensor

    @staticmethod
    def start(architecture: Architecture, tau: float = 1.0) -> "Hyperparameters":
        """Where training begins: weak prior, noise of a tenth of the targets' variance.

        The prior that the starting weights are drawn from is a faster start on noisy data, but on nearly exact data the
        evidence then settles where the network is all but linear.
        """
        ones = torch.ones(architecture.outputs, dtype=torch.float64)
        return Hyperparameters(
            torch.full((architecture.layers + 1,), 0.01, dtype=torch.float64), 10 * ones, tau * ones
        )

    @property
    def precision(self) -> Tensor:
        """Weight of each output's squared errors, `[K]`."""
        return self.beta / self.tau

    def alpha_hidden(self, architecture: Architecture) -> Tensor:
        """Prior precision of each hidden weight, `[P_h]`."""
        return self.alpha[architecture.layer_of]

    def alpha_output(self, architecture: Architecture) -> Tensor:
        """Prior precision of each output weight, `[K, Z]`."""
        return self.alpha[-1].expand(architecture.outputs, len(architecture.output_reads))


@dataclass(frozen=True)
class Evidence:
    """Laplace's approximation at one point.

    Attributes:
        factor: lower Cholesky factor of the posterior precision H, `[P, P]`.
        gamma: well-determined parameters of each layer, `[L + 1]`.
        log_evidence: natural logarithm of p(targets | architecture, alpha, beta), for scaled targets.
        squared_error: SSE of each output, `[K]`.
        rows: number of samples.
    """

    factor: Tensor
    gamma: Tensor
    log_evidence: float
    squared_error: Tensor
    rows: int


def posterior_precision(
    architecture: Architecture, curvature: Curvature, moments: OutputMoments, hyper: Hyperparameters
) -> Tensor:
    """H over all weights, `[P, P]`; `curvature` must have been computed with `hyper.precision`."""
    hidden, size = architecture.hidden_parameters, len(architecture.output_reads)
    matrix = torch.zeros(architecture.parameters, architecture.parameters, dtype=torch.float64)
    matrix[:hidden, :hidden] = curvature.hidden
    for k, precision in enumerate(hyper.precision):
        mine = slice(hidden + k * size, hidden + (k + 1) * size)
        matrix[:hidden, mine] = curvature.cross[k]
        matrix[mine, :hidden] = curvature.cross[k].T
        matrix[mine, mine] = precision * moments.gram
    prior = torch.cat([hyper.alpha_hidden(architecture), hyper.alpha_output(architecture).reshape(-1)])
    return matrix + torch.diag(prior)


def evidence(network: Network, precision: Tensor, moments: OutputMoments, hyper: Hyperparameters) -> Evidence:
    """Effective numbers of parameters and log evidence at a minimum.

    Args:
        network: weights at the minimum.
        precision: H from `posterior_precision`.
        moments: at the same weights.
        hyper: with which H was computed.
    """
    architecture = network.architecture
    factor = cholesky(precision)
    identity = torch.eye(len(precision), dtype=torch.float64)
    variance = torch.linalg.solve_triangular(factor, identity, upper=False).square().sum(0)
    gamma = well_determined(architecture, variance, hyper)
    log_det = 2 * float(factor.diagonal().log().sum())
    found = log_evidence(network, log_det, moments, hyper)
    return Evidence(factor, gamma, found, moments.squared_error(network.output), moments.rows)


def well_determined(architecture: Architecture, variance: Tensor, hyper: Hyperparameters) -> Tensor:
    """gamma of each layer `[L + 1]` from the posterior variance of every weight `[P]`."""
    sizes = _sum_groups(architecture, torch.ones_like(variance))
    return torch.minimum((sizes - hyper.alpha * _sum_groups(architecture, variance)).clamp_min(0), sizes)


def log_evidence(network: Network, log_det: float, moments: OutputMoments, hyper: Hyperparameters) -> float:
    """Natural logarithm of p(targets | architecture, alpha, beta), from log det H."""
    sizes, squares = _groups(network)
    error = moments.squared_error(network.output)
    likelihood = moments.rows / hyper.tau * torch.log(hyper.beta / (2 * torch.pi)) - hyper.precision * error
    prior = sizes * torch.log(hyper.alpha) - hyper.alpha * squares
    return 0.5 * (float(likelihood.sum() + prior.sum()) - log_det)


def update(
    network: Network, gamma: Tensor, moments: OutputMoments, hyper: Hyperparameters
) -> Hyperparameters:
    """MacKay's re-estimation, guarded.

    `alpha_g = gamma_g / |w_g|^2` and `beta_k = (N - tau_k gamma_k) / SSE_k`. The hidden layers are shared by
    the outputs, so each output is charged an equal part `gamma_k = gamma / K`; with a single output this is
    exact. No update moves a value by more than a factor of ten; a layer whose gamma vanishes keeps a finite
    alpha; SSE = 0 does not let beta run away; at least a twentieth of the samples is counted as free.
    """
    _, squares = _groups(network)
    alpha = gamma.clamp_min(1e-3) / squares.clamp_min(1e-12)
    rows, share = moments.rows, gamma.sum() / len(hyper.beta)
    free = torch.maximum(rows - hyper.tau * share, torch.tensor(0.05 * rows))
    beta = free / moments.squared_error(network.output).clamp_min(rows / BETA_RANGE[1])
    return replace(
        hyper, alpha=_guard(alpha, hyper.alpha, ALPHA_RANGE), beta=_guard(beta, hyper.beta, BETA_RANGE)
    )


def score_autocorrelation(
    network: Network, now: Evidence, runs: Iterable[tuple[Tensor, Tensor]], points: Tensor
) -> Tensor:
    """Autocorrelation time of each output's score, `[K]`, at least 1.

    The score of sample n is its contribution `J_n^T e_n` to the gradient; its autocorrelation, not that of the
    errors e_n, is what makes the posterior too sure (Godambe's information). The function's error at a point with
    gradient g is the sum of the scores along `H^-1 g`, so the autocorrelation is taken along that direction, and the mean
    over the points is what makes the mean square of the error in standard deviations one. (A mean over all directions of
    the weights is shorter: the fine shapes, which are many and matter at few points, last less than the coarse ones.)
    It is first summed up to five times the time found so far (Sokal's window), then up to eight times that time with
    Bartlett's weights, because the slowest directions matter most. A network that has fitted gamma slow shapes has taken
    just these out of its errors: the share `gamma w / N` of the window w that is lost is made good, up to a factor of two.
    At least one effective sample a weight is left.

    Args:
        network: weights at the minimum.
        now: evidence there.
        runs: unbroken stretches of scaled inputs `[n, F]` and targets `[n, K]` in order of time.
        points: scaled inputs at which the function is asked, `[D, F]`.
    """
    outputs = network.architecture.outputs
    gradients = jacobian(network, points.double()).permute(1, 2, 0)
    probes = torch.cholesky_solve(gradients, now.factor.expand(outputs, -1, -1))
    total = np.zeros((outputs, 0, len(points)))
    for x, y in runs:
        scores = torch.einsum("nkp,kpd->nkd", jacobian(network, x.double()), probes)
        scores = scores * (network(x.double()) - y.double())[..., None]
        products = _lagged_products(scores.numpy())
        longest = max(total.shape[1], products.shape[1])
        total = _padded(total, longest) + _padded(products, longest)
    gamma = float(now.gamma.sum()) / outputs
    correlation = (total / np.maximum(total[:, :1], np.finfo(float).tiny)).mean(2)
    times = [_correlation_time(row, gamma, now.rows) for row in correlation]
    # Tempered further, the network would shrink to nothing, its errors would last longer, and so on round the circle.
    most = max(1.0, now.rows / network.architecture.parameters)
    return torch.tensor(times, dtype=torch.float64).clamp_max(most)


def _lagged_products(scores: np.ndarray) -> np.ndarray:
    """`sum_n s[n, k, d] s[n + h, k, d]` for every lag h, `[K, n, D]`."""
    count = len(scores)
    spectrum = np.fft.rfft(scores, 2 * count, axis=0)
    power = spectrum.real**2 + spectrum.imag**2
    return np.fft.irfft(power, axis=0)[:count].transpose(1, 0, 2)


def _correlation_time(correlation: np.ndarray, gamma: float, rows: int) -> float:
    times = 2 * np.cumsum(correlation) - 1
    lags = np.arange(len(correlation))
    inside = lags >= 5 * np.maximum(times, 1)
    sokal = max(times[int(np.argmax(inside))] if inside.any() else times[-1], 1.0)
    window = min(max(int(8 * sokal), 2), len(correlation))
    bartlett = 2 * float(((1 - lags[:window] / window) * correlation[:window]).sum()) - 1
    return float(max(bartlett, sokal, 1.0) / max(1 - gamma * window / rows, 0.5))


def _padded(products: np.ndarray, length: int) -> np.ndarray:
    return np.pad(products, ((0, 0), (0, length - products.shape[1]), (0, 0)))


def _groups(network: Network) -> tuple[Tensor, Tensor]:
    """Number of weights and sum of their squares in each layer."""
    weights = network.parameters()
    return _sum_groups(network.architecture, torch.ones_like(weights)), _sum_groups(
        network.architecture, weights**2
    )


def _sum_groups(architecture: Architecture, values: Tensor) -> Tensor:
    layers = torch.cat(
        [architecture.layer_of, torch.full((architecture.output_parameters,), architecture.layers)]
    )
    return torch.zeros(architecture.layers + 1, dtype=values.dtype).index_add_(0, layers, values)


def _guard(new: Tensor, old: Tensor, limits: tuple[float, float]) -> Tensor:
    return torch.minimum(torch.maximum(new, old / STEP), old * STEP).clamp(*limits)
