"""Whether a parameter changed at once, and when: magnets that weakened, a winding that shorted, a load that was coupled.

What a parameter explains before and after a moment is already in the evidence, block of time by block: splitting its column
at every boundary between two blocks costs no simulation. The best of many moments: Andrews (1993), doi:10.2307/2951764.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.run import Run
from motorlens_workbench.bend import Bend
from motorlens_workbench.evidence import Evidence, Score, score
from motorlens_workbench.screen import layout
from motorlens_workbench.variation import Variation

Array = NDArray[np.float64]

# Blocks of time that must lie before a change and after it.
SHORTEST = 2


@dataclass(frozen=True)
class Change(Variation):
    """A parameter that changed at once in one recording.

    Attributes:
        run: name of the recording.
        at_s: when, to about a block of time.
        by: how much, as a share of the fitted value.
    """

    run: str
    at_s: float
    by: float


def changes(evidence: Evidence, found: Fit, runs: Sequence[Run], parameters: Mapping[str, str]) -> list[Bend]:
    """The moment at which each parameter would best have changed.

    Args:
        evidence: of all columns, the fitted parameters among them, by blocks of `layout`.
        found: the fit.
        runs: prepared recordings.
        parameters: name of each and the equation it belongs to; those that were not fitted are passed over.
    """
    keys = found.prior.keys
    fitted = evidence.of_columns(keys)
    blocks = layout(runs, found.whiteners)
    of_run = np.array([r for r, _ in blocks])
    moments = [(r, k) for r in range(len(runs)) for k in np.flatnonzero(of_run == r)[SHORTEST : 1 - SHORTEST]]
    if not moments:
        return []
    after = np.array([(of_run == r) & (np.arange(len(blocks)) >= k) for r, k in moments])
    strongest = []
    for key in keys:
        if key not in parameters:
            continue
        left = fitted.split(key, after).given(keys)
        tests = [score(left, [f"{key}/{m}"]) for m in range(len(moments))]
        known = [m for m, test in enumerate(tests) if test is not None]
        if not known:
            continue
        best = max(known, key=lambda m: tests[m].statistic)  # type: ignore[union-attr]
        tested, (r, k) = tests[best], moments[best]
        assert tested is not None
        strongest.append(_bend(key, parameters[key], found, runs[r], blocks[k][1].start, tested))
    return strongest


def _bend(key: str, equation: str, found: Fit, run: Run, row: int, tested: Score) -> Bend:
    time = run.time_s
    unit, value = found.prior.sd[key], found.model.values()[key]
    jump, sd = tested.coefficient[0] * unit, np.sqrt(tested.covariance[0, 0]) * unit
    knots = np.array([time[0], time[row - 1], time[row], time[-1]])
    by = float(jump / value) if value else float("inf")
    curve = Change(
        key, equation, found.model.file.meaning(key).unit, "time", knots, run.name, float(time[row]), by
    )
    step = np.array([0.0, 0.0, 1.0, 1.0])
    gain, deviations = tested.gain - tested.inflation, (tested.statistic - 1) / np.sqrt(2)
    return Bend(curve, gain, float(deviations), tested.statistic, knots, jump * step, sd * step)
