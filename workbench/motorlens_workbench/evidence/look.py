"""A look: what the ledger says of every hypothesis about one model, under one noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.prior import Prior
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.ledger import Beside, Ledger, Lens, layout, ledger, ledgers
from motorlens_workbench.evidence.score import Entry, Score
from motorlens_workbench.hypotheses.bumps import in_bumps
from motorlens_workbench.hypotheses.changes import changes
from motorlens_workbench.hypotheses.free_response import free_responses
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Look:
    """A look.

    Attributes:
        lines: the runs about the model.
        lens: through what they are seen.
        book: the sums.
        beside: of all fitted parameters.
        scores: every shape of every hypothesis.
    """

    lines: tuple[Line, ...]
    lens: Lens
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
        the noises are right: if they are larger, some is left, and leads to another size (`Ledger.noisier`).

        Args:
            scores: of this look.
            uncorrected: the runs about the same model, along their inputs as measured.
            prior: of the fitted parameters.
        """
        book, entries = self.entries(scores, uncorrected, self.lens, prior)
        beside = self.book.noisier(book).beside()
        noisier = [
            score.entry.towards(entry, CRITERIA.doubt) for score, entry in zip(scores, entries, strict=True)
        ]
        return [
            score.doubted(score.doubt_of(beside.score(entry)))
            for score, entry in zip(scores, noisier, strict=True)
        ]

    def entries(
        self,
        scores: Sequence[Score],
        lines: Sequence[Line],
        lens: Lens,
        prior: Prior,
    ) -> tuple[Ledger, list[Entry]]:
        """A ledger of other lines, or through another lens, of the shapes of some scores alone, and their entries.

        Args:
            scores: of this look.
            lines: the runs.
            lens: through what they are seen.
            prior: of the fitted parameters.
        """
        alone = [replace(score.entry.hypothesis, shapes=(score.entry.shape,)) for score in scores]
        book = ledger(lines, lens, prior, alone)
        return book, list(book.entries)


def looks(
    lines: Sequence[Line],
    lenses: Sequence[Lens],
    prior: Prior,
    listed: Sequence[Hypothesis],
    constants: Mapping[str, str],
) -> list[Look]:
    """Look at every hypothesis, through each lens.

    Args:
        lines: the runs about the model.
        lenses: through what they are seen.
        prior: of the fitted parameters.
        listed: the hypotheses; those of a change at once are added.
        constants: parameters that cannot have changed at once unless something is missing, and the equation of each.
    """
    made = []
    memory = [free_responses(lines, layout(lines))] if constants else []
    for lens, book in zip(lenses, ledgers(lines, lenses, prior, [*listed, *memory]), strict=True):
        tested = [entry for entry in book.entries if entry.hypothesis not in memory]
        book = replace(book, entries=(*in_bumps(tested), *changes(book, lines, constants)))
        beside = book.beside()
        made.append(Look(tuple(lines), lens, book, beside, tuple(beside.scores(book.entries))))
    return made


def best_of(scores: Sequence[Score]) -> dict[str, Score]:
    """The strongest possible shape of every hypothesis, by name.

    Of a name that which explains most, for how it scatters is known only once it is fitted; of a term without one, which is
    not, that which weighs most.
    """
    best: dict[str, tuple[float, Score]] = {}
    for score in scores:
        strength = score.gain if score.entry.hypothesis.named else score.weight
        if score.possible and (score.name not in best or strength > best[score.name][0]):
            best[score.name] = strength, score
    return {name: score for name, (_, score) in best.items()}
