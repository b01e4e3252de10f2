"""Scaling of targets and whitening of inputs, so that one prior suits every quantity and sums stay well conditioned."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Scaling:
    """`scaled = (value - mean) / deviation`, per column.

    Attributes:
        mean: `[C]` float64.
        deviation: `[C]` float64, 1 for a constant column.
    """

    mean: Tensor
    deviation: Tensor

    @staticmethod
    def of(values: Tensor) -> "Scaling":
        """Mean and deviation of the columns of `[N, C]`."""
        values = values.double()
        mean = values.mean(0)
        deviation = (values - mean).square().mean(0).sqrt()
        # A column that varies by rounding only is constant.
        constant = deviation <= 1e-9 * mean.abs() + 1e-300
        return Scaling(mean, torch.where(constant, torch.ones_like(deviation), deviation))

    def scale(self, values: Tensor) -> Tensor:
        """Scaled values, in the type of `values`."""
        return (values - self.mean.to(values.dtype)) / self.deviation.to(values.dtype)

    def restore(self, scaled: Tensor) -> Tensor:
        """Values in their own units, in the type of `scaled`."""
        return scaled * self.deviation.to(scaled.dtype) + self.mean.to(scaled.dtype)


@dataclass(frozen=True)
class Whitening:
    """`scaled = (value - mean) @ matrix`: uncorrelated inputs of unit variance, each as close as possible to its own.

    Filters of one signal resemble each other, and what tells temperature from speed is their small differences: scaled
    one by one they would drown in rounding and in the prior. The matrix is `D^-1 (C + r I)^(-1/2)` with D the deviations
    and C the correlations (ZCA-cor; Kessy, Lewin and Strimmer 2018).

    Attributes:
        mean: `[F]` float64.
        matrix: `[F, F]` float64.
    """

    mean: Tensor
    matrix: Tensor

    @staticmethod
    def of(values: Tensor, ridge: float) -> "Whitening":
        """Whitening of `[N, F]`.

        Args:
            values: inputs.
            ridge: r; directions with less than this share of one input's variance are not blown up. Much larger than
                the number of inputs, it leaves the correlations as they are.
        """
        single = Scaling.of(values)
        scaled = single.scale(values.double())
        eigenvalues, basis = torch.linalg.eigh(scaled.T @ scaled / len(values))
        root = (basis * ((1 + ridge) / (eigenvalues.clamp_min(0) + ridge)).sqrt()) @ basis.T
        # Rounded to float32, so that the exported sensor holds the same matrix in half the space.
        return Whitening(single.mean, (root / single.deviation[:, None]).float().double())

    def scale(self, values: Tensor) -> Tensor:
        """Whitened values `[N, F]`, computed in float64, in the type of `values`."""
        return ((values.double() - self.mean) @ self.matrix).to(values.dtype)
