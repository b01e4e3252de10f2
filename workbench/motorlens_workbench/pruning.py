"""Whether what was accepted early is still needed beside what was accepted later, for which it may have stood in.

Forward choice with elimination: Efroymson (1960), Multiple regression analysis, in Ralston and Wilf (eds.), Mathematical
methods for digital computers, Wiley.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from motorlens_physics.estimate.fit import Fit, fit
from motorlens_physics.estimate.model import Model, parts_of, with_effect, with_sensor, without_part
from motorlens_physics.estimate.prior import Prior, part_prior, start_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.sensor_model import SensorModel
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.evidence import own_score, similarity
from motorlens_workbench.look import Look
from motorlens_workbench.selection import REAL, WORTH, possible, total
from motorlens_workbench.steps import NEAR, Step, among, as_good, inflation_of


def dispensable(steps: Sequence[Step], now: Look, runs: Sequence[Run]) -> tuple[Step, Fit] | None:
    """The step before the last that would not be accepted beside the others, and the fit without it; None if all would be.

    Args:
        steps: effects accepted, in order.
        now: the screen with all of them.
        runs: prepared recordings.
    """
    earlier = steps[:-1]
    fits = on_all_cores(lambda step: _without(now.found, step.test.candidate.name, runs), earlier)
    losses = {}
    for step, less in zip(earlier, fits, strict=True):
        seen = own_score(now.evidence, now.found.prior.keys, step.test.candidate.key)
        if less is None or seen is None:
            continue
        loss = total(less) - total(now.found)
        if loss < max(REAL * seen.inflation, WORTH * now.samples, among(steps, step.test.candidate)):
            losses[loss] = step, less
    return losses[min(losses)] if losses else None


def simpler(steps: Sequence[Step], now: Look, runs: Sequence[Run]) -> tuple[Step, Step] | None:
    """A step before the last, and the one of a simpler rival that does as well beside the others; None if none does.

    While others were missing, what claims more had more to explain.
    """
    for step in steps[:-1]:
        able = {
            name: test
            for name, test in step.rivals.items()
            if test.candidate.claims < step.test.candidate.claims
            and now.found.model.file.motor.effect(name) is None
        }
        tries = on_all_cores(partial(_instead, now.found, step, runs), able)
        for (name, test), tried in zip(able.items(), tries, strict=True):
            if tried is not None and as_good(tried, now.found, inflation_of(step.test), runs):
                winner = step.test.candidate.name
                return step, replace(
                    step, test=test, found=tried, losses={**step.losses, name: 0.0, winner: 0.0}
                )
    return None


def _instead(found: Fit, step: Step, runs: Sequence[Run], name: str) -> Fit | None:
    """The fit with a rival in the place of a step, begun where the rival had been fitted."""
    less = without_part(found.model, step.test.candidate.name)
    part = next(part for part in parts_of(step.refits[name].model.file) if part.name() == name)
    model = with_sensor(less, part) if isinstance(part, SensorModel) else with_effect(less, part)
    prior = _of(found.prior, less).joined(part_prior(model.file, name)).joined(start_prior(model, name))
    try:
        return fit(model, runs, prior, found.whiteners)
    except ModelError:
        return None


def seen_from(step: Step, last: Look) -> Step:
    """The step with what resembles it, and could replace it, as seen from the final model, which lacks nothing else."""
    assert step.test.score is not None
    key, own = step.test.candidate.key, f"{step.test.candidate.name}."
    # A rival stands in for the effect as it is, its shape as well.
    left = last.evidence.given([other for other in last.found.prior.keys if not other.startswith(own)])
    size = _size(step, last)
    alike, losses = {}, dict(step.losses)
    for name, test in last.tests.items():
        if test.involved:
            continue
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
    key = step.test.candidate.key
    null = now.found.model.file.meaning(key).null or 0.0
    return (now.found.model.values()[key] - null) / now.found.prior.sd[key]


def _without(found: Fit, name: str, runs: Sequence[Run]) -> Fit | None:
    model = without_part(found.model, name)
    try:
        return fit(model, runs, _of(found.prior, model), found.whiteners)
    except ModelError:
        return None


def _of(known: Prior, model: Model) -> Prior:
    """What is known of those parameters that a model has."""
    values = model.values()
    kept = [key for key in known.keys if key in values]
    return Prior(
        {key: known.centre[key] for key in kept},
        {key: known.sd[key] for key in kept},
        {key: known.bounds[key] for key in kept},
    )
