"""One look from a fitted model: all effects, sensor faults, free curves and decoys in one linearised pass."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_workbench.candidates import candidates
from motorlens_workbench.curves import BALANCES, curves
from motorlens_workbench.evidence import Evidence, statistics
from motorlens_workbench.fitting import Fit, noise_of, plain_noise, squares
from motorlens_workbench.input_errors import without_input_errors
from motorlens_workbench.model import predict
from motorlens_workbench.run import Run
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
# Share of a parameter by which errors of the inputs may move it and still be told from what is missing.
SWAMPED = 0.17
# Of which parameters: those that a drive's noise moves little where the motor is driven.
WELL_KNOWN = ("R_a0", "ke", "J")
# Share of the squared error of a channel, beyond its noise, that is much of it.
MUCH = 0.15


@dataclass(frozen=True)
class Look:
    """The screen from one model.

    Attributes:
        found: the fit it was taken from, with the noise of this screen.
        evidence: all columns, without what errors of the inputs feign.
        recorded: all columns, as recorded.
        left: what the fitted parameters leave.
        tests: every candidate.
        decoy: the best statistic that a decoy reaches.
        noise: (C,) per run, standard deviation of what nothing explains.
        columns: unwhitened, per run.
    """

    found: Fit
    evidence: Evidence
    recorded: Evidence
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
    recorded = evidence_of(columns, runs, whiteners)
    evidence = without_input_errors(recorded, found, runs, whiteners, listed, free, with_decoys=True)
    evidence = with_priors(evidence, found)
    found = replace(found, whiteners=whiteners, error=squares(found.residuals, runs, whiteners))
    left = evidence.given(found.prior.keys)
    tests = test_all(left, listed, found.model)
    tests |= seen_turning(tests, found, runs)
    noise = tuple(np.sqrt(np.mean(e[run.fresh()] ** 2, axis=0)) for e, run in zip(rest, runs, strict=True))
    recorded = with_priors(recorded, found)
    return Look(found, evidence, recorded, left, tests, decoy_of(left), noise, columns)


def swamped(now: Look) -> tuple[str, float] | None:
    """The well-known parameter that errors of the inputs alone move most, as a share of the motor file's value.

    None if that is little. Near standstill the noise of a voltage may drive as much current as its signal: the resistance
    that then fits best is far too large, and an estimate of the error, made from there, falls short.
    """
    prior = now.found.prior
    (cleared, _), (recorded, _) = now.evidence.solve(prior.keys), now.recorded.solve(prior.keys)
    off = dict(zip(prior.keys, np.abs(cleared - recorded).tolist(), strict=True))
    moved = {
        key: off[key] * prior.sd[key] / abs(prior.centre[key])
        for key in WELL_KNOWN
        if key in off and prior.centre[key]
    }
    most = max(moved, key=lambda key: moved[key], default=None)
    return (most, moved[most]) if most is not None and moved[most] > SWAMPED else None


def decoy_of(left: Evidence, given: Sequence[str] = ()) -> float:
    """The best statistic that a decoy reaches beside some columns."""
    found = dict(zip(left.names, statistics(left, given).tolist(), strict=False))
    return max((value for name, value in found.items() if name.startswith("decoy.")), default=0.0)


def held_out(now: Look, runs: Sequence[Run]) -> dict[str, float]:
    """RMSE of each channel on blocks of time that the parameters were not fitted to, see `held_out_rmse`."""
    return held_out_rmse(now.found, runs, now.columns, now.recorded)


def noise_floor(now: Look, runs: Sequence[Run]) -> dict[str, float]:
    """Standard deviation of what nothing explains, per channel, over all runs."""
    squares: dict[str, list[tuple[float, int]]] = {}
    for noise, run in zip(now.noise, runs, strict=True):
        for c, channel in enumerate(run.channels):
            squares.setdefault(channel, []).append((float(noise[c] ** 2), len(run)))
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
