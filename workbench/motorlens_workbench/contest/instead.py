"""Another name in the place of one that has entered, so that a further one can enter beside it.

Of two effects that are missing, one name may explain more than either, for it makes up for a part of both: the heat of an
iron loss for a sensor that shows too much, its torque for a friction. It enters first, and what is left then has no name.
So where something is left that no name explains, the names that explain most in the place of one that has entered are fitted
there. One of them stays if another enters beside it, if the model then leaves nothing, and if it is likelier than the one
that stood by what a name must weigh.
"""

from collections.abc import Sequence

from motorlens_physics.effect import Effect
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.entering import enter, unlikely_as_known
from motorlens_workbench.contest.exchange import fitted_in_its_place
from motorlens_workbench.contest.needed import beyond_chance, follows, needed_weight, promising
from motorlens_workbench.contest.rivals import rivals_of
from motorlens_workbench.evidence.score import Score, log_chance
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.standing import Standing
from motorlens_workbench.telling import Progress

# Names that are fitted in the place of one, at most.
TRIED = 2


def enter_instead(
    here: Standing, accepted: Sequence[Accepted], own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]] | None:
    """Where another name and a further one stand in the place of one; None if no two explain what is left.

    Args:
        here: where the contest stands.
        accepted: what has entered.
        own: effects from outside the catalogue.
        say: told what is being done.
    """
    for one in accepted:
        others = [other for other in accepted if other is not one]
        for score in _in_the_place_of(here, one, others):
            place = f"{score.name} in the place of {one.hypothesis.name}".replace("_", " ")
            say(f"{place}, and what enters beside it")
            try:
                found = _with_a_further_one(here, one, others, score, own, say)
            except ModelError:
                continue
            if found is not None:
                return found
    return None


def _in_the_place_of(here: Standing, one: Accepted, others: Sequence[Accepted]) -> list[Score]:
    """The names that explain most where one is missing, and that are not in the model."""
    known = {other.hypothesis.name for other in (one, *others)}
    able = [
        score
        for name, score in rivals_of(here, one).scores.items()
        if score.entry.hypothesis.named and score.possible and name not in known
    ]
    return sorted(able, key=lambda score: -score.gain)[:TRIED]


def _with_a_further_one(
    here: Standing,
    one: Accepted,
    others: Sequence[Accepted],
    score: Score,
    own: Sequence[type[Effect]],
    say: Progress,
) -> tuple[Standing, list[Accepted]] | None:
    """A name in the place of one, and what enters beside it, if nothing is left then.

    Raises:
        ModelError: no model can be fitted with it.
    """
    there, new, holds = fitted_in_its_place(here, one.hypothesis, score.entry.hypothesis, own)
    challengers, able = beyond_chance(there, [*others, new], ()), promising(there, ())
    if not holds or not (challengers or able):
        return None
    # The motor is not estimated from the beginning: that has been tried beside the one that stands.
    every = [known.name for known in there.scores]
    step = enter(there, challengers, able, (), every, own, say)
    if step.standing is None or step.accepted is None:
        return None
    end, names = step.standing, [*others, new, step.accepted]
    if not follows(end) or any(not left.named for left in beyond_chance(end, names, ())):
        return None
    won = here.unlikely + here.fitted.unlikely_beforehand - unlikely_as_known(here, end.fitted)
    return (end, names) if -log_chance(max(won, 0.0), 1) >= needed_weight(here) else None
