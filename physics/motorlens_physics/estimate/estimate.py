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

from motorlens_physics.estimate.between_samples import otherwise
from motorlens_physics.estimate.fit import CONVERGED, NEAR, Fit, fit, foretold, inverse, start_model, white
from motorlens_physics.estimate.hum import hum_of_channels
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.noise_likelihood import PIECE
from motorlens_physics.estimate.pieces import as_found, cut, pieces_of, prior_of, starting_as
from motorlens_physics.estimate.points import (
    at,
    from_noise,
    gained,
    minimised,
    needed,
    noisier,
    simulated_as,
    with_colour,
    with_moments,
    with_rough_inputs,
    with_uneven_noise,
)
from motorlens_physics.estimate.prior import Prior, at_prior, base_prior
from motorlens_physics.estimate.report import Findings, findings
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.shaft import followed
from motorlens_physics.estimate.spikes import spikes_of_channels, spikes_of_inputs
from motorlens_physics.estimate.timing import Timing, moved
from motorlens_physics.estimate.weighed import Array, Errors, Weighed
from motorlens_physics.motor_file import MotorFile

# Delays are looked for in this many times as many samples as everything else, for they may be a tenth of what is looked at;
# and so many are next.
FARTHER = 4
# Relative error of simulations until all samples are looked at.
COARSE = 1e-4
# Steps with all samples for which the noise is as it was found in pieces: the first makes up for what those did not tell.
TRUSTED = 1
# Updates of the noise at the end.
SETTLED = 20
# What is not told is put back where it was; the others are fitted again if that moves one by more than this share of its
# deviation.
MOVES = 0.05


@dataclass(frozen=True)
class Estimate:
    """A motor fitted to recordings, with the noise that was found in them.

    Attributes:
        fit: parameters and their covariance, scatter between blocks of time included.
        runs: the recordings with their noise and their corrected inputs, delays taken out.
        converged: whether what was left to go is small against the standard deviations.
        outliers: samples left out because no noise explains them.
        otherwise: per run, the probability that voltage or load torque did not run between samples as they were taken to;
            empty where how they ran was given. What it leaves open is in the covariance.
    """

    fit: Fit
    runs: tuple[Run, ...]
    converged: bool
    outliers: int
    otherwise: tuple[float, ...] = ()


def estimate(
    file: MotorFile,
    runs: Sequence[Run],
    prior: Prior | None = None,
    *,
    held: bool | None = None,
    begin: Model | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Estimate:
    """Fit a motor to prepared recordings.

    Args:
        file: the motor, with what is known of it.
        runs: prepared recordings.
        prior: the free parameters; None is all that is not known exactly, see `base_prior`.
        held: whether measured inputs hold between samples or run linearly; None decides by the likelihood, each input and
            recording of its own.
        begin: where to begin; None is where the motor file says, see `at_prior`.
        progress: told what goes on.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    prior = base_prior(file, runs) if prior is None else prior
    model = start_model(at_prior(file, prior), runs) if begin is None else begin
    if held is not None:
        model = replace(model, held=((held, held, held),) * len(runs))

    def best(runs: Sequence[Run]) -> tuple[Weighed, Array, float]:
        reached = near(runs, prior, model, free=held is None, progress=progress)
        return _tempered(whole(reached, model, runs, prior, progress), prior, progress)

    point, gram, left = best(runs)
    driven = [part.run.without(spikes_of_inputs(part)) for part in point.parts]
    if any(run is not part.run for run, part in zip(driven, point.parts, strict=True)):
        # What a spike of an input did to the simulation may have passed for another timing, and for spikes of the channels.
        point, gram, left = best([run.as_recorded.showing(False) for run in driven])
    quiet = [_without_hum(part) for part in point.parts]
    if any(run is not part.run for run, part in zip(quiet, point.parts, strict=True)):
        # It passes for coloured noise.
        point, gram, left = best([run.as_recorded.showing(False) for run in quiet])
    alone = _without_spikes(point, prior)
    if alone is not point:
        point, gram, left = _tempered(alone, prior, progress)
    found = _concluded(point, prior, gram, left)
    if held is None:
        chances, spread = otherwise(point, prior)
        found = replace(
            found, fit=replace(found.fit, covariance=found.fit.covariance + spread), otherwise=chances
        )
    said = findings(found.fit)
    if said.told and said.untold and _shifted(found, said):
        found = _put_back(found, point, said, progress)
    return replace(found, runs=_followed(found.fit.model, found.runs))


def whole(
    reached: Weighed,
    begin: Model,
    runs: Sequence[Run],
    prior: Prior,
    progress: Callable[[str], None] = lambda text: None,
) -> Weighed:
    """From near the best parameters as pieces of runs tell them to near those of all samples.

    Args: where `near` has led; the others as of `estimate`.

    Raises:
        ModelError: the motor cannot be simulated there.
    """
    point = _with_more(reached, *pieces_of(begin, runs, FARTHER * PIECE), runs, prior, progress)
    point = _with_more(point, begin, runs, runs, prior, progress)
    return _with_shaft(point, begin.tolerance, prior)


def near(
    runs: Sequence[Run],
    prior: Prior,
    begin: Model,
    *,
    free: bool = True,
    progress: Callable[[str], None] = lambda text: None,
) -> Weighed:
    """Near the best parameters: in pieces of long runs, with delays, the way inputs ran between samples, and noise.

    Args: as of `estimate`; inputs run as they do in `begin` unless how they ran is `free`.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    progress("coming near")
    begin = replace(begin, tolerance=COARSE)
    wide, longer = pieces_of(begin, runs, FARTHER * PIECE)
    model, pieces = pieces_of(wide, longer, PIECE)
    every = prior_of(prior, begin, pieces, cut(runs, pieces))
    prior = every.only([key for key in every.keys if not _knee(begin, key)])
    timing = Timing(model, wide, longer, prior, progress)
    point = timing.held_at_file(timing.likeliest(timing.near(model, pieces), free=free))
    between = with_moments(point)
    if between is not point:
        point = minimised(between, prior, progress, outliers=False)[0]
        point = timing.under_its_noise(point, model, pieces, free=free)
    # Parameters that are wrong leave errors that follow the inputs, and that last.
    rough = with_rough_inputs(point, prior)
    point = point if rough is point else minimised(rough, prior, progress, outliers=False)[0]
    coloured = with_colour(point)
    if coloured is not point:
        point = minimised(coloured, prior, progress, outliers=False)[0]
        point = timing.under_its_noise(point, model, pieces, free=free)
    uneven = with_uneven_noise(point)
    point = point if uneven is point else minimised(uneven, prior, progress, outliers=False)[0]
    return point if prior.keys == every.keys else at(point.model, point, every)


def _knee(model: Model, key: str) -> bool:
    """Whether a parameter is how sharp a transition's knee is, which hardly shows until all else is found."""
    return "@" not in key and model.file.meaning(key).role == "knee"


def by_least_squares(runs: Sequence[Run], prior: Prior, begin: Model) -> float:
    """How unlikely what least squares leave is, as white noise, no channel moved: of models to be tried the least first.

    Args: as of `near`.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    begin, pieces = pieces_of(replace(begin, tolerance=COARSE), runs, PIECE)
    prior = prior_of(prior, begin, pieces, cut(runs, pieces))
    straight = prior.only([key for key in prior.keys if not key.startswith("skew.")])
    return white(fit(begin, pieces, straight, rounds=NEAR, enough=1.0), pieces)


def one_step_ahead(point: Weighed, runs: Sequence[Run], prior: Prior, begin: Model) -> float:
    """The least cost of a model as linearised about where least squares leads it, much sooner known than by `near`.

    Args:
        point: where `near` has led another model of the same recordings, whose pieces, timing, noise and corrected inputs
            are taken as they are.
        runs: prepared recordings.
        prior: the free parameters.
        begin: where to begin.

    Raises:
        ModelError: the motor cannot be simulated where it starts, or where that leads.
    """
    few = cut(runs, point.runs)
    begin = starting_as(replace(begin, tolerance=COARSE), start_model(begin.file, point.runs), few)
    prior = prior_of(prior, begin, point.runs, few)
    skews = {key: point.model.values()[key] for key in prior.keys if key.startswith("skew.")}
    along = [replace(run, corrections=None) for run in point.runs]
    straight = prior.only([key for key in prior.keys if key not in skews])
    rough = fit(begin, along, straight, rounds=NEAR, enough=1.0).model
    return foretold(at(rough.with_values(skews), point, prior), prior)


def beside(
    model: Model, runs: Sequence[Run], prior: Prior, progress: Callable[[str], None] = lambda text: None
) -> Estimate:
    """An estimate near one that was made before: other things are known of the parameters, timing stays as it was found.

    Args:
        model: where to begin, and how inputs ran between samples.
        runs: prepared recordings, delays taken out, with their noise.
        prior: the free parameters.
        progress: told what goes on.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    noises = [run.noise for run in runs if run.noise is not None]
    point = _with_shaft(from_noise(model, runs, noises, prior), model.tolerance, prior)
    point, gram, left = _tempered(point, prior, progress, trusted=TRUSTED)
    return _concluded(point, prior, gram, left)


def _tempered(
    point: Weighed, prior: Prior, progress: Callable[[str], None], *, trusted: int = 0
) -> tuple[Weighed, Array, float]:
    """The best parameters from a point, what no noise explains weighed as little as it tells."""
    point, gram, left = minimised(point, prior, progress, outliers=True, trusted=trusted)
    # Only where it ends does scatter between blocks tell of what is missing; on the way it is the parameters that are wrong.
    tempered = point.tempered()
    if tempered.inflation > 1.0:
        point, gram, left = minimised(tempered, prior, progress, outliers=True)
    return point, gram, left


def _without_hum(part: Errors) -> Run:
    run = part.run
    for hum in hum_of_channels(part):
        run = run.less(hum.channel, hum.frequency_Hz, hum.line)
    return run


def _without_spikes(point: Weighed, prior: Prior) -> Weighed:
    """The best parameters without samples of channels that stand alone; itself if there are none."""
    runs = [part.run.without(spikes_of_channels(part)) for part in point.parts]
    if all(run is part.run for run, part in zip(runs, point.parts, strict=True)):
        return point
    parts = tuple(replace(part, run=run, used=run.there) for run, part in zip(runs, point.parts, strict=True))
    return at(point.model, replace(point, parts=parts, inflation=1.0), prior)


def _with_shaft(near: Weighed, tolerance: float, prior: Prior) -> Weighed:
    """A point near the best parameters with what shows only there, where its shaft stood, simulated this exactly."""
    turned = any(
        state.kind == "angle" for effect in near.model.file.motor.effects for state in effect.states.values()
    )
    runs = _followed(near.model, near.runs) if turned else near.runs
    alike = all(run is part.run for part, run in zip(near.parts, runs, strict=True))
    if alike and tolerance == near.model.tolerance:
        return near
    parts = tuple(replace(part, run=run) for part, run in zip(near.parts, runs, strict=True))
    return simulated_as(replace(near, parts=parts), tolerance, prior)


def _followed(model: Model, runs: Sequence[Run]) -> tuple[Run, ...]:
    return tuple(followed(run, *predict(model, run, r)) for r, run in enumerate(runs))


def _shifted(found: Estimate, said: Findings) -> bool:
    """Whether putting back what is not told moves the rest of a fit by more than `MOVES` deviations."""
    keys, fitted = found.fit.prior.keys, found.fit.model.values()
    back = np.array([said.value[key] - fitted[key] for key in said.untold])
    of = [keys.index(key) for key in said.untold]
    rest = [keys.index(key) for key in said.told]
    covariance = found.fit.covariance
    moved = covariance[np.ix_(rest, of)] @ inverse(covariance[np.ix_(of, of)]) @ back
    return bool(np.any(np.abs(moved) > MOVES * np.sqrt(np.diagonal(covariance)[rest])))


def _put_back(found: Estimate, end: Weighed, said: Findings, progress: Callable[[str], None]) -> Estimate:
    """An estimate with what is not told where it was before; the rest, which leant on where it had gone, fitted again.

    Itself where the recordings are likelier as it is.
    """
    prior = found.fit.prior
    rest = prior.only([key for key in prior.keys if key not in said.untold])
    model = found.fit.model.with_values({key: said.value[key] for key in said.untold})
    # What had made up for it is far off at first, and no outlier.
    near = minimised(
        replace(at(model, end, rest), inflation=end.inflation),
        rest,
        progress,
        outliers=False,
        trusted=TRUSTED,
    )[0]
    again, gram, left = minimised(near, rest, progress, outliers=True)
    # What together is told may be untold one by one.
    if gained(again, end, prior) > needed(1):
        return found
    other = _concluded(again, rest, gram, left)
    return replace(
        other,
        fit=replace(other.fit, prior=prior, covariance=found.fit.covariance),
        otherwise=found.otherwise,
    )


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
    point = from_noise(model, found, [part.noise for part in near.parts], prior)
    # The flanks that tell when a channel was sampled may be few, and elsewhere.
    return moved(minimised(point, prior, progress, outliers=False, trusted=TRUSTED)[0], prior, progress)


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
    found = Fit(end.model, prior, covariance, residuals, left)
    outliers = sum(int(np.sum(part.run.there & ~part.used)) for part in end.parts)
    return Estimate(found, runs, left < CONVERGED, outliers)
