"""Laplace's posterior: how sure the network is of its function.

- *Full*: `var f_k(x) = g_k^T H^-1 g_k` with g_k the gradient of output k by all weights (MacKay 1992, eq.
  2.31).
- *Last layer*: hidden weights taken as known, so g_k is what the output layer reads and H^-1 its ridge
  covariance. All outputs share the eigenvectors Q of the Gram matrix: `var f_k = sum_i d_ki (Q^T z)_i^2`, one
  small product, which the exported sensor can afford. It leaves out what the hidden weights contribute; the
  exported sigma is calibrated on unseen duty cycles to make up for that.

Both are in the targets' scaled units squared and hold the function only; an observation adds the noise `1 /
beta_k`.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from motorlens_train.cascade import Network, jacobian
from motorlens_train.trainer import Trained


def full_variance(network: Network, factor: Tensor, x: Tensor) -> Tensor:
    """Variance of the function `[N, K]` at scaled inputs `[N, F]`, from the Cholesky factor of H."""
    rows = []
    for part in torch.split(x.double(), 512):
        gradients = jacobian(network, part)
        whitened = torch.linalg.solve_triangular(factor, gradients.flatten(0, 1).T, upper=False)
        rows.append(whitened.square().sum(0).view(len(part), -1))
    return torch.cat(rows)


@dataclass(frozen=True)
class LastLayer:
    """The last-layer posterior.

    Attributes:
        basis: eigenvectors Q of the Gram matrix of what the output layer reads, least determined first, `[Z, D]`.
        variances: variance d along each eigenvector for each output, scaled units, `[K, D]`.
    """

    basis: Tensor
    variances: Tensor

    @staticmethod
    def of(trained: Trained, directions: int | None = None) -> "LastLayer":
        """The last-layer posterior of a trained network; only its D least determined directions, if asked for."""
        eigenvalues, basis = torch.linalg.eigh(trained.moments.gram)
        precision = trained.hyper.precision[:, None] * eigenvalues.clamp_min(0) + trained.hyper.alpha[-1]
        return LastLayer(basis[:, :directions], 1 / precision[:, :directions])

    def variance(self, read: Tensor) -> Tensor:
        """Variance of the function `[N, K]` for what the output layer reads, `[N, Z]`."""
        return (read @ self.basis).square() @ self.variances.T
