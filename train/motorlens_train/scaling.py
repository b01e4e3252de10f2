"""Scaling of inputs and targets to zero mean and unit variance, so that one prior suits every quantity."""

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
