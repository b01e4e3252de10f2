"""What one recording says of the motor: its log-likelihood as a parabola, free of what was known beforehand.

The estimate of a recording is a point; near it the log-likelihood of the parameters is quadratic, with the gradient and the
information that the last step of the fit had (Gauss-Newton). What belongs to the recording alone, such as its start, is
taken out by its own best value (Laplace). Populations, histories and oddness are computed from these parabolas, and no
recording is simulated again.

Candidates are the effects of the catalogue and the faults of sensors, each at the value at which it vanishes: the parabola
reaches into their directions too, so that whether one is missing is a score test (Rao 1948,
doi:10.1017/S0305004100023987), on one recording or on a thousand together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.estimate import Estimate
from motorlens_physics.estimate.fit import inverse, start_model
from motorlens_physics.estimate.innovations import innovations
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.noise import OUTLIER, Noise
from motorlens_physics.estimate.points import weighed
from motorlens_physics.estimate.prior import NOTHING, Prior, part_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensor_model import sensor_models

Array = NDArray[np.float64]

# Faults of sensors of what the motor does. What an input's sensor shows wrongly would be sought along the input as it was
# measured, noise included, and attenuated like any error in a variable.
_FAULTS = ("gain", "offset", "lag")
# Share of what is known beforehand that keeps what no recording tells finite.
FAINT = 1e-3
# A recording that tells a candidate no better than this many times its typical size says nothing of it.
TELLS = 3.0


@dataclass(frozen=True, eq=False)
class Parabola:
    """log p(recording | x) = const + gradient (x - at) - (x - at) information (x - at) / 2.

    Attributes:
        keys: of the parameters, k.
        at: (k,) where it was found.
        gradient: (k,) there.
        information: (k, k) symmetric, positive or zero.
    """

    keys: tuple[str, ...]
    at: Array
    gradient: Array
    information: Array

    def as_json(self) -> dict[str, Any]:
        """For a result file."""
        return {
            "keys": list(self.keys), "at": self.at.tolist(), "gradient": self.gradient.tolist(),
            "information": self.information.tolist(),
        }  # fmt: skip

    @classmethod
    def of_json(cls, document: Mapping[str, Any]) -> "Parabola":
        """From a result file."""
        at, gradient, information = (
            np.array(document[name], dtype=np.float64) for name in ("at", "gradient", "information")
        )
        return cls(tuple(document["keys"]), at, gradient, information)


def candidates(file: MotorFile, channels: Sequence[str]) -> tuple[str, ...]:
    """Names of effects and sensor faults that a parabola can reach, and the motor file does not hold.

    Effects that bring a state or go with the shaft's angle are not among them: at the value at which they vanish, their
    shape is undetermined.
    """
    there, models = {part.name() for part in file.parts}, sensor_models()
    effects = (name for name, effect in catalogue().items() if not effect.states)
    faults = (f"{channel}_sensor_{fault}" for channel in channels for fault in _FAULTS)
    return tuple(
        name
        for name in (*effects, *faults)
        if name not in there and (name in models or "_sensor_" not in name)
    )


def switch_of(name: str) -> str:
    """The key of the parameter that switches an effect or a sensor fault off at its null."""
    model: Any = catalogue().get(name) or sensor_models()[name]
    return next(f"{name}.{key}" for key, p in model.parameters().items() if p.null is not None)


def with_candidates(file: MotorFile, names: Sequence[str]) -> MotorFile:
    """The motor file with effects and sensor faults that vanish."""
    effects, models = catalogue(), sensor_models()
    for name in names:
        if name in effects:
            file = replace(file, motor=file.motor.with_effect(effects[name].at_null(file.rated)))
        else:
            file = replace(file, sensors=(*file.sensors, models[name].at_null(file.rated)))
    return file


def parabola(found: Estimate, names: Sequence[str] = (), prior: Prior | None = None) -> Parabola:
    """The parabola of an estimate from one recording.

    Args:
        found: of one recording.
        names: of candidates, see `candidates`.
        prior: the parameters that it is a parabola of; None: those that were fitted.

    Raises:
        ModelError: the motor cannot be simulated with one of them.
    """
    file, prior = with_candidates(found.fit.model.file, names), prior or found.fit.prior
    switches = tuple(switch_of(name) for name in names)
    prior = prior.joined(_priors(file, names).only(switches))
    point = _point(replace(found.fit.model, file=file), found, prior.keys)
    values = point.model.values()
    width = prior.width(values)
    pull = prior.pull(values) / width
    gram, gradient = point.normal()
    known = np.diag(width**-2)
    own = np.array(["@" in key for key in prior.keys])
    switch = np.array([key in switches for key in prior.keys])
    wider = np.ones(len(width))
    wider[~switch] = _wider(point, gram, known, ~switch)
    wider[switch] = _wider_scores(point, gram, known, switch)
    # What belongs to the recording is at its best for every value of the others.
    information, slope = _without(gram + np.where(own, known, 0.0), gradient + np.where(own, pull, 0.0), own)
    switch, wider, known = switch[~own], wider[~own], known[np.ix_(~own, ~own)]
    weaker = information / np.outer(wider, wider)
    slope = _slopes(information, slope, known, switch, weaker, wider)
    keys = tuple(key for key in prior.keys if "@" not in key)
    return Parabola(keys, np.array([values[key] for key in keys]), slope, weaker)


def ended(found: Estimate) -> dict[str, Any]:
    """Where the estimate of one recording ended, for a result file: from there it can go on."""
    run, model = found.runs[0], found.fit.model
    assert run.noise is not None
    return {
        "values": {key: model.values()[key] for key in found.fit.prior.keys},
        "held": list(model.held[0]),
        "late": dict(run.late),
        "mean_speed": run.mean_speed,
        "noise": {
            "sensors": run.noise.sensors.tolist(), "disturbances": run.noise.disturbances.tolist(),
            "lasts_s": run.noise.lasts_s.tolist(), "between": list(run.noise.between),
            "edges_V": run.noise.edges_V.tolist(),
        },
    }  # fmt: skip


def where_it_ended(
    end: Mapping[str, Any], file: MotorFile, runs: Sequence[Run], prior: Prior
) -> tuple[Model, tuple[Run, ...]]:
    """A motor file's model and a prepared recording where an estimate of it ended.

    Args:
        end: see `ended`.
        file: the motor, with what is known of it now.
        runs: the recording, one.
        prior: the parameters that are free now.
    """
    (run,), told = runs, end["noise"]
    # Files of before speeds were taken as means do not say so.
    run = run.showing(end.get("mean_speed", False))
    for channel, samples in end["late"].items():
        run = run.delayed(channel, samples)
    disturbances, lasts_s = (np.array(told[name]) for name in ("disturbances", "lasts_s"))
    # Files of before noise could be uneven have one variance of each channel.
    sensors = np.array(told["sensors"] if "sensors" in told else [[one] for one in told["channels"]])
    # Its limits are those of the recording, see `Noise.like`.
    nothing, between = np.zeros_like(disturbances), told.get("between", False)
    # Files of before a load could change between samples say so of the voltage alone.
    voltage, load = between if isinstance(between, list) else (between, False)
    edges_V, floor = np.array(told.get("edges_V", [])), sensors.min(axis=1)
    noise = Noise(sensors, disturbances, disturbances, lasts_s, floor, nothing, (voltage, load), edges_V)
    # What had gone where nothing is any more begins at the nearest.
    values = {
        key: float(np.clip(value, *prior.bounds[key]))
        for key, value in end["values"].items()
        if key in prior.keys
    }
    held: Any = tuple(end["held"])
    return replace(start_model(file, runs), held=(held,)).with_values(values), (replace(run, noise=noise),)


def _without(gram: Array, gradient: Array, own: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Information and gradient of the others, with the parameters `own` at their best."""
    if not own.any():
        return gram, gradient
    through = gram[np.ix_(~own, own)] @ inverse(gram[np.ix_(own, own)])
    information = gram[np.ix_(~own, ~own)] - through @ gram[np.ix_(own, ~own)]
    return 0.5 * (information + information.T), gradient[~own] - through @ gradient[own]


def _slopes(
    information: Array, slope: Array, known: Array, switch: NDArray[np.bool_], weaker: Array, wider: Array
) -> Array:
    """Gradients of the weaker parabola.

    The top in the parameters fitted stays where it is; of a candidate, its efficient score beside them goes down with its
    information, so that it is as many deviations away as its scatter allows.
    """
    base, cross = np.ix_(~switch, ~switch), np.ix_(switch, ~switch)
    out = slope.copy()
    # A direction that is not told has no top; a trace of what is known beforehand keeps it finite.
    out[~switch] = weaker[base] @ inverse(information[base] + FAINT * known[base]) @ slope[~switch]

    def shift(table: Array, gradient: Array) -> Array:
        return np.asarray(table[cross] @ inverse(table[base] + known[base]) @ gradient)

    efficient = slope[switch] - shift(information, slope[~switch])
    out[switch] = efficient / wider[switch] ** 2 + shift(weaker, out[~switch])
    return out


def _priors(file: MotorFile, names: Sequence[str]) -> Prior:
    prior = NOTHING
    for name in names:
        prior = prior.joined(part_prior(file, name))
    return prior


def _point(model: Model, found: Estimate, keys: Sequence[str]) -> Weighed:
    noises = [run.noise for run in found.runs]
    assert all(noise is not None for noise in noises)
    used = [run.there for run in found.runs]
    point = weighed(model, found.runs, [n for n in noises if n is not None], used, keys)
    if found.outliers:
        used = [
            part.used
            & (np.abs(innovations(part.read.space, part.read.error[:, :, None]).white[:, :, 0]) <= OUTLIER)
            for part in point.parts
        ]
        point = weighed(model, found.runs, [part.noise for part in point.parts], used, keys)
    return point.tempered()


def _wider(point: Weighed, gram: Array, known: Array, of: NDArray[np.bool_]) -> Array:
    """(k,) at least 1: by how much the scatter of the scores between blocks of time widens each deviation."""
    model_based, scores = inverse((gram + known)[np.ix_(of, of)]), _centred(point)[:, of]
    sandwich = model_based @ (scores.T @ scores) @ model_based
    return np.asarray(np.sqrt(np.maximum(np.diagonal(sandwich) / np.diagonal(model_based), 1.0)))


def _wider_scores(point: Weighed, gram: Array, known: Array, switch: NDArray[np.bool_]) -> float:
    """The same of the efficient scores of candidates, one factor for all: some of them are nearly the same thing."""
    if not switch.any():
        return 1.0
    through = gram[np.ix_(switch, ~switch)] @ inverse((gram + known)[np.ix_(~switch, ~switch)])
    information = np.diagonal(gram[np.ix_(switch, switch)] - through @ gram[np.ix_(~switch, switch)])
    scores = _centred(point)
    scatter = np.sum((scores[:, switch] - scores[:, ~switch] @ through.T) ** 2, axis=0)
    told = information > 0
    return float(np.sqrt(max(np.median(scatter[told] / information[told]), 1.0))) if told.any() else 1.0


def _centred(point: Weighed) -> Array:
    """(B, k) scores of blocks of time, for sums of squares."""
    scores = point.scores() / point.inflation
    return np.asarray(scores * np.sqrt(len(scores) / max(len(scores) - 1, 1)))
