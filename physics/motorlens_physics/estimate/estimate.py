"""The estimate of a motor from recordings, with noise found in them: the one way a motor is fitted.

Noise on a measured input drives the simulation, but did not drive the motor. Least squares that takes inputs as they were
measured is therefore biased: its sensitivities hold the same noise as its errors (errors in variables; Söderström 2007,
doi:10.1016/j.automatica.2006.11.025). Here the inputs are unknowns like the parameters: those are sought that, together
with their own measurement, explain everything measured best (Fuller 1987, Measurement Error Models, ISBN
978-0-471-86187-4, chapter 3, for static ones). For given parameters, what the inputs' sensors showed too little is what a
smoother expects given all measurements (`innovations.disturbances`). Sensitivities along the corrected inputs are
independent of the errors that are left, whatever their weights, so that the estimate is consistent; and the innovations'
weights make it efficient.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorlens_physics.estimate.between_samples import BETTER, as_they_ran
from motorlens_physics.estimate.delays import LEVEL, gain, late_channels, nearer, realigned
from motorlens_physics.estimate.fit import NEAR, Fit, fit, inverse, plain_noise, squares, start_model
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.noise import PIECE, Noise
from motorlens_physics.estimate.pieces import as_found, cut, pieces_of, prior_of, starting_as
from motorlens_physics.estimate.prior import Prior, base_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import (
    Array,
    Weighed,
    at,
    begun,
    first_point,
    minimised,
    noisier,
    unlikely,
)
from motorlens_physics.motor_file import MotorFile

# Delays are looked for in this many times as many samples as everything else, for they may be a tenth of what is looked at;
# and so many are next.
FARTHER = 4
# How often channels that are late are looked for again.
REALIGNED = 4
# Relative error of simulations until all samples are looked at.
COARSE = 1e-4
# Steps with all samples for which the noise is as it was found in pieces: the first make up for what those did not tell.
TRUSTED = 2
# Updates of the noise at the end.
SETTLED = 20
# A fit this close to the minimum, in standard deviations of the result, counts as converged.
CONVERGED = 0.3


@dataclass(frozen=True)
class Estimate:
    """A motor fitted to recordings, with the noise that was found in them.

    Attributes:
        fit: parameters and their covariance, scatter between blocks of time included.
        runs: the recordings with their noise and their corrected inputs, delays taken out.
        converged: whether what was left to go is small against the standard deviations.
        outliers: samples left out because no noise explains them.
    """

    fit: Fit
    runs: tuple[Run, ...]
    converged: bool
    outliers: int


def estimate(
    file: MotorFile,
    runs: Sequence[Run],
    prior: Prior | None = None,
    *,
    held: bool | None = None,
    begin: Model | None = None,
    onward: bool = False,
    progress: Callable[[str], None] = lambda text: None,
) -> Estimate:
    """Fit a motor to prepared recordings.

    Args:
        file: the motor, with what is known of it.
        runs: prepared recordings.
        prior: the free parameters; None is all that is not known exactly, see `base_prior`.
        held: whether measured inputs hold between samples or run linearly; None decides by the likelihood, each input and
            recording of its own.
        begin: where to begin, instead of the motor file.
        onward: go on from an earlier estimate, whose runs these are: their delays and how their inputs ran stay, and their
            noise is where this one begins. What changed since then should be small.
        progress: told what goes on.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    prior = base_prior(file, runs) if prior is None else prior
    model = start_model(file, runs) if begin is None else begin
    if held is not None:
        model = replace(model, held=((held, held, held),) * len(runs))
    progress("coming near")
    if onward:
        point = _from_noise(model, runs, [run.noise for run in runs], prior)
    else:
        point = _near(replace(model, tolerance=COARSE), runs, prior, held, progress)
        point = _with_more(point, *pieces_of(model, runs, FARTHER * PIECE), runs, prior, progress)
        point = _with_more(point, model, runs, runs, prior, progress)
    if point.model.tolerance != model.tolerance:
        point = at(replace(point.model, tolerance=model.tolerance), point, prior)
    point, gram, left = minimised(point, prior, progress, outliers=True)
    # Only where it ends does scatter between blocks tell of what is missing; on the way it is the parameters that are wrong.
    tempered = point.tempered()
    if tempered.inflation > 1.0:
        point, gram, left = minimised(tempered, prior, progress, outliers=True)
    return _concluded(point, prior, gram, left)


def _near(
    begin: Model, whole: Sequence[Run], prior: Prior, held: bool | None, progress: Callable[[str], None]
) -> Weighed:
    """Near the best parameters: in pieces of long runs, with delays, the way inputs ran between samples, and noise."""
    wide, longer = pieces_of(begin, whole, FARTHER * PIECE)
    model, runs = pieces_of(wide, longer, PIECE)
    prior = prior_of(prior, begin, runs, cut(whole, runs))
    # Without skews, which would make up for inputs that ran otherwise between their samples.
    straight = prior.only([key for key in prior.keys if not key.startswith("skew.")])
    rough = fit(model, runs, straight, rounds=NEAR, enough=1.0)
    # What is late bends the fit, and a motor that is slower than its file looks late: each is tried in full.
    for seen_from in (wide, starting_as(rough.model, wide, cut(longer, runs))):
        late = late_channels(seen_from, longer)
        moved = tuple(as_found(run, other) for run, other in zip(runs, late, strict=True))
        if any(one is not run for one, run in zip(moved, runs, strict=True)):
            tried = fit(model, moved, straight, rounds=NEAR, enough=1.0)
            if gain(rough.residuals, tried.residuals) > LEVEL:
                runs, rough = nearer(moved, tried, straight)
                break
    point = begun(rough.model, runs, prior)
    # While parameters are wrong, a large error is theirs, and every sample counts.
    point, _, _ = minimised(point, prior, progress, outliers=False)
    ran = point.runs if held is not None else as_they_ran(point, prior)
    other = point
    if any(one is not run for one, run in zip(ran, point.runs, strict=True)):
        # Parameters fitted to inputs that ran otherwise have made up for it.
        runs = tuple(replace(run, corrections=None) for run in ran)
        skews = {key: 0.0 for key in prior.keys if key not in straight.keys}
        again = replace(point.model.with_values(skews), held=tuple(run.inputs.hold for run in runs))
        rough = fit(again, runs, straight, rounds=NEAR, enough=1.0)
        other = begun(rough.model, runs, prior)
    for _ in range(REALIGNED):
        other = realigned(other, prior)
        if other is point:
            break
        other, _, _ = minimised(other, prior, progress, outliers=False)
        # One step away promised it; where it truly ends must hold it.
        if unlikely(other, prior) > unlikely(point, prior) - BETTER:
            break
        point = other
    return point


def _with_more(
    near: Weighed,
    begin: Model,
    runs: Sequence[Run],
    whole: Sequence[Run],
    prior: Prior,
    progress: Callable[[str], None],
) -> Weighed:
    """From a point of some samples near the best parameters of more of them; itself if there are no more."""
    more = cut(runs, near.runs)
    if not any(more):
        return near
    progress(f"{sum(len(run.measured) for run in runs)} samples")
    few = cut(whole, runs)
    model = replace(starting_as(near.model, begin, more), tolerance=COARSE if any(few) else begin.tolerance)
    found = tuple(as_found(run, piece) for run, piece in zip(runs, near.runs, strict=True))
    prior = prior_of(prior, begin, runs, few)
    point = _from_noise(model, found, [part.noise for part in near.parts], prior)
    return minimised(point, prior, progress, outliers=False, trusted=TRUSTED)[0]


def _from_noise(model: Model, runs: Sequence[Run], noises: Sequence[Noise | None], prior: Prior) -> Weighed:
    """A point with noise that was found before."""
    point = first_point(model, runs, prior.keys)
    parts = [
        part if known is None else replace(part, noise=part.noise.like(known))
        for part, known in zip(point.parts, noises, strict=True)
    ]
    return replace(point, parts=tuple(parts))


def _concluded(end: Weighed, prior: Prior, gram: Array, left: float) -> Estimate:
    end = noisier(end, SETTLED, outliers=True)
    model_based = inverse(gram)
    scores = end.scores() / end.inflation
    count = len(scores)
    sandwich = model_based @ (scores.T @ scores) @ model_based * count / max(count - 1, 1)
    wider = np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(model_based), 1.0))
    covariance = model_based * np.outer(wider, wider)
    runs = tuple(replace(part.run, noise=part.noise) for part in end.parts)
    residuals = tuple(part.run.average(part.error) for part in end.parts)
    whiteners = plain_noise(residuals, runs)
    found = Fit(
        end.model, prior, whiteners, squares(residuals, runs, whiteners), prior.penalty(end.model.values()), covariance,
        residuals, left,
    )  # fmt: skip
    outliers = sum(int(np.sum(part.run.there & ~part.used)) for part in end.parts)
    return Estimate(found, runs, left < CONVERGED, outliers)
