"""Ledgers of columns as they are, without a motor."""

import itertools

import numpy as np

from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.evidence.score import Entry
from motorlens_workbench.hypotheses.hypothesis import Hypothesis

BLOCKS, ROWS = 64, 6400


class Free:
    """A shape of which any size is possible."""

    def __init__(self, width: int) -> None:
        self.width = width

    def limits(self) -> tuple[float, float]:
        return -np.inf, np.inf


def by_block(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("bni,bnj->bij", a.reshape(BLOCKS, -1, a.shape[1]), b.reshape(BLOCKS, -1, b.shape[1]))


def book_of(base: np.ndarray, shapes: list[np.ndarray], error: np.ndarray, pull: float = 0.0) -> Ledger:
    """A ledger of columns as they are: `base` (N, p) with a prior of width 1 each, `shapes` (N, k) without a name."""
    wide = np.column_stack([base, error])
    keys = tuple(f"p{k}" for k in range(base.shape[1]))
    entries = []
    for j, columns in enumerate(shapes):
        shape = Free(columns.shape[1])
        hypothesis = Hypothesis(f"h{j}", "unnamed", "electrical", (shape,))  # type: ignore[arg-type]
        entries.append(Entry(hypothesis, shape, by_block(wide, columns), by_block(columns, columns)))  # type: ignore[arg-type]
    edges = np.linspace(0, len(error), BLOCKS + 1).astype(int)
    blocks = tuple((0, slice(int(a), int(b))) for a, b in itertools.pairwise(edges))
    return Ledger(
        keys, dict.fromkeys(keys, 1.0), by_block(wide, wide), np.full(len(keys), pull), tuple(entries), blocks
    )
