"""Fitting a model to runs: one Levenberg-Marquardt for every way of weighing errors.

Maximum a posteriori estimate of all parameters of the motor, its effects and sensors, and of the nuisances of each run,
by simulation (output error), with what is known beforehand (`prior`). A `Point` weighs errors and sensitivities: by the
noise of the recording as a state-space model (`weighed`), or, to come near, each channel by the size of its errors (`fit`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from motorlens_physics.estimate.model import Model, predict, sensitivities_of
from motorlens_physics.estimate.prior import Prior, nuisance_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError

Array = NDArray[np.float64]

# Damping is tried this often before a fit is taken to be at its end, each ten times the last.
TRIES = 8
# It falls by as much after a step that was taken at once, by this after one that had to turn, and not at all where less of
# it has just been refused.
TURNED = 3.0
# A step that is refused is tried again along a curve that turns away by at most this share of its length.
TURN = 0.5
# Nothing that can only be positive falls to less than this share of itself in one step: at its bound a linear step would
# leave it without a slope to come back by.
NEAREST = 0.1
# Closer to the minimum than this, in standard deviations of the result, a step gains less than the likelihood can tell, and
# what the simulation's tolerance does to the cost may be as much: steps are no longer judged by it.
FLAT = 1.0
# A fit this close counts as converged, and ends where steps get no shorter: the inputs' corrections, smoothed over twice as
# many samples at one step as at another, move it by a tenth.
CONVERGED = 0.3
# Steps with white noise, to come near.
NEAR = 8


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        model: with the parameters found.
        prior: what was known.
        covariance: (k, k) of `prior.keys`.
        residuals: per run (rows, C), measured less predicted, averaged rows.
        left: distance to the minimum where it ended, in standard deviations of the result.
    """

    model: Model
    prior: Prior
    covariance: Array
    residuals: tuple[Array, ...]
    left: float = 0.0

    def sd(self) -> dict[str, float]:
        """Standard deviation of each parameter fitted."""
        return dict(
            zip(self.prior.keys, np.sqrt(np.maximum(np.diagonal(self.covariance), 0)).tolist(), strict=True)
        )


class Point(Protocol):
    """Errors at some parameters, weighed."""

    @property
    def model(self) -> Model:
        """The parameters."""

    @property
    def cost(self) -> float:
        """Whitened sum of squares, priors excluded."""

    def normal(self) -> tuple[Array, Array]:
        """J^T J (k, k) and J^T e (k,) of whitened sensitivities and errors."""

    def cost_in(self, other: Self) -> float:
        """Its errors' whitened sum of squares as `other`, from which a step led here, weighs them."""

    def products_in(self, other: Self) -> tuple[Array, float]:
        """Its errors times the sensitivities (k,) and times the errors of `other`, whitened as `other` weighs them."""


def start_model(file: MotorFile, runs: Sequence[Run]) -> Model:
    """The motor file as it is, every run starting where its first samples say."""
    own: list[dict[str, float]] = [{} for _ in runs]
    for key, value in nuisance_prior(file, runs).centre.items():
        name, _, r = key.partition("@")
        own[int(r)][name] = value
    return Model(file, tuple(own), tuple(run.inputs.hold for run in runs))


P = TypeVar("P", bound=Point)


# A motor that runs away is refused by its cost.
@np.errstate(over="ignore", invalid="ignore")
def minimise(
    begin: P,
    prior: Prior,
    at: Callable[[Model], P],
    shown: Callable[[Model], P],
    *,
    rounds: int,
    enough: float,
    damping: float = 1e-6,
    between: Callable[[P], P] = lambda point: point,
    anew: Callable[[P], P] = lambda point: point,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[P, Array, float]:
    """Levenberg-Marquardt from a point.

    Args:
        begin: where to begin.
        prior: the free parameters.
        at: the point at a model.
        shown: the same without its sensitivities, which is known much sooner: once a step is refused, so may the next be.
        rounds: at most this many steps.
        enough: stop this close to the minimum, in standard deviations of the result.
        damping: of the first step, a share of the diagonal.
        between: what is done at a point before the step from it, such as finding its noise.
        anew: the point as `at` sees it after `between`; the same object if that changes nothing. A step that is refused is
            tried once more from there before it is damped: what `between` found may cost more than the step won.
        progress: told how far there is to go.

    Returns:
        the last point, or the one before if that is close enough and no step gets shorter, J^T J there with the deviations
        that the prior states (k, k), and how far from the minimum it is.

    Raises:
        ModelError: the way leads where nothing can be simulated.
    """
    keys = prior.keys
    point = seen = begin
    gram, left = np.diag(prior.width(begin.model.values()) ** -2.0), float("inf")
    before, whole, share, swings = (point, gram, left), np.zeros(len(keys)), 1.0, False

    def tried(step: Array, again: bool) -> tuple[P | None, float]:
        """Where a step leads, and what it costs there as the point it starts from sees it; sensitivities if that is less."""
        values = point.model.values()
        there = dict(zip(keys, (_vector(values, keys) + step).tolist(), strict=True))
        trial, reached = None, np.inf
        try:
            for see in (shown, at) if again else (at,):
                trial = see(point.model.with_values(there))
                reached = trial.cost_in(point) + prior.penalty(trial.model.values())
                if not reached < cost:
                    break
        except ModelError:
            return None, np.inf
        return (trial, reached) if np.isfinite(reached) else (None, np.inf)

    for k in range(rounds):
        point = between(point)
        if swings:
            point = anew(point)
        last = whole
        seen, (gram, gradient, cost, whole) = point, _seen(point, prior)
        left = _length(whole, gram)
        if left < enough:
            break
        if before[2] <= min(left, CONVERGED):
            near, gram, left = before
            return near, _as_stated(gram, near, prior), left
        # What `between` found is a step old: where the minimum moves with it, steps swing about the end and get no shorter.
        if before[2] <= left and not swings:
            swings, point = True, anew(point)
            seen, (gram, gradient, cost, whole) = point, _seen(point, prior)
            left = _length(whole, gram)
        before = point, gram, left
        share = _share(share, last, whole, gram)
        moved, fresh, refused = False, False, False
        for attempt in range(TRIES):
            step = share * _step(point.model.values(), prior, gram, gradient, damping)
            trial, reached = tried(step, again=attempt > 0 and left >= FLAT)
            straight = True
            if trial is not None and reached >= cost and left >= FLAT:
                straight = False
                turned = _turned(step, point, trial, prior, gram, gradient, damping)
                # A curve that ends soon bends too much to be known from as far away as that.
                half = (
                    tried(step / 2, again=True)
                    if _length(turned, gram) < _length(step, gram) / 2
                    else (None, np.inf)
                )
                trial, reached = half if half[1] < cost else tried(turned, again=True)
            if trial is not None and (reached < cost or left < FLAT):
                point, moved = trial, True
                break
            if not fresh:
                fresh, stale = True, point
                point = anew(stale)
                if point is not stale:
                    seen, (gram, gradient, cost, whole) = point, _seen(point, prior)
                    left = _length(whole, gram)
                    continue
            damping, refused = max(damping * 10, 1e-4), True
            if _length(step, gram) < enough:
                break
        if not moved:
            break
        if not refused:
            damping = max(damping / (10 if straight else TURNED), 1e-9)
        progress(f"step {k + 1}: {left:.3g} standard deviations to go")
    return point, _as_stated(gram, seen, prior), left


def _as_stated(gram: Array, seen: Point, prior: Prior) -> Array:
    """J^T J at a point with the deviations that the prior states, from that with its curvature there.

    That a parameter is hardly next to nothing tells steps where to go, not how certain it is.
    """
    known = np.array([prior.sd[key] for key in prior.keys]) ** -2.0
    return np.asarray(gram + np.diag(known - prior.width(seen.model.values()) ** -2.0))


def _turned(
    step: Array, point: P, trial: P, prior: Prior, gram: Array, gradient: Array, damping: float
) -> Array:
    """A step (k,) along a curve that follows how the errors bend: a step that was refused shows that where it led.

    With errors e(t) = e - t J v + t^2 q along the step v, what J can undo of the bend q turns the way, v t + a t^2, and the
    rest of q says how far to go (geodesic acceleration: Transtrum, Machta and Sethna 2011, doi:10.1103/PhysRevE.83.036701).

    Args:
        step: v (k,), refused.
        point, trial: where it starts, and where it led.
        prior: the free parameters.
        gram, gradient: J^T J (k, k) and J^T e (k,) at the point, with the prior's.
        damping: of the step.
    """
    values = point.model.values()
    width = prior.width(values)
    known = width**-2.0
    # What is known of the parameters beforehand does not bend.
    pull = gradient - prior.pull(values) / width
    along = gram @ step - known * step
    seen, overlap = trial.products_in(point)
    # J^T q, a, e^T (e - J v), e^T q and q^T q.
    bend = seen - pull + along
    turn = _step(values, prior, gram, bend, damping)
    linear = point.cost - pull @ step
    across = overlap - linear
    size = trial.cost_in(point) - 2 * (overlap - seen @ step) + linear - pull @ step + along @ step
    # The cost along the curve, from t^4 to t^1.
    course = np.array(
        [
            turn @ gram @ turn - 2 * turn @ bend + size,
            2 * (step @ gram @ turn - step @ bend),
            step @ gram @ step - 2 * (gradient @ turn - across),
            -2 * gradient @ step,
            0.0,
        ]
    )
    # How long they are is compared as damping weighs them: a step along a valley is short in what it changes.
    lengths = np.sqrt(np.diagonal(gram) @ np.square([step, turn]).T)
    farthest = min(1.0, TURN * lengths[0] / max(lengths[1], 1e-300))
    flat = np.roots(np.polyder(course))
    ends = np.append(flat[np.isreal(flat)].real, farthest)
    ends = ends[(ends > 0) & (ends <= farthest)]
    t = ends[np.argmin(np.polyval(course, ends))]
    low, high = _room(values, prior)
    return np.asarray(np.clip(t * step + t**2 * turn, low, high))


def _seen(point: Point, prior: Prior) -> tuple[Array, Array, float, Array]:
    """At a point, with what is known beforehand: J^T J (k, k), J^T e (k,), the cost, and the step to the minimum (k,).

    Raises:
        ModelError: a response to a parameter is not finite.
    """
    values = point.model.values()
    width = prior.width(values)
    gram, gradient = point.normal()
    if not np.isfinite(gram).all():
        raise ModelError("the model's response to its parameters has no bound; start from other values")
    gram = gram + np.diag(1 / width**2)
    gradient = gradient + prior.pull(values) / width
    step = _step(values, prior, gram, gradient, 0.0)
    return gram, gradient, point.cost + prior.penalty(values), step


def foretold(point: Point, prior: Prior, fixed: Mapping[str, float] | None = None) -> float:
    """The cost at the minimum, what is known beforehand included, as the problem linearised about a point has it.

    Args:
        point: where it is linearised.
        prior: the free parameters.
        fixed: values of some of these at which they stay, wherever they are at the point.

    Raises:
        ModelError: a response to a parameter is not finite.
    """
    gram, gradient, cost, step = _seen(point, prior)
    if fixed:
        values, step = point.model.values(), np.zeros(len(step))
        stays = np.array([key in fixed for key in prior.keys])
        step[stays] = [fixed[key] - values[key] for key in prior.keys if key in fixed]
        others = prior.only([key for key in prior.keys if key not in fixed])
        beside = gradient[~stays] - gram[np.ix_(~stays, stays)] @ step[stays]
        step[~stays] = _step(values, others, gram[np.ix_(~stays, ~stays)], beside, 0.0)
    return cost - 2 * float(gradient @ step) + float(step @ gram @ step)


def _share(before: float, last: Array, step: Array, gram: Array) -> float:
    """How much of a step (k,) to go that turns back on another one, of which that share was gone.

    Each step is told in the frame and under the noise of the point before it. Where those change with the parameters, steps
    swing about the end, for ever if they are as long as the last: Aitken's relaxation ends that (Irons and Tuck 1969,
    doi:10.1002/nme.1620010306).

    >>> _share(1.0, np.array([1.0]), np.array([-1.0]), np.eye(1)), _share(1.0, np.array([1.0]), np.array([0.5]), np.eye(1))
    (0.5, 1.0)
    """
    change = step - last
    if last @ gram @ step >= 0:
        return 1.0
    return min(1.0, -before * float(last @ gram @ change) / float(change @ gram @ change))


def _length(step: Array, gram: Array) -> float:
    """Of a step, in standard deviations of the result."""
    return float(np.sqrt(max(float(step @ gram @ step), 0.0)))


def _vector(values: Mapping[str, float], keys: Sequence[str]) -> Array:
    return np.array([values[key] for key in keys])


def _step(values: Mapping[str, float], prior: Prior, gram: Array, gradient: Array, damping: float) -> Array:
    """The damped step that costs least within bounds."""
    low, high = _room(values, prior)
    damped = gram + damping * np.diag(np.diagonal(gram))
    move = inverse(damped) @ gradient
    if np.all((low <= move) & (move <= high)):
        return np.asarray(move)
    # |A x - b|^2 with A'A the damped J^T J and A'b the gradient, in units in which the diagonal is 1.
    scale = np.sqrt(np.diagonal(damped))
    spread, vectors = _axes(damped / np.outer(scale, scale))
    root = np.sqrt(spread)
    # What cannot move at all stays.
    able, within = low < high, np.zeros(len(low))
    within[able] = (
        lsq_linear(
            root[:, None] * vectors.T[:, able],
            vectors.T @ (gradient / scale) / root,
            (low[able] * scale[able], high[able] * scale[able]),
            method="bvls",
        ).x
        / scale[able]
    )
    return np.clip(within, low, high)


def _room(values: Mapping[str, float], prior: Prior) -> tuple[Array, Array]:
    """How far each parameter may go down and up in one step (k,)."""
    at = _vector(values, prior.keys)
    low, high = (np.array([prior.bounds[key][side] for key in prior.keys]) for side in (0, 1))
    return np.where(low > 0, np.maximum(low, NEAREST * at), low) - at, high - at


@dataclass(frozen=True)
class _Averaged:
    """Errors (rows, C) and sensitivities (rows, C, k) of averaged rows, each channel of a run in units of its size (C,).

    The sensitivities of a run are those to the keys at its positions in `mine`.
    """

    model: Model
    runs: Sequence[Run]
    keys: tuple[str, ...]
    mine: Sequence[list[int]]
    residuals: tuple[Array, ...]
    columns: tuple[Array, ...]
    sizes: Sequence[Array] = ()

    @classmethod
    def at(cls, model: Model, runs: Sequence[Run], keys: tuple[str, ...]) -> "_Averaged":
        """At a model, sizes left open; nearly every point is one from which the next step is taken.

        Raises:
            ModelError: a simulation cannot go on.
        """
        mine = [
            [k for k, key in enumerate(keys) if "@" not in key or key.endswith(f"@{r}")]
            for r in range(len(runs))
        ]

        def one(r: int) -> tuple[Array, Array]:
            # Beside the inputs as they were measured: what their sensors showed wrongly is in the errors, whole.
            run = replace(runs[r], corrections=None)
            _, shown, columns, _ = sensitivities_of(model, run, r, [keys[k] for k in mine[r]])
            return run.average(run.measured - shown), run.average(columns)

        residuals, columns = zip(*on_all_cores(one, range(len(runs))), strict=True)
        return cls(model, runs, keys, mine, residuals, columns)

    @classmethod
    def shown(cls, model: Model, runs: Sequence[Run], keys: tuple[str, ...]) -> "_Averaged":
        """The same without sensitivities.

        Raises:
            ModelError: a simulation cannot go on.
        """

        def one(r: int) -> Array:
            return runs[r].average(
                runs[r].measured - predict(model, replace(runs[r], corrections=None), r)[1]
            )

        return cls(model, runs, keys, (), tuple(on_all_cores(one, range(len(runs)))), ())

    @property
    def cost(self) -> float:
        return sum(float(np.sum(self._errors(r) ** 2)) for r in range(len(self.runs)))

    def cost_in(self, other: Self) -> float:
        return self.cost

    def products_in(self, other: Self) -> tuple[Array, float]:
        products, overlap = np.zeros(len(self.keys)), 0.0
        for r, (run, mine) in enumerate(zip(self.runs, other.mine, strict=True)):
            z = (other.columns[r][run.fresh()] / self.sizes[r][:, None]).reshape(-1, len(mine))
            errors = self._errors(r).ravel()
            products[mine] += z.T @ errors
            overlap += float(other._errors(r).ravel() @ errors)
        return products, overlap

    def normal(self) -> tuple[Array, Array]:
        gram, gradient = np.zeros((len(self.keys), len(self.keys))), np.zeros(len(self.keys))
        for r, (run, mine) in enumerate(zip(self.runs, self.mine, strict=True)):
            z = (self.columns[r][run.fresh()] / self.sizes[r][:, None]).reshape(-1, len(mine))
            gram[np.ix_(mine, mine)] += z.T @ z
            gradient[mine] += z.T @ self._errors(r).ravel()
        return gram, gradient

    def _errors(self, r: int) -> Array:
        return np.asarray(self.residuals[r][self.runs[r].fresh()] / self.sizes[r])


# As of `minimise`.
@np.errstate(over="ignore", invalid="ignore")
def fit(model: Model, runs: Sequence[Run], prior: Prior, *, rounds: int = 12, enough: float = 0.02) -> Fit:
    """Fit the parameters that the prior names, starting from the model, each channel weighed by the size of its errors.

    Args:
        model: where to begin.
        runs: prepared recordings.
        prior: the free parameters.
        rounds, enough: see `minimise`.

    Raises:
        ModelError: the starting point cannot be simulated, or the way from it leads where nothing can be.
    """

    latest: list[Sequence[Array]] = [()]

    def at(trial: Model) -> _Averaged:
        return replace(_Averaged.at(trial, runs, prior.keys), sizes=latest[0])

    def shown(trial: Model) -> _Averaged:
        return replace(_Averaged.shown(trial, runs, prior.keys), sizes=latest[0])

    def between(here: _Averaged) -> _Averaged:
        latest[0] = [_sizes(residual, run) for residual, run in zip(here.residuals, runs, strict=True)]
        return replace(here, sizes=latest[0])

    end, gram, left = minimise(
        at(model), prior, at, shown, rounds=rounds, enough=enough, between=between, damping=1e-3
    )
    return Fit(end.model, prior, inverse(gram), end.residuals, left)


def white(found: Fit, runs: Sequence[Run]) -> float:
    """Twice the negative logarithmic likelihood of what a fit leaves, as white noise as large as that in each channel.

    Samples that are missing, as where a channel was moved, count as what the others leave in the mean.
    """
    return sum(
        2.0 * len(residual) * float(np.sum(np.log(_sizes(residual, run))))
        for residual, run in zip(found.residuals, runs, strict=True)
    )


def _sizes(residual: Array, run: Run) -> Array:
    return np.asarray(np.maximum(np.sqrt(np.mean(residual[run.fresh()] ** 2, axis=0)), run.floor))


def inverse(gram: Array) -> Array:
    """Of a symmetric positive matrix, directions that are not determined kept finite."""
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    spread, vectors = _axes(gram / np.outer(scale, scale))
    return np.asarray((vectors / spread) @ vectors.T / np.outer(scale, scale))


def _axes(gram: Array) -> tuple[Array, Array]:
    """Eigenvalues (k,), those of directions that are not determined kept above nothing, and eigenvectors (k, k)."""
    spread, vectors = np.linalg.eigh(gram)
    return np.maximum(spread, 1e-13 * spread.max(initial=0.0)), vectors
