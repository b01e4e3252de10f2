"""Which test would tell a group apart: every scenario simulated from the present model, added to what the recordings say.

Two rivals are apart by the 2 log likelihood that one leaves where the other is true: of the truth's column, at the size it
was found with, what the rival, the base parameters and the other effects cannot take up. Information adds, so that of a new
recording is added to that of the old ones, which know the base parameters already and hold the rivals to their sizes.
Hunter and Reiner (1965), Designs for discriminating between two rival models, doi:10.1080/00401706.1965.10490265.

Where no run with the sensors at hand is enough, one with a further sensor may be, or one without the torque sensor and
anything else on the shaft: what the shaft does not bear, no sensor can report wrongly. Where none tells all apart, the one
is proposed that leaves fewest together; where none tells anything, only a reference instrument does.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.run import STATE_OF, Run
from motorlens_physics.scenario import perform, scenarios
from motorlens_physics.sensor_model import RATED_OF_CHANNEL
from motorlens_runtime.errors import ModelError, MotorlensError
from motorlens_workbench.contest.exchange import fitted_in_its_place
from motorlens_workbench.contest.worth import own_score
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.diagnose import Finding
from motorlens_workbench.evidence.ledger import common
from motorlens_workbench.evidence.score import inverse
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.hypotheses.courses import of_parameter
from motorlens_workbench.hypotheses.effects import EffectShape, effects
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.hypotheses.sensors import sensors
from motorlens_workbench.standing import Standing
from motorlens_workbench.verdict import Verdict

Array = NDArray[np.float64]

# 2 log likelihood between two rivals, over the inflation of the accepted one's test, that settles the matter; and how many
# times what the model leaves out may feign.
SETTLED, CLEAR = 60.0, 2.0
# A run may be made so many times as long as its scenario has it, up to two hours; one shorter than the least would be judged
# by the torque that nobody measures, which goes on for seconds.
LONGER, LONGEST_S, SHORTEST_S = 20.0, 7200.0, 20.0
# No bench is given up for one question for longer than a working day.
DAY_S = 8 * 3600.0
# Once the rotor has stopped, a longer run of it says nothing more.
ENDS = ("coast_down",)
# Noise of a sensor that is not there yet, as a share of the rated value.
NEW_SENSOR = 0.01


@dataclass(frozen=True)
class Experiment:
    """A test that would tell rivals apart.

    Attributes:
        test: the scenario's name, "" if none would.
        separates: the rivals.
        parts: these, those together that it does not tell from each other.
        seconds: how long to record.
        why: a sentence.
        with_sensor: the quantity to measure beside those recorded so far, "" if they are enough.
        bare: run it with nothing on the shaft, the torque sensor taken off and 0 in its column, see `Run.bare`.
        check: quantities whose sensors only a reference instrument can judge, where no test tells.
    """

    test: str
    separates: tuple[str, ...]
    parts: tuple[tuple[str, ...], ...]
    seconds: float
    why: str
    with_sensor: str = ""
    bare: bool = False
    check: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """For the reader."""
        apart = self.parts if len(self.parts) > 1 else [(name,) for name in self.separates]
        return f"To tell {_listed([_said(' or '.join(part)) for part in apart])} apart: {self.why}"


@dataclass(frozen=True)
class _Run:
    """A run that may be made.

    Attributes:
        test: the scenario's name.
        way: how it is measured: which is new of the outputs, and whether the shaft is bare.
        parts: the group as it tells it apart.
        seconds: how long it takes.
    """

    test: str
    way: tuple[str, bool]
    parts: tuple[tuple[str, ...], ...]
    seconds: float


@dataclass(frozen=True)
class _Question:
    """A group, and what the recordings say of it.

    Attributes:
        found: the finding.
        accepted: the first of the group.
        rivals: the others, which the final model does not hold.
        keys: parameters of the final model that all recordings share; columns are per standard deviation of their prior.
        labels: columns of the rivals: their position among the shapes, and within the shape.
        gram: (k + l, k + l) products of white columns, keys and labels, what each run has of its own projected out.
        scatter: between blocks of time, over that of white noise.
    """

    found: Finding
    accepted: Accepted
    rivals: tuple[Hypothesis, ...]
    keys: tuple[str, ...]
    labels: tuple[str, ...]
    gram: Array
    scatter: float

    @classmethod
    def of(cls, found: Finding, group: Sequence[str]) -> "_Question":
        """What tells a group apart so far."""
        last = found.outcome.last
        accepted = next(one for one in found.outcome.accepted if one.hypothesis.name == group[0])
        fitted = last.fitted
        every = [*effects(fitted.model.file), *sensors(fitted.model.file, [line.run for line in last.lines])]
        rivals = tuple(_as_fitted(last, accepted, one) for one in every if one.name in group)
        shapes = [shape for rival in rivals for shape in rival.shapes]
        labels = tuple(label for rival in rivals for labels in _labels(rival) for label in labels)
        noises = [run.noise for run in fitted.runs if run.noise is not None]
        prior = fitted.prior
        gram = common(last.lines, noises, prior, shapes)
        gram[: len(prior.keys), : len(prior.keys)] += np.eye(len(prior.keys))
        own = [k for k, key in enumerate(prior.keys) if "@" in key]
        keys = [k for k, key in enumerate(prior.keys) if "@" not in key]
        rest = [*keys, *range(len(prior.keys), len(gram))]
        seen = own_score(last.book, last.fitted, accepted.hypothesis)
        scatter = seen.scatter if seen else accepted.scatter
        return cls(
            found,
            accepted,
            rivals,
            tuple(prior.keys[k] for k in keys),
            labels,
            _given(gram, own, rest),
            scatter,
        )

    @property
    def names(self) -> tuple[str, ...]:
        """All of the group, the accepted one first."""
        return (self.winner, *(rival.name for rival in self.rivals))

    @property
    def winner(self) -> str:
        """The one that was accepted."""
        return self.accepted.hypothesis.name


def _as_fitted(last: Standing, accepted: Accepted, rival: Hypothesis) -> Hypothesis:
    """A rival with the shape that it takes in the place of the accepted name, besides those that are looked at."""
    (first, *others) = rival.shapes
    if not others or not isinstance(first, EffectShape) or first.width > 1:
        return rival
    try:
        there, _, _ = fitted_in_its_place(last, accepted.hypothesis, rival, last.own)
    except ModelError:
        return rival
    part = there.fitted.model.file.motor.effect(rival.name)
    assert part is not None
    size = type(part).switch().name
    typical = replace(part, **{size: getattr(first.parts[0], size)})
    return replace(rival, shapes=(*rival.shapes, replace(first, parts=(typical,))))


def _labels(rival: Hypothesis) -> list[list[str]]:
    """Names of the columns of every shape of a rival."""
    return [[f"{rival.name}#{s}.{k}" for k in range(shape.width)] for s, shape in enumerate(rival.shapes)]


def propose(found: Finding, verdict: Verdict, rng: np.random.Generator) -> Experiment | None:
    """The shortest test that tells the first ambiguous group apart, or most of it; None where there is no group."""
    group = next((group for group in verdict.groups if len(group) > 1), None)
    if group is None:
        return None
    asked = _Question.of(found, group)
    recorded = tuple(sorted({c for run in found.runs for c in run.channels}))
    known = tuple(sorted({q for run in found.runs for q in run.known if q == "load_torque"}))
    best: _Run | None = None
    for measured, also, bare in _ways(recorded, known):
        shown = {*measured, "voltage", "ambient", *(() if bare else known)}
        for name in scenarios():
            told = None if name == "duty" else _told(asked, name, _floor(found, measured), shown, rng)
            if told is None:
                continue
            run = _Run(name, (also, bare), *told)
            # The simplest way comes first: another must tell more.
            if best is None or (len(run.parts), run.way == best.way, -run.seconds) > (
                len(best.parts), True, -best.seconds
            ):  # fmt: skip
                best = run
        if best is not None and len(best.parts) == len(group):
            break
    if best is None:
        check = _channels_of(group)
        why = "no run of this motor tells them apart" + _by_reference(group, check)
        return Experiment("", group, (group,), 0.0, why, check=check)
    also, bare = best.way
    how = f" with the {_said(also)} measured as well" if also else ""
    how += (
        " with nothing on the shaft, the torque sensor taken off, and write 0 in its column" if bare else ""
    )
    why = f"run {best.test} for {best.seconds:.0f} s{how}"
    together = [part for part in best.parts if len(part) > 1]
    for part in together:
        why += f"; it leaves {_listed([_said(name) for name in part])} together"
    rest = [name for part in together for name in part]
    check = _channels_of(rest)
    why += _by_reference(rest, check)
    return Experiment(best.test, group, best.parts, round(best.seconds, 1), why, also, bare, check)


def _by_reference(group: Sequence[str], check: Sequence[str]) -> str:
    """What to do with the sensors that a group suspects, as the end of a sentence."""
    if not check:
        return ""
    faults = {name.rpartition("_")[2] for name in group if _channel_of(name)}
    sensors = f"the sensor{'s' if len(check) > 1 else ''} of {' and '.join(map(_said, check))}"
    if faults == {"offset"} and "temperature" not in check:
        look = f"read {sensors} at rest, with no voltage and nothing on the shaft: 0 is right"
    else:
        look = f"hold a reference instrument against {sensors}, at two values far apart"
    return (
        f"; {look}; in the motor file, give those found right sd = 0 and a source that begins with 'measured'"
    )


def _ways(recorded: Sequence[str], known: Sequence[str]) -> Iterator[tuple[tuple[str, ...], str, bool]]:
    """Outputs to measure, the one among them that is new, and whether the shaft is bare; the simplest first."""
    yield tuple(recorded), "", False
    if "load_torque" in known:
        yield tuple(recorded), "", True
    for channel in STATE_OF:
        if channel not in recorded:
            yield (*recorded, channel), channel, False


def _said(quantity: str) -> str:
    return quantity.replace("_", " ")


def _listed(names: Sequence[str]) -> str:
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def _channels_of(group: Sequence[str]) -> tuple[str, ...]:
    """The channels whose sensors a group suspects."""
    return tuple(dict.fromkeys(channel for name in group if (channel := _channel_of(name))))


def _channel_of(name: str) -> str:
    """The channel of a sensor's fault, "" for an effect."""
    channel, sensor, _ = name.partition("_sensor_")
    return channel if sensor else ""


def _floor(found: Finding, measured: Sequence[str]) -> dict[str, float]:
    """Standard deviation of the noise of every output that will be measured."""
    last = found.outcome.last
    rated = last.fitted.model.file.rated
    return {c: last.floor.get(c, NEW_SENSOR * rated.scale(RATED_OF_CHANNEL[c])) for c in measured}


def _told(
    asked: _Question, name: str, floor: Mapping[str, float], shown: Collection[str], rng: np.random.Generator
) -> tuple[tuple[tuple[str, ...], ...], float] | None:
    """The group as a scenario tells it apart, and in how many seconds; None if in no reasonable time it tells anything."""
    try:
        new, seconds = _of_scenario(asked, name, floor, shown, rng)
    except (MotorlensError, FloatingPointError, ValueError):
        return None
    longest = seconds if name in ENDS else max(min(LONGER * seconds, LONGEST_S), seconds)
    if longest < SHORTEST_S or seconds > DAY_S:
        return None
    lengths = np.geomspace(1.0, longest / seconds, 12).tolist()
    most = _parts(asked, lengths[-1] * new)
    if len(most) == 1:
        return None
    times = next(times for times in lengths if len(_parts(asked, times * new)) == len(most))
    return most, max(float(seconds * times), SHORTEST_S)


def _parts(asked: _Question, new: Array) -> tuple[tuple[str, ...], ...]:
    """A group as products that a run adds to what the recordings say tell it apart, the largest part last."""
    # What the recordings say has been weighed already: the new one must settle it.
    said = min(_apart(asked, asked.gram)[0].values())
    apart, worth = _apart(asked, asked.gram + new)
    needed = said + SETTLED * asked.scatter + CLEAR * CRITERIA.alike * worth
    parts: list[tuple[str, ...]] = [(name,) for name in asked.names]
    for pair, left in apart.items():
        if left <= needed:
            one, other = (next(part for part in parts if name in part) for name in pair)
            if one is not other:
                parts = [part for part in parts if part not in (one, other)] + [(*one, *other)]
    return tuple(sorted(parts, key=len))


def _of_scenario(
    asked: _Question, name: str, floor: Mapping[str, float], shown: Collection[str], rng: np.random.Generator
) -> tuple[Array, float]:
    """What a run of a scenario would add to the products, and its seconds.

    Raises:
        ValueError: it puts a load on the shaft that nobody would measure, and that would pass for friction.
    """
    fitted = asked.found.outcome.last.fitted
    file = fitted.model.file
    recording = perform(replace(file, sensors=()), scenarios()[name](), rng)
    if "load_torque" not in shown and recording.channels["load_torque"].any():
        raise ValueError(f"{name} needs a torque sensor")
    recording = replace(recording, channels={q: y for q, y in recording.channels.items() if q in shown})
    run = prepare(recording, file)
    if "load_torque" in shown:
        # Planned, its sensor shows exactly 0 where it will not.
        run = replace(run, bare=False, known=tuple(sorted({"load_torque", *run.known})))
    model = start_model(file, [run])
    own = {key: width for key, width in base_prior(file, [run]).sd.items() if "@" in key}
    keys = [*own, *asked.keys]
    units = np.array([{**fitted.prior.sd, **own}[key] for key in keys])
    line = Line.of(model, run, 0, keys)
    columns = [
        _as_rivals_are(asked, line) * units,
        *(shape.columns(line) for rival in asked.rivals for shape in rival.shapes),
    ]
    # Noise per row as the recordings had it, at their rate or at what the test asks for.
    z = np.concatenate(columns, axis=2) / np.array([floor[channel] for channel in run.channels])[:, None]
    flat = z.reshape(-1, z.shape[2])
    gram = flat.T @ flat * _rate(asked.found, run)
    n = len(own)
    gram[np.arange(n), np.arange(n)] += 1.0
    return _given(gram, range(n), range(n, len(gram))), recording.duration_s


def _as_rivals_are(asked: _Question, line: Line) -> Array:
    """(N, C, k) the sensitivities of a run, those of the accepted effect as those of its rivals are made: of what it adds at
    the samples. Else the transients of a slow run, which is all between them, would tell one from the same by another name.
    """
    own, winner = line.own.copy(), line.model.file.motor.effect(asked.winner)
    if winner is not None and not winner.states and not winner.turns():
        for k, key in enumerate(line.keys):
            if key.startswith(f"{asked.winner}."):
                own[:, :, k] = line.of_forcing(of_parameter(line.trajectory, key))[:, :, 0]
    return own


def _rate(found: Finding, planned: Run) -> float:
    """Rows that the recordings' own rate, the nearest of them, would bring over those simulated; no fewer than these."""
    rates = [planned.period_s / run.period_s for run in found.runs]
    return max(min(rates, key=lambda rate: float(abs(np.log(rate)))), 1.0)


def _apart(asked: _Question, gram: Array) -> tuple[dict[tuple[str, str], float], float]:
    """2 log likelihood of each pair, one true and the other fitted in its place, and what the truth is worth at most."""
    names = [*asked.keys, *asked.labels]
    mine = f"{asked.winner}."
    base = [k for k, key in enumerate(asked.keys) if not key.startswith(mine)]
    rest = [k for k in range(len(names)) if k not in base]
    before, after = _given(asked.gram, base, rest), _given(gram, base, rest)
    place = {names[k]: n for n, k in enumerate(rest)}
    columns = {asked.winner: [[place[key] for key in asked.keys if key.startswith(mine)]]}
    for rival in asked.rivals:
        columns[rival.name] = [[place[label] for label in labels] for labels in _labels(rival)]
    fitted, key = asked.found.outcome.last.fitted, asked.accepted.hypothesis.key
    size = np.zeros(len(rest))
    size[place[key]] = (
        fitted.model.values()[key] - (fitted.model.file.meaning(key).null or 0.0)
    ) / fitted.prior.sd[key]
    one_way, worth = {}, 0.0
    for name, shapes in columns.items():
        truth = size
        if name != asked.winner:
            # At the size that explains the recordings as the accepted one does.
            fits = [_instead(before, size, shape) for shape in shapes]
            truth = min(fits, key=lambda fit: _left(before, size - fit))
        worth = max(worth, float(truth @ after @ truth))
        for other in columns.keys() - {name}:
            # Fitted, it takes any shape between those that are looked at.
            every = [at for shape in columns[other] for at in shape]
            one_way[name, other] = _left(after, truth - _instead(after, truth, every))
    pairs = combinations(asked.names, 2)
    return {(one, other): min(one_way[one, other], one_way[other, one]) for one, other in pairs}, worth


def _given(gram: Array, base: Sequence[int], rest: Sequence[int]) -> Array:
    """(r, r) products of some columns once others have explained all they can of them."""
    cross = gram[np.ix_(base, rest)]
    return np.asarray(gram[np.ix_(rest, rest)] - cross.T @ inverse(gram[np.ix_(base, base)]) @ cross)


def _instead(gram: Array, truth: Array, shape: Sequence[int]) -> Array:
    """The sizes at which some columns stand for the truth best, all others 0."""
    fit = np.zeros(len(truth))
    fit[list(shape)] = inverse(gram[np.ix_(shape, shape)]) @ (gram @ truth)[list(shape)]
    return fit


def _left(gram: Array, difference: Array) -> float:
    """2 log likelihood between two that differ so."""
    return max(float(difference @ gram @ difference), 0.0)


__all__ = ["Experiment", "propose"]
