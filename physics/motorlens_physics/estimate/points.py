"""Points at which `fit.minimise` stands: how they are made, noise and all, and which of two is likelier.

`minimised` goes on from one, noise and corrected inputs found along the way.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from motorlens_physics.estimate.fit import minimise
from motorlens_physics.estimate.model import Model, predict, sensitivities_of
from motorlens_physics.estimate.noise import TORQUE, Noise, first_noise
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import CHANCE, Array, Errors, Frame, Weighed, without_noise
from motorlens_physics.threads import on_all_cores

# Updates of the noise while parameters are sought.
BRIEFLY = 8
# Steps, with the noise as it is found.
ROUNDS = 20
# The fit ends this close to the minimum, in standard deviations of the result.
ENOUGH = 0.05
# Relative difference of the steps of two recordings below which one converter has read both.
SAME_STEP = 1e-3
# Close enough to look at how the inputs ran, and at outliers: what a step changes is then noise.
CLOSE = 1.0


def weighed(model: Model, runs: Sequence[Run], noises: Sequence[Noise], used: Sequence[NDArray[np.bool_]],
            keys: Sequence[str]) -> Weighed:  # fmt: skip
    """Errors and sensitivities of all runs at a model, along their corrected inputs.

    Raises:
        ModelError: a simulation cannot go on.
    """

    def one(r: int) -> Errors:
        run = runs[r].holding(model.held[r])
        mine = tuple(k for k, key in enumerate(keys) if "@" not in key or key.endswith(f"@{r}"))
        _, shown, columns, linear = sensitivities_of(model, run, r, [keys[k] for k in mine])
        difference, frame = run.measured - shown, Frame(model, run, r, linear)
        return Errors(run, difference, columns, mine, frame, noises[r], used[r], frame.error(difference))

    return Weighed(model, tuple(on_all_cores(one, range(len(runs)))), len(keys))


def at(model: Model, latest: Weighed, prior: Prior) -> Weighed:
    """A point at other parameters, with the noise, the corrections, the samples and the inflation of the latest."""
    parts = latest.parts
    other = weighed(
        model,
        [part.run for part in parts],
        [part.noise for part in parts],
        [part.used for part in parts],
        prior.keys,
    )
    return replace(other, inflation=latest.inflation)


def shown_at(model: Model, latest: Weighed) -> Weighed:
    """The same without sensitivities and not linearised, to be seen in the frames of the latest.

    Raises:
        ModelError: a simulation cannot go on.
    """

    frames = latest.frames

    def one(r: int) -> Errors:
        part, frame = latest.parts[r], frames[r]
        difference = part.run.measured - predict(model, part.run.holding(model.held[r]), r)[1]
        none = np.empty((*difference.shape, 0))
        return replace(
            part, difference=difference, columns=none, mine=(), frame=frame, error=frame.error(difference)
        )

    return replace(latest, model=model, parts=tuple(on_all_cores(one, range(len(latest.parts)))))


def noisier(point: Weighed, updates: int, *, lasting_too: bool = False, outliers: bool = False) -> Weighed:
    """The same point under the noise that its errors show."""

    def one(part: Errors) -> Errors:
        if lasting_too:
            part = part.with_duration()
        return part.with_noise(updates, outliers=outliers)

    return replace(point, parts=tuple(on_all_cores(one, point.parts)))


def with_rough_inputs(point: Weighed, prior: Prior) -> Weighed:
    """A point near the best parameters with inputs as noisy as the errors say that follow them; itself if none is."""
    # Sensitivities along corrected inputs do not hold what a parameter does to their roughness.
    recorded = weighed(
        point.model,
        [replace(part.run, corrections=None) for part in point.parts],
        [part.noise for part in point.parts],
        [part.used for part in point.parts],
        prior.keys,
    )
    parts = tuple(
        part.with_rough_inputs(other) for part, other in zip(point.parts, recorded.parts, strict=True)
    )
    return _with_parts(point, tuple(_as_noisy_as(part, parts) for part in parts))


def _as_noisy_as(part: Errors, parts: Sequence[Errors]) -> Errors:
    """With inputs as noisy at least as errors say of other recordings by the same converter, which its step tells.

    A slow recording, or one of a motor at rest whose current stays at one reading, says nothing of it.
    """
    least = part.noise.least[:TORQUE].copy()
    for which, step in enumerate(part.run.input_step):
        alike = [
            one.noise.least[which]
            for one in parts
            if abs(one.run.input_step[which] - step) < SAME_STEP * step
        ]
        least[which] = min(max(alike, default=0.0), part.noise.most[which])
    return (
        part
        if np.all(least <= part.noise.least[:TORQUE])
        else replace(part, noise=part.noise.followed(least))
    )


def with_moments(point: Weighed) -> Weighed:
    """A point near the best parameters whose inputs changed between samples where that is likelier; itself if none did."""
    return _with_parts(point, tuple(on_all_cores(Errors.with_moments, point.parts)))


def with_colour(point: Weighed) -> Weighed:
    """A point near the best parameters with coloured noise in each run where that is likelier; itself if in none."""
    return _with_parts(point, tuple(on_all_cores(Errors.with_colour, point.parts)))


def with_uneven_noise(point: Weighed) -> Weighed:
    """A point near the best parameters with noise that differs with the size of the voltage where that is likelier.

    Itself if it does in none.
    """
    return _with_parts(point, tuple(on_all_cores(Errors.with_uneven_noise, point.parts)))


def _with_parts(point: Weighed, parts: tuple[Errors, ...]) -> Weighed:
    """The point with other noise; itself if it is the same."""
    if all(one is part for one, part in zip(parts, point.parts, strict=True)):
        return point
    return noisier(replace(point, parts=parts), 0)


def minimised(
    point: Weighed, prior: Prior, progress: Callable[[str], None], *, outliers: bool, trusted: int = 0
) -> tuple[Weighed, Array, float]:
    """The best parameters from a point, noise and corrected inputs found along the way.

    Args:
        point: where to begin.
        prior: the free parameters.
        progress: told how far there is to go.
        outliers: leave them out, and go to the end; otherwise all samples count, and it only comes `CLOSE`.
        trusted: for how many steps the noise stays as it is, because it was found where errors were small.
    """
    latest, updates = [point], iter([0] * trusted)

    def between(here: Weighed) -> Weighed:
        latest[0] = noisier(here, next(updates, BRIEFLY), outliers=outliers)
        return latest[0]

    # Corrections that were made far away must not keep it from going on.
    def anew(here: Weighed) -> Weighed:
        return at(here.model, here, prior)

    end, gram, left = minimise(
        point, prior, lambda model: at(model, latest[0], prior), lambda model: shown_at(model, latest[0]), rounds=ROUNDS,
        enough=ENOUGH if outliers else CLOSE, between=between, anew=anew, progress=progress,
    )  # fmt: skip
    return end, gram, left


def needed(tried: int) -> float:
    """What `gained` must exceed for one parameter more: the level of `CHANCE` for the best of so many that were tried."""
    return float(chdtri(1, CHANCE / tried))


def gained(point: Weighed, other: Weighed, prior: Prior) -> float:
    """Twice the gain in logarithmic likelihood from one point to another of the same runs, channels moved or not.

    Both are looked at in the frames and with the noise of the first, at the samples that both have, and a gain counts as
    much less as blocks of time scatter more than noise says.
    """
    won = prior.penalty(point.model.values()) - prior.penalty(other.model.values())
    for r, (a, frame) in enumerate(zip(point.parts, point.frames, strict=True)):
        run = replace(other.parts[r].run, corrections=a.run.corrections).holding(other.model.held[r])
        moved = tuple(run.late.get(c, 0) - a.run.late.get(c, 0) for c in run.channels)
        _, shown = predict(other.model, run, r)
        here = replace(a, frame=frame, used=a.run.there & moved_on(run.there, moved))
        there = replace(here, error=frame.error(moved_on(run.measured - shown, moved)))
        won += here.squares() - there.squares()
    return won / point.tempered().inflation


def moved_on(y: NDArray[Any], samples: Sequence[int]) -> NDArray[Any]:
    """(N, C, ...) with each channel moved later by some samples; what comes in at an end is 0."""
    if not any(samples):
        return y
    out = np.zeros_like(y)
    for c, lag in enumerate(samples):
        first, last = max(lag, 0), len(y) + min(lag, 0)
        out[first:last, c] = y[first - lag : last - lag, c]
    return out


def first_point(model: Model, runs: Sequence[Run]) -> Weighed:
    """The point at a model with all samples, and noise as large as the errors there; it has no normal equations."""
    unknown = [_nothing_known(model, run) for run in runs]
    point = weighed(model, runs, unknown, [run.there for run in runs], ())
    torque = model.file.rated.torque_Nm
    parts = [
        replace(part, noise=first_noise(part.run, part.error, torque, model.tolerance))
        for part in point.parts
    ]
    return replace(point, parts=tuple(parts))


def _nothing_known(model: Model, run: Run) -> Noise:
    """The noise of a run that has not been simulated yet."""
    return first_noise(run, np.ones_like(run.measured), model.file.rated.torque_Nm, model.tolerance)


def simulated_as(point: Weighed, tolerance: float, prior: Prior) -> Weighed:
    """The same point, simulated this exactly, with noise that is believed as far as that."""
    model = replace(point.model, tolerance=tolerance)
    parts = tuple(
        replace(part, noise=_nothing_known(model, part.run).like(part.noise, part.run))
        for part in point.parts
    )
    return at(model, replace(point, parts=parts), prior)


def begun(model: Model, runs: Sequence[Run], prior: Prior) -> Weighed:
    """A first point, with its noise found, along inputs corrected by it."""
    return at(model, noisier(first_point(model, runs), 0, lasting_too=True), prior)


def from_noise(model: Model, runs: Sequence[Run], noises: Sequence[Noise], prior: Prior) -> Weighed:
    """A point with noise that was found before, along inputs corrected by it."""
    noises = [_nothing_known(model, run).like(found, run) for run, found in zip(runs, noises, strict=True)]
    # At first by what shows in the inputs alone.
    runs = [without_noise(run, noise) for run, noise in zip(runs, noises, strict=True)]
    point = weighed(model, runs, noises, [run.there for run in runs], ())
    return at(model, noisier(point, 0), prior)
