"""Estimates relative to an observer's: what the network learns beside an observer is what the observer gets wrong.

Targets become (value - estimate) / deviation with the observer's own estimate and standard deviation, so that instants at
which nobody can know count no more than others, and intervals widen with the observer's.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorlens_train.data import Cycle
from motorlens_train.specification import Array, Bank


@dataclass(frozen=True)
class Frame:
    """Columns of the features, one an output: the observer's estimates and the logarithms of its variances."""

    estimates: tuple[int, ...]
    log_variances: tuple[int, ...]

    @staticmethod
    def of(bank: Bank, outputs: Sequence[str]) -> "Frame":
        """The frame of a bank with an observer."""
        assert bank.observer is not None
        names = [bank.observer.outputs[f.filters[0]] if f.kind == "observer" else "" for f in bank.features]
        return Frame(
            tuple(names.index(output) for output in outputs),
            tuple(names.index(f"log_{output}") for output in outputs),
        )

    def start(self, features: Array) -> tuple[Array, Array]:
        """Estimates and standard deviations `[N, K]` of the observer, from features `[N, F]`."""
        return features[:, self.estimates], np.exp(0.5 * features[:, self.log_variances])

    def relative(self, cycle: Cycle) -> Cycle:
        """The cycle with targets relative to the observer."""
        estimate, deviation = self.start(cycle.x)
        return replace(cycle, y=(cycle.y - estimate) / deviation)

    def selection(self, features: int) -> tuple[Array, Array]:
        """Matrices `[F, K]` that pick estimates, and half logarithms of variances, from features `[N, F]`."""
        picks = np.zeros((2, features, len(self.estimates)))
        for k, (estimate, variance) in enumerate(zip(self.estimates, self.log_variances, strict=True)):
            picks[0, estimate, k], picks[1, variance, k] = 1.0, 0.5
        return picks[0], picks[1]
