"""The whole model fitted again with a hypothesis in it, or without one: does what the linearised problem promised hold?"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.estimate import by_least_squares, near, one_step_ahead, whole
from motorlens_physics.estimate.fit import NEAREST, foretold, inverse, minimise, start_model
from motorlens_physics.estimate.model import Model, with_effect, with_sensor, without_part
from motorlens_physics.estimate.points import at, minimised, needed, shown_at, weighed
from motorlens_physics.estimate.points import begun as first_noise_of
from motorlens_physics.estimate.prior import Prior, at_prior, part_prior, start_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed
from motorlens_runtime.errors import ModelError
from motorlens_workbench.evidence.ledger import Beside
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.hypotheses.effects import EffectShape, phase_of
from motorlens_workbench.hypotheses.sensors import SensorShape

Array = NDArray[np.float64]

# Steps of a refit, and how near to the minimum it ends, in standard deviations of the result: rivals differ by more.
ROUNDS, ENOUGH = 10, 0.3
# Share of the gain that the linearised problem promised below which a refit has lost its way and is begun elsewhere.
KEPT = 0.5
# A linear start is not quite at null, where shapes would be undetermined.
LEAST = 1e-3
# The variance of a parameter that is known for certain.
TINY = 1e-300


def refit(model: Model, prior: Prior, runs: Sequence[Run]) -> Fitted | None:
    """Fit a model from where it is, the noise as it is; None if it leads where nothing can be simulated."""
    try:
        return _refit(_point(model, prior, runs), prior, runs)
    except ModelError:
        return None


def _refit(point: Weighed, prior: Prior, runs: Sequence[Run]) -> Fitted | None:
    try:
        point, gram, _ = minimise(
            point,
            prior,
            lambda trial: _point(trial, prior, runs),
            lambda trial: shown_at(trial, point),
            rounds=ROUNDS,
            enough=ENOUGH,
        )
    except ModelError:
        return None
    cost = point.cost + prior.penalty(point.model.values())
    return Fitted(point.model, prior, tuple(runs), cost, inverse(gram))


def settled(fitted: Fitted) -> Fitted:
    """Fitted to the end, the noise and the inputs' corrections found along.

    Raises:
        ModelError: it leads where nothing can be simulated.
    """
    return _settled(_point(fitted.model, fitted.prior, fitted.runs), fitted.prior)


def _settled(point: Weighed, prior: Prior) -> Fitted:
    point, gram, _ = minimised(point, prior, lambda text: None, outliers=False)
    runs = tuple(replace(part.run, noise=part.noise) for part in point.parts)
    cost = point.cost + prior.penalty(point.model.values())
    return Fitted(point.model, prior, runs, cost, inverse(gram))


def anew(fitted: Fitted, reached: Weighed | None = None) -> Fitted | None:
    """The model estimated from the beginning with the effects and sensors' faults that it has, timing and noise included.

    It begins at the motor file, not where the model without them had ended: what is missing bends the parameters, and may
    pass for a delay or for inputs that ran otherwise. Or it goes on from what `nearly` has reached. It ends as `settled`
    does, so that both can be compared. None if it leads where nothing can be simulated.
    """
    begin, runs = _beginning(fitted)
    prior = fitted.prior
    try:
        pieces = near(runs, prior, begin) if reached is None else reached
        return _settled(whole(pieces, begin, runs, prior), prior)
    except ModelError:
        return None


def nearly(fitted: Fitted) -> Weighed | None:
    """Near the best parameters as far as pieces of long recordings tell, as `anew` begins; inputs run as in the fit."""
    begin, runs = _beginning(fitted)
    try:
        return near(runs, fitted.prior, replace(begin, held=fitted.model.held), free=False)
    except ModelError:
        return None


def may_be_likelier(one: Weighed, other: Weighed, prior: Prior, full: Prior) -> bool:
    """Whether a model may be likelier beyond chance, where `nearly` has led it, than another of fewer parameters is there.

    Each under its own noise, for one that has gone astray may have a noise by which every other model is impossible; or by
    the errors that both leave, in units of the noise of the other. Where friction falls with speed a resting rotor is about
    to slip, and what noise of the inputs does between slow samples is told by neither model before it is fitted to the end.

    Args:
        one: the other's.
        other: the model's.
        prior: of the other's parameters.
        full: of the model's.
    """
    beyond = needed(1)
    if _unlikely(one, prior) - _unlikely(other, full) > beyond:
        return True
    try:
        seen = at(other.model, one, full.only([]))
    except ModelError:
        return False
    won = one.cost - seen.cost + prior.penalty(one.model.values()) - full.penalty(other.model.values())
    return won > beyond


def _unlikely(point: Weighed, prior: Prior) -> float:
    """Twice the negative logarithmic likelihood of a point; samples that are missing count as the others do in the mean."""
    samples = 0.0
    for part in point.parts:
        samples += float(np.sum(part.read.unlikely) * part.used.size / max(int(np.sum(part.used)), 1))
    return samples + prior.penalty(point.model.values())


def at_first(fitted: Fitted) -> float:
    """What least squares leave of a model from the beginning, see `by_least_squares`; infinite if it cannot be simulated."""
    begin, runs = _beginning(fitted)
    try:
        return by_least_squares(runs, fitted.prior, begin)
    except ModelError:
        return float("inf")


def ahead(fitted: Fitted, other: Weighed) -> float:
    """What a model would leave near the best parameters, see `one_step_ahead`; infinite where nothing can be simulated.

    Args:
        fitted: the model.
        other: where `nearly` has led another.
    """
    begin, runs = _beginning(fitted)
    try:
        return one_step_ahead(other, runs, fitted.prior, replace(begin, held=fitted.model.held))
    except ModelError:
        return float("inf")


def _beginning(fitted: Fitted) -> tuple[Model, list[Run]]:
    """The model as its motor file has it, but for effects and sensors' faults, and the runs as they were recorded."""
    runs = [run.as_recorded for run in fitted.runs]
    return start_model(at_prior(fitted.model.file, fitted.prior), runs), runs


def begun(fitted: Fitted, score: Score, sizes: Array | None = None) -> Fitted:
    """The model with a hypothesis at some sizes (k,) of its columns, or at its typical size, not fitted."""
    shape = score.entry.shape
    assert isinstance(shape, EffectShape | SensorShape)
    model, prior = _added(fitted, _part(shape, _typical(score) if sizes is None else sizes), moved={})
    return replace(fitted, model=model, prior=prior)


def at_file(fitted: Fitted) -> Fitted:
    """The model with the motor as its file has it, nothing fitted: its recordings as they were, with the noise there.

    Raises:
        ModelError: it cannot be simulated there.
    """
    model, runs = _beginning(fitted)
    point = first_noise_of(model, runs, fitted.prior)
    there = tuple(replace(part.run, noise=part.noise) for part in point.parts)
    unsure = np.diag(fitted.prior.width(model.values()) ** 2)
    return replace(fitted, model=model, runs=there, cost=point.cost, covariance=unsure)


def _point(model: Model, prior: Prior, runs: Sequence[Run]) -> Weighed:
    noises = []
    for run in runs:
        assert run.noise is not None
        noises.append(run.noise)
    return weighed(model, runs, noises, [run.there for run in runs], prior.keys)


def with_hypothesis(fitted: Fitted, beside: Beside, score: Score) -> Fitted | None:
    """The model fitted again with a hypothesis, under the noise that the model has; None if no start can be simulated.

    It starts where the linearised problem ends or, from the model as it is, with the hypothesis at its typical size: where
    the errors are smaller, and if that loses its way, from the other.
    """
    best: Fitted | None = None
    for point, prior in _starts(fitted, beside, score):
        other = _refit(point, prior, fitted.runs)
        if other is not None and (best is None or other.cost < best.cost):
            best = other
        if best is not None and fitted.cost - best.cost >= KEPT * score.gain:
            break
    return best


def promise(fitted: Fitted, beside: Beside, score: Score) -> float:
    """By how much the cost falls with a hypothesis in the model, as linearised from where a fit of it starts.

    Where its size is nought, the parameters beside it may fall from there to less than the model has: it did not do that.
    """
    size = score.entry.hypothesis.key
    for point, prior in _starts(fitted, beside, score):
        values, null = point.model.values(), point.model.file.meaning(size).null
        assert null is not None
        own = {key: values[key] for key in prior.keys if key not in fitted.prior.keys}
        try:
            without = foretold(point, prior, {**own, size: null})
            return min(fitted.cost, without) - foretold(point, prior)
        except ModelError:
            continue
    return 0.0


def _starts(fitted: Fitted, beside: Beside, score: Score) -> list[tuple[Weighed, Prior]]:
    """Where a fit with a hypothesis may start, the errors smallest first; see `with_hypothesis`."""
    shape = score.entry.shape
    assert isinstance(shape, EffectShape | SensorShape)
    at_typical = begun(fitted, score)
    starts: list[tuple[float, Weighed, Prior]] = []
    for model, prior in (
        _added(fitted, _part(shape, _sizes(score)), _moved(fitted, beside, score)),
        (at_typical.model, at_typical.prior),
    ):
        try:
            point = _point(model, prior, fitted.runs)
        except ModelError:
            continue
        starts.append((point.cost + prior.penalty(model.values()), point, prior))
    return [(point, prior) for _, point, prior in sorted(starts, key=lambda start: start[0])]


def without_hypothesis(fitted: Fitted, name: str) -> Fitted | None:
    """The model fitted again without an effect or a sensor's fault; None if it cannot be simulated.

    It starts from where the others would go, as linearised, if the size of that went to nought, or from where they are.
    """
    model = without_part(fitted.model, name)
    values = model.values()
    prior = fitted.prior.only([key for key in fitted.prior.keys if key in values])
    goes, starts = _making_up_for(fitted, name), []
    for moved in ({key: values[key] + goes[key] for key in prior.keys}, {}):
        try:
            point = _point(model.with_values(_within(prior, values, moved)), prior, fitted.runs)
        except ModelError:
            continue
        starts.append((point.cost + prior.penalty(point.model.values()), point))
    if not starts:
        return None
    return _refit(min(starts, key=lambda start: start[0])[1], prior, fitted.runs)


def _making_up_for(fitted: Fitted, name: str) -> dict[str, float]:
    """How far each other parameter goes, as linearised, if the size of an effect or a sensor's fault goes to nought."""
    keys, values = fitted.prior.keys, fitted.model.values()
    own = {key: fitted.model.file.meaning(key).null for key in keys if key.startswith(f"{name}.")}
    size, null = next((key, null) for key, null in own.items() if null is not None)
    at = keys.index(size)
    steps = fitted.covariance[at] / max(fitted.covariance[at, at], TINY) * (null - values[size])
    return {key: step for key, step in zip(keys, steps.tolist(), strict=True) if key not in own}


def _typical(score: Score) -> Array:
    low, high = score.entry.shape.limits()
    sign = np.sign(score.coefficient[0])
    return np.asarray(np.eye(score.entry.shape.width)[0] * (sign if sign and low <= sign <= high else 1.0))


def _sizes(score: Score) -> Array:
    if len(score.coefficient) > 1:
        return score.coefficient
    low, high = score.entry.shape.limits()
    size = float(np.clip(score.coefficient[0], low, high))
    return np.array([size if abs(size) > LEAST else LEAST * (1.0 if high > 0 else -1.0)])


def _part(shape: EffectShape | SensorShape, sizes: Array) -> Effect | object:
    if isinstance(shape, SensorShape):
        switch = shape.sensor.switch()
        assert switch is not None and switch.null is not None
        typical = getattr(shape.sensor, switch.name)
        return replace(shape.sensor, **{switch.name: switch.null + sizes[0] * (typical - switch.null)})
    effect = shape.parts[0]
    switch = type(effect).switch()
    assert switch.null is not None
    typical = getattr(effect, switch.name) - switch.null
    if len(sizes) == 1:
        return replace(effect, **{switch.name: switch.null + float(sizes[0]) * typical})
    # sin(N phi + p) = sin(N phi) cos p + cos(N phi) sin p
    amplitude, phase = float(np.hypot(*sizes)), float(np.arctan2(sizes[1], sizes[0]))
    return replace(effect, **{switch.name: switch.null + amplitude * typical, phase_of(type(effect)): phase})


def _added(fitted: Fitted, part: object, moved: dict[str, float]) -> tuple[Model, Prior]:
    model = (
        with_effect(fitted.model, part) if isinstance(part, Effect) else with_sensor(fitted.model, part)  # type: ignore[arg-type]
    )
    name = part.name()  # type: ignore[attr-defined]
    prior = fitted.prior.joined(part_prior(model.file, name, fitted.runs)).joined(start_prior(model, name))
    return model.with_values(moved), prior


def _moved(fitted: Fitted, beside: Beside, score: Score) -> dict[str, float]:
    """The fitted parameters moved along, as the linearised problem has them beside the hypothesis."""
    values, prior = fitted.model.values(), fitted.prior
    steps = beside.moves_with(score.entry, score.coefficient)
    moved = {
        key: values[key] + step * beside.ledger.unit[key] for key, step in zip(prior.keys, steps, strict=True)
    }
    return _within(prior, values, moved)


def _within(prior: Prior, values: Mapping[str, float], moved: Mapping[str, float]) -> dict[str, float]:
    """Moved parameters as far as they may go from their values."""
    allowed = {}
    for key in prior.keys:
        if key in moved:
            low, high = prior.bounds[key]
            if low >= 0 and values[key] > 0:
                low = max(low, NEAREST * values[key])
            allowed[key] = float(np.clip(moved[key], low, high))
    return allowed
