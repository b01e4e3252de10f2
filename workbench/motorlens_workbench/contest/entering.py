"""Which name enters a model next: the best are fitted in full, and the best of those enters if it is beyond chance there.

Where no name does though something is missing, or where the model with one still does not follow, the motor is estimated
from the beginning with each name of the equation: what is missing bends a fit, and from where that ends no name may help.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import chdtri

from motorlens_physics.effect import Effect
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import likeliest, posterior, scatter_of
from motorlens_workbench.contest.needed import follows
from motorlens_workbench.contest.worth import consistent, worth
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Score, log_chance
from motorlens_workbench.fitted import Accepted, Challenger, Fitted
from motorlens_workbench.refit import anew, begun, settled, with_hypothesis
from motorlens_workbench.standing import Standing, likelier_by_block, stand, under, unlikely_from
from motorlens_workbench.telling import Progress

# Hypotheses that are fitted in full at each step.
REFITTED = 4


@dataclass(frozen=True)
class Step:
    """What attempts to add a name have led to.

    Attributes:
        standing: with the name that enters, or a likelier fit of the same model; None if there is neither.
        accepted: that name.
        refused: names that do not hold once fitted.
        judged: how heavy each name fitted in full is, in multiples of the weight that is needed.
        unlikely: of what the model with the name leaves, see `unlikely_from`.
    """

    standing: Standing | None = None
    accepted: Accepted | None = None
    refused: tuple[str, ...] = ()
    judged: Mapping[str, float] = field(default_factory=dict)
    unlikely: float = float("inf")

    def then(self, other: "Step") -> "Step":
        """What has been found after another attempt: the likelier of both."""
        judged = {**self.judged, **{n: max(t, self.judged.get(n, 0.0)) for n, t in other.judged.items()}}
        best = other if other.unlikely < self.unlikely else self
        return replace(best, refused=(*self.refused, *other.refused), judged=judged)


def enter(
    here: Standing,
    challengers: Sequence[Challenger],
    promised: Sequence[Challenger],
    refused: Sequence[str],
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
        equations = _beside(strongest.score.entry.hypothesis.equation)
        near = [one for one in named if one.score.entry.hypothesis.equation in equations]
        tried += [one for one in near[:REFITTED] if one not in tried]
    tried += [one for one in promised[:REFITTED] if one not in tried]
    say(f"fitting with {', '.join(one.name.replace('_', ' ') for one in tried) or 'none'}")
    # All under one noise, that which the strongest leaves.
    base, beside = under(here, strongest.noises)
    fits = on_all_cores(lambda one: with_hypothesis(base, beside, one.score), tried)
    made = [(one, fitted) for one, fitted in zip(tried, fits, strict=True) if fitted is not None]
    made.sort(key=lambda pair: -posterior(pair[0], base.cost - pair[1].cost, scatter))
    step = Step()
    for one, fitted in made:
        # It was fitted under what noise the strongest would leave; from there and from the model's own, noise is found anew.
        step = step.then(_judged(here, one.score, (fitted, replace(fitted, runs=here.fitted.runs)), own))
        if step.accepted is None and step.standing is not None:
            return step
        if step.standing is not None:
            # What was missing may have passed for a delay.
            again = anew(step.standing.fitted)
            if again is not None and _unlikely(here, again) < step.unlikely:
                step = step.then(_judged(here, one.score, (again,), own))
            break
    if not (strongest.named if step.standing is None else follows(step.standing)):
        # What is missing has bent the model, and where that ended another name, or none, may help most.
        best = strongest.score.entry.hypothesis if step.accepted is None else step.accepted.hypothesis
        step = step.then(enter_anew(here, best.equation, refused, own, say))
    if step.standing is None and strongest.named:
        return replace(step, refused=(*step.refused, strongest.name))
    return step


def enter_anew(
    here: Standing,
    equation: str,
    refused: Sequence[str],
    own: Sequence[type[Effect]],
    say: Progress,
) -> Step:
    """The likeliest of all names about an equation, with each of which the motor is estimated from the beginning."""
    equations = _about(equation)
    named: dict[str, Score] = {}
    for score in sorted(here.scores, key=lambda score: score.gain):
        hypothesis = score.entry.hypothesis
        if hypothesis.named and hypothesis.equation in equations and score.name not in refused:
            named[score.name] = score

    def estimated(one: Score) -> Fitted | None:
        say(f"estimating anew with {one.name.replace('_', ' ')}")
        return anew(begun(here.fitted, one))

    fits = zip(named.values(), on_all_cores(estimated, list(named.values())), strict=True)
    made = [
        (one, fitted) for one, fitted in fits if fitted is not None and np.isfinite(_unlikely(here, fitted))
    ]
    made.sort(key=lambda pair: _unlikely(here, pair[1]))
    step = Step()
    for one, fitted in made:
        step = step.then(_judged(here, one, (fitted,), own))
        if step.accepted is not None:
            break
    if step.accepted is None or step.standing is None:
        return step
    likeliest_end = step.standing.fitted
    less = {
        one.name: consistent(likelier_by_block(here, likeliest_end, fitted), np.inf) for one, fitted in made
    }
    # Of those that blocks of time do not tell from the likeliest, the one with the fewest parameters.
    alike = [pair for pair in made if less[pair[0].name] < chdtri(1, 1 - CRITERIA.credible)]
    for one, fitted in sorted(alike, key=lambda pair: _parameters(pair[1], pair[0].name)):
        if _parameters(fitted, one.name) < _parameters(likeliest_end, step.accepted.hypothesis.name):
            simpler = _judged(here, one, (fitted,), own)
            if simpler.accepted is not None:
                step = replace(simpler, judged={**step.judged, **simpler.judged})
                break
    assert step.accepted is not None
    least = less.get(step.accepted.hypothesis.name, 0.0)
    beside = {name: 0.5 * (least - more) for name, more in less.items()}
    return replace(step, accepted=replace(step.accepted, beside=beside))


def _unlikely(here: Standing, fitted: Fitted) -> float:
    """See `unlikely_from`; infinite where the model cannot be simulated."""
    try:
        return unlikely_from(here, fitted)
    except ModelError:
        return float("inf")


def _parameters(fitted: Fitted, name: str) -> int:
    """How many parameters a hypothesis has that are fitted."""
    return sum(key.startswith(f"{name}.") for key in fitted.prior.keys)


def _judged(here: Standing, one: Score, starts: Sequence[Fitted], own: Sequence[type[Effect]]) -> Step:
    """A hypothesis fitted in full, from some models that have it; it enters if it is beyond chance."""
    try:
        ends = [settled(start) for start in starts]
        end = min(ends, key=lambda end: unlikely_from(here, end))
        told = worth(here, one, end)
        score, judged = told.score, {one.name: told.times}
        if score is None or told.times < 1.0:
            kept = here.unlikely - unlikely_from(here, told.lacking)
            if -log_chance(max(kept, 0.0), 1) < told.needed:
                return Step(refused=(one.name,), judged=judged)
            # Without the name the model fits beyond chance better than where it had ended: it goes on from there.
            return Step(stand(told.lacking, own), judged=judged, unlikely=here.unlikely - kept)
        then, unlikely = stand(end, own), unlikely_from(here, end)
    except ModelError:
        return Step(refused=(one.name,))
    entered = Accepted(
        one.entry.hypothesis,
        score.gain / score.scatter,
        score.scatter,
        score.weight,
        one.doubt,
        told.agreed,
    )
    return Step(then, entered, judged=judged, unlikely=unlikely)


def _about(equation: str) -> tuple[str, ...]:
    """What may stand in the place of something in an equation, or in a channel: equations, and the channels of sensors."""
    channels = {
        "electrical": ("voltage", "current"),
        "mechanical": ("speed", "load_torque"),
        "thermal": ("temperature",),
    }
    beside = _beside(next((one for one, its in channels.items() if equation in its), equation))
    return (*beside, *(channel for one in beside for channel in channels.get(one, ())))


def _beside(equation: str) -> tuple[str, ...]:
    return {
        "electrical": ("electrical", "coupling"), "mechanical": ("mechanical", "coupling"),
        "coupling": ("coupling", "electrical", "mechanical"),
    }.get(equation, (equation,))  # fmt: skip
