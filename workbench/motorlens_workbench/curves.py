"""Terms without a name: what one balance lacks, as a free curve of what the motor does."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.candidates import EQUATIONS

Array = NDArray[np.float64]

UNITS = {"voltage": "V", "torque": "N*m", "heat": "W"}
BALANCES = tuple(UNITS)
# Against what, and with how many knots: finer than the bumps that a coarse curve would miss.
KNOTS = {"speed": 18, "current": 12, "temperature": 8, "time": 12}


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

    def columns(self) -> list[str]:
        """Names of the columns."""
        return [f"curve.{self.balance}.{self.against}.{k}" for k in range(len(self.knots))]

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit at each knot adds to the balances, (N, k) each; nothing against an angle that is not known."""
        if self.against != "angle":
            return self.adding(hat_functions(self.knots, variables(trajectory)[self.against]))
        angle = trajectory.states.get("phi")
        if angle is None:
            return self.adding(np.zeros((len(trajectory.inputs.time_s), len(self.knots))))
        return self.adding(around(self.knots, angle))


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
    """(N, k) hat functions of the shaft angle (N,), rad, within a revolution, each the mean over its sample."""
    turn = np.gradient(angle)
    ways = [angle + ((k + 0.5) / PHASES - 0.5) * turn for k in range(PHASES)]
    return np.asarray(sum(hat_functions(knots, np.mod(way, 2 * np.pi)) for way in ways) / PHASES)


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


def curves(trajectories: Sequence[Trajectory], balances: Sequence[str]) -> list[Curve]:
    """Free curves of every balance against every variable that varies."""
    found = []
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
        found += [Curve(balance, against, knots) for balance in balances]
    return found
