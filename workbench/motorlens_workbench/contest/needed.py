"""What a hypothesis must weigh to be beyond chance, and which of those that are looked at from a model do."""

from collections.abc import Sequence

from motorlens_workbench.contest.bayes_factor import posterior
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Accepted, Challenger
from motorlens_workbench.standing import Standing


def needed_weight(here: Standing) -> float:
    """The weight of a name that is beyond chance."""
    assert here.null is not None
    return max(here.null.weight(CRITERIA.excess), 0.0)


def needed_without_a_name(here: Standing, accepted: Sequence[Accepted], colour: float) -> float:
    """The weight of a free term that is beyond chance, and beyond what an imperfect model may leave.

    Args:
        here: where the contest stands.
        accepted: what has entered: a free term must explain a share of what any of these has.
        colour: that is left in the noise beside the term, see `Ledger.colour`.
    """
    assert here.null is not None
    shares = (0.5 * CRITERIA.instead * one.gain for one in accepted)
    return max(here.null.weight(CRITERIA.excess, wide=2.0), 0.5 * CRITERIA.colour * colour, *shares, 0.0)


def beyond_chance(here: Standing, accepted: Sequence[Accepted], refused: Sequence[str]) -> list[Challenger]:
    """The challengers that are, the heaviest first."""
    if here.null is None:
        return []
    of_names = needed_weight(here)
    return [
        one
        for one in here.challengers
        if one.name not in refused
        and one.weight > (of_names if one.named else needed_without_a_name(here, accepted, one.colour))
    ]


def promising(here: Standing, refused: Sequence[str]) -> list[Challenger]:
    """Names that would be beyond chance if they scattered as noise does, the likeliest first.

    Seen from a model that lacks something, its size differs from block to block, for what makes up for it fits none of them:
    how a name scatters is known only from the model that has it.
    """
    if here.null is None:
        return []
    named = [one for one in here.challengers if one.named and one.name not in refused]
    able = [one for one in named if one.score.undivided > needed_weight(here)]
    return sorted(able, key=lambda one: -posterior(one, one.gain, 1.0))


def unseen(here: Standing, refused: Sequence[str]) -> list[Score]:
    """What may hold a rotor at rest, in the shape that explains most in each look.

    A rotor that sticks starts late or not at all. That is nothing like the response to a small torque about a rotor that
    turns, by which the linearised problem has it, and what such a name explains is known only once it is fitted.
    """
    best = [
        score
        for look in here.looks
        for score in look.best().values()
        if score.name not in refused and score.entry.hypothesis.holds
    ]
    alike = {(score.name, score.entry.shape): score for score in best}
    return list(alike.values())


def follows(here: Standing) -> bool:
    """Whether a model leaves no more than noise does where nothing is missing."""
    return here.times_noise <= CRITERIA.follows


def leaves_noise(here: Standing) -> bool:
    """Whether what a model leaves is no more than noise, and no more correlated, than where nothing is missing."""
    return follows(here) and here.book.colour <= CRITERIA.white
