"""All that could stand in the place of a name that was accepted."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from motorlens_workbench.contest.bayes_factor import log_bayes_factor
from motorlens_workbench.contest.worth import own_score
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.hypotheses.effects import EffectShape, times_as_much
from motorlens_workbench.standing import Standing


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


def rivals_of(here: Standing, accepted: Accepted) -> Rivals:
    """What could stand in the place of an accepted hypothesis, as seen from the model that lacks nothing else."""
    return rivals_in(here.book, here.fitted, accepted)


def rivals_in(book: Ledger, fitted: Fitted, accepted: Accepted) -> Rivals:
    """The same, of the hypotheses in a ledger about a fitted model."""
    name, key = accepted.hypothesis.name, accepted.hypothesis.key
    file, prior = fitted.model.file, fitted.prior
    null = file.meaning(key).null or 0.0
    size = (fitted.model.values()[key] - null) / prior.sd[key]
    others = [other for other in book.keys if not other.startswith(f"{name}.")]
    scores = best_of(book.scores(others, {key: size}))
    itself = own_score(book, fitted, accepted.hypothesis)
    if itself is None:
        return Rivals(name, {name: 1.0}, scores)
    # What adds the same to the balances explains as much, however well a shape that is sampled shows it.
    twins = _twins(book, fitted, accepted, itself)
    scores.update(twins)
    # What the model leaves out lets rivals differ by a share of what the accepted one explains.
    scatter = itself.scatter + CRITERIA.alike * itself.gain
    # Its own column is per standard deviation of its prior, that of a rival per typical size.
    typical = itself.in_units(abs(accepted.hypothesis.typical) / prior.sd[key])
    scores[name] = replace(typical, entry=replace(itself.entry, hypothesis=accepted.hypothesis))
    # What is no likelier than nothing there, such as what the recordings cannot know at all, is no rival; what explains
    # nearly as much as the accepted one is, however little that is: how much less, and how surely, is in its weight.
    as_much = (1 - CRITERIA.instead) * itself.gain
    weights = {
        other: log_bayes_factor(score, scatter)
        for other, score in scores.items()
        if score.entry.hypothesis.named
        and (other == name or score.gain >= as_much or log_bayes_factor(score, itself.scatter) > 0)
    }
    for other in twins:
        weights[other] += _share(scores[other])
    for other, less in accepted.beside.items():
        weights[other] = max(weights.get(other, -np.inf), weights[name] + less)
    # What has been fitted there needs no linearisation.
    weights |= {other: weights[name] + more for other, more in accepted.instead.items()}
    total = logsumexp(list(weights.values()))
    return Rivals(name, {other: float(np.exp(w - total)) for other, w in weights.items()}, scores)


def _twins(book: Ledger, fitted: Fitted, accepted: Accepted, itself: Score) -> dict[str, Score]:
    """The scores of hypotheses of which a shape adds to the balances what an accepted one does."""
    motor = fitted.model.file.motor
    effect = motor.effect(accepted.hypothesis.name)
    if effect is None:
        return {}
    found = {}
    for entry in book.entries:
        shape = entry.shape
        if isinstance(shape, EffectShape) and shape.width == 1 and entry.hypothesis.named:
            times = times_as_much(shape.parts[0], effect, motor)
            if times is not None:
                alike = itself.in_units(float(itself.coefficient[0]) * times)
                found[entry.hypothesis.name] = replace(alike, entry=entry)
    return found


def _share(score: Score) -> float:
    """How likely the shares are beforehand that a shape leaves undone: a logarithm, nought where that is none."""
    (part,) = score.entry.shape.parts  # type: ignore[attr-defined]
    shares = [meaning for meaning in part.parameters().values() if meaning.role == "share"]
    return float(-0.5 * sum(((getattr(part, one.name) - one.default) / one.prior) ** 2 for one in shares))
