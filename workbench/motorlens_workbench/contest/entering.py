"""Which name enters a model next: the best are fitted in full, and the best of those enters if it is beyond chance there.

What may hold a rotor at rest is looked at from models that have it, once nothing else is beyond chance. Before all else,
what a delay stands for may be the lag of a sensor, and once more when nothing else shows: the motor is estimated anew with
one, and the likelier stays.

Where no name does though something is missing, or where the model with one still does not follow, the motor is estimated
from the beginning with each name of the equation: what is missing bends a fit, and from where that ends no name may help.
Which promise most is asked from there, and from the motor file, where nothing is bent yet.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.delays import delays_of
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import likeliest, log_occam_of, posterior, scatter_of
from motorlens_workbench.contest.needed import follows, needed_weight
from motorlens_workbench.contest.worth import consistent, worth
from motorlens_workbench.criteria import CRITERIA, NEARLY
from motorlens_workbench.evidence.score import Score, log_chance
from motorlens_workbench.fitted import Accepted, Challenger, Fitted
from motorlens_workbench.hypotheses.sensors import SensorShape
from motorlens_workbench.refit import (
    ahead,
    anew,
    at_file,
    at_first,
    begun,
    may_be_likelier,
    nearly,
    promise,
    settled,
    with_hypothesis,
)
from motorlens_workbench.standing import Residual, Standing, residual_of, stand, under, unlikely_from
from motorlens_workbench.telling import Progress

# Hypotheses that are fitted in full at each step.
REFITTED = 4
# Names with which the motor is estimated to the end, of all that are tried.
ESTIMATED = 6
# Of these, names that a look from the motor file shows.
FROM_FILE = 2
# The model in which a name was tried, and the same with it.
Attempt = tuple[Fitted, Fitted]


@dataclass(frozen=True)
class Step:
    """What attempts to add a name have led to.

    Attributes:
        standing: with the name that enters, or a likelier fit of the same model; None if there is neither.
        accepted: that name.
        refused: names that do not hold once fitted.
        estimated: names with which the motor was estimated from the beginning.
        judged: how heavy each name fitted in full is, in multiples of the weight that is needed.
        attempts: those with names that do not hold.
        unlikely: of what the model with the name leaves, see `unlikely_from`.
    """

    standing: Standing | None = None
    accepted: Accepted | None = None
    refused: tuple[str, ...] = ()
    estimated: tuple[str, ...] = ()
    judged: Mapping[str, float] = field(default_factory=dict)
    attempts: Mapping[str, Attempt] = field(default_factory=dict)
    unlikely: float = float("inf")

    def then(self, other: "Step") -> "Step":
        """What has been found after another attempt: the likelier of both."""
        judged, attempts = heaviest((self.judged, self.attempts), (other.judged, other.attempts))
        best = other if other.unlikely < self.unlikely else self
        return replace(
            best,
            accepted=_with_all_beside(best.accepted, self.accepted, other.accepted),
            refused=(*self.refused, *other.refused),
            estimated=(*self.estimated, *other.estimated),
            judged=judged,
            attempts=attempts,
        )


def _with_all_beside(best: Accepted | None, *others: Accepted | None) -> Accepted | None:
    """What has been accepted, with what each attempt to add it has shown of names beside it."""
    if best is None:
        return None
    alike = [one.beside for one in others if one is not None and one.hypothesis.name == best.hypothesis.name]
    return replace(best, beside={name: less for beside in alike for name, less in beside.items()})


Judged = tuple[Mapping[str, float], Mapping[str, Attempt]]


def heaviest(one: Judged, other: Judged) -> Judged:
    """Of names judged twice, how heavy they were at most, and the attempts of then."""
    (before, attempts), (after, again) = one, other
    better = {name: attempt for name, attempt in again.items() if after[name] >= before.get(name, 0.0)}
    judged = {**before, **{name: max(times, before.get(name, 0.0)) for name, times in after.items()}}
    return judged, {**attempts, **better}


def enter(
    here: Standing,
    challengers: Sequence[Challenger],
    promised: Sequence[Challenger],
    refused: Sequence[str],
    estimated: Sequence[str],
    own: Sequence[type[Effect]],
    say: Progress,
) -> Step:
    """The best of all names in the model, and those that do not hold once fitted.

    A term without a name may explain more than any one name, because two are missing; it is told in the end, of what all
    names leave.
    """
    able = challengers or promised
    scatter, strongest = scatter_of(able), likeliest(able)
    named = [one for one in here.challengers if one.named and one.name not in refused]
    named.sort(key=lambda one: -posterior(one, one.gain, scatter))
    tried = [one for one in named[:REFITTED] if one in challengers or posterior(one, one.gain, scatter) > 0]
    if not strongest.named:
        # An effect may be too far from linear to be seen whole: those of the equation are fitted before it goes unnamed.
        equations = _beside(strongest.score.entry.hypothesis.equation, here.fitted.runs)
        near = [one for one in named if one.score.entry.hypothesis.equation in equations]
        tried += [one for one in near[:REFITTED] if one not in tried]
    tried += [one for one in promised[:REFITTED] if one not in tried]
    if tried:
        say(f"fitting with {', '.join(one.name.replace('_', ' ') for one in tried)}")
    # All under one noise, that which the strongest leaves.
    base, beside = under(here, strongest.noises)
    fits = on_all_cores(lambda one: with_hypothesis(base, beside, one.score), tried)
    made = [(one, fitted) for one, fitted in zip(tried, fits, strict=True) if fitted is not None]
    made.sort(key=lambda pair: -posterior(pair[0], base.cost - pair[1].cost, scatter))
    step = Step()
    for one, fitted in made:
        step = step.then(_judged(here, one.score, fitted, own))
        if step.accepted is None and step.standing is not None:
            return step
        if step.standing is not None:
            step = _beside_all(_timed_anew(here, one.score, step, own), one, made, base.cost)
            break
    if not (strongest.named if step.standing is None else follows(step.standing)):
        # What is missing has bent the model, and where that ended another name, or none, may help most.
        best = strongest.score.entry.hypothesis if step.accepted is None else step.accepted.hypothesis
        step = step.then(enter_anew(here, best.equation, estimated, own, say))
    if step.standing is None and strongest.named:
        return replace(step, refused=(*step.refused, strongest.name))
    return step


def _beside_all(step: Step, one: Challenger, made: Sequence[tuple[Challenger, Fitted]], cost: float) -> Step:
    """The step with how likely each of the names is that were fitted beside the one that entered, from the same model.

    In the model that has it, a name may seem to explain twice what it did there: it has taken the shape that it needed.
    """
    if step.accepted is None:
        return step
    likely = {other.name: posterior(other, cost - fitted.cost, one.score.scatter) for other, fitted in made}
    beside = {name: how - likely[one.name] for name, how in likely.items() if name != one.name}
    return replace(step, accepted=replace(step.accepted, beside={**beside, **step.accepted.beside}))


def enter_for_delays(here: Standing, own: Sequence[type[Effect]], say: Progress) -> Step:
    """The lag of a sensor in the place of delays, where any were found and it is likelier.

    Delays are found before any name is looked at, and from where they have led nothing shows of a lag. A channel may come
    early because any other lags: that is tried of which least squares leave the least. A channel that lags may come
    late besides, but not early: nothing answers before it is driven.
    """
    if here.null is None:
        return Step()
    fitted = here.fitted
    # What a look says of their sizes is bent by the delays, and need not be possible.
    faults = {score.name: score for score in here.scores if isinstance(score.entry.shape, SensorShape)}
    lags = [one for name, one in faults.items() if name.endswith("_lag") and name != "temperature_sensor_lag"]
    if not delays_of(fitted.fit, fitted.runs) or not lags:
        return Step()
    left = on_all_cores(lambda one: at_first(begun(fitted, one)), lags)
    one = lags[int(np.argmin(left))]
    say(f"estimating anew with {one.name.replace('_', ' ')} in the place of a delay")
    end, refused = anew(begun(fitted, one)), Step(judged={one.name: 0.0})
    if end is None or _early(end, one.entry.hypothesis.equation):
        return refused
    if -log_chance(max(_won_by_both(here, end), 0.0), 1) < needed_weight(here):
        return refused
    try:
        # As the likelier of both sees it: to a motor with another timing the noise of the inputs is not what it is.
        there = stand(settled(end), own)
        told = worth(here, one, there.fitted, there)
    except ModelError:
        return refused
    judged, entered = {one.name: told.times}, told.accepted(one.entry.hypothesis)
    return Step(there if entered else None, entered, judged=judged, unlikely=told.unlikely)


def _early(fitted: Fitted, channel: str) -> bool:
    """Whether a channel comes before its voltage in some run."""
    delays = delays_of(fitted.fit, fitted.runs)
    return any(delay.channel == channel and delay.value_s < 0 for delay in delays)


def _won_by_both(here: Standing, fitted: Fitted) -> float:
    """By how much another model is likelier than the one that stands, in the frame of whichever of both grants it less.

    Timing decides how noise of the inputs passes through, and a lag smooths it: where inputs run slowly, a model in which a
    channel lags and is early at once foretells more, because it averages the noise of the inputs. That is no evidence of it,
    and the model that stands does not see it.
    """
    try:
        return min(
            unlikely_from(frame, here.fitted) - unlikely_from(frame, fitted)
            for frame in (here, stand(fitted))
        )
    except ModelError:
        return -np.inf


def enter_unseen(here: Standing, unseen: Sequence[Score], own: Sequence[type[Effect]], say: Progress) -> Step:
    """The best of names that no look shows as they are: each is looked at from a model that has it.

    Those that may win are looked at so in all their shapes, and the best are fitted. Of each name the shape is judged that
    wins most.
    """
    step, needed = Step(refused=tuple(dict.fromkeys(one.name for one in unseen))), needed_weight(here)
    try:
        base, beside = under(here, here.noises)
    except ModelError:
        return step

    def enough(won: float) -> bool:
        return -log_chance(max(won, 0.0), 1) >= needed

    def promising(scores: Sequence[Score]) -> list[Score]:
        promises = on_all_cores(lambda one: promise(base, beside, one), scores)
        able = [(won, one) for won, one in zip(promises, scores, strict=True) if enough(won)]
        return [one for _, one in sorted(able, key=lambda known: -known[0])]

    names = {one.name for one in promising(unseen)}
    able = promising(
        [one for look in here.looks for one in look.scores if one.possible and one.name in names]
    )
    able = able[:REFITTED]
    if able:
        say(f"fitting with {', '.join(dict.fromkeys(one.name.replace('_', ' ') for one in able))}")
    fits = zip(able, on_all_cores(lambda one: with_hypothesis(base, beside, one), able), strict=True)
    made = [(base.cost - fitted.cost, one, fitted) for one, fitted in fits if fitted is not None]
    for won, one, fitted in sorted(made, key=lambda known: -known[0]):
        if not enough(won) or one.name in step.judged:
            continue
        step = step.then(_judged(here, one, fitted, own))
        if step.accepted is not None:
            return _timed_anew(here, one, step, own)
        if step.standing is not None:
            break
    return step


def enter_anew(
    here: Standing,
    equation: str,
    estimated: Sequence[str],
    own: Sequence[type[Effect]],
    say: Progress,
) -> Step:
    """The likeliest of all names about an equation, with each of which the motor is estimated from the beginning.

    To the end with those that promise to explain most; not with those with which it has been `estimated` before.
    """
    equations = _about(equation, here.fitted.runs)
    named: dict[str, Score] = {}
    for score in sorted(here.scores, key=lambda score: score.gain):
        hypothesis = score.entry.hypothesis
        if hypothesis.named and hypothesis.equation in equations and score.name not in estimated:
            named[score.name] = score
    if not named:
        return Step()
    say(f"estimating anew with each of {len(named)} names that may stand there")
    nothing = Step(estimated=tuple(named))
    base = nearly(here.fitted)
    if base is None:
        return nothing
    begins = _promising(here, base, named, own)
    say(f"and to the end with {', '.join(one.name.replace('_', ' ') for one, _ in begins) or 'none'}")

    def to_the_end(begin: Fitted) -> Fitted | None:
        reached = nearly(begin)
        if reached is None or not may_be_likelier(base, reached, here.fitted.prior, begin.prior):
            return None
        return anew(begin, reached)

    ends = on_all_cores(to_the_end, [begin for _, begin in begins])
    fits = [(one, end) for (one, _), end in zip(begins, ends, strict=True)]
    leaves = [(_residual(here, fitted), one, fitted) for one, fitted in fits if fitted is not None]
    weighed = [(residual, one, fitted) for residual, one, fitted in leaves if residual is not None]
    made = [(one, fitted) for _, one, fitted in weighed]
    if not made:
        return nothing
    best = min((residual for residual, _, _ in weighed), key=lambda residual: residual.unlikely)
    less = {one.name: consistent(best.likelier_by_block(residual), np.inf) for residual, one, _ in weighed}
    likely = {
        one.name: log_occam_of(one.entry.hypothesis, fitted) - 0.5 * less[one.name] / CRITERIA.tempered
        for one, fitted in made
    }
    step = nothing
    able: list[tuple[Score, Step, Standing]] = []
    for one, fitted in sorted(made, key=lambda pair: -likely[pair[0].name]):
        if able and (follows(able[-1][2]) or likely[one.name] < likely[able[0][0].name] - NEARLY):
            break
        other = _judged(here, one, fitted, own)
        if other.accepted is None or other.standing is None:
            step = step.then(other)
        else:
            able.append((one, other, other.standing))
    if not able:
        return step
    # Of names that are nearly as likely, one with which the model follows what it was not fitted to.
    one, entered, _ = max(able, key=lambda known: follows(known[2]))
    judged = {name: times for _, other, _ in able for name, times in other.judged.items()}
    step = replace(step, judged={**step.judged, **judged}).then(entered)
    if step.accepted is not None:
        step = _timed_anew(here, one, step, own)
    if step.accepted is None:
        return step
    beside = {name: 0.5 * (less[one.name] - more) for name, more in less.items()}
    return replace(step, accepted=replace(step.accepted, beside=beside))


def _promising(
    here: Standing, base: Weighed, named: Mapping[str, Score], own: Sequence[type[Effect]]
) -> list[tuple[Score, Fitted]]:
    """Names that promise most, and the models with which estimates with them begin.

    A few as a look from the motor file shows them, at the size that it shows: where another motor has made up for what is
    missing, with another timing, nothing leads there from the fit. The others by what they leave one step ahead of it.
    """
    begins = [
        (one, begun(here.fitted, one, one.coefficient))
        for one in _seen_from_file(here, named, own)[:FROM_FILE]
    ]
    seen = {one.name for one, _ in begins}
    others = [one for name, one in named.items() if name not in seen]
    without = ahead(here.fitted, base)
    left = on_all_cores(lambda one: ahead(begun(here.fitted, one), base), others)
    won = [(without - cost, one) for one, cost in zip(others, left, strict=True) if cost < without]
    won.sort(key=lambda known: -known[0])
    return begins + [(one, begun(here.fitted, one)) for _, one in won[: ESTIMATED - len(begins)]]


def _seen_from_file(here: Standing, named: Collection[str], own: Sequence[type[Effect]]) -> list[Score]:
    """Some names as a look from the motor file shows them, nothing fitted, the one that explains most first."""
    try:
        there = stand(at_file(here.fitted), own)
    except ModelError:
        return []
    best: dict[str, Score] = {}
    for score in sorted(there.scores, key=lambda score: score.gain):
        if score.possible and score.name in named:
            best[score.name] = score
    return list(reversed(best.values()))


def _timed_anew(here: Standing, one: Score, step: Step, own: Sequence[type[Effect]]) -> Step:
    """A step that led somewhere, or to where the motor is estimated from the beginning with it, if that is likelier."""
    assert step.standing is not None
    again = from_the_beginning(here, step.standing.fitted)
    if again is None:
        return step
    other = _judged(here, one, again, own)
    both = step.then(other)
    if other.standing is None:
        return both
    return replace(both, standing=other.standing, accepted=other.accepted, unlikely=other.unlikely)


def from_the_beginning(here: Standing, fitted: Fitted, typical: Score | None = None) -> Fitted | None:
    """A model estimated from the beginning, unless where a refit has led is likelier by more than `NEARLY`: then None.

    It begins with its effects as the refit has them and, given what a look says of the last, with that at its typical size.

    What was missing may have passed for a delay, or for inputs that ran otherwise between their samples; or it has bent the
    parameters to where another motor, unlike its file, does nearly as well. Which is likelier is asked of both as they are
    known from the recordings and beforehand. Of two that are nearly as likely it is not for the last digits to choose: the
    one from the beginning is what a calibration of that model would give.
    """
    begins = [fitted] if typical is None else [fitted, begun(here.fitted, typical)]
    ends = [(unlikely_as_known(here, end), end) for end in map(anew, begins) if end is not None]
    unlikely, best = min(ends, key=lambda known: known[0], default=(np.inf, fitted))
    return best if unlikely < unlikely_as_known(here, fitted) + 2 * NEARLY else None


def unlikely_as_known(here: Standing, fitted: Fitted) -> float:
    """Of a model, by what it leaves and by what is known of it beforehand; infinite where it cannot be simulated.

    A motor file that is wrong by far must not prefer what is wrong by less and cannot be.
    """
    residual = _residual(here, fitted)
    return residual.unlikely + fitted.unlikely_beforehand if residual else float("inf")


def _residual(here: Standing, fitted: Fitted) -> Residual | None:
    """See `residual_of`; None where the model cannot be simulated, or leaves what is no number."""
    try:
        residual = residual_of(here, fitted)
    except ModelError:
        return None
    return residual if np.isfinite(residual.unlikely) else None


def _judged(here: Standing, one: Score, start: Fitted, own: Sequence[type[Effect]]) -> Step:
    """A hypothesis fitted in full, from a model that has it; it enters if it is beyond chance."""
    try:
        end = settled(start)
        told = worth(here, one, end)
        judged, entered = {one.name: told.times}, told.accepted(one.entry.hypothesis)
        if entered is None:
            if -log_chance(max(told.kept, 0.0), 1) < told.needed:
                return Step(refused=(one.name,), judged=judged, attempts={one.name: (here.fitted, end)})
            # Without the name the model fits beyond chance better than where it had ended: it goes on from there.
            tried = {one.name: (told.lacking, end)}
            return Step(
                stand(told.lacking, own), judged=judged, attempts=tried, unlikely=here.unlikely - told.kept
            )
        then = stand(end, own)
    except ModelError:
        return Step(refused=(one.name,))
    return Step(then, entered, judged=judged, unlikely=told.unlikely)


def _about(equation: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """What may stand in the place of something in an equation, or in a channel: equations, and the channels of sensors."""
    channels = {
        "electrical": ("voltage", "current"),
        "mechanical": ("speed", "load_torque"),
        "thermal": ("temperature",),
    }
    beside = _beside(next((one for one, its in channels.items() if equation in its), equation), runs)
    return (*beside, *(channel for one in beside for channel in channels.get(one, ())))


def _beside(equation: str, runs: Sequence[Run]) -> tuple[str, ...]:
    """Equations that may be meant by one: only where current and speed are both measured is a voltage told from a torque."""
    told = all({"current", "speed"} <= set(run.channels) for run in runs)
    if equation == "coupling" or not (told or equation == "thermal"):
        return ("coupling", "electrical", "mechanical")
    return (equation, "coupling") if equation in ("electrical", "mechanical") else (equation,)
