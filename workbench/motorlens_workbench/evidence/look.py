"""A look: what the ledger says of every hypothesis about one model, under one noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.prior import Prior
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Beside, Ledger, ledger, with_entries
from motorlens_workbench.evidence.score import Entry, Score
from motorlens_workbench.hypotheses.changes import changes
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Look:
    """A look.

    Attributes:
        lines: the runs about the model.
        noises: of each run.
        plain: whether the sensors' noise is taken as white, see `ledger`.
        book: the sums.
        beside: of all fitted parameters.
        scores: every shape of every hypothesis.
    """

    lines: tuple[Line, ...]
    noises: tuple[Noise, ...]
    plain: bool
    book: Ledger
    beside: Beside
    scores: tuple[Score, ...]

    def best(self) -> dict[str, Score]:
        """The strongest possible shape of every hypothesis, by name."""
        return best_of(self.scores)

    def rests(self, score: Score | None) -> list[Array]:
        """(N, C) of each run: what a hypothesis at its best size, and the parameters beside it, leave of the errors.

        What the parameters alone leave, without a hypothesis.
        """
        moves = self.beside.moves
        if score is not None:
            moves = self.beside.moves_with(score.entry, score.coefficient)
        rests = []
        for line in self.lines:
            own = [self.book.keys.index(key) for key in line.keys]
            units = np.array([self.book.unit[key] for key in line.keys])
            rest = line.error - line.own @ (moves[own] * units)
            if score is not None:
                rest = rest - score.entry.shape.columns(line) @ score.coefficient
            rests.append(rest)
        return rests

    def doubted(self, scores: Sequence[Score], uncorrected: Sequence[Line], prior: Prior) -> list[Score]:
        """Scores, each with the doubt that the correction for noise of the inputs leaves.

        Noise of the inputs makes columns and errors alike. Along corrected inputs that is taken out, as far as the sizes of
        the noises are right: what the correction moved a score by is uncertain by as much as they are.

        Args:
            scores: of this look.
            uncorrected: the runs about the same model, along their inputs as measured.
            prior: of the fitted parameters.
        """
        book, entries = self.entries(scores, uncorrected, self.noises, prior)
        beside, doubted = book.beside(), []
        for score, entry in zip(scores, entries, strict=True):
            there, here = beside.projected(entry)[0], self.beside.projected(score.entry)[0]
            moved = there.sum(axis=0) - here.sum(axis=0)
            doubt = CRITERIA.doubt**2 * float(moved @ score.inverse @ moved) / score.width
            doubted.append(score.doubted(doubt))
        return doubted

    def entries(
        self,
        scores: Sequence[Score],
        lines: Sequence[Line],
        noises: Sequence[Noise],
        prior: Prior,
        rests: Sequence[Array] | None = None,
    ) -> tuple[Ledger, list[Entry]]:
        """A ledger of other lines about the same model, or under other noise, and the entries of the shapes of some scores.

        Args:
            scores: of this look.
            lines: the runs.
            noises: of each run.
            prior: of the fitted parameters.
            rests: what is taken for noise, see `ledger`.
        """
        alone = [replace(score.entry.hypothesis, shapes=(score.entry.shape,)) for score in scores]
        book = ledger(lines, noises, prior, alone, rests, plain=self.plain and rests is None)
        return book, list(book.entries)


def look(
    lines: Sequence[Line],
    noises: Sequence[Noise],
    prior: Prior,
    listed: Sequence[Hypothesis],
    constants: Mapping[str, str],
    *,
    plain: bool = False,
) -> Look:
    """Look at every hypothesis.

    Args:
        lines: the runs about the model.
        noises: of each run.
        prior: of the fitted parameters.
        listed: the hypotheses; those of a change at once are added.
        constants: parameters that cannot have changed at once unless something is missing, and the equation of each.
        plain: see `ledger`.
    """
    book = ledger(lines, noises, prior, listed, plain=plain)
    book = with_entries(book, changes(book, lines, constants))
    beside = book.beside()
    scores = tuple(score for entry in book.entries if (score := beside.score(entry)) is not None)
    return Look(tuple(lines), tuple(noises), plain, book, beside, scores)


def best_of(scores: Sequence[Score]) -> dict[str, Score]:
    """The strongest possible shape of every hypothesis, by name."""
    best: dict[str, Score] = {}
    for score in scores:
        if score.possible and (score.name not in best or score.gain > best[score.name].gain):
            best[score.name] = score
    return best
