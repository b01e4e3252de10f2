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
from itertools import product

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.delays import LEVEL, MOST_OF_A_SAMPLE, gain, late_channels
from motorlens_physics.estimate.fit import (
    Fit,
    fit,
    inverse,
    minimise,
    plain_noise,
    squares,
    start_model,
)
from motorlens_physics.estimate.innovations import disturbances, innovations
from motorlens_physics.estimate.model import Model, error_of, sensitivities_of
from motorlens_physics.estimate.noise import LOAD, OUTLIER, VOLTAGE, Noise, first_noise, lasting, likelier
from motorlens_physics.estimate.prior import Prior, base_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensitivity import Linearisation
from motorlens_physics.threads import on_all_cores

Array = NDArray[np.float64]

# Updates of the noise: while parameters are sought, at the beginning, and at the end.
BRIEFLY, AT_FIRST, SETTLED = 2, 6, 20
# Blocks of time between which the scatter of the scores is looked at.
BLOCKS = 64
# Steps with white noise, to come near; and with the noise as it is found.
NEAR, ROUNDS = 8, 20
# The fit ends this close to the minimum, in standard deviations of the result, and counts as converged within the second.
ENOUGH, CONVERGED = 0.02, 0.3
# Close enough to look at how the inputs ran, and at outliers: what a step changes is then noise.
CLOSE = 1.0
# How often inputs that ran otherwise, and channels that are late, are looked for again.
REALIGNED = 4
# Twice the logarithm of the likelihood by which another way the inputs ran must be better: that of one parameter more at
# the 1 % level.
BETTER = 6.6


@dataclass(frozen=True)
class Errors:
    """One run at some parameters.

    Attributes:
        run: with its corrected inputs.
        error: (N, C) beside the inputs as recorded.
        columns: (N, C, k) sensitivities along the corrected inputs, for the parameters that concern this run.
        mine: (k,) their positions.
        linear: the linearised motor.
        noise: of the run.
        used: (N, C) samples that count.
    """

    run: Run
    error: Array
    columns: Array
    mine: tuple[int, ...]
    linear: Linearisation
    noise: Noise
    used: NDArray[np.bool_]

    def white(self) -> Array:
        """(N, C, k + 1) innovations of sensitivities and, last, of the error."""
        table = np.concatenate([self.columns, self.error[:, :, None]], axis=2)
        return innovations(self.noise.space(self.run, self.linear, self.used), table).white

    def with_noise(self, updates: int, *, outliers: bool) -> "Errors":
        """With likelier noise, outliers left out if asked for, and the inputs' corrections expected under it."""
        noise, _ = likelier(self.noise, self.run, self.linear, self.error, self.used, updates)
        space = noise.space(self.run, self.linear, self.run.there)
        filtered = innovations(space, self.error[:, :, None])
        used = self.run.there
        if outliers:
            used = used & (np.abs(filtered.white[:, :, 0]) <= OUTLIER)
        seen, _, _ = disturbances(space, filtered)
        # A load brakes: what the torque balance got too little, the load sensor showed too much.
        corrections = np.column_stack([seen[:, VOLTAGE], -seen[:, LOAD]])
        return replace(self, noise=noise, used=used, run=self.run.corrected(corrections))


@dataclass(frozen=True)
class Weighed:
    """All runs at some parameters: a `Point`."""

    model: Model
    parts: tuple[Errors, ...]
    whites: tuple[Array, ...]
    size: int
    inflation: float = 1.0

    @property
    def cost(self) -> float:
        """Whitened sum of squares, over the inflation."""
        return float(sum(np.sum(white[:, :, -1] ** 2) for white in self.whites)) / self.inflation

    def tempered(self) -> "Weighed":
        """With an inflation by which blocks of time scatter more than their noise says, at least 1.

        What no noise explains has the same sign for long. Its samples are worth less than as many of noise, beside what is
        known of the parameters beforehand (Bissiri, Holmes and Walker 2016, doi:10.1111/rssb.12158).
        """
        plain = replace(self, inflation=1.0)
        gram, _ = plain.normal()
        scores = plain.scores()
        told = np.diagonal(gram) > 0
        scatter = np.sum((scores - scores.mean(axis=0)) ** 2, axis=0)[told] / np.diagonal(gram)[told]
        return replace(self, inflation=max(float(np.median(scatter)), 1.0))

    def normal(self) -> tuple[Array, Array]:
        """J^T J and J^T e."""
        gram, gradient = np.zeros((self.size, self.size)), np.zeros(self.size)
        for part, white in zip(self.parts, self.whites, strict=True):
            mine = list(part.mine)
            flat = white.reshape(-1, white.shape[2])
            products = flat.T @ flat
            gram[np.ix_(mine, mine)] += products[:-1, :-1]
            gradient[mine] += products[:-1, -1]
        return gram / self.inflation, gradient / self.inflation

    def scores(self) -> Array:
        """(B, k) sums of J^T e over blocks of time."""
        samples = sum(len(white) for white in self.whites)
        found = []
        for part, white in zip(self.parts, self.whites, strict=True):
            blocks = max(round(BLOCKS * len(white) / samples), 8)
            each = np.einsum("ncj,nc->nj", white[:, :, :-1], white[:, :, -1])
            edges = np.unique(np.linspace(0, len(white), min(blocks, len(white)) + 1).astype(int)[:-1])
            wide = np.zeros((len(edges), self.size))
            wide[:, list(part.mine)] = np.add.reduceat(each, edges, axis=0)
            found.append(wide)
        return np.concatenate(found)


def weighed(model: Model, runs: Sequence[Run], noises: Sequence[Noise], used: Sequence[NDArray[np.bool_]],
            keys: Sequence[str]) -> Weighed:  # fmt: skip
    """Errors and sensitivities of all runs at a model, along their corrected inputs.

    Raises:
        ModelError: a simulation cannot go on.
    """

    def one(r: int) -> tuple[Errors, Array]:
        run = runs[r].holding(model.held[r])
        mine = tuple(k for k, key in enumerate(keys) if "@" not in key or key.endswith(f"@{r}"))
        _, shown, columns, linear = sensitivities_of(model, run, r, [keys[k] for k in mine])
        error = error_of(model, run, r, run.measured - shown, linear)
        part = Errors(run, error, columns, mine, linear, noises[r], used[r])
        return part, part.white()

    parts = on_all_cores(one, range(len(runs)))
    return Weighed(model, tuple(part for part, _ in parts), tuple(white for _, white in parts), len(keys))


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
        progress: told what goes on.

    Raises:
        ModelError: the motor cannot be simulated where it starts.
    """
    prior = base_prior(file, runs) if prior is None else prior
    model = start_model(file, runs) if begin is None else begin
    if held is not None:
        model = replace(model, held=((held, held, held),) * len(runs))
    progress("coming near")
    # Without skews, which would make up for inputs that ran otherwise between their samples.
    straight = prior.only([key for key in prior.keys if not key.startswith("skew.")])
    rough = fit(model, runs, straight, rounds=NEAR, enough=1.0)
    # What is late bends the fit, and a motor that is slower than its file looks late: each is tried in full.
    for seen_from in (model, rough.model):
        moved = late_channels(seen_from, runs)
        if any(one is not run for one, run in zip(moved, runs, strict=True)):
            tried = fit(model, moved, straight, rounds=NEAR, enough=1.0)
            if gain(rough.residuals, tried.residuals) > LEVEL:
                runs, rough = _nearer(moved, tried, straight)
                break
    point = _noisier(_first_point(rough, runs, prior), AT_FIRST, lasting_too=True)
    # While parameters are wrong, a large error is theirs, and every sample counts.
    point, _, _ = _minimised(point, prior, progress, outliers=False)
    for _ in range(REALIGNED):
        ran = list(_runs(point)) if held is not None else _as_they_ran(point, prior)
        other = point
        if any(one is not run for one, run in zip(ran, _runs(point), strict=True)):
            # Parameters fitted to inputs that ran otherwise have made up for it.
            runs = tuple(replace(run, corrections=None) for run in ran)
            skews = {key: 0.0 for key in prior.keys if key not in straight.keys}
            begun = replace(point.model.with_values(skews), held=tuple(run.inputs.hold for run in runs))
            rough = fit(begun, runs, straight, rounds=NEAR, enough=1.0)
            other = _noisier(_first_point(rough, runs, prior), AT_FIRST, lasting_too=True)
        other = _realigned(other, prior)
        if other is point:
            break
        other, _, _ = _minimised(other, prior, progress, outliers=False)
        # One step away promised it; where it truly ends must hold it.
        if _unlikely(other, prior) > _unlikely(point, prior) - BETTER:
            break
        point = other
    point, gram, left = _minimised(point, prior, progress, outliers=True)
    # Only where it ends does scatter between blocks tell of what is missing; on the way it is the parameters that are wrong.
    tempered = point.tempered()
    if tempered.inflation > 1.0:
        point, gram, left = _minimised(tempered, prior, progress, outliers=True)
    return _concluded(point, prior, gram, left)


def _nearer(runs: tuple[Run, ...], found: Fit, prior: Prior) -> tuple[tuple[Run, ...], Fit]:
    """Runs with late channels, and their fit, with the delays that fit best: a motor unlike its file has bent the first."""
    late = [(r, channel) for r, run in enumerate(runs) for channel in run.late if channel in run.channels]
    for samples in (4, 2, 1):
        for r, channel in late * REALIGNED:
            ways = [
                tuple(run.delayed(channel, step) if k == r else run for k, run in enumerate(runs))
                for step in (samples, -samples)
            ]
            tried = [(way, fit(found.model, way, prior, rounds=2 * NEAR, enough=0.1)) for way in ways]
            best = min(tried, key=lambda way: _size(way[1]))
            if _size(best[1]) < _size(found):
                runs, found = best
    return runs, found


def _size(found: Fit) -> float:
    """Logarithm of the mean squares of a fit's residuals, over channels and samples."""
    return float(sum(len(e) * np.sum(np.log(np.mean(e**2, axis=0))) for e in found.residuals))


def _minimised(
    point: Weighed, prior: Prior, progress: Callable[[str], None], *, outliers: bool
) -> tuple[Weighed, Array, float]:
    """The best parameters from a point, noise and corrected inputs found along the way."""
    # The point along its corrected inputs.
    point = _at(point.model, point, prior)
    latest = [point]

    def between(here: Weighed) -> Weighed:
        latest[0] = _noisier(here, BRIEFLY, outliers=outliers)
        return latest[0]

    return minimise(
        point, prior, lambda model: _at(model, latest[0], prior), rounds=ROUNDS,
        enough=ENOUGH if outliers else CLOSE, between=between, progress=progress,
    )  # fmt: skip


def _runs(point: Weighed) -> Sequence[Run]:
    return [part.run for part in point.parts]


def _realigned(point: Weighed, prior: Prior) -> Weighed:
    """The point with channels moved by the whole samples that their skew has come to; itself if there are none."""
    parts, values = list(point.parts), {}
    for r, part in enumerate(parts):
        for channel in part.run.channels:
            key = f"skew.{channel}"
            skew = point.model.own[r].get(key, 0.0)
            if abs(skew) > MOST_OF_A_SAMPLE * part.run.period_s:
                samples = round(skew / part.run.period_s)
                run = parts[r].run.delayed(channel, samples)
                parts[r] = replace(parts[r], run=run, used=run.there)
                values[f"{key}@{r}"] = skew - samples * part.run.period_s
    if not values:
        return point
    return _at(point.model.with_values(values), replace(point, parts=tuple(parts)), prior)


def _first_point(rough: Fit, runs: Sequence[Run], prior: Prior) -> Weighed:
    noises, used = [], []
    torque = rough.model.file.rated.torque_Nm
    for run in runs:
        noises.append(first_noise(run, run.measured * 0 + 1, torque))
        used.append(run.there)
    point = weighed(rough.model, runs, noises, used, prior.keys)
    parts = [replace(part, noise=first_noise(part.run, part.error, torque)) for part in point.parts]
    return replace(point, parts=tuple(parts))


def _noisier(point: Weighed, updates: int, *, lasting_too: bool = False, outliers: bool = False) -> Weighed:
    """The same point under the noise that its errors show."""

    def one(part: Errors) -> tuple[Errors, Array]:
        if lasting_too:
            part = replace(part, noise=lasting(part.noise, part.run, part.linear, part.error, part.used))
        part = part.with_noise(updates, outliers=outliers)
        return part, part.white()

    found = on_all_cores(one, point.parts)
    return replace(point, parts=tuple(p for p, _ in found), whites=tuple(w for _, w in found))


def _at(model: Model, latest: Weighed, prior: Prior) -> Weighed:
    parts = latest.parts
    return weighed(
        model,
        [part.run for part in parts],
        [part.noise for part in parts],
        [part.used for part in parts],
        prior.keys,
    )


def _as_they_ran(point: Weighed, prior: Prior) -> list[Run]:
    """The runs with their inputs held between samples, or not, and all channels a sample earlier or later: as is likeliest.

    Each way is judged at its own best parameters, one step away, and with its own noise. A run that stays as it was is the
    same object.
    """
    chosen = []
    for r, part in enumerate(point.parts):
        here = part.run.inputs.hold
        loads = (False, True) if "load_torque" in part.run.known else (here[1],)
        scores: dict[tuple[tuple[bool, bool, bool], int], float] = {}
        for voltage, load in product((False, True), loads):
            hold = (voltage, load, here[2])
            scores |= {(hold, moved): score for moved, score in _likelihoods(point, prior, r, hold).items()}
        likeliest = min(scores, key=lambda way: scores[way])
        better = scores[likeliest] < scores[here, 0] - BETTER
        chosen.append(_moved(part.run.holding(likeliest[0]), likeliest[1]) if better else part.run)
    return chosen


def _unlikely(point: Weighed, prior: Prior) -> float:
    """Twice the negative logarithmic likelihood of a point, priors included."""
    parts = (
        likelier(part.noise, part.run, part.linear, part.error, part.used, BRIEFLY)[1] for part in point.parts
    )
    return sum(parts) + prior.penalty(point.model.values())


def _moved(run: Run, samples: int) -> Run:
    for channel in run.channels:
        run = run if channel == "temperature" else run.delayed(channel, samples)
    return run


def _likelihoods(point: Weighed, prior: Prior, r: int, hold: tuple[bool, bool, bool]) -> dict[int, float]:
    """Twice the negative logarithmic likelihood of a run whose inputs ran this way, by how many samples it was late."""
    part = point.parts[r]
    # Without skews, which make up for inputs that ran otherwise.
    mine = tuple(k for k in part.mine if not prior.keys[k].startswith("skew."))
    keys = [prior.keys[k] for k in mine]
    straight = {f"{name}@{r}": 0.0 for name in point.model.own[r] if name.startswith("skew.")}
    held = tuple(hold if k == r else h for k, h in enumerate(point.model.held))
    model = replace(point.model, held=held).with_values(straight)
    plain = replace(part.run.holding(hold), corrections=None)
    _, shown, columns, linear = sensitivities_of(model, plain, r, keys)
    width = np.array([prior.sd[key] for key in keys])
    scores = {}
    for samples in (-1, 0, 1):
        run = _moved(plain, samples)
        # What one way cannot explain are no outliers of the other; the same samples count in all.
        used = run.there.copy()
        used[[0, -1]] = False
        error = run.measured - shown
        noise = likelier(part.noise, run, linear, error, used, 1)[0]
        white = Errors(run, error, columns, mine, linear, noise, used).white()
        flat = white.reshape(-1, white.shape[2])
        gram = flat.T @ flat
        step = np.linalg.lstsq(gram[:-1, :-1] + np.diag(width**-2.0), gram[:-1, -1], rcond=1e-12)[0]
        _, total = likelier(noise, run, linear, error - columns @ step, used, BRIEFLY)
        scores[samples] = total + float(np.sum((step / width) ** 2))
    return scores


def _concluded(end: Weighed, prior: Prior, gram: Array, left: float) -> Estimate:
    end = _noisier(end, SETTLED, outliers=True)
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
