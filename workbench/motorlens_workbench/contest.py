"""The contest: which hypotheses belong into the model. Adding, dropping and exchanging one are the same comparison.

Every hypothesis, with a name or without, is weighed by what it explains of the evidence (Bayes factors under one scatter),
the best with a name are fitted in full, and the best of all enters if it is beyond what the largest of all would be by
chance (`evidence.null`). What has entered is weighed again beside whatever enters later. At the end every name is compared
with all that could stand in its place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from motorlens_physics.effect import Effect
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Ledger, Score
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.fitted import Challenger, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.refit import settled, with_hypothesis, without_hypothesis
from motorlens_workbench.standing import Standing, stand, summed, under, unlikely_from
from motorlens_workbench.telling import Progress

Array = NDArray[np.float64]

# Effects that are looked for at most, and hypotheses that are fitted in full at each step.
EFFECTS, REFITTED = 3, 4
# Orders of magnitude over which the prior of a free curve's size is spread (Zellner's g).
SPREAD = 10.0 ** np.arange(7)


@dataclass(frozen=True)
class Accepted:
    """A hypothesis in the model.

    Attributes:
        hypothesis: which.
        gain: twice the fall of the negative log likelihood as it entered, over the scatter.
        scatter: of its size between blocks of time, as seen from the model that has it.
        weight: minus the logarithm of the probability of as much by chance.
        doubt: that the correction for noise of the inputs leaves, in units of the scatter.
    """

    hypothesis: Hypothesis
    gain: float
    scatter: float
    weight: float
    doubt: float


@dataclass(frozen=True)
class Rivals:
    """All that could stand in the place of an accepted hypothesis.

    Attributes:
        name: of the accepted one.
        probability: of each hypothesis with a name, summing to one.
        scores: of each, from the model without the accepted one.
    """

    name: str
    probability: Mapping[str, float]
    scores: Mapping[str, Score]

    @property
    def group(self) -> tuple[str, ...]:
        """The smallest set that is credible, itself first, then the likelier."""
        ranked = sorted(self.probability, key=lambda name: -self.probability[name])
        kept, held = [], 0.0
        for name in ranked:
            if held >= CRITERIA.credible:
                break
            kept.append(name)
            held += self.probability[name]
        return (self.name, *(name for name in kept if name != self.name))


@dataclass(frozen=True)
class Outcome:
    """How the contest ended.

    Attributes:
        first: where it began.
        last: where it ended.
        accepted: in the order in which they entered.
        rivals: of each of these.
        unnamed: the term without a name that is beyond chance, and that no name explains; None if none is.
        refused: names that the screen points at, but that do not hold when fitted.
        judged: the heaviest that every name fitted in full was, in multiples of the weight that is needed.
    """

    first: Standing
    last: Standing
    accepted: tuple[Accepted, ...]
    rivals: tuple[Rivals, ...]
    unnamed: Score | None
    refused: tuple[str, ...]
    judged: Mapping[str, float]


def contest(base: Fitted, own: Sequence[type[Effect]] = (), say: Progress = lambda text: None) -> Outcome:
    """Hold it.

    Raises:
        ModelError: the base cannot be simulated.
    """
    say("weighing every effect, sensor fault and free term")
    first = here = stand(base, own)
    accepted: list[Accepted] = []
    refused: list[str] = []
    judged: dict[str, float] = {}
    nameless: tuple[Standing, list[Accepted]] | None = None
    entered = 0
    # What entered may leave again beside what came later: it must not go on for ever.
    while len(accepted) < EFFECTS and entered < 2 * EFFECTS:
        challengers = beyond_chance(here, accepted, refused)
        if not challengers:
            break
        if nameless is None and any(not one.named for one in challengers):
            nameless = here, list(accepted)
        step = _entered(here, challengers, refused, own, say)
        refused += step.refused
        judged |= {name: max(times, judged.get(name, 0.0)) for name, times in step.judged.items()}
        if step.standing is not None and step.accepted is not None:
            here, refused, entered = step.standing, [], entered + 1
            accepted.append(step.accepted)
            here, accepted = _needed(here, accepted, own, say)
        elif not step.refused:
            break
    remains = any(not one.named for one in beyond_chance(here, accepted, refused))
    if remains and nameless is not None and _imitate(nameless[0], here):
        here, accepted = nameless
    unnamed = simplest([one for one in here.challengers if not one.named]).score if remains else None
    rivals = tuple(rivals_of(here, one) for one in accepted)
    return Outcome(first, here, tuple(accepted), rivals, unnamed, tuple(dict.fromkeys(refused)), judged)


def _imitate(nameless: Standing, here: Standing) -> bool:
    """Whether names that entered since explain less than what remains beside them, of which they may be a part."""
    remains = max((one.won for one in here.challengers if not one.named), default=0.0)
    return nameless.unlikely - unlikely_from(nameless, here.fitted) < remains


def needed_weight(
    here: Standing, accepted: Sequence[Accepted], colour: float | None = None, *, named: bool = True
) -> float:
    """The weight that is beyond chance, and beyond what an imperfect model may leave.

    Args:
        here: where the contest stands.
        accepted: what has entered.
        colour: that is left in the noise beside the hypothesis; None is what the model leaves.
        named: whether the hypothesis has a name. A free term must besides explain a share of what any name has.
    """
    assert here.null is not None
    colour = here.book.colour if colour is None else colour
    if named:
        return max(here.null.weight(CRITERIA.excess), 0.5 * CRITERIA.colour * colour, 0.0)
    shares = (0.5 * CRITERIA.instead * one.gain for one in accepted)
    return max(here.null.weight(CRITERIA.unnamed), 0.5 * CRITERIA.unnamed_colour * colour, *shares, 0.0)


def beyond_chance(here: Standing, accepted: Sequence[Accepted], refused: Sequence[str]) -> list[Challenger]:
    """The challengers that are, the heaviest first."""
    if here.null is None:
        return []
    return [
        one
        for one in here.challengers
        if one.name not in refused and one.weight > needed_weight(here, accepted, one.colour, named=one.named)
    ]


def log_bayes_factor(score: Score, scatter: float, gain: float | None = None) -> float:
    """Against nothing there, over a prior of sizes.

    Args:
        score: of a shape.
        scatter: by which evidence is divided.
        gain: instead of the linearised problem's.
    """
    gain = (score.gain if gain is None else gain) / scatter
    if score.entry.hypothesis.named:
        # Sizes are spread as Cauchy's distribution about nought, as wide as the typical size: a factor more is as likely as
        # the same factor less, and of two that explain as much the one nearer its typical size is likelier. By Laplace's
        # approximation, without what all names share.
        known = np.linalg.slogdet(score.information / scatter + np.eye(len(score.information)))[1]
        beyond = 0.5 * (1 + len(score.coefficient)) * np.log1p(score.coefficient @ score.coefficient)
        return float(0.5 * gain - 0.5 * known - beyond)
    g = SPREAD
    return float(logsumexp(-score.width / 2 * np.log1p(g) + 0.5 * gain * g / (1 + g)) - np.log(len(g)))


def likeliest(challengers: Sequence[Challenger]) -> Challenger:
    """The one with the largest Bayes factor under one scatter."""
    scatter = _scatter(challengers)
    return max(challengers, key=lambda one: posterior(one, one.gain, scatter))


def simplest(challengers: Sequence[Challenger]) -> Challenger:
    """Of the terms that leave what is nearly as likely, as noise, as the best of them does, the one with fewest columns.

    Sizes are those of the linearised problem, and what they leave is known no better.
    """
    most = max(one.won for one in challengers)
    able = [one for one in challengers if one.won >= (1 - CRITERIA.instead) * most]
    return min(able, key=lambda one: (one.score.width, -one.won))


def posterior(one: Challenger, gain: float, scatter: float) -> float:
    """Logarithm of the Bayes factor of a challenger against nothing there, the search over its shapes paid for."""
    return log_bayes_factor(one.score, scatter, gain) - float(np.log(len(one.score.entry.hypothesis.shapes)))


def _scatter(challengers: Sequence[Challenger]) -> float:
    """By which the evidence of rivals is divided: that of the one that leaves least."""
    return max(challengers, key=lambda one: one.gain).score.scatter * CRITERIA.tempered


@dataclass(frozen=True)
class _Step:
    standing: Standing | None = None
    accepted: Accepted | None = None
    refused: tuple[str, ...] = ()
    judged: Mapping[str, float] = field(default_factory=dict)


def _entered(
    here: Standing,
    challengers: Sequence[Challenger],
    refused: Sequence[str],
    own: Sequence[type[Effect]],
    say: Progress,
) -> _Step:
    """The best of all names in the model, and those that do not hold once fitted.

    A term without a name may explain more than any one name, because two are missing; it is told in the end, of what all
    names leave.
    """
    scatter, strongest = _scatter(challengers), likeliest(challengers)
    able = [one for one in here.challengers if one.named and one.name not in refused]
    able.sort(key=lambda one: -posterior(one, one.gain, scatter))
    tried = [one for one in able[:REFITTED] if one in challengers or posterior(one, one.gain, scatter) > 0]
    if not strongest.named:
        # An effect may be too far from linear to be seen whole: those of the equation are fitted before it goes unnamed.
        equations = _beside(strongest.score.entry.hypothesis.equation)
        near = [one for one in able if one.score.entry.hypothesis.equation in equations]
        tried += [one for one in near[:REFITTED] if one not in tried]
    say(f"fitting with {', '.join(one.name.replace('_', ' ') for one in tried) or 'none'}")
    # All under one noise, that which the strongest leaves.
    base, beside = under(here, strongest.noises)
    fits = on_all_cores(lambda one: with_hypothesis(base, beside, one.score), tried)
    made = [(one, fitted) for one, fitted in zip(tried, fits, strict=True) if fitted is not None]
    made.sort(key=lambda pair: -posterior(pair[0], base.cost - pair[1].cost, scatter))
    failed: list[str] = []
    judged: dict[str, float] = {}
    for one, fitted in made:
        step = _judged(here, one, fitted, own)
        judged |= step.judged
        if step.standing is not None:
            return replace(step, refused=tuple(failed), judged=judged)
        failed.append(one.name)
    return _Step(refused=tuple({*failed, *([strongest.name] if strongest.named else [])}), judged=judged)


def _beside(equation: str) -> tuple[str, ...]:
    return {
        "electrical": ("electrical", "coupling"), "mechanical": ("mechanical", "coupling"),
        "coupling": ("coupling", "electrical", "mechanical"),
    }.get(equation, (equation,))  # fmt: skip


def _judged(here: Standing, one: Challenger, fitted: Fitted, own: Sequence[type[Effect]]) -> _Step:
    """A hypothesis fitted in full; it enters if it is beyond chance."""
    hypothesis = one.score.entry.hypothesis
    try:
        # It was fitted under what noise the strongest would leave; from there and from the model's own, noise is found anew.
        ends = [settled(start) for start in (fitted, replace(fitted, runs=here.fitted.runs))]
        unlikely = [unlikely_from(here, end) for end in ends]
        end = ends[int(np.argmin(unlikely))]
        book, plain = summed(end)
        score = held_score(book, plain, end, hypothesis)
        if score is None:
            return _Step()
        needed = needed_weight(here, (), book.colour)
        if score.weight >= needed:
            # Never more than the rise of the likelihood, each model with a noise of its own. The model may have ended short
            # of where it fits best: what it keeps when the name is taken out again is not the name's.
            without = without_hypothesis(end, one.name)
            kept = here.unlikely if without is None else unlikely_from(here, settled(without))
            score = score.winning(min(here.unlikely, kept) - min(unlikely))
        judged = {one.name: score.weight / needed}
        if judged[one.name] < 1.0:
            return _Step(judged=judged)
        then = stand(end, own)
    except ModelError:
        return _Step()
    entered = Accepted(hypothesis, score.gain / score.scatter, score.scatter, score.weight, one.score.doubt)
    return _Step(then, entered, judged=judged)


def own_score(book: Ledger, fitted: Fitted, hypothesis: Hypothesis) -> Score | None:
    """What an accepted hypothesis explains, seen from the model that has it (Wald's test); None where it is not told."""
    key = hypothesis.key
    if key not in book.keys:
        return None
    null = fitted.model.file.meaning(key).null or 0.0
    size = (fitted.model.values()[key] - null) / fitted.prior.sd[key]
    others = [other for other in book.keys if not other.startswith(f"{hypothesis.name}.")]
    free = replace(hypothesis, kind="unnamed", typical=float("inf"))
    return book.beside(others, {key: size}).score(book.entry_of(key, free, hypothesis.shapes[0]))


def held_score(book: Ledger, plain: Ledger, fitted: Fitted, hypothesis: Hypothesis) -> Score | None:
    """Of an accepted hypothesis, the weaker of what it explains beside the colour of the noise, and with the noise as white.

    Colour takes away what lasts, white noise believes all of it: what is missing shows either way.
    """
    both = [own_score(one, fitted, hypothesis) for one in (book, plain)]
    told = [score for score in both if score is not None]
    return min(told, key=lambda score: score.weight) if len(told) == len(both) else None


def _needed(
    here: Standing, accepted: list[Accepted], own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]]:
    """Without what is no longer needed beside what entered later."""
    for one in accepted[:-1]:
        others = [other for other in accepted if other is not one]
        score = held_score(here.book, here.plain or here.book, here.fitted, one.hypothesis)
        if score is None or here.null is None or score.weight >= needed_weight(here, others):
            continue
        fitted = without_hypothesis(here.fitted, one.hypothesis.name)
        if fitted is not None:
            say(f"without {one.hypothesis.name.replace('_', ' ')}")
            return stand(settled(fitted), own), others
    return here, accepted


def rivals_of(here: Standing, accepted: Accepted) -> Rivals:
    """What could stand in the place of an accepted hypothesis, as seen from the model that lacks nothing else."""
    name, key = accepted.hypothesis.name, accepted.hypothesis.key
    file, prior = here.fitted.model.file, here.fitted.prior
    null = file.meaning(key).null or 0.0
    size = (here.fitted.model.values()[key] - null) / prior.sd[key]
    others = [other for other in here.book.keys if not other.startswith(f"{name}.")]
    beside = here.book.beside(others, {key: size})
    scores = best_of([s for entry in here.book.entries if (s := beside.score(entry)) is not None])
    itself = own_score(here.book, here.fitted, accepted.hypothesis)
    if itself is None:
        return Rivals(name, {name: 1.0}, scores)
    # What the model leaves out lets rivals differ by a share of what the accepted one explains. Its own column is per
    # standard deviation of its prior, that of a rival per typical size.
    scatter = (itself.scatter + CRITERIA.alike * itself.gain) * CRITERIA.tempered
    unit = prior.sd[key] / abs(accepted.hypothesis.typical)
    entry = replace(itself.entry, hypothesis=accepted.hypothesis)
    scores[name] = replace(itself, entry=entry, information=itself.information / unit**2)
    # What is no likelier than nothing there, such as what the recordings cannot know at all, is no rival.
    weights = {
        other: log_bayes_factor(score, scatter)
        for other, score in scores.items()
        if score.entry.hypothesis.named and (other == name or log_bayes_factor(score, itself.scatter) > 0)
    }
    total = logsumexp(list(weights.values()))
    return Rivals(name, {other: float(np.exp(w - total)) for other, w in weights.items()}, scores)
