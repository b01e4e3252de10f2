"""Whether a name that could stand in the place of one that has entered is likelier there, once it is fitted in full.

What the linearised problem says of rivals is bent by the name that is in the model.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motorlens_physics.effect import Effect
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import log_occam_of
from motorlens_workbench.contest.rivals import rivals_of
from motorlens_workbench.contest.worth import consistent, held_score
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Lens, ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.refit import settled, with_hypothesis, without_hypothesis
from motorlens_workbench.standing import Standing, likelier_by_block, stand, summed
from motorlens_workbench.telling import Progress


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
    for k, one in enumerate(names):
        rivals = rivals_of(here, one)
        likeliest = max(rivals.probability, key=lambda name: rivals.probability[name])
        if likeliest == one.hypothesis.name:
            continue
        say(f"{likeliest.replace('_', ' ')} in the place of {one.hypothesis.name.replace('_', ' ')}")
        other = rivals.scores[likeliest].entry.hypothesis
        fitted = _in_its_place(here, one.hypothesis, other)
        if fitted is None:
            continue
        likelier = _likelier(here, fitted, other) - _likelier(here, here.fitted, one.hypothesis)
        new = _accepted(fitted, other) if likelier > 0 else None
        if new is None:
            names[k] = replace(one, instead={likeliest: min(likelier, 0.0)})
        else:
            here, names[k] = stand(fitted, own), replace(new, instead={one.hypothesis.name: -likelier})
    return here, names


def _in_its_place(here: Standing, one: Hypothesis, other: Hypothesis) -> Fitted | None:
    """The model with another name in the place of one; None if it cannot be simulated."""
    lacking = without_hypothesis(here.fitted, one.name)
    if lacking is None:
        return None
    try:
        base = stand(lacking)
        book = ledger(base.lines, Lens(base.noises), lacking.prior, [other])
        beside = book.beside()
        score = best_of(beside.scores(book.entries)).get(other.name)
        fitted = None if score is None else with_hypothesis(lacking, beside, score)
        return None if fitted is None else settled(fitted)
    except ModelError:
        return None


def _likelier(here: Standing, fitted: Fitted, hypothesis: Hypothesis) -> float:
    """The logarithm of how likely a model is beside that which stands, as far as blocks of time agree on it."""
    won = likelier_by_block(here, fitted, here.fitted)
    told = consistent(won, np.inf) - consistent(-won, np.inf)
    return log_occam_of(hypothesis, fitted) + 0.5 * told / CRITERIA.tempered


def _accepted(fitted: Fitted, hypothesis: Hypothesis) -> Accepted | None:
    """A name that a model has; None where it is not told there."""
    score = held_score(*summed(fitted), fitted, hypothesis)
    if score is None:
        return None
    return Accepted(hypothesis, score.gain / score.scatter, score.scatter, score.weight)
