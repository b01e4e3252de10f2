"""How much the best of all hypotheses explains where nothing is missing, in this very recording.

The search over hundreds of shapes is paid for: the signs of whole blocks of time are flipped, which keeps the noise within
them as it is and takes away what a missing effect would have in common, and the best of all shapes is looked up again (wild
cluster bootstrap: Cameron, Gelbach and Miller 2008, doi:10.1162/rest.90.3.414; the maximum: Westfall and Young 1993,
ISBN 978-0-471-55761-6). The largest of many has Gumbel's distribution.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from motorlens_workbench.evidence.score import Score

Array = NDArray[np.float64]

FLIPS = 300
# Width of Gumbel's distribution whose standard deviation is one.
WIDTH = math.sqrt(6) / math.pi
# So wide is the null of a single test: -log of a probability has a standard deviation of one. Where few blocks of time carry
# what a recording tells, none of their flips is far from the others, and the null seems narrower than that.
LEAST = WIDTH
EULER = 0.5772156649


@dataclass(frozen=True)
class Null:
    """Gumbel's distribution of the largest weight.

    Attributes:
        mode: its most probable value.
        scale: its width.
    """

    mode: float
    scale: float

    def excess(self, weight: float) -> float:
        """How far a weight lies beyond the mode, in widths."""
        return (weight - self.mode) / self.scale

    def weight(self, excess: float, wide: float = 1.0) -> float:
        """The weight so many widths beyond, each that many times as wide as the null's, and no narrower than `LEAST`."""
        return self.mode + excess * max(wide * self.scale, LEAST)


def null_of(scores: Sequence[Score], rng: np.random.Generator) -> Null | None:
    """The null of the largest weight of some scores; None without any."""
    if not scores:
        return None
    signs = rng.choice([-1.0, 1.0], (FLIPS, len(scores[0].rests)))
    # Of shapes as wide, the largest weight is that of the largest statistic.
    largest: dict[int, Array] = {}
    for score in scores:
        flipped = signs @ score.rests
        statistic = np.sum((flipped @ score.inverse) * flipped, axis=1) / score.scatter
        largest[score.width] = np.maximum(largest.get(score.width, 0.0), statistic)
    best = np.max(
        [-np.log(chdtrc(width, np.minimum(most, 1300.0))) for width, most in largest.items()], axis=0
    )
    scale = max(float(np.std(best)) * WIDTH, 1e-3)
    return Null(float(np.mean(best)) - EULER * scale, scale)
