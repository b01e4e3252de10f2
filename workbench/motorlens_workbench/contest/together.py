"""Two names that enter together: of two that are missing, one alone may explain too little that blocks of time agree on.

The likeliest models with a name that did not hold are looked at as if it held. What enters beside it is judged as any name
is, and then the first as one beside the second. A model that does not follow with both lacks something else: none is told.
"""

from collections.abc import Mapping, Sequence

from motorlens_physics.effect import Effect
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.entering import Attempt, enter, unlikely_as_known
from motorlens_workbench.contest.needed import beyond_chance, follows, promising
from motorlens_workbench.contest.worth import worth
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.refit import settled, without_hypothesis
from motorlens_workbench.standing import Standing, stand
from motorlens_workbench.telling import Progress

# Models with a name that did not hold, from which another is looked for.
BEGUN = 3


def enter_two(
    here: Standing, attempts: Mapping[str, Attempt], own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]] | None:
    """Where two names stand beside each other; None if no two hold.

    Args:
        here: where no name holds alone.
        attempts: the model in which each was tried, and the same with it.
        own: effects from outside the catalogue.
        say: told what is being done.
    """
    first = best_of(here.scores)
    able = [(name, end) for name, (model, end) in attempts.items() if model is here.fitted and name in first]
    tried = [(name, end) for name, end in able if end.allows(first[name].entry.hypothesis)]
    for name, end in sorted(tried, key=lambda one: unlikely_as_known(here, one[1]))[:BEGUN]:
        say(f"beside {name.replace('_', ' ')}")
        try:
            found = _beside(here, first[name], end, own, say)
        except ModelError:
            continue
        if found is not None:
            return found
    return None


def _beside(
    here: Standing, one: Score, end: Fitted, own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]] | None:
    """A name and what enters beside it, if both hold.

    Raises:
        ModelError: a model cannot be simulated.
    """
    there = stand(end, own)
    challengers, able = beyond_chance(there, (), (one.name,)), promising(there, (one.name,))
    if not challengers and not able:
        return None
    # Names with which the motor would be estimated from the beginning have been tried alone.
    every = [score.name for score in here.scores]
    step = enter(there, challengers, able, (one.name,), every, own, say)
    if step.standing is None or step.accepted is None or not follows(step.standing):
        return None
    alone = without_hypothesis(step.standing.fitted, one.name)
    if alone is None:
        return None
    told = worth(stand(settled(alone), own), one, step.standing.fitted).accepted(one.entry.hypothesis)
    return None if told is None else (step.standing, [told, step.accepted])
