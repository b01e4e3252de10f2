"""Whether what was accepted early is still needed beside what was accepted later, for which it may have stood in.

Forward choice with elimination: Efroymson (1960), Multiple regression analysis, in Ralston and Wilf (eds.), Mathematical
methods for digital computers, Wiley.
"""

from collections.abc import Sequence
from dataclasses import replace

from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.evidence import score, similarity
from motorlens_workbench.fitting import Fit, Prior, fit
from motorlens_workbench.look import Look
from motorlens_workbench.model import without_part
from motorlens_workbench.run import Run
from motorlens_workbench.selection import REAL, WORTH, possible, total
from motorlens_workbench.steps import AMONG, NEAR, Step


def dispensable(steps: Sequence[Step], now: Look, runs: Sequence[Run]) -> tuple[Step, Fit] | None:
    """The step before the last that would not be accepted beside the others, and the fit without it; None if all would be.

    Args:
        steps: effects accepted, in order.
        now: the screen with all of them.
        runs: prepared recordings.
    """
    earlier = steps[:-1]
    fits = on_all_cores(lambda step: _without(now.found, step.test.candidate.name, runs), earlier)
    worth = max(WORTH * now.samples, AMONG * sum(step.gain for step in steps))
    losses = {}
    for step, less in zip(earlier, fits, strict=True):
        key = key_of(step)
        seen = score(now.evidence.given([other for other in now.found.prior.keys if other != key]), [key])
        if less is None or seen is None:
            continue
        loss = total(less) - total(now.found)
        if loss < max(REAL * seen.inflation, worth):
            losses[loss] = step, less
    return losses[min(losses)] if losses else None


def key_of(step: Step) -> str:
    """The parameter that is the size of an accepted effect."""
    return f"{step.test.candidate.name}.{step.test.candidate.switch}"


def seen_from(step: Step, last: Look) -> Step:
    """The step with what resembles it, and could replace it, as seen from the final model, which lacks nothing else."""
    assert step.test.score is not None
    key = key_of(step)
    left = last.evidence.given([other for other in last.found.prior.keys if other != key])
    size = _size(step, last)
    alike, losses = {}, dict(step.losses)
    for name, test in last.tests.items():
        labels = test.candidate.columns()[test.variant]
        alike[name] = float(similarity(left, [key, *labels])[0, 1:].max())
        if alike[name] > NEAR and len(labels) == 1:
            at = left.index([key, *labels])
            mine, common, its = left.total[at[0], at[0]], left.total[at[0], at[1]], left.total[at[1], at[1]]
            if possible(test, size * common / its):
                loss = size**2 * mine * (1 - alike[name]) / step.test.score.inflation
                losses[name] = min(losses.get(name, loss), loss)
    return replace(step, alike=alike, losses=losses)


def _size(step: Step, now: Look) -> float:
    """Of an accepted effect, away from null, in standard deviations of its prior."""
    key = key_of(step)
    null = now.found.model.file.meaning(key).null or 0.0
    return (now.found.model.values()[key] - null) / now.found.prior.sd[key]


def _without(found: Fit, name: str, runs: Sequence[Run]) -> Fit | None:
    model = without_part(found.model, name)
    left = model.values()
    kept = [key for key in found.prior.keys if key in left]
    known = found.prior
    prior = Prior(
        {key: known.centre[key] for key in kept},
        {key: known.sd[key] for key in kept},
        {key: known.bounds[key] for key in kept},
    )
    try:
        return fit(model, runs, prior, found.whiteners)
    except ModelError:
        return None
