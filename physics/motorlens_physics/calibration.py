"""Calibration: parameters of a motor from recordings, with honest uncertainty.

The motor is simulated from the measured inputs and compared with all that was measured (output error, Ljung 1999, System
Identification, 2nd ed., section 4.3): consistent for a motor in a closed loop too, since nothing but the inputs is
taken from the measurement. Levenberg-Marquardt on analytic sensitivities; each channel weights itself by its own noise
(concentrated likelihood), whose colour is estimated and whitened; outliers count by Huber's loss; priors come from the
motor file. Every recording has initial states of its own. Free runs that are unstable or drift are cut into windows
that are tied together at their ends (multiple shooting, Bock 1981, doi:10.1007/978-3-642-68220-9_8).

Inputs are taken as they were recorded. Noise on them that changes within R/L biases L, which then also stands for a filter
of that noise; the command a drive holds is a better input than its noisy measurement.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from motorlens_physics.calibration_noise import Noise, estimate, huber_loss, huber_weights
from motorlens_physics.calibration_problem import (
    LOAD,
    Assignment,
    Run,
    Unknown,
    assign,
    differentiate,
    local_unknowns,
    parameter_unknowns,
    predict,
    runs_of,
)
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.sensitivity import INITIAL
from motorlens_physics.simulation import Array
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError

# Steps adapt to this relative error; noise is larger by orders of magnitude.
TOLERANCE = 1e-6
# Largest gap between the end of a window and the next one's initial state, as a share of the rated quantity.
GAP = 1e-3
# A parameter whose deviation shrank by less than this share is not identified.
SHRUNK = 0.9
# Parameters more correlated than this are known only together.
CONFOUNDED = 0.99
# Smallest noise that is believed, as a share of the channel's largest value.
SMALLEST_NOISE = 1e-6
ITERATIONS = 60
# The fit ends this close to the minimum, in deviations of the result, and counts as converged within the second.
SMALL_STEP, CONVERGED = 0.02, 0.3
# Blocks of time whose contributions are compared.
BLOCKS = 64


@dataclass(frozen=True)
class Calibration:
    """What a calibration found.

    Attributes:
        keys: the free parameters, k of them.
        value: by key.
        sd: standard deviation by key; of a parameter fitted in its logarithm, the value times that of the logarithm.
        correlation: (k, k).
        unidentified: what the recordings do not tell, by key, in words.
        confounded: pairs of parameters that the recordings tell only together, in words.
        residuals: for each recording, channel to measured less predicted (N,).
        noise_sd: for each recording, channel to the deviation of its residuals.
        initial: for each recording, its initial state.
        load_torque_Nm: for each recording, the constant load fitted; empty if none was asked for.
        iterations: accepted steps.
        converged: whether what was left to go is small against the deviations.
        held: whether inputs were held between samples.
        file: the motor file with values, deviations and sources of what was identified written in.
    """

    keys: tuple[str, ...]
    value: Mapping[str, float]
    sd: Mapping[str, float]
    correlation: Array
    unidentified: Mapping[str, str]
    confounded: tuple[str, ...]
    residuals: tuple[Mapping[str, Array], ...]
    noise_sd: tuple[Mapping[str, float], ...]
    initial: tuple[Mapping[str, float], ...]
    load_torque_Nm: tuple[float, ...]
    iterations: int
    converged: bool
    held: bool
    file: MotorFile


def default_keys(file: MotorFile, recordings: Sequence[Recording]) -> list[str]:
    """All parameters that the measured channels can show: without a temperature none that is thermal alone."""
    thermal = {"alpha", "k0", "kT", "k_ir", "H"}
    warm = any(recording.has("temperature") for recording in recordings)
    return [key for key in file.values() if not file.meaning(key).fixed and (warm or key not in thermal)]


def calibrate(
    file: MotorFile,
    recordings: Sequence[Recording],
    free: Sequence[str],
    *,
    held: bool | None = None,
    fit_load: bool = False,
    window_s: float | None = None,
    colour: int | None = None,
    start_sd_K: float = 2.0,
    progress: Callable[[str], None] = lambda text: None,
) -> Calibration:
    """Fit parameters to recordings jointly.

    Args:
        file: the motor, with what is known of it; deviations stated there are priors.
        recordings: any subset of current, speed and temperature measured; rates may differ. Load torque absent is zero.
        free: keys of parameters of motor, effects and sensors.
        held: whether inputs hold between samples or run linearly; None takes what fits better.
        fit_load: whether each recording has an unknown constant load torque besides what was recorded.
        window_s: length of the windows of multiple shooting; None simulates each recording in one run.
        colour: order of the autoregression that whitens residuals; 0 takes them as white, None decides by them.
        start_sd_K: how far a motor whose temperature was not measured may be from ambient at first, as a deviation.
        progress: told what goes on.

    Raises:
        DataError: recordings that cannot be used.
        ModelError: unknown or fixed parameters, or a motor that cannot be simulated where it starts.
    """
    if not recordings or not free:
        raise ModelError("calibration needs at least one recording and one free parameter")

    def posed(hold: bool) -> _Problem:
        runs = runs_of(file, recordings, held=hold, window_s=window_s)
        unknowns = parameter_unknowns(file, free)
        unknowns += local_unknowns(file, runs, fit_load=fit_load, start_sd_K=start_sd_K)
        return _Problem(file, runs, unknowns)

    problem = posed(bool(held))
    q, noise, iterations, converged = _minimise(problem, problem.means, 0, progress)
    if held is None:
        other = posed(True)
        found = _minimise(other, q, 0, progress)
        if _criterion(other, found[1]) < _criterion(problem, noise):
            problem, held, (q, noise, iterations, converged) = other, True, found
    if colour != 0:
        q, noise, more, converged = _minimise(problem, q, colour, progress)
        iterations += more
    normal, _, scores = _normal_equations(problem, q, noise)
    covariance = _covariance(normal, scores)
    return _report(problem, recordings, q, noise, covariance, iterations, converged, bool(held))


# What a run shows, by channel, and the states at its end.
_Prediction = tuple[dict[str, Array], Array]


@dataclass(frozen=True)
class _Problem:
    file: MotorFile
    runs: Sequence[Run]
    unknowns: Sequence[Unknown]

    @property
    def means(self) -> Array:
        """Where the fit starts: the centres of the priors."""
        return np.array([unknown.coordinate(unknown.mean) for unknown in self.unknowns])

    @property
    def sds(self) -> Array:
        """Deviations of the priors."""
        return np.array([unknown.sd for unknown in self.unknowns])

    def at(self, q: Array) -> list[Assignment]:
        """All runs at the coordinates q."""
        return [assign(self.file, self.unknowns, q, k, run) for k, run in enumerate(self.runs)]

    def predictions(self, q: Array) -> list[_Prediction]:
        """What every run shows, and where it ends."""

        def one(k: int) -> _Prediction:
            return predict(self.runs[k], points[k], tolerance=TOLERANCE)

        points = self.at(q)
        return on_all_cores(one, range(len(self.runs)))

    def ties(self) -> list[tuple[int, int]]:
        """Pairs of neighbouring windows."""
        pairs = zip(range(len(self.runs) - 1), range(1, len(self.runs)), strict=True)
        return [(a, b) for a, b in pairs if self.runs[a].recording == self.runs[b].recording]

    def gaps(self) -> Array:
        """Deviations of the gaps between windows, per state."""
        rated = self.file.rated
        sizes = {"i": rated.current_A, "w": rated.speed_rad_s, "theta": rated.rise_K}
        return np.array([GAP * sizes.get(name, 1.0) for name in self.file.motor.states()])


def _residual(run: Run, shown: Mapping[str, Array], channel: str) -> Array:
    return run.measured[channel] - shown[channel]


def _loss(
    problem: _Problem, q: Array, predictions: Sequence[_Prediction], noise: Sequence[Mapping[str, Noise]]
) -> float:
    """Huber's loss of everything measured, and the priors; infinite where the motor cannot be simulated."""
    if not predictions:
        return float("inf")
    loss = 0.5 * float(np.sum(((q - problem.means) / problem.sds) ** 2))
    for run, (shown, _), sizes in zip(problem.runs, predictions, noise, strict=True):
        for channel, size in sizes.items():
            loss += huber_loss(size.whitened(np.nan_to_num(_residual(run, shown, channel))))
    points, names, gaps = problem.at(q), list(problem.file.motor.states()), problem.gaps()
    for a, b in problem.ties():
        gap = predictions[a][1] - np.array([points[b].start[name] for name in names])
        loss += 0.5 * float(np.sum((gap / gaps) ** 2))
    return loss if np.isfinite(loss) else float("inf")


def _normal_equations(
    problem: _Problem, q: Array, noise: Sequence[Mapping[str, Noise]]
) -> tuple[Array, Array, Array]:
    """Gauss-Newton: the matrix and the right-hand side, priors included, and the latter's parts by blocks of time."""
    points = problem.at(q)
    slopes = np.array([unknown.slope(unknown.value(q[j])) for j, unknown in enumerate(problem.unknowns)])

    blocks = max(BLOCKS // len(problem.runs), 1)

    def one(k: int) -> tuple[Array, Array, Array, Array]:
        run, at, sizes = problem.runs[k], points[k], noise[k]
        keys = [problem.unknowns[j].key for j in at.own]
        shown, columns, end, ends = differentiate(run, at, keys, tolerance=TOLERANCE)
        samples = run.inputs.time_s.size
        edges = np.unique(np.linspace(0, samples, min(blocks, samples) + 1).astype(int)[:-1])
        normal, scores = np.zeros((len(keys), len(keys))), np.zeros((edges.size, len(keys)))
        for channel, size in sizes.items():
            residual = _residual(run, shown, channel)
            missing = ~np.isfinite(residual)
            jacobian = columns[channel] * slopes[list(at.own)]
            jacobian[missing] = 0.0
            white, e = size.whitened(jacobian), size.whitened(np.nan_to_num(residual))
            weights = huber_weights(e)
            normal += white.T @ (weights[:, None] * white)
            scores += np.add.reduceat((weights * e)[:, None] * white, edges, axis=0)
        return normal, scores, end, ends * slopes[list(at.own)]

    parts = on_all_cores(one, range(len(problem.runs)))
    normal = np.diag(1.0 / problem.sds**2)
    right = (problem.means - q) / problem.sds**2
    scores = []
    for at, (own_normal, own_scores, _, _) in zip(points, parts, strict=True):
        own = list(at.own)
        normal[np.ix_(own, own)] += own_normal
        wide = np.zeros((len(own_scores), len(q)))
        wide[:, own] = own_scores
        scores.append(wide)
        right += wide.sum(axis=0)
    names, gaps = list(problem.file.motor.states()), problem.gaps()
    starts = {
        (unknown.run, unknown.key.removeprefix(INITIAL)): j
        for j, unknown in enumerate(problem.unknowns)
        if unknown.run is not None
    }
    for a, b in problem.ties():
        tie = np.zeros((len(names), len(q)))
        tie[:, list(points[a].own)] = parts[a][3]
        for r, name in enumerate(names):
            if (b, name) in starts:
                tie[r, starts[b, name]] -= 1.0
        gap = parts[a][2] - np.array([points[b].start[name] for name in names])
        tie /= gaps[:, None]
        normal += tie.T @ tie
        right -= tie.T @ (gap / gaps)
    return normal, right, np.concatenate(scores)


def _covariance(normal: Array, scores: Array) -> Array:
    """The covariance of the fit, no smaller than blocks of time bear out.

    Residuals that the noise model does not explain, such as those of physics that is missing, agree over long stretches.
    The sum of their contributions then varies more from block to block than the inverse of the normal matrix says (White
    1982, doi:10.2307/1912526, by clusters); deviations are widened to that.
    """
    model = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    sandwich = model @ (scores.T @ scores) @ model
    blocks = len(scores)
    widened = np.sqrt(np.maximum(np.diag(sandwich) * blocks / max(blocks - 1, 1) / np.diag(model), 1.0))
    return np.asarray(model * np.outer(widened, widened), dtype=np.float64)


def _noise(
    problem: _Problem, predictions: Sequence[_Prediction], colour: int | None
) -> list[dict[str, Noise]]:
    """The noise of each channel, from the residuals of all windows of its recording."""
    residuals: dict[tuple[int, str], list[Array]] = {}
    for run, (shown, _) in zip(problem.runs, predictions, strict=True):
        for channel in run.measured:
            residuals.setdefault((run.recording, channel), []).append(_residual(run, shown, channel))
    found = {}
    for (recording, channel), parts in residuals.items():
        of_channel = [run.measured[channel] for run in problem.runs if run.recording == recording]
        joined = np.nan_to_num(np.concatenate(of_channel))
        largest = float(np.max(np.abs(joined)))
        floor = max(SMALLEST_NOISE * largest, 1e-12)
        found[recording, channel] = estimate(np.concatenate(parts), floor, order=colour)
    return [{channel: found[run.recording, channel] for channel in run.measured} for run in problem.runs]


def _criterion(problem: _Problem, noise: Sequence[Mapping[str, Noise]]) -> float:
    """The concentrated likelihood: the sum of N log(sd) over all channels."""
    sizes = ((run, size) for run, own in zip(problem.runs, noise, strict=True) for size in own.values())
    return float(sum(run.inputs.time_s.size * np.log(size.sd) for run, size in sizes))


def _minimise(
    problem: _Problem, q: Array, order: int | None, progress: Callable[[str], None]
) -> tuple[Array, list[dict[str, Noise]], int, bool]:
    """Levenberg-Marquardt from q, noise of this order of colour estimated anew after every step."""
    accepted, damping, left = 0, 1e-3, float("inf")
    predictions = problem.predictions(q)
    noise = _noise(problem, predictions, order)
    while accepted < ITERATIONS:
        loss = _loss(problem, q, predictions, noise)
        normal, right, _ = _normal_equations(problem, q, noise)
        # How far the minimum is, in units of what the data can tell.
        left = float(np.sqrt(right @ np.linalg.solve(normal, right)))
        if left < SMALL_STEP:
            break
        scale = np.diag(np.diag(normal))
        lower, trial, ahead = float("inf"), q, predictions
        while lower >= loss and damping < 1e9:
            change = np.linalg.solve(normal + damping * scale, right)
            trial = _within_bounds(problem, q + change)
            ahead = _attempt(problem, trial)
            lower = _loss(problem, trial, ahead, noise)
            damping *= 8.0
        if lower >= loss:
            break
        q, predictions, accepted, damping = trial, ahead, accepted + 1, max(damping / 64.0, 1e-12)
        noise = _noise(problem, predictions, order)
        progress(f"step {accepted}: {left:.3g} deviations to go")
    return q, noise, accepted, left < CONVERGED


def _attempt(problem: _Problem, q: Array) -> list[_Prediction]:
    """Predictions, or nothing where the motor cannot be simulated."""
    try:
        return problem.predictions(q)
    except ModelError:
        return []


def _within_bounds(problem: _Problem, q: Array) -> Array:
    return np.array(
        [unknown.coordinate(unknown.value(x)) for unknown, x in zip(problem.unknowns, q, strict=True)]
    )


def _report(
    problem: _Problem,
    recordings: Sequence[Recording],
    q: Array,
    noise: Sequence[Mapping[str, Noise]],
    covariance: Array,
    iterations: int,
    converged: bool,
    held: bool,
) -> Calibration:
    unknowns = problem.unknowns
    count = sum(unknown.recording is None for unknown in unknowns)
    widened = np.sqrt(np.diag(covariance))
    # Blocks of time may disagree by more than the prior allows; the prior holds all the same.
    deviations = np.minimum(widened, problem.sds)
    value = {unknown.key: unknown.value(q[j]) for j, unknown in enumerate(unknowns[:count])}
    sd = {u.key: float(deviations[j] * u.slope(value[u.key])) for j, u in enumerate(unknowns[:count])}
    correlation = covariance[:count, :count] / np.outer(widened[:count], widened[:count])
    unidentified = {}
    for j, unknown in enumerate(unknowns[:count]):
        left = deviations[j] / unknown.sd
        if left > SHRUNK:
            unit = problem.file.meaning(unknown.key).unit
            unidentified[unknown.key] = (
                f"{unknown.key}: these recordings do not tell it ({left:.0%} of its prior deviation is left); "
                f"it stays at {unknown.mean:.4g} {unit}"
            )
            value[unknown.key] = unknown.mean
    names = ", ".join(recording.name for recording in recordings)
    known = {key: Knowledge(sd[key], f"calibrated on {names}") for key in value if key not in unidentified}
    predictions = problem.predictions(q)
    points = problem.at(q)
    residuals: list[dict[str, Array]] = [{} for _ in recordings]
    for run, (shown, _) in zip(problem.runs, predictions, strict=True):
        for channel in run.measured:
            whole = residuals[run.recording].setdefault(
                channel, np.full(len(recordings[run.recording]), np.nan)
            )
            whole[run.rows] = _residual(run, shown, channel)
    firsts = [
        next(k for k, run in enumerate(problem.runs) if run.recording == r) for r in range(len(recordings))
    ]
    fitted_load = any(unknown.key == LOAD for unknown in unknowns)
    return Calibration(
        keys=tuple(value),
        value=value,
        sd=sd,
        correlation=correlation,
        unidentified=unidentified,
        confounded=_confounded(list(value), correlation, unidentified),
        residuals=tuple(residuals),
        noise_sd=tuple({c: size.marginal_sd for c, size in noise[k].items()} for k in firsts),
        initial=tuple({name: float(x) for name, x in points[k].start.items()} for k in firsts),
        load_torque_Nm=tuple(points[k].load for k in firsts) if fitted_load else (),
        iterations=iterations,
        converged=converged,
        held=held,
        file=problem.file.with_values({key: value[key] for key in known}, known),
    )


def _confounded(keys: list[str], correlation: Array, unidentified: Mapping[str, str]) -> tuple[str, ...]:
    told = [k for k, key in enumerate(keys) if key not in unidentified]
    return tuple(
        f"{keys[a]} and {keys[b]}: these recordings tell them only together (correlation {correlation[a, b]:+.3f})"
        for a in told
        for b in told
        if a < b and abs(correlation[a, b]) > CONFOUNDED
    )
