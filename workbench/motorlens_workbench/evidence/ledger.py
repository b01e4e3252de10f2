"""The ledger: what every shape of every hypothesis has in common with what a model leaves, block of time by block.

A shape is a few columns: what a unit of each would change in all measured channels. Columns and errors are filtered to
innovations under the noise that was found in the recording, of sensors, of inputs and of a torque that nobody measured, so
that all three are integrated out. Kept are the products with the fitted parameters' columns, with the errors, and within
the shape; all else is algebra on them.

The correction for leverage of a block is that of MacKinnon and White (1985), doi:10.1016/0304-4076(85)90158-7.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.innovations import in_blocks, read
from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.weighed import BLOCKS
from motorlens_physics.threads import on_all_cores
from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.evidence.colour import coloured, gain_of
from motorlens_workbench.evidence.score import Entry, Score, inverse, log_chance, scatter_of
from motorlens_workbench.evidence.whitening import white as white_noise
from motorlens_workbench.hypotheses.hypothesis import Hypothesis, Shape
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

# Makes columns (N, C, m) white: (len, C, m) of each of some blocks of samples, which follow each other from the first on.
White = Callable[[Array, Iterable[slice]], Iterator[Array]]
# Columns filtered at once, so that memory stays small on long recordings.
CHUNK = 48
# Shapes tested at once, likewise.
TOGETHER = 64
# Share of its power that a column must keep beside the fitted parameters: below it, rounding alone is left.
COPY = 1e-7
# Degrees of freedom of what a motor file states: Student's t, for data sheets err by more than they say (Lange, Little and
# Taylor 1989, doi:10.1080/01621459.1989.10478852).
FREEDOM = 4.0
# Share of a test that one block may bear before its scatter is taken as unknown, and a column of a free term as not tested.
MOST_OF_IT = 0.9


@dataclass(frozen=True)
class Ledger:
    """All sums.

    Attributes:
        keys: the fitted parameters.
        unit: of their columns.
        base: (B, p + 1, p + 1) products of their columns, in these units, and of the errors.
        pull: (p,) how far the prior would have each parameter, in units.
        entries: one per shape.
        blocks: which run and which of its samples each block is.
        colour: what is left of colour in what was taken for noise, see `colour.gain_of`; 0 if it was not looked at.
        trusted: parameters of which the motor file is taken at its word, however far they are from it.
    """

    keys: tuple[str, ...]
    unit: Mapping[str, float]
    base: Array
    pull: Array
    entries: tuple[Entry, ...]
    blocks: tuple[tuple[int, slice], ...]
    colour: float = 0.0
    trusted: frozenset[str] = frozenset()

    @property
    def belief(self) -> Array:
        """(p,) weight of each prior, that of Student's t at where the parameter is: a file may simply be wrong."""
        taken = np.array([key in self.trusted for key in self.keys], dtype=np.bool_)
        return np.where(taken, 1.0, np.minimum((FREEDOM + 1) / (FREEDOM + self.pull**2), 1.0))

    def noisier(self, uncorrected: "Ledger") -> "Ledger":
        """As it would be, but for its shapes, with inputs as much noisier than they were corrected for as is not known.

        Sums of products grow with the variance of the noise that is left: from those along corrected inputs, which have
        none, to those along the inputs as measured, which have all of it.
        """
        return replace(self, base=self.base + CRITERIA.doubt * (uncorrected.base - self.base), entries=())

    def entry_of(self, key: str, hypothesis: Hypothesis, shape: Shape) -> Entry:
        """A fitted parameter as a shape of its own."""
        c = self.keys.index(key)
        return Entry(hypothesis, shape, self.base[:, :, c : c + 1], self.base[:, c : c + 1, c : c + 1])

    def beside(
        self, given: Sequence[str] | None = None, target: Mapping[str, float] | None = None
    ) -> "Beside":
        """What is left once fitted parameters have explained all they can of every shape and of the errors.

        Args:
            given: these parameters; None is all.
            target: sizes, in units, of columns that are added to the errors: what they explain counts as missing.
        """
        given = self.keys if given is None else given
        at = np.array([self.keys.index(key) for key in given], dtype=np.intp)
        mix = np.zeros(len(self.keys) + 1)
        mix[-1] = 1.0
        for key, size in (target or {}).items():
            mix[self.keys.index(key)] = size
        right = self.base[:, at] @ mix
        power = np.einsum("i,bij,j->b", mix, self.base, mix)
        return Beside(self, at, mix, self.base[:, at[:, None], at], right, power)

    def scores(
        self, given: Sequence[str] | None = None, target: Mapping[str, float] | None = None
    ) -> list[Score]:
        """Every shape of which the recordings can say anything, see `beside`."""
        return self.beside(given, target).scores(self.entries)


@dataclass(frozen=True)
class Beside:
    """Sums from which some fitted parameters are projected.

    Attributes:
        ledger: the sums.
        at: (q,) positions of these parameters.
        mix: (p + 1,) what counts as error.
        gram: (B, q, q) their products.
        right: (B, q) theirs with the error.
        power: (B,) squares of the error.
    """

    ledger: Ledger
    at: NDArray[np.intp]
    mix: Array
    gram: Array
    right: Array
    power: Array

    @cached_property
    def inverse(self) -> Array:
        """(q, q); the prior keeps it regular."""
        return inverse(self.gram.sum(axis=0) + np.diag(self.ledger.belief[self.at]))

    @cached_property
    def moves(self) -> Array:
        """(q,) how the parameters would move, in units."""
        return np.asarray(
            self.inverse @ (self.right.sum(axis=0) + self.ledger.belief[self.at] * self.ledger.pull[self.at])
        )

    def projected(self, entries: Sequence[Entry]) -> tuple[Array, Array]:
        """(S, B + 1, k) and (S, B + 1, k, k): score and information of each block of as many shapes of one width.

        The last block is what the priors say.
        """
        cross = np.stack([entry.cross for entry in entries])
        own = cross[:, :, self.at]
        weights = self.inverse @ own.sum(axis=1)
        mix = self.mix.copy()
        mix[self.at] -= self.moves
        score = mix @ cross - self._unexplained @ weights
        explained = np.concatenate(self.gram) @ weights
        half = weights.swapaxes(1, 2)[:, None] @ (0.5 * explained.reshape(own.shape) - own)
        inner = np.stack([entry.inner for entry in entries]) + half + half.swapaxes(2, 3)
        belief, across = self.ledger.belief[self.at], weights.swapaxes(1, 2)
        prior = -across @ (belief * (self.ledger.pull[self.at] - self.moves))
        known = (across * belief) @ weights
        return np.concatenate([score, prior[:, None]], axis=1), np.concatenate(
            [inner, known[:, None]], axis=1
        )

    @cached_property
    def _unexplained(self) -> Array:
        """(B, q) products of the parameters with what they leave of the error."""
        return self.right - self.gram @ self.moves

    def moves_with(self, entry: Entry, size: Array) -> Array:
        """(q,) how the parameters would move beside a shape of that size (k,), in units."""
        return np.asarray(self.moves - self.inverse @ entry.cross[:, self.at].sum(axis=0) @ size)

    def score(self, entry: Entry) -> Score | None:
        """The test of a shape; None where fitted parameters can do all that it does."""
        return next(iter(self.scores([entry])), None)

    def scores(self, entries: Sequence[Entry]) -> list[Score]:
        """The tests of shapes, in their order, but for those of which fitted parameters can do all."""
        scores: dict[int, Score] = {}
        widths = np.array([entry.inner.shape[-1] for entry in entries])
        for width in np.unique(widths):
            alike = np.flatnonzero(widths == width)
            for first in range(0, len(alike), TOGETHER):
                some = alike[first : first + TOGETHER].tolist()
                told = self._scores([entries[k] for k in some])
                scores |= {k: score for k, score in zip(some, told, strict=True) if score is not None}
        return [scores[k] for k in sorted(scores)]

    def _scores(self, entries: Sequence[Entry]) -> list[Score | None]:
        """Of shapes of one width."""
        by_block, inner = self.projected(entries)
        raw = np.array([np.diagonal(entry.inner.sum(axis=0)) for entry in entries])
        kept = np.diagonal(inner.sum(axis=1), axis1=1, axis2=2) > COPY * np.maximum(raw, 1e-300)
        # What a free term does within a single block of time no other block could contradict. A name has a size, also where
        # it stands in the model and is weighed as if it could have any.
        of_block = np.diagonal(inner[:, :-1], axis1=2, axis2=3)
        free = np.array([not entry.hypothesis.key for entry in entries])
        kept &= ~free[:, None] | (of_block.max(axis=1) <= MOST_OF_IT * of_block.sum(axis=1))
        able, widths = kept.any(axis=1), kept.sum(axis=1)
        if kept.shape[1] <= 2:
            able &= kept.all(axis=1)
        both = kept[:, :, None] & kept[:, None, :]
        by_block, inner = by_block * kept[:, None], inner * both[:, None]
        information = inner.sum(axis=1)
        largest = np.array([
            CRITERIA.largest if entry.hypothesis.named else entry.hypothesis.typical for entry in entries
        ])  # fmt: skip
        sizes = np.divide(1.0, largest**2, out=np.zeros(len(largest)), where=largest > 0)
        # What is not kept stands by itself in what is inverted, and is no part of the inverse.
        precision = information + np.eye(kept.shape[1]) * np.where(kept, sizes[:, None], 1.0)[:, None]
        whole = inverse(precision) * both
        total = by_block.sum(axis=1)
        size = (whole @ total[:, :, None])[:, :, 0]
        shares = np.einsum("sij,sbji->sb", whole, inner) / np.maximum(widths, 1)[:, None]
        rests = by_block - (inner @ size[:, None, :, None])[:, :, :, 0]
        rests /= (1 - np.clip(shares, 0.0, MOST_OF_IT))[:, :, None]
        gains, scatters = np.sum(total * size, axis=1), scatter_of(rests, whole, np.maximum(widths, 1))
        return [
            Score(
                entry, size[k], whole[k] * scatter, information[k], gain, scatter, -log_chance(gain / scatter, width),
                width, rests[k], whole[k],
            ) if able[k] else None
            for k, (entry, gain, scatter, width) in enumerate(
                zip(entries, gains.tolist(), scatters.tolist(), widths.tolist(), strict=True)
            )
        ]  # fmt: skip


def layout(lines: Sequence[Line]) -> tuple[tuple[int, slice], ...]:
    """The blocks of time: which run, which of its samples."""
    samples = sum(len(line.error) for line in lines)
    blocks: list[tuple[int, slice]] = []
    for r, line in enumerate(lines):
        rows = len(line.error)
        wanted = min(max(round(BLOCKS * rows / samples), BLOCKS // 3), rows // 8)
        edges = np.linspace(0, rows, max(wanted, 1) + 1).astype(int)
        blocks += [(r, slice(int(a), int(b))) for a, b in itertools.pairwise(edges)]
    return tuple(blocks)


@dataclass(frozen=True)
class Lens:
    """Through what errors are seen.

    Attributes:
        noises: of each run.
        rests: (N, C) of each run, what is taken for noise; None is all of the errors.
        plain: take the sensors' noise as white: what is missing must not hide in its colour.
    """

    noises: Sequence[Noise]
    rests: Sequence[Array] | None = None
    plain: bool = False

    def white(self, line: Line) -> tuple[White, Array, float]:
        """What makes columns of a run white, its errors (N, C) as read, and the colour taken out, see `Ledger`."""
        rest = line.error if self.rests is None else self.rests[line.r]
        seen = read(self.noises[line.r].space(line.run, line.linear, line.run.there), rest)
        whitener, colour = white_noise(np.ones(line.error.shape[1])), 0.0
        if not self.plain:
            left = seen.filtered.white[:, :, 0]
            whitener = coloured(line.run, left, len(line.keys))
            colour = gain_of(line.run, left, whitener, self.noises[line.r], len(line.keys))
        error = line.error + (seen.error - rest)

        def white(columns: Array, blocks: Iterable[slice]) -> Iterator[Array]:
            return whitener.in_blocks(in_blocks(seen.space, seen.filtered, columns, blocks))

        return white, error, colour


def ledger(lines: Sequence[Line], lens: Lens, prior: Prior, hypotheses: Sequence[Hypothesis]) -> Ledger:
    """Filter and sum everything.

    Args:
        lines: the runs about one model.
        lens: through what they are seen.
        prior: of the fitted parameters; a unit of a column is a standard deviation where the parameter is.
        hypotheses: to be tested.
    """
    return ledgers(lines, (lens,), prior, hypotheses)[0]


def ledgers(
    lines: Sequence[Line], lenses: Sequence[Lens], prior: Prior, hypotheses: Sequence[Hypothesis]
) -> list[Ledger]:
    """A ledger through each lens, see `ledger`: the columns, which cost most, are made once."""
    keys, blocks = prior.keys, layout(lines)
    shapes = [(hypothesis, shape) for hypothesis in hypotheses for shape in hypothesis.shapes]
    values = lines[0].model.values()
    unit = dict(zip(keys, prior.width(values).tolist(), strict=True))

    def of_run(line: Line) -> list[_Sums]:
        own = [rows for r, rows in blocks if r == line.r]
        return _sums(line, lenses, unit, own, [shape for _, shape in shapes])

    parts = on_all_cores(of_run, lines)
    made = []
    for seen in zip(*parts, strict=True):
        entries = tuple(
            Entry(
                hypothesis,
                shape,
                np.concatenate([one.of_shapes[j][0] for one in seen]),
                np.concatenate([one.of_shapes[j][1] for one in seen]),
            )
            for j, (hypothesis, shape) in enumerate(shapes)
        )
        base = np.concatenate([one.base for one in seen])
        colour = sum(one.colour for one in seen)
        made.append(Ledger(keys, unit, base, prior.pull(values), entries, blocks, colour))
    return made


@dataclass(frozen=True)
class _Sums:
    """Of one run through one lens: products within the base, across and within each shape, and the colour."""

    base: Array
    of_shapes: list[tuple[Array, Array]]
    colour: float


def _sums(
    line: Line,
    lenses: Sequence[Lens],
    units: Mapping[str, float],
    blocks: Sequence[slice],
    shapes: Sequence[Shape],
) -> list[_Sums]:
    keys, unit = list(units), np.array([units[key] for key in line.keys])
    filters, made = [], []
    for lens in lenses:
        white, error, colour = lens.white(line)
        wide = np.zeros((*error.shape, len(keys) + 1))
        table = np.concatenate([line.own * unit, error[:, :, None]], axis=2)
        known = [*(keys.index(key) for key in line.keys), len(keys)]
        for rows, filtered in zip(blocks, white(table, blocks), strict=True):
            wide[rows, :, known] = filtered
        filters.append((white, wide))
        made.append(_Sums(np.array([_products(wide[rows], wide[rows]) for rows in blocks]), [], colour))
    for chunk in _chunks(shapes):
        columns = np.concatenate([shape.columns(line) for shape in chunk], axis=2)
        edges = np.cumsum([0, *(shape.width for shape in chunk)])
        own = [slice(first, last) for first, last in itertools.pairwise(edges)]
        for (white, wide), sums in zip(filters, made, strict=True):
            # A block at a time stays near the processor.
            cross, inner = [], []
            for rows, filtered in zip(blocks, white(columns, blocks), strict=True):
                cross.append(_products(wide[rows], filtered))
                inner.append(_products(filtered, filtered))
            across, within = np.array(cross), np.array(inner)
            sums.of_shapes.extend((across[:, :, at], within[:, at, at].copy()) for at in own)
    return made


def common(lines: Sequence[Line], noises: Sequence[Noise], prior: Prior, shapes: Sequence[Shape]) -> Array:
    """(p + k, p + k) products of the fitted parameters' columns and those of some shapes, all runs together."""
    keys, width = list(prior.keys), sum(shape.width for shape in shapes)
    total = np.zeros((len(keys) + width, len(keys) + width))
    for line in lines:
        unit = np.array([prior.sd[key] for key in line.keys])
        columns = [line.own * unit, *(shape.columns(line) for shape in shapes)]
        everything = np.concatenate(columns, axis=2)
        (white,) = Lens(noises).white(line)[0](everything, [slice(0, len(everything))])
        at = [*(keys.index(key) for key in line.keys), *range(len(keys), len(keys) + width)]
        total[np.ix_(at, at)] += _products(white, white)
    return total


def _products(a: Array, b: Array) -> Array:
    return np.asarray(a.reshape(-1, a.shape[2]).T @ b.reshape(-1, b.shape[2]))


def _chunks(shapes: Sequence[Shape]) -> Iterator[list[Shape]]:
    chunk: list[Shape] = []
    for shape in shapes:
        if chunk and sum(one.width for one in chunk) + shape.width > CHUNK:
            yield chunk
            chunk = []
        chunk.append(shape)
    if chunk:
        yield chunk
