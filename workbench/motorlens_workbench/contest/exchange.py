"""Whether a name that could stand in the place of one that has entered is likelier there, once it is fitted in full.

What the linearised problem says of rivals is bent by the name that is in the model: that has taken the shape that explains
most, they have theirs as the file has it. So those that seem likelier are fitted, and those outside its group until what is
left of these is less likely together than a name may be wrong. Of those that are fitted both models are asked: how likely
each is beside the other, seen from the model that has the one and from the model that has the other. The one that leaves
what is likelier, as noise, sees more than the other, and counts alone where both together would say less. All that counts as
far as blocks of time agree on which of the two that is; and the shape that each had to take counts besides. A rival that is
not beyond chance in its own model may be what is missing as well, as far as it is likely, but does not stand in the place of
a name that is.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motorlens_physics.effect import Effect
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import log_shape
from motorlens_workbench.contest.rivals import Rivals, rivals_in, rivals_of
from motorlens_workbench.contest.worth import told_apart, worth
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Lens, ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.refit import settled, with_hypothesis, without_hypothesis
from motorlens_workbench.standing import Standing, residual_of, stand
from motorlens_workbench.telling import Progress

# Rivals that are fitted in the place of one name, at most.
TRIED = 12
# A probability too small to be told from nought.
TINY = 1e-300


def exchanged(
    here: Standing, accepted: Sequence[Accepted], own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]]:
    """Each name that has entered, or in its place what seems likelier from there and is.

    Args:
        here: where the contest stands.
        accepted: what has entered.
        own: effects from outside the catalogue.
        say: told what is being done.

    Returns:
        where it stands then, and the names in their order; each knows how likely what was tried in its place is.
    """
    names = list(accepted)
    for k in range(len(names)):
        for _ in range(TRIED):
            rivals = rivals_of(here, names[k])
            doubtful = _doubtful(rivals, names[k])
            if not doubtful:
                break
            likeliest = max(doubtful, key=lambda name: rivals.probability[name])
            say(f"{likeliest} in the place of {names[k].hypothesis.name}".replace("_", " "))
            here, names[k] = _likelier(here, names[k], rivals, likeliest, own)
    return here, names


def _doubtful(rivals: Rivals, accepted: Accepted) -> list[str]:
    """The rivals of a name of which it matters what they are once they are fitted, and that have not been.

    Those that seem likelier; else those outside the group of the name, if they have more than too little together.
    """
    own, known = accepted.hypothesis.name, accepted.instead
    # Of names with which the motor was estimated from the beginning some may explain nothing from here.
    untried = {
        name: likely
        for name, likely in rivals.probability.items()
        if name != own and name not in known and name in rivals.scores
    }
    likelier = [name for name, likely in untried.items() if likely > rivals.probability[own]]
    group = rivals.group
    outside = [name for name in untried if name not in group]
    return likelier or (outside if sum(untried[name] for name in outside) > CRITERIA.untried else [])


def _likelier(
    here: Standing, accepted: Accepted, rivals: Rivals, name: str, own: Sequence[type[Effect]]
) -> tuple[Standing, Accepted]:
    """Where the contest stands with a name that has entered, or with a rival of this name in its place if it is likelier."""
    one, other = accepted.hypothesis, rivals.scores[name].entry.hypothesis
    try:
        there, new, holds = fitted_in_its_place(here, one, other, own)
    except ModelError:
        return here, replace(accepted, instead={**accepted.instead, name: -np.inf})
    from_here, from_there = _odds(rivals, other, one), _odds(_in_the_place_of(there, new, one), other, one)
    both = 0.5 * (from_here + from_there)
    won = residual_of(here, there.fitted).likelier_by_block(here.residual)
    for_it, against = told_apart(won), told_apart(-won)
    likelier = max(both, from_there) if for_it > against else min(both, from_here)
    # What recordings tell is worth no more than they agree on; how far either shape is from what it may be is known besides.
    likelier = float(np.clip(likelier, -against, for_it))
    likelier += log_shape(other, there.fitted) - log_shape(one, here.fitted)
    # However alike two names are held to be, the model goes on with the one that recordings agree on.
    if holds and likelier > against:
        # What others were worth beside the one they are worth as much less beside the likelier.
        instead, beside = (
            {known: how - likelier for known, how in of.items() if known != name}
            for of in (accepted.instead, accepted.beside)
        )
        return there, replace(new, instead={**instead, one.name: -likelier}, beside=beside)
    return here, replace(accepted, instead={**accepted.instead, name: min(likelier, 0.0)})


def _odds(rivals: Rivals, other: Hypothesis, one: Hypothesis) -> float:
    """The logarithm of how much likelier another name is than one."""
    shares = (max(rivals.probability.get(name, 0.0), TINY) for name in (other.name, one.name))
    likelier, less = np.log(list(shares))
    return float(likelier - less)


def _in_the_place_of(there: Standing, new: Accepted, one: Hypothesis) -> Rivals:
    """The rivals of a name that has entered as if there were but one other: all that could stand there need not be seen."""
    return rivals_in(ledger(there.lines, Lens(there.noises), there.fitted.prior, [one]), there.fitted, new)


def fitted_in_its_place(
    here: Standing, one: Hypothesis, other: Hypothesis, own: Sequence[type[Effect]]
) -> tuple[Standing, Accepted, bool]:
    """Where the contest stands with another name in the place of one, fitted in full, and whether it is beyond chance there.

    Raises:
        ModelError: no model can be fitted with it there, or it is not told, or larger than it can be.
    """
    lacking = _fitted(without_hypothesis(here.fitted, one.name), one)
    base = stand(lacking)
    book = ledger(base.lines, Lens(base.noises), lacking.prior, [other])
    beside = book.beside()
    score = best_of(beside.scores(book.entries)).get(other.name)
    if score is None:
        raise ModelError(f"{other.name} explains nothing there")
    end = settled(_fitted(with_hypothesis(lacking, beside, score), other))
    won = worth(base, score, end, known=here)
    there = won.as_fitted(other)
    if there is None:
        raise ModelError(f"{other.name} is not told in the model that has it, or larger than it can be")
    return stand(end, own), there, won.times >= 1.0


def _fitted(fitted: Fitted | None, hypothesis: Hypothesis) -> Fitted:
    if fitted is None:
        raise ModelError(f"no model can be fitted with {hypothesis.name} exchanged")
    return fitted
