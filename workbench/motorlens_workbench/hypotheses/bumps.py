"""Terms without a name that act about one speed alone, as a resonance or a bump of the friction does.

A curve over all speeds pays for all its knots, and those are too far apart for what is narrow. A bump is a few adjacent
knots of a finer curve: the sums of that are made once, and every bump is a part of them. The best of all places is paid for
by `evidence.null`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.parameter import Rated
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.evidence.score import Entry
from motorlens_workbench.hypotheses.curves import Curve, free_curves, what_drives
from motorlens_workbench.hypotheses.hypothesis import Hypothesis

Array = NDArray[np.float64]

# What may act about one speed alone; heat is too slow to tell at which speed it was made.
BALANCES = ("torque", "voltage")
# Intervals that one between two knots of the curve over all speeds is divided into.
FINER = 4
# How many adjacent knots a bump takes: up to as wide as the curve over all speeds shows.
WIDTHS = (1, 2, 4, 8)


class FineCurve(Curve):
    """A curve that is not tested as a whole: its bumps are."""


@dataclass(frozen=True)
class Bump(Curve):
    """A free term in one balance about one speed.

    Attributes:
        at: which of the knots it takes.
    """

    at: slice

    @property
    def width(self) -> int:
        """How many columns it has."""
        return int(self.at.stop - self.at.start)

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit at each knot that it takes adds to the balances, (N, k) each."""
        return self.adding(self.hats(trajectory)[:, self.at])

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """(K,) all knots, the bump there in its unit, and its standard deviation."""
        value, sd = np.zeros((2, len(self.knots)))
        value[self.at], sd[self.at] = coefficient, np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return self.knots, value, sd

    def place(self, coefficient: Array) -> float:
        """About which speed it is, rad/s."""
        return float(np.average(self.knots[self.at], weights=np.abs(coefficient)))


def fine_curves(trajectories: Sequence[Trajectory], rated: Rated) -> list[Hypothesis]:
    """The curves of which bumps are parts."""
    driven, made = what_drives(rated), []
    for curve in free_curves(trajectories, BALANCES):
        if curve.against != "speed":
            continue
        whole = np.arange(curve.width)
        knots = np.interp(np.linspace(0, whole[-1], FINER * whole[-1] + 1), whole, curve.knots)
        fine = FineCurve(curve.balance, curve.against, knots)
        name = f"{curve.balance} about one speed"
        made.append(Hypothesis(name, "unnamed", curve.equation, (fine,), typical=driven[curve.balance]))
    return made


def in_bumps(entries: Sequence[Entry]) -> list[Entry]:
    """Entries, with all its bumps in the place of every fine curve."""
    made: list[Entry] = []
    for entry in entries:
        curve = entry.shape
        if not isinstance(curve, FineCurve):
            made.append(entry)
            continue
        places = [slice(first, first + width) for width in WIDTHS for first in range(curve.width - width + 1)]
        able = tuple(Bump(curve.balance, curve.against, curve.knots, at) for at in places)
        hypothesis = replace(entry.hypothesis, shapes=able)
        made += [
            Entry(hypothesis, one, entry.cross[:, :, one.at], entry.inner[:, one.at, one.at]) for one in able
        ]
    return made
