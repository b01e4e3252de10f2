"""Whether what goes with the shaft angle is seen while the shaft turns, not only at rest and about reversals.

Within less than a period a torque of the angle is hardly more than a constant one, with a sign of its own at every stop:
what friction, or an error of the speed, leaves there passes for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.forcing import Forcing, forcing
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.shaft import turning
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.curves import Curve
from motorlens_workbench.evidence import Score, score
from motorlens_workbench.screen import all_columns, evidence_of, with_priors
from motorlens_workbench.selection import REAL, Test

Array = NDArray[np.float64]

# How many times what is seen while the shaft turns a candidate's statistic may be.
BEYOND = 4.0


@dataclass(frozen=True)
class WhileTurning:
    """An effect of the shaft angle where the shaft turns, nothing elsewhere.

    Attributes:
        name: of the candidate.
        parts: its shape: one effect, or a sine and a cosine.
    """

    name: str
    parts: tuple[Effect, ...]

    def columns(self) -> list[str]:
        """Names of the columns."""
        return [f"turning.{self.name}.{k}" for k in range(len(self.parts))]

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What the effect adds to the balances, (N, k) each; nothing in runs whose angle is not known."""
        angle = trajectory.states.get("phi")
        if angle is None:
            still = np.zeros((len(trajectory.inputs.time_s), len(self.parts)))
            return Forcing(still, still, still)
        period = 2 * np.pi / getattr(self.parts[0], self.parts[0].with_role("count"), 1.0)
        added = [forcing(part, trajectory) for part in self.parts]
        everywhere = Forcing(
            *(
                np.column_stack([getattr(one, name) for one in added])
                for name in ("voltage", "torque", "heat")
            )
        )
        return _where(turning(angle, trajectory.speed_rad_s, period), everywhere)


class CurveWhileTurning(Curve):
    """A free curve of the shaft angle where the shaft turns a revolution, nothing elsewhere."""

    def columns(self) -> list[str]:
        """Names of the columns."""
        return [f"turning.{name}" for name in super().columns()]

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit at each knot adds to the balances, (N, k) each."""
        everywhere = super().forcing(trajectory)
        angle = trajectory.states.get("phi")
        if angle is None:
            return everywhere
        return _where(turning(angle, trajectory.speed_rad_s, 2 * np.pi), everywhere)


def _where(moving: NDArray[np.bool_], added: Forcing) -> Forcing:
    """A forcing (N, k) at some samples (N,), nothing elsewhere."""
    kept = moving[:, None]
    return Forcing(added.voltage * kept, added.torque * kept, added.heat * kept)


def seen_turning(tests: Mapping[str, Test], found: Fit, runs: Sequence[Run]) -> dict[str, Test]:
    """Those tests of effects of the shaft angle that looked real, each with what is left of it while the shaft turns."""
    shown = {}
    for name, test in tests.items():
        parts = test.candidate.variants[test.variant]
        if test.statistic > REAL and isinstance(parts[0], Effect) and parts[0].turns():
            shown[name] = WhileTurning(name, tuple(part for part in parts if isinstance(part, Effect)))
    if not shown:
        return {}
    columns = all_columns(found, runs, (), list(shown.values()), with_decoys=False)
    evidence = with_priors(evidence_of(columns, runs, found.whiteners), found).given(found.prior.keys)
    judged = {}
    for name, effect in shown.items():
        test, seen = tests[name], score(evidence, effect.columns())
        assert test.score is not None
        most = BEYOND * _gain_at(test.score.coefficient, seen) / seen.inflation if seen else 0.0
        inflation = max(test.score.inflation, test.gain / max(most, 1e-9))
        judged[name] = replace(test, score=test.score.inflated(inflation))
    return judged


def _gain_at(size: Array, seen: Score) -> float:
    """What columns of a given size (k,), not of their best one, would explain."""
    off = size - seen.coefficient
    return float(seen.gain - off @ seen.information @ off)
