"""What is known of a motor before its recordings are looked at: the motor file, and what anybody knows of motors.

One table and one rule for every command. A parameter with `sd = 0` is known exactly and is never fitted. A stated
deviation counts as stated; that a resistance or an inertia is next to nothing is far less likely than that says. A value
without one, or one that was fitted while something was missing from the model, may be off by the share of it that the
table says. What a file learnt from a recording does not count beside that recording, which would be counted twice; what was
stated, or taken, before does, and there the next fit begins.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import SETTLED
from motorlens_physics.estimate.model import Model, parts_of
from motorlens_physics.estimate.run import FIRST, STATE_OF, Run
from motorlens_physics.estimate.signals import most_noise_sd
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated

Array = NDArray[np.float64]

# How far from an unsupported value in a motor file a parameter may reasonably be, relative (one standard deviation). A
# motor file may be rough; copper is copper.
RELATIVE_SD = {
    "R_a0": 0.4, "L": 0.5, "ke": 0.4, "J": 0.5, "b": 1.0, "alpha": 0.1, "k0": 0.5, "kT": 1.0, "k_ir": 1.0, "H": 0.5,
}  # fmt: skip
# A source that begins so was fitted while an effect was missing, and moves when the effect is added.
FITTED = "fitted to "
# A source that begins so names the recordings that the value was learnt from.
CALIBRATED = "calibrated on "
# The source of what is taken of a parameter where nothing is stated.
TAKEN = "taken, as nothing was stated"
# A share of the value in the motor file below which no textbook parameter may fall: none is 20 times off.
LEAST = 0.05
# A width is no less than this share of what it typically is, or, that of a speed, than the noise of the speed if that is
# less: what is sharper acts as that does, and a fit has nothing to go by (`test_estimate_smooth_drive.py`: with no such
# end some fits wander there and do not converge).
SHARPEST = 0.1
# Nuisances are for small things: what would need more of them than this many standard deviations is something else.
WITHIN = 4.0
# A converter takes its channels one after another, within about a sample: one standard deviation, in samples. What is
# late by more is looked for as a delay of whole samples, see `delays`.
SKEW = 0.25
# An ambient that was not recorded is a room's.
AMBIENT_SD_K = 10.0


@dataclass(frozen=True)
class Prior:
    """What is known of the parameters being fitted: centre and standard deviation, and what is possible.

    Attributes:
        centre: what is likeliest.
        sd: standard deviation there.
        bounds: what is possible.
        positive: parameters that cannot be nought. All are normal, but below their centre these have the density of a gamma
            distribution of the same curvature there, which has nothing at nought.
    """

    centre: Mapping[str, float]
    sd: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    positive: frozenset[str] = frozenset()

    @property
    def keys(self) -> tuple[str, ...]:
        """The parameters being fitted."""
        return tuple(self.sd)

    def penalties(self, values: Mapping[str, float]) -> Array:
        """(k,) of each parameter, twice the negative logarithm of its density over that at the centre.

        >>> inertia = Prior({"J": 2.0}, {"J": 1.0}, {"J": (0.0, 9.0)}, frozenset({"J"}))
        >>> inertia.penalties({"J": 3.0}).round(1), inertia.penalties({"J": 0.02}).round(1)
        (array([1.]), array([28.9]))
        """

        def of(key: str, width: float) -> float:
            value, centre = values[key], self.centre[key]
            if key in self.positive and value < centre:
                share = value / centre
                return 2 * (centre / width) ** 2 * (share - 1 - float(np.log(share)))
            return float(((value - centre) / width) ** 2)

        return np.array([of(key, width) for key, width in self.sd.items()], dtype=np.float64)

    def penalty(self, values: Mapping[str, float]) -> float:
        """Of all parameters, see `penalties`; near the centre the squared distance from it, in standard deviations."""
        return float(np.sum(self.penalties(values)))

    def width(self, values: Mapping[str, float]) -> Array:
        """(k,) one over the root of half the curvature of each penalty, there."""
        wide = [
            width * (min(values[key] / self.centre[key], 1.0) if key in self.positive else 1.0)
            for key, width in self.sd.items()
        ]
        return np.array(wide, dtype=np.float64)

    def pull(self, values: Mapping[str, float]) -> Array:
        """(k,) half the slope of each penalty, towards the centre, in terms of that width."""
        towards = [(self.centre[key] - values[key]) / width for key, width in self.sd.items()]
        return np.array(towards, dtype=np.float64)

    def joined(self, other: "Prior") -> "Prior":
        """Both."""
        return Prior(
            {**self.centre, **other.centre}, {**self.sd, **other.sd}, {**self.bounds, **other.bounds},
            self.positive | other.positive,
        )  # fmt: skip

    def only(self, keys: Sequence[str]) -> "Prior":
        """Of some parameters."""
        return Prior(
            {key: self.centre[key] for key in keys},
            {key: self.sd[key] for key in keys},
            {key: self.bounds[key] for key in keys},
            self.positive & frozenset(keys),
        )


NOTHING = Prior({}, {}, {})


def base_prior(file: MotorFile, runs: Sequence[Run]) -> Prior:
    """All that may be fitted: the textbook's parameters, those of effects and sensors, the nuisances of each run."""
    names = frozenset(run.name for run in runs)
    prior = textbook_prior(file, names)
    for part in parts_of(file):
        prior = prior.joined(part_prior(file, part.name(), runs))
    return prior.joined(nuisance_prior(file, runs))


def textbook_prior(file: MotorFile, recordings: Set[str] = frozenset()) -> Prior:
    """The textbook's parameters that are not known exactly, beside recordings of these names."""
    prior = NOTHING
    for key in RELATIVE_SD:
        meaning, known = file.meaning(key), held_to(file, key, recordings)
        if known.sd == 0:
            continue
        bounds = (max(meaning.bounds[0], LEAST * known.value), meaning.bounds[1])
        positive = frozenset({key} if bounds[0] > 0 else ())
        prior = prior.joined(Prior({key: known.value}, {key: known.sd}, {key: bounds}, positive))
    return prior


def stated(file: MotorFile, key: str, recordings: Set[str] = frozenset()) -> Stated | None:
    """What a motor file states of a parameter beside recordings of these names, from which none of it was learnt.

    None if it states nothing.
    """
    known = file.knowledge.get(key, Knowledge())
    if known.sd is None:
        return known.prior
    now = Stated(file.values()[key], known.sd, known.source)
    return next((one for one in (now, known.prior) if one and not _learnt(one, recordings)), None)


def held_to(file: MotorFile, key: str, recordings: Set[str] = frozenset()) -> Stated:
    """What a fit to recordings of these names holds a parameter to: what is stated, or what is taken where nothing is."""
    known = stated(file, key, recordings)
    if known is not None:
        return known
    meaning, value = file.meaning(key), file.values()[key]
    if key in RELATIVE_SD:
        size = max(abs(value), 0.1 * meaning.typical(file.rated))
        return Stated(value, RELATIVE_SD[key] * size, TAKEN)
    # The switch is free; a shape is known within a factor of a few.
    if meaning.null is not None:
        return Stated(meaning.null, 30 * abs(meaning.typical(file.rated)), TAKEN)
    return Stated(value, max(abs(value), meaning.sd(file.rated)), TAKEN)


def states(file: MotorFile, key: str) -> bool:
    """Whether a motor file says what a parameter is: always of the motor's own, of others with a standard deviation."""
    known = file.knowledge.get(key, Knowledge())
    source = known.source if known.prior is None else known.prior.source
    return key in RELATIVE_SD or (known.sd is not None and source != TAKEN)


def at_prior(file: MotorFile, prior: Prior) -> MotorFile:
    """The motor file with the textbook's parameters at the centre of their prior: where an estimate begins.

    Begun where an earlier fit to the same recordings ended, it may end in another minimum than that fit did. Effects and
    sensors' faults, whose prior is of any size, stay where they are.
    """
    return file.with_values({key: prior.centre[key] for key in prior.keys if key in RELATIVE_SD})


def calibrated_on(one: Stated | None) -> tuple[str, ...]:
    """The recordings that something stated was learnt from, by name."""
    if one is None or not one.source.startswith(CALIBRATED):
        return ()
    return tuple(one.source.removeprefix(CALIBRATED).split(", "))


def _learnt(one: Stated, recordings: Set[str]) -> bool:
    """Whether it was learnt from one of these recordings, or while something was missing; not what is known exactly."""
    return one.sd > 0 and (one.source.startswith(FITTED) or not recordings.isdisjoint(calibrated_on(one)))


def part_prior(file: MotorFile, name: str, runs: Sequence[Run] = ()) -> Prior:
    """The free parameters of an effect or a sensor model of the file: wide around their value, within their bounds.

    Args:
        file: the motor file.
        name: of the effect or sensor model.
        runs: what it is fitted to, see `stated` and `SHARPEST`.
    """
    part = next(part for part in parts_of(file) if part.name() == name)
    prior, recordings = NOTHING, frozenset(run.name for run in runs)
    for parameter, meaning in part.parameters().items():
        key = f"{name}.{parameter}"
        known = held_to(file, key, recordings)
        if meaning.fixed or known.sd == 0:
            continue
        low, high = meaning.bounds
        if meaning.role == "width":
            shown = map(_speed_noise, runs) if meaning.unit == "rad/s" else ()
            low = max(low, min([SHARPEST * meaning.typical(file.rated), *shown]))
        prior = prior.joined(Prior({key: known.value}, {key: known.sd}, {key: (low, high)}))
    return prior


def _speed_noise(run: Run) -> float:
    """The largest that the noise of a measured speed can be, rad/s, its converter's included; infinite without one."""
    if "speed" not in run.channels:
        return np.inf
    k = run.channels.index("speed")
    step = float(run.steps[k])
    return float(np.hypot(most_noise_sd(run.measured[:, k], step), step / np.sqrt(12)))


def nuisance_prior(file: MotorFile, runs: Sequence[Run]) -> Prior:
    """What each run has of its own: its start, an ambient that was not recorded, a skew between its channels."""
    prior = NOTHING
    for r, run in enumerate(runs):
        for name, width in nuisance_sd(file, run).items():
            prior = prior.joined(around(f"{name}@{r}", first_guess(run, name), width))
    return prior


def start_prior(model: Model, name: str) -> Prior:
    """How warm the parts that an effect of the model brings were at the start of each run."""
    effect = model.file.motor.effect(name)
    prior = NOTHING
    for state in effect.states if effect else ():
        for r, own in enumerate(model.own):
            key = f"initial.{state}"
            if key in own:
                width = _warmth_sd(model.file, own["initial.theta"])
                prior = prior.joined(around(f"{key}@{r}", own[key], width))
    return prior


def around(key: str, middle: float, width: float) -> Prior:
    """A nuisance that is small beside `WITHIN` standard deviations."""
    return Prior({key: middle}, {key: width}, {key: (middle - WITHIN * width, middle + WITHIN * width)})


def first_guess(run: Run, name: str) -> float:
    """Where a nuisance of a run starts."""
    if not name.startswith("initial."):
        return 0.0
    # What is not measured warms with the winding.
    return run.start.get(name.removeprefix("initial."), SETTLED * run.start["theta"])


def nuisance_sd(file: MotorFile, run: Run) -> dict[str, float]:
    """The nuisances of a run and how large they may be."""
    rated = file.rated
    own = {"initial.theta": 0.3 * rated.rise_K, "initial.i": 0.3 * rated.current_A}
    if "current" not in run.channels:
        own["initial.i"] += abs(run.start["i"])
    own["initial.w"] = (0.02 if "speed" in run.channels else 0.1) * rated.speed_rad_s
    if "temperature" not in run.channels:
        # Without a current either, how warm the winding is cannot be told from R_a0, and is left to it.
        own["initial.theta"] = (0.5 if "current" in run.channels else 0.03) * rated.rise_K
    for effect in file.motor.effects:
        warm = _warmth_sd(file, run.start["theta"])
        own |= {f"initial.{state}": warm for state, what in effect.states.items() if what.kind == "rise"}
    if "ambient" not in run.known and "temperature" in run.channels:
        own["ambient"] = AMBIENT_SD_K
    for k, channel in enumerate(run.channels):
        if channel != "temperature":
            own[f"skew.{channel}"] = SKEW * run.period_s
            # A motor that is switched on with its first sample is elsewhere at the third.
            key = f"initial.{STATE_OF[channel]}"
            own[key] = float(np.hypot(own[key], np.ptp(run.measured[:FIRST, k])))
    return own


def _warmth_sd(file: MotorFile, rise_K: float) -> float:
    return 0.3 * abs(rise_K) + 0.02 * file.rated.rise_K
