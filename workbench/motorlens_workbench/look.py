"""One look from a fitted model: all effects, sensor faults, free curves and decoys in one linearised pass."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.fit import Fit, noise_of, plain_noise, squares
from motorlens_physics.estimate.free_run import floor_of
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.run import Run
from motorlens_workbench.candidates import candidates
from motorlens_workbench.curves import BALANCES, curves
from motorlens_workbench.evidence import Evidence, statistics
from motorlens_workbench.screen import (
    Columns,
    all_columns,
    evidence_of,
    held_out_rmse,
    unexplained,
    with_priors,
)
from motorlens_workbench.selection import Test, test_all
from motorlens_workbench.turning import seen_turning

Array = NDArray[np.float64]

# Times the noise floor from which on a channel is not explained.
FAR = 2.0
# Share of the squared error of a channel, beyond its noise, that is much of it.
MUCH = 0.15


@dataclass(frozen=True)
class Look:
    """The screen from one model.

    Attributes:
        found: the fit it was taken from, with the noise of this screen.
        evidence: all columns, along the corrected inputs.
        left: what the fitted parameters leave.
        tests: every candidate.
        decoy: the best statistic that a decoy reaches.
        noise: (C,) per run, standard deviation of what nothing explains.
        columns: unwhitened, per run.
    """

    found: Fit
    evidence: Evidence
    left: Evidence
    tests: dict[str, Test]
    decoy: float
    noise: tuple[Array, ...]
    columns: list[Columns]

    @property
    def samples(self) -> float:
        """How many whitened samples there are."""
        return float(self.evidence.samples.sum()) * len(self.found.residuals[0][0])


def look(found: Fit, runs: Sequence[Run], own: Sequence[type[Effect]] = ()) -> Look:
    """Screen everything from a fitted model."""
    outputs = sorted({channel for run in runs for channel in run.channels})
    inputs = ("voltage", *sorted({q for run in runs for q in run.known}))
    exact: dict[str, float] = {}
    for run in runs:
        exact |= {q: min(limit, exact.get(q, limit)) for q, limit in run.offset_below.items()}
    listed = candidates(found.model.file, outputs, inputs, own, exact)
    trajectories = [predict(found.model, run, r)[0] for r, run in enumerate(runs)]
    free = curves(trajectories, BALANCES)
    columns = all_columns(found, runs, listed, free)
    rest, spent = unexplained(columns, runs, plain_noise(found.residuals, runs), found.prior.keys)
    whiteners = noise_of(rest, runs, spent)
    evidence = with_priors(evidence_of(columns, runs, whiteners), found)
    found = replace(found, whiteners=whiteners, error=squares(found.residuals, runs, whiteners))
    left = evidence.given(found.prior.keys)
    tests = test_all(left, listed, found.model)
    tests |= seen_turning(tests, found, runs)
    noise = tuple(np.sqrt(np.mean(e[run.fresh()] ** 2, axis=0)) for e, run in zip(rest, runs, strict=True))
    return Look(found, evidence, left, tests, decoy_of(left), noise, columns)


def decoy_of(left: Evidence, given: Sequence[str] = ()) -> float:
    """The best statistic that a decoy reaches beside some columns."""
    found = dict(zip(left.names, statistics(left, given).tolist(), strict=False))
    return max((value for name, value in found.items() if name.startswith("decoy.")), default=0.0)


def held_out(now: Look, runs: Sequence[Run]) -> dict[str, float]:
    """RMSE of each channel on blocks of time that the parameters were not fitted to, see `held_out_rmse`."""
    return held_out_rmse(now.found, runs, now.columns, now.evidence)


def noise_floor(now: Look, runs: Sequence[Run]) -> dict[str, float]:
    """What a perfect model's error would be, per channel, over all runs: as `compare` states it, of averaged rows."""
    return pooled_floor(now.found.model, runs)


def pooled_floor(model: Model, runs: Sequence[Run]) -> dict[str, float]:
    """The floor of each channel over runs from an estimate, see `free_run.floor_of`."""
    squares: dict[str, list[tuple[float, int]]] = {}
    for r, run in enumerate(runs):
        plain = replace(run, corrections=None)
        error = run.measured - predict(model, plain, r)[1]
        for channel, floor in zip(
            run.channels, floor_of(model, plain, r, error, averaged=run.every), strict=True
        ):
            squares.setdefault(channel, []).append((float(floor**2), len(run)))
    return {
        channel: float(np.sqrt(sum(s * n for s, n in parts) / sum(n for _, n in parts)))
        for channel, parts in squares.items()
    }


def unsettled(first: Look, now: Look, runs: Sequence[Run]) -> bool:
    """Whether the model is still far from speed or temperature; the current follows the noise on the voltage as well.

    Far is beyond the noise, and much of what there was to explain from the first model.
    """
    at_first, error, floor = held_out(first, runs), held_out(now, runs), noise_floor(now, runs)
    return any(
        error[c] > FAR * floor[c]
        and error[c] ** 2 - floor[c] ** 2 > MUCH * (at_first[c] ** 2 - floor[c] ** 2)
        for c in error
        if c != "current"
    )
