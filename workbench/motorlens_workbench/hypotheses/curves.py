"""Terms without a name: what one balance lacks, as a free curve of what the motor does."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.estimate.shaft import turning
from motorlens_physics.parameter import Rated
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.hypotheses.effects import EQUATIONS
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

UNITS = {"voltage": "V", "torque": "N*m", "heat": "W"}
BALANCES = tuple(UNITS)
# Against what, and with how many knots: finer than the bumps that a coarse curve would miss.
KNOTS = {"speed": 18, "current": 12, "temperature": 8, "time": 12}
# Knots around a revolution of the shaft.
ROUND = 24


@dataclass(frozen=True)
class Term:
    """A free term in one balance.

    Attributes:
        balance: "voltage", "torque" or "heat".
    """

    balance: str

    @property
    def equation(self) -> str:
        """Which equation it stands in."""
        return EQUATIONS[self.balance]

    @property
    def term(self) -> str:
        """What it is the course of."""
        return self.balance

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return -np.inf, np.inf

    @property
    def unit(self) -> str:
        """Of its values."""
        return UNITS[self.balance]

    def adding(self, columns: Array) -> Forcing:
        """The forcing by columns (N, k) of its balance alone."""
        still = np.zeros_like(columns)
        return Forcing(**{"voltage": still, "torque": still, "heat": still, self.balance: columns})


@dataclass(frozen=True)
class Curve(Term):
    """A free curve in one equation: hat functions of one variable.

    Attributes:
        against: "speed", "current", "temperature", "time" or "angle" (of the shaft, within a revolution).
        knots: (k,) in the variable's unit.
    """

    against: str
    knots: Array

    @property
    def width(self) -> int:
        """How many columns it has."""
        return len(self.knots)

    @property
    def name(self) -> str:
        """What it is called where hypotheses are listed."""
        return f"{self.balance} against {self.against}"

    def columns(self, line: Line) -> Array:
        """(N, C, k) what a unit at each knot would change in the channels."""
        return line.of_forcing(self.forcing(line.trajectory))

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """(k,) the knots, the curve there in its unit, and its standard deviation."""
        return self.knots, coefficient, np.sqrt(np.maximum(np.diagonal(covariance), 0.0))

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit at each knot adds to the balances, (N, k) each.

        Nothing against an angle that is not known, or while the shaft does not turn whole revolutions.
        """
        return self.adding(self.hats(trajectory))

    def hats(self, trajectory: Trajectory) -> Array:
        """(N, k) what the shares of the knots are; see `forcing`."""
        if self.against != "angle":
            return hat_functions(self.knots, variables(trajectory)[self.against])
        angle = trajectory.states.get("phi")
        if angle is None:
            return np.zeros((len(trajectory.inputs.time_s), len(self.knots)))
        moving = turning(angle, trajectory.speed_rad_s, 2 * np.pi)
        return around(self.knots, angle) * moving[:, None]


def hat_functions(knots: Array, z: Array) -> Array:
    """(N, k) hat functions, which sum to one between the outer knots; constant beyond.

    >>> hat_functions(np.array([0.0, 1.0, 2.0]), np.array([0.25, 5.0])).tolist()
    [[0.75, 0.25, 0.0], [0.0, 0.0, 1.0]]
    """
    clipped = np.clip(z, knots[0], knots[-1])
    out = np.zeros((len(z), len(knots)))
    right = np.clip(np.searchsorted(knots, clipped, side="right"), 1, len(knots) - 1)
    share = (clipped - knots[right - 1]) / (knots[right] - knots[right - 1])
    rows = np.arange(len(z))
    out[rows, right - 1] = 1 - share
    out[rows, right] += share
    return out


# Points at which hat functions of the shaft angle are taken within a sample.
PHASES = 8


def around(knots: Array, angle: Array) -> Array:
    """(N, k) hat functions of the shaft angle (N,), rad, around a revolution, each the mean over its sample.

    The first of the knots (k,) is at 0 rad, where a revolution ends as well.
    """
    turn = np.gradient(angle)
    ways = [angle + ((k + 0.5) / PHASES - 0.5) * turn for k in range(PHASES)]
    ends = np.append(knots, 2 * np.pi)
    mean = np.asarray(sum(hat_functions(ends, np.mod(way, 2 * np.pi)) for way in ways) / PHASES)
    mean[:, 0] += mean[:, -1]
    return mean[:, :-1]


def knots_of(samples: Array, count: int) -> Array | None:
    """Knots over the range that the samples visit: between even spacing and equal populations; None if it hardly varies."""
    low, high = np.quantile(samples, [0.002, 0.998])
    if not high - low > 1e-6 * max(abs(low), abs(high), 1e-12):
        return None
    even = np.linspace(low, high, count)
    ranked = np.quantile(samples, np.linspace(0.002, 0.998, count))
    knots = np.unique(0.5 * (even + ranked))
    return knots if len(knots) >= 4 else None


def variables(trajectory: Trajectory) -> dict[str, Array]:
    """What curves are drawn against, (N,) each."""
    return {
        "speed": trajectory.speed_rad_s,
        "current": trajectory.current_A,
        "temperature": trajectory.rise_K,
        "time": trajectory.inputs.time_s,
    }


def curves(trajectories: Sequence[Trajectory], rated: Rated) -> list[Hypothesis]:
    """Free curves of every balance against every variable that varies.

    A voltage or a torque that goes with time, or with the temperature that rises with it, is none of them: noise of the
    inputs and a slow torque, which every fit has, are that.
    """
    every = free_curves(trajectories, BALANCES)
    listed = [one for one in every if one.balance == "heat" or one.against not in ("time", "temperature")]
    if any("phi" in trajectory.states for trajectory in trajectories):
        listed.append(Curve("torque", "angle", np.linspace(0, 2 * np.pi, ROUND, endpoint=False)))
    driven = what_drives(rated)
    return [
        Hypothesis(curve.name, "unnamed", curve.equation, (curve,), typical=driven[curve.balance])
        for curve in listed
    ]


def what_drives(rated: Rated) -> dict[str, float]:
    """What each balance is made of in rated operation, in V, N m and W: no free term is much larger."""
    return {
        "voltage": rated.voltage_V,
        "torque": rated.torque_Nm,
        "heat": rated.voltage_V * rated.current_A,
    }


def free_curves(trajectories: Sequence[Trajectory], balances: Sequence[str]) -> list[Curve]:
    """Curves of some balances against every variable that varies."""
    listed = []
    for against, count in KNOTS.items():
        samples = np.concatenate([variables(t)[against] for t in trajectories])
        knots = knots_of(samples, count)
        if knots is None:
            continue
        if against == "speed":
            # Friction turns its sign at rest: a knot on either side of zero.
            near = 0.02 * np.max(np.abs(knots))
            if knots[0] < -near and knots[-1] > near:
                knots = np.unique(np.concatenate([knots[np.abs(knots) > 2 * near], [-near, 0.0, near]]))
        listed += [Curve(balance, against, knots) for balance in balances]
    return listed
