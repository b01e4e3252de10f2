"""Training data as the trainer reads it: rows in blocks, from memory, from a mapped file or from a generator.

The trainer never holds more than one block (and a bounded sample), so the data may be larger than memory.
Blocks are re-cut to the size asked for, so sums do not depend on how the data arrive.
"""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

from motorlens_runtime.errors import DataError

Block = tuple[Tensor, Tensor]


class Source(Protocol):
    """Rows of inputs `[N, F]` and targets `[N, K]` in the order of time."""

    @property
    def rows(self) -> int:
        """Number of rows."""

    @property
    def inputs(self) -> int:
        """Number of inputs."""

    @property
    def outputs(self) -> int:
        """Number of targets."""

    def blocks(self, rows: int) -> Iterator[Block]:
        """All data in order, in blocks of exactly `rows` rows (the last one shorter)."""

    def sample(self, rows: int, generator: np.random.Generator) -> Block:
        """At most `rows` rows drawn without replacement, in the order of time."""

    def runs(self, rows: int, length: int) -> Iterator[Block]:
        """Unbroken stretches of at most `length` rows within one sequence, about `rows` rows in all, spread evenly."""


@dataclass(frozen=True)
class Arrays:
    """Data in arrays: numpy arrays, torch tensors or memory-mapped files.

    Attributes:
        x: inputs `[N, F]`.
        y: targets `[N, K]`.
        sequences: length of each unbroken sequence (duty cycle), first to last; empty means one sequence.
    """

    x: np.ndarray
    y: np.ndarray
    sequences: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.x.ndim != 2 or self.y.ndim != 2 or len(self.x) != len(self.y):
            raise DataError(
                f"inputs {tuple(self.x.shape)} and targets {tuple(self.y.shape)} must be [N, F] and [N, K]"
            )
        if len(self.x) == 0:
            raise DataError("no training data: zero rows")
        if self.sequences and sum(self.sequences) != len(self.x):
            raise DataError(f"sequences add up to {sum(self.sequences)} rows, the data have {len(self.x)}")

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.x)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return int(self.x.shape[1])

    @property
    def outputs(self) -> int:
        """Number of targets."""
        return int(self.y.shape[1])

    def blocks(self, rows: int) -> Iterator[Block]:
        """All data in order; see `Source`."""
        for first in range(0, self.rows, rows):
            yield self._rows(slice(first, first + rows))

    def sample(self, rows: int, generator: np.random.Generator) -> Block:
        """A random subset; see `Source`."""
        if rows >= self.rows:
            return self._rows(slice(None))
        return self._rows(np.sort(generator.choice(self.rows, size=rows, replace=False, shuffle=False)))

    def runs(self, rows: int, length: int) -> Iterator[Block]:
        """Stretches for autocorrelations; see `Source`."""
        sequences = self.sequences or (self.rows,)
        starts = np.concatenate([[0], np.cumsum(sequences)])
        pieces = [
            (first, min(first + length, int(stop)))
            for start, stop in itertools.pairwise(starts)
            for first in range(int(start), int(stop), length)
            if min(first + length, stop) - first >= min(length, stop - start) // 2
        ]
        keep = max(1, min(len(pieces), rows // max(1, min(length, max(sequences)))))
        for index in np.unique(np.linspace(0, len(pieces) - 1, keep).round().astype(int)):
            yield self._rows(slice(*pieces[index]))

    def _rows(self, which: slice | np.ndarray) -> Block:
        return _tensor(self.x[which]), _tensor(self.y[which])


@dataclass(frozen=True)
class Stream:
    """Data from a generator that can be started again and again, for instance a simulation or a file reader.

    Attributes:
        start: begins a pass; yields inputs `[n, F]` and targets `[n, K]` in pieces of any size, always the
        same data.
        rows: total number of rows.
        inputs: number of inputs F.
        outputs: number of targets K.
    """

    start: Callable[[], Iterator[tuple[np.ndarray, np.ndarray]]]
    rows: int
    inputs: int
    outputs: int

    def blocks(self, rows: int) -> Iterator[Block]:
        """All data in order; see `Source`."""
        kept: list[Block] = []
        held = 0
        for piece_x, piece_y in self.start():
            x, y = _tensor(piece_x), _tensor(piece_y)
            while held + len(x) >= rows:
                cut = rows - held
                yield _join([*kept, (x[:cut], y[:cut])])
                x, y, kept, held = x[cut:], y[cut:], [], 0
            if len(x):
                kept.append((x, y))
                held += len(x)
        if held:
            yield _join(kept)

    def sample(self, rows: int, generator: np.random.Generator) -> Block:
        """A random subset, from one pass; see `Source`."""
        size = min(rows, self.rows)
        chosen = np.sort(generator.choice(self.rows, size=size, replace=False, shuffle=False))
        parts, first = [], 0
        for x, y in self.blocks(65536):
            mine = torch.from_numpy(chosen[(chosen >= first) & (chosen < first + len(x))] - first)
            parts.append((x[mine], y[mine]))
            first += len(x)
        return _join(parts)

    def runs(self, rows: int, length: int) -> Iterator[Block]:
        """Stretches for autocorrelations; see `Source`."""
        every = max(1, self.rows // max(rows, 1))
        for index, block in enumerate(self.blocks(length)):
            if index % every == 0:
                yield block


def _tensor(array: np.ndarray | Tensor) -> Tensor:
    if isinstance(array, Tensor):
        return array
    # A read-only array (a mapped file) would make torch warn; its block is copied, never written to.
    return torch.from_numpy(np.array(array) if not array.flags.writeable else np.ascontiguousarray(array))


def _join(parts: list[Block]) -> Block:
    if len(parts) == 1:
        return parts[0]
    return torch.cat([x for x, _ in parts]), torch.cat([y for _, y in parts])
