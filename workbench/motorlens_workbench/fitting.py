"""Fitting a model to runs: Levenberg-Marquardt on whitened residuals with what is known beforehand.

Maximum a posteriori estimate of all parameters of the motor, its effects and sensors, and of the nuisances of each run,
by simulation (output error), with the noise of every channel estimated along (`whitening`). Wide priors keep what the runs
do not determine where the motor file has it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Parameter
from motorlens_physics.sensor_model import RATED_OF_CHANNEL
from motorlens_runtime.errors import ModelError
from motorlens_workbench.candidates import SETTLED, is_rise
from motorlens_workbench.model import Model, parts_of, predict, sensitivities_of
from motorlens_workbench.run import STATE_OF, Run
from motorlens_workbench.whitening import Whitener, fit_whitener, white

Array = NDArray[np.float64]

# How far from the motor file a parameter may reasonably be, relative (one standard deviation). A motor file may be rough;
# copper is copper.
RELATIVE_SD = {
    "R_a0": 0.4, "L": 0.5, "ke": 0.4, "J": 0.5, "b": 1.0, "alpha": 0.1, "k0": 0.5, "kT": 1.0, "k_ir": 1.0, "H": 0.5,
}  # fmt: skip
# A value whose source begins with the first word is taken at its standard deviation (0: not fitted); one with the second
# was fitted while an effect was missing, and is as free as one without a source. A datasheet may promise too much: it
# counts, but no less than this share of the above.
MEASURED, FITTED, FORMER = "measured", "fitted to", 0.25
# Nuisances are for small things: what would need more of them than this many standard deviations is something else.
WITHIN = 4.0
# The same for a channel that is sampled late: a quarter of a sample is its converter's, more is a lag of its sensor.
LATE = 2.0
# An ambient that was not recorded is a room's.
AMBIENT_SD_K = 10.0


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters being fitted: centre and standard deviation, and what is possible."""

    centre: Mapping[str, float]
    sd: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]

    @property
    def keys(self) -> tuple[str, ...]:
        """The parameters being fitted."""
        return tuple(self.sd)

    def joined(self, other: "Prior") -> "Prior":
        """Both."""
        return Prior(
            {**self.centre, **other.centre}, {**self.sd, **other.sd}, {**self.bounds, **other.bounds}
        )


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        model: with the parameters found.
        prior: what was known.
        whiteners: noise of each run.
        error: whitened sum of squares, priors excluded.
        penalty: that of the priors.
        covariance: (k, k) of `prior.keys`, for white noise.
        residuals: per run (rows, C), measured less predicted, averaged rows.
    """

    model: Model
    prior: Prior
    whiteners: tuple[Whitener, ...]
    error: float
    penalty: float
    covariance: Array
    residuals: tuple[Array, ...]

    def sd(self) -> dict[str, float]:
        """Standard deviation of each parameter fitted."""
        return dict(
            zip(self.prior.keys, np.sqrt(np.maximum(np.diagonal(self.covariance), 0)).tolist(), strict=True)
        )


def base_prior(file: MotorFile, runs: Sequence[Run]) -> Prior:
    """The textbook's parameters and the nuisances of each run, as the motor file and the recordings leave them open."""
    values, rated = file.values(), file.rated
    centre: dict[str, float] = {}
    sd: dict[str, float] = {}
    bounds: dict[str, tuple[float, float]] = {}
    for key, relative in RELATIVE_SD.items():
        what = file.meaning(key)
        size = max(abs(values[key]), 0.1 * what.typical(rated))
        known = file.knowledge.get(key, Knowledge())
        sure = known.sd is not None and known.source.startswith(MEASURED)
        if known.sd == 0 and sure:
            continue
        centre[key] = values[key]
        least = 0.0 if sure else FORMER * relative * size
        # What was fitted before an effect was added moves with it.
        free = not known.sd or known.source.startswith(FITTED)
        sd[key] = relative * size if free else max(known.sd or 0.0, least)
        bounds[key] = (max(what.bounds[0], 0.05 * values[key]), what.bounds[1])
    prior = Prior(centre, sd, bounds)
    for part in parts_of(file):
        prior = prior.joined(part_prior(file, part.name()))
    for r, run in enumerate(runs):
        own = _nuisance_sd(file, run)
        for name, width in own.items():
            key = f"{name}@{r}"
            prior = prior.joined(_around(key, _first(run, name), width))
    return prior


def _around(key: str, middle: float, width: float) -> Prior:
    reach = (LATE if key.startswith("skew.") else WITHIN) * width
    return Prior({key: middle}, {key: width}, {key: (middle - reach, middle + reach)})


def _first(run: Run, name: str) -> float:
    """Where a nuisance of a run starts."""
    state = name.removeprefix("initial.")
    if is_rise(state):
        return SETTLED * run.start["theta"]
    return run.start[state] if name.startswith("initial.") else 0.0


def start_prior(model: Model, name: str) -> Prior:
    """How warm the parts that an effect of the model brings were at the start of each run."""
    effect = model.file.motor.effect(name)
    prior = Prior({}, {}, {})
    for state in effect.states if effect else ():
        for r, own in enumerate(model.own):
            key = f"initial.{state}"
            if key in own:
                width = _warmth_sd(model.file, own["initial.theta"])
                prior = prior.joined(_around(f"{key}@{r}", own[key], width))
    return prior


def _warmth_sd(file: MotorFile, rise_K: float) -> float:
    return 0.3 * abs(rise_K) + 0.02 * file.rated.rise_K


def part_prior(file: MotorFile, name: str) -> Prior:
    """The free parameters of an effect or a sensor model of the file: wide around their value, within their bounds."""
    part = next(part for part in parts_of(file) if part.name() == name)
    centre: dict[str, float] = {}
    sd: dict[str, float] = {}
    bounds: dict[str, tuple[float, float]] = {}
    for parameter, what in part.parameters().items():
        if what.fixed:
            continue
        key = f"{name}.{parameter}"
        typical = what.typical(file.rated)
        known = file.knowledge.get(key, Knowledge())
        if known.sd == 0 and known.source.startswith(MEASURED):
            continue
        # The switch is free; a shape is known within a factor of a few.
        centre[key] = what.null if what.null is not None else getattr(part, parameter)
        sd[key] = 30 * abs(typical) if what.null is not None else max(abs(centre[key]), what.sd(file.rated))
        bounds[key] = what.bounds
    return Prior(centre, sd, bounds)


def _nuisance_sd(file: MotorFile, run: Run) -> dict[str, float]:
    rated = file.rated
    own = {
        "initial.i": 0.3 * rated.current_A,
        "initial.w": 0.02 * rated.speed_rad_s,
        "initial.theta": 0.3 * rated.rise_K,
    }
    if "speed" not in run.channels:
        own["initial.w"] = 0.1 * rated.speed_rad_s
    if "temperature" not in run.channels:
        # Without a current either, how warm the winding is cannot be told from R_a0, and is left to it.
        own["initial.theta"] = (0.5 if "current" in run.channels else 0.03) * rated.rise_K
    for effect in file.motor.effects:
        warm = _warmth_sd(file, run.start["theta"])
        own |= {f"initial.{state}": warm for state in effect.states if is_rise(state)}
    if "ambient" not in run.known and "temperature" in run.channels:
        own["ambient"] = AMBIENT_SD_K
    for channel in run.channels:
        # A converter that takes its channels one after another; more than that is a sensor that lags.
        if channel != "temperature":
            own[f"skew.{channel}"] = 0.12 * run.period_s
    return own


def start_model(file: MotorFile, runs: Sequence[Run]) -> Model:
    """The motor file as it is, every run starting where its first samples say."""
    own = []
    for run in runs:
        names = _nuisance_sd(file, run)
        own.append({name: _first(run, name) for name in names})
    return Model(file, tuple(own), tuple(run.inputs.held for run in runs))


def residuals_of(model: Model, runs: Sequence[Run]) -> tuple[Array, ...]:
    """Measured less predicted, averaged rows, (rows, C) of each run.

    Raises:
        ModelError: a simulation cannot go on.
    """
    return tuple(run.average(run.measured - predict(model, run, r)[1]) for r, run in enumerate(runs))


def squares(residuals: Sequence[Array], runs: Sequence[Run], whiteners: Sequence[Whitener]) -> float:
    """Whitened sum of squares over all valid rows."""
    total = 0.0
    for residual, run, whitener in zip(residuals, runs, whiteners, strict=True):
        z = whitener(residual)[usable(run, whitener)]
        total += float(np.sum(z * z))
    return total


def usable(run: Run, whitener: Whitener) -> NDArray[np.bool_]:
    """(rows,) rows whose sample and all lags are valid."""
    fresh = run.fresh()
    kept = fresh.copy()
    for lag in range(1, whitener.order + 1):
        kept[lag:] &= fresh[:-lag]
    kept[: whitener.order] = False
    return kept


def penalty_of(values: Mapping[str, float], prior: Prior) -> float:
    """What the priors cost."""
    return sum(((values[key] - prior.centre[key]) / width) ** 2 for key, width in prior.sd.items())


def noise_of(residuals: Sequence[Array], runs: Sequence[Run], used: int = 0) -> tuple[Whitener, ...]:
    """Noise models of residuals."""
    return tuple(
        fit_whitener(residual, run.fresh(), run.floor, used // len(runs))
        for residual, run in zip(residuals, runs, strict=True)
    )


def plain_noise(residuals: Sequence[Array], runs: Sequence[Run]) -> tuple[Whitener, ...]:
    """White noise of the residuals' size, taken robustly: where to begin."""
    chosen = []
    for residual, run in zip(residuals, runs, strict=True):
        fresh = residual[run.fresh()]
        size = np.sqrt(np.mean(fresh**2, axis=0))
        chosen.append(white(np.maximum(size, run.floor)))
    return tuple(chosen)


def fit(
    model: Model,
    runs: Sequence[Run],
    prior: Prior,
    whiteners: Sequence[Whitener] | None = None,
    *,
    rounds: int = 12,
    tolerance: float = 2e-5,
    nearest: float = 0.0,
) -> Fit:
    """Fit the parameters that the prior names, starting from the model.

    Args:
        model: where to begin.
        runs: prepared recordings.
        prior: the free parameters.
        whiteners: the noise; None: white, of the size of the residuals, updated every round.
        rounds: at most this many Jacobians.
        tolerance: stop when a round lowers the sum of squares by less than this share (and less than 0.1).
        nearest: share of itself below which nothing that can only be positive may fall in one step: at its bound a linear
            step would leave it without a slope to come back by.

    Raises:
        ModelError: the starting point cannot be simulated, or the way from it leads where nothing can be.
    """
    keys = prior.keys
    residuals = residuals_of(model, runs)
    adaptive = whiteners is None
    noise = tuple(whiteners) if whiteners is not None else plain_noise(residuals, runs)
    damping = 1e-3 if adaptive else 1e-6
    gram = np.zeros((len(keys), len(keys)))
    scale = np.array([prior.sd[key] for key in keys])
    for _ in range(rounds):
        values = model.values()
        cost = squares(residuals, runs, noise) + penalty_of(values, prior)
        gram, gradient = normal_equations(model, runs, keys, noise, residuals)
        if not np.isfinite(gram).all():
            raise ModelError("the model's response to its parameters has no bound; start from other values")
        gram += np.diag(1 / scale**2)
        gradient += np.array([(prior.centre[key] - values[key]) / prior.sd[key] ** 2 for key in keys])
        moved = False
        for _ in range(8):
            trial = _step(model, prior, keys, gram, gradient, damping, nearest)
            try:
                new = residuals_of(trial, runs)
                reached = squares(new, runs, noise) + penalty_of(trial.values(), prior)
            except ModelError:
                reached = np.inf
            if np.isfinite(reached) and reached < cost:
                moved = True
                break
            damping = max(damping * 10, 1e-4)
        if not moved:
            break
        fall = cost - reached
        model, residuals = trial, new
        damping = max(damping / 10, 1e-9)
        if adaptive:
            noise = plain_noise(residuals, runs)
        if fall < max(tolerance * cost, 0.1):
            break
    inverse = _inverse(gram)
    return Fit(
        model,
        prior,
        noise,
        squares(residuals, runs, noise),
        penalty_of(model.values(), prior),
        inverse,
        residuals,
    )


def normal_equations(
    model: Model,
    runs: Sequence[Run],
    keys: Sequence[str],
    whiteners: Sequence[Whitener],
    residuals: Sequence[Array],
) -> tuple[Array, Array]:
    """J^T J and J^T e of whitened columns and residuals."""
    gram, gradient = np.zeros((len(keys), len(keys))), np.zeros(len(keys))
    for r, (run, whitener, residual) in enumerate(zip(runs, whiteners, residuals, strict=True)):
        mine = [k for k, key in enumerate(keys) if "@" not in key or key.endswith(f"@{r}")]
        columns = sensitivities_of(model, run, r, [keys[k] for k in mine])[2]
        kept = usable(run, whitener)
        z = whitener(run.average(columns))[kept].reshape(-1, len(mine))
        e = whitener(residual)[kept].ravel()
        gram[np.ix_(mine, mine)] += z.T @ z
        gradient[mine] += z.T @ e
    return gram, gradient


def _step(
    model: Model,
    prior: Prior,
    keys: Sequence[str],
    gram: Array,
    gradient: Array,
    damping: float,
    nearest: float,
) -> Model:
    values = model.values()
    at = np.array([values[key] for key in keys])
    low = np.array([prior.bounds[key][0] for key in keys])
    high = np.array([prior.bounds[key][1] for key in keys])
    low = np.where(low > 0, np.maximum(low, nearest * at), low)
    free = np.ones(len(keys), dtype=bool)
    move = np.zeros(len(keys))
    # Parameters that the step would push through their bounds stop there, and the rest is solved again.
    for _ in range(4):
        damped = gram + damping * np.diag(np.diagonal(gram))
        inner = np.ix_(free, free)
        right = gradient[free] - gram[np.ix_(free, ~free)] @ move[~free]
        move[free] = _inverse(damped[inner]) @ right
        beyond = free & ((at + move < low) | (at + move > high))
        if not beyond.any():
            break
        move[beyond] = np.clip(at[beyond] + move[beyond], low[beyond], high[beyond]) - at[beyond]
        free &= ~beyond
        if not free.any():
            break
    return model.with_values(dict(zip(keys, np.clip(at + move, low, high).tolist(), strict=True)))


def _inverse(gram: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    values = np.maximum(values, 1e-13 * values[-1])
    return np.asarray((vectors / values) @ vectors.T / np.outer(scale, scale))


__all__ = [
    "RATED_OF_CHANNEL",
    "STATE_OF",
    "Fit",
    "Parameter",
    "Prior",
    "base_prior",
    "fit",
    "part_prior",
    "replace",
]
