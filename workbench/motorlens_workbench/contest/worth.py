"""What a name explains in a model that has it, fitted in full.

Wald's test asks how far its size is from nought, seen from the model that has it. Where sensitivities change on the way,
that says too little; then the score test asks the same, seen from the model without it, and the likelihoods of both models
ask which of them recordings prefer, block of time by block of time. None counts for more than the likelihood rises.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import log_occam_of_shape
from motorlens_workbench.contest.needed import needed_weight
from motorlens_workbench.criteria import NEARLY
from motorlens_workbench.evidence.ledger import Ledger, Lens, ledger
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import Score, log_chance
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.refit import settled, without_hypothesis
from motorlens_workbench.standing import Residual, Standing, no_more_than, residual_of, summed, under

Array = NDArray[np.float64]


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


def own_doubt(last: Standing, score: Score, hypothesis: Hypothesis) -> float:
    """The doubt of an accepted hypothesis, seen from the model that has it; see `evidence.look`, `Look.doubted`.

    Args:
        last: where the contest has ended.
        score: of the hypothesis, by `own_score` of its plain sums.
        hypothesis: which.
    """
    bare = ledger(last.uncorrected, Lens(last.noises, plain=True), last.fitted.prior, ())
    return score.doubt_of(own_score(last.plain.noisier(bare), last.fitted, hypothesis))


def held_score(book: Ledger, plain: Ledger, fitted: Fitted, hypothesis: Hypothesis) -> Score | None:
    """Of an accepted hypothesis, the weaker of what it explains beside the colour of the noise, and with the noise as white.

    Colour takes away what lasts, white noise believes all of it: what is missing shows either way.
    """
    return _weaker([own_score(one, fitted, hypothesis) for one in (book, plain)])


def lacking_score(lacking: Fitted, hypothesis: Hypothesis) -> Score | None:
    """What a hypothesis would explain of what a model without it leaves (score test), the weaker as of `held_score`.

    Raises:
        ModelError: the model cannot be simulated.
    """
    books = summed(lacking, [hypothesis])
    return _weaker([best_of(book.beside().scores(book.entries)).get(hypothesis.name) for book in books])


def _weaker(scores: Sequence[Score | None]) -> Score | None:
    """The one that weighs least; None if one is not told."""
    told = [score for score in scores if score is not None]
    return min(told, key=lambda score: score.weight) if len(told) == len(scores) else None


def agreement(won: Array, lacking: Fitted, hypothesis: Hypothesis, rise: float) -> float:
    """Squared ratio of what a name explains to how that scatters between blocks of time, without Wald's linearisation.

    Args:
        won: (B,) by a model with the name over one without it, see `Residual.likelier_by_block`.
        lacking: the model without it.
        hypothesis: the name.
        rise: twice the rise of the logarithmic likelihood from the one to the other.

    Raises:
        ModelError: the model cannot be simulated.
    """
    by_block = consistent(won, rise)
    seen = lacking_score(lacking, hypothesis)
    return by_block if seen is None else max(by_block, min(seen.gain, max(rise, 0.0)) / seen.scatter)


def consistent(won: Array, rise: float) -> float:
    """Squared ratio of what a model wins over another to how that scatters between blocks of time (B,), at most the rise.

    It needs no linearisation (Vuong 1989, doi:10.2307/1912557), but more evidence than Wald's test where that holds.
    """
    if np.sum(won) <= 0:
        return 0.0
    told = []
    for merged in (1, 2, 4):
        joined = np.add.reduceat(won, np.arange(0, len(won), merged))
        told.append(float(np.sum(joined) ** 2 / (len(joined) * np.var(joined, ddof=1))))
    return min(*told, max(rise, 0.0))


def told_apart(won: Array) -> float:
    """By how much one of two models is likelier than the other, in a logarithm, as far as blocks of time agree on that.

    Where nothing but noise tells them apart, each block wins some d^2, give or take 2 d, and all agree that it is half of
    what is won: the squared ratio of `consistent` is a quarter of that.

    Args:
        won: (B,) by the one over the other, twice the logarithm of the likelihood.
    """
    return 2 * consistent(won, np.inf)


@dataclass(frozen=True)
class Worth:
    """What a name wins in a model that has it.

    Attributes:
        score: None if it is not told there.
        needed: the weight that it needs.
        lacking: the likelier of the model that stands and the one with the name taken out again.
        unlikely: of what the model with the name leaves, see `unlikely_from`.
        allowed: whether it is no larger than it can be: a wonder of nature stands for something else, whatever it explains.
        kept: by how much less unlikely is what `lacking` leaves than what the model that stands leaves.
        agreed: squared ratio to which blocks of time agree on the name, where that tells more than Wald's test; else 0.
    """

    score: Score | None
    needed: float
    lacking: Fitted
    unlikely: float
    allowed: bool
    kept: float = 0.0
    agreed: float = 0.0

    @property
    def times(self) -> float:
        """Its weight in multiples of what it needs."""
        return self.score.weight / self.needed if self.score else 0.0

    def accepted(self, hypothesis: Hypothesis) -> Accepted | None:
        """The hypothesis as it enters the model; None if it is not beyond chance there, or larger than it can be."""
        return self.as_fitted(hypothesis) if self.times >= 1.0 else None

    def as_fitted(self, hypothesis: Hypothesis) -> Accepted | None:
        """The hypothesis as it is in its own model, by chance or not; None if it is not told, or larger than it can be."""
        score = self.score
        if score is None or not self.allowed:
            return None
        return Accepted(hypothesis, score.gain / score.scatter, score.scatter, score.weight, self.agreed)


def worth(
    here: Standing, one: Score, end: Fitted, frame: Standing | None = None, known: Standing | None = None
) -> Worth:
    """What a name wins in a model that has it over one that has not.

    Args:
        here: where the contest stands.
        one: what a look says of the name.
        end: the model with it.
        frame: where likelihoods are compared, see `unlikely_from`; None is `here`.
        known: where what chance does is told, see `needed_weight`: a model that lacks less; None is `here`.

    Raises:
        ModelError: the model cannot be simulated without it.
    """
    book, plain = summed(end)
    score = held_score(book, plain, end, one.entry.hypothesis)
    needed = needed_weight(known or here)
    with_it = residual_of(frame or here, end)
    without = here.residual if frame is None else residual_of(frame, here.fitted)
    unlikely = with_it.unlikely
    stood = here.unlikely if frame is None else without.unlikely
    most = stood - unlikely
    allowed = end.allows(one.entry.hypothesis)
    if score is None:
        return Worth(None, needed, here.fitted, unlikely, allowed)
    told, rise, lacking, kept, agreed = score.winning(most), most, here.fitted, 0.0, 0.0
    if -log_chance(max(most, 0.0), 1) >= needed:
        # The model that stands may have ended short of where it fits best: what is kept when the name is taken out again is
        # not the name's.
        refitted = without_hypothesis(end, one.name)
        if refitted is not None:
            other = settled(refitted)
            rest = residual_of(frame or here, other)
            if rest.unlikely < without.unlikely:
                lacking, without = other, rest
        kept = stood - without.unlikely
        rise = min(most, most - kept)
        held = score.winning(rise)
        agreed = agreement(with_it.likelier_by_block(without), lacking, one.entry.hypothesis, rise)
        told, agreed = held.or_at_least(agreed), agreed if agreed > held.gain / held.scatter else 0.0
    if told.weight < needed and frame is None:
        rise = _of_what_is_unexplained(here, one, end, with_it, rise)
        told = max(told, score.winning(rise), key=lambda known: known.weight)
    return Worth(told, needed, lacking, unlikely, allowed, kept, agreed)


def _of_what_is_unexplained(here: Standing, one: Score, end: Fitted, with_it: Residual, won: float) -> float:
    """What a name wins over a model that has no more of what is unexplained than the name leaves.

    A torque that nobody measured, and coloured noise, make up for a name as other names do, and where the name is likelier
    than they are, its shape paid for (they have a size as well), that they nearly do is no reason to say that nothing is
    missing.

    Args:
        here: where the contest stands.
        one: what a look says of the name.
        end: the model with it.
        with_it: what that leaves.
        won: over the model that stands, as it is.
    """
    hypothesis = one.entry.hypothesis
    if 0.5 * won + log_occam_of_shape(hypothesis, end) < NEARLY:
        return won
    quiet = [no_more_than(noise, other) for noise, other in zip(here.noises, with_it.noises, strict=True)]
    try:
        lacking = [under(here, quiet)[0], without_hypothesis(end, hypothesis.name)]
        left = [
            residual_of(here, fitted, with_it.noises).unlikely + fitted.unlikely_beforehand
            for fitted in lacking
            if fitted is not None
        ]
    except ModelError:
        # No such model can be simulated: then nothing is known of what the name would win over it.
        return won
    return max(won, min(left) - with_it.unlikely - end.unlikely_beforehand)
