"""Which test would tell a group apart: every scenario simulated from the present model, ranked by its worst pair.

For two rivals of the present size, 2 log likelihood that a recording of a scenario would put between them is
c^2 |x|^2 (1 - rho^2), with x the column of one after the base parameters have taken their share and rho its correlation with
the other's. Hunter and Reiner (1965), Designs for discriminating between two rival models,
doi:10.1080/00401706.1965.10490265.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.scenario import perform, scenarios
from motorlens_runtime.errors import MotorlensError
from motorlens_workbench.candidates import Candidate, candidates
from motorlens_workbench.diagnosis import Finding
from motorlens_workbench.evidence import _inverse
from motorlens_workbench.fitting import base_prior, start_model
from motorlens_workbench.look import noise_floor
from motorlens_workbench.run import prepare
from motorlens_workbench.screen import columns_of
from motorlens_workbench.verdict import Verdict
from motorlens_workbench.whitening import white

Array = NDArray[np.float64]

# 2 log likelihood between two rivals that settles the matter.
SETTLED = 60.0
LONGEST_S = 7200.0


@dataclass(frozen=True)
class Experiment:
    """A test that would tell rivals apart.

    Attributes:
        test: the scenario's name, "" if none would.
        separates: the rivals.
        seconds: how long to record.
        why: a sentence.
    """

    test: str
    separates: tuple[str, ...]
    seconds: float
    why: str


def propose(found: Finding, verdict: Verdict, rng: np.random.Generator) -> Experiment | None:
    """The scenario that best tells the first ambiguous group apart; None where there is no group."""
    group = next((group for group in verdict.groups if len(group) > 1), None)
    if group is None:
        return None
    step = next(step for step in found.steps if step.test.candidate.name == group[0])
    file = found.base.model.file
    floor = noise_floor(found.last, found.runs)
    every = {c.name: c for c in candidates(file, tuple(floor), ("voltage", *_known(found)))}
    listed = [every[name] for name in group if name in every]
    strength = abs(step.test.size / step.test.typical)
    best: tuple[float, float, str] | None = None
    for name, scenario in scenarios().items():
        if name == "duty":
            continue
        try:
            worst, seconds = _distance(found, listed, scenario(), floor, strength, rng)
        except (MotorlensError, FloatingPointError, ValueError):
            continue
        if seconds <= LONGEST_S and (best is None or worst / np.sqrt(seconds) > best[0] / np.sqrt(best[1])):
            best = (worst, seconds, name)
    names = ", ".join(group)
    if best is None or best[0] < SETTLED / 10:
        return Experiment(
            "",
            group,
            0.0,
            "no run of this motor tells them apart; calibrate or exchange the sensors concerned",
        )
    worst, seconds, name = best
    needed = float(np.clip(seconds * SETTLED / worst, seconds, LONGEST_S))
    return Experiment(name, group, round(needed, 1), f"run {name} for {needed:.0f} s; it tells {names} apart")


def _known(found: Finding) -> tuple[str, ...]:
    return tuple(sorted({q for run in found.runs for q in run.known if q in ("load_torque",)}))


def _distance(
    found: Finding,
    listed: Sequence[Candidate],
    scenario: object,
    floor: dict[str, float],
    strength: float,
    rng: np.random.Generator,
) -> tuple[float, float]:
    """2 log likelihood between the closest pair that a run of a scenario would bring, and its seconds."""
    file = replace(found.base.model.file, sensors=())
    recording = perform(file, scenario, rng)  # type: ignore[arg-type]
    recording = replace(
        recording,
        channels={
            q: y
            for q, y in recording.channels.items()
            if q in floor or q in ("voltage", "ambient", *_known(found))
        },
    )
    run = prepare(recording, file)
    model = start_model(file, [run])
    prior = base_prior(file, [run])
    columns = columns_of(model, run, 0, prior.keys, dict(prior.sd), listed, (), with_decoys=False)
    # Noise per averaged row, as the recordings had it per row.
    whitener = white(np.array([floor[channel] for channel in run.channels]))
    z = whitener(columns.values).reshape(-1, columns.values.shape[2])
    keys = len(prior.keys)
    gram = z.T @ z
    gram[np.arange(keys), np.arange(keys)] += 1.0
    inner = gram[keys:, keys:] - gram[keys:, :keys] @ _inverse(gram[:keys, :keys]) @ gram[:keys, keys:]
    names = list(columns.names[keys:])
    best_of: dict[tuple[str, str], float] = {}
    for a, one in enumerate(names):
        for b, other in enumerate(names):
            pair = (one.partition("#")[0], other.partition("#")[0])
            if pair[0] >= pair[1]:
                continue
            rho2 = inner[a, b] ** 2 / max(inner[a, a] * inner[b, b], 1e-300)
            apart = strength**2 * max(inner[a, a], inner[b, b]) * max(1 - rho2, 0.0)
            best_of[pair] = min(best_of.get(pair, np.inf), apart)
    return min(best_of.values(), default=0.0), recording.duration_s


__all__ = ["Experiment", "propose"]
