"""What a motor remembers: how it goes on by itself from what its states are at a moment.

Whatever acts from a moment on acts on a motor that has no past of it: what acts all the time, less what the motor remembers
of it at that moment. One column of each state that lasts does so for everything that may change then.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

# Share of a state that is still there a block of time later, if the motor is to remember it.
LASTS = 0.05


@dataclass(frozen=True)
class FreeResponse:
    """The free response of a motor from one moment of one recording on.

    Attributes:
        recording: name of it.
        sample: the moment.
        states: those that last.
    """

    recording: str
    sample: int
    states: tuple[str, ...]

    @property
    def width(self) -> int:
        """How many columns it has."""
        return len(self.states)

    def columns(self, line: Line) -> Array:
        """(N, C, k) what a unit of each state at the moment changes in the channels; nothing in another recording."""
        columns = np.zeros((*line.error.shape, self.width))
        if line.run.name == self.recording:
            for j, state in enumerate(self.states):
                columns[:, :, j] = line.of_states(line.linear.released(state, [self.sample]))[:, :, 0]
        return columns

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return -np.inf, np.inf


def free_responses(lines: Sequence[Line], blocks: Sequence[tuple[int, slice]]) -> Hypothesis:
    """What is remembered at the start of every block of time.

    Args:
        lines: the runs about the model.
        blocks: of time, as of a ledger.
    """
    shapes = []
    for line in lines:
        starts = [rows.start for r, rows in blocks if r == line.r]
        states = tuple(state for state in line.linear.states if _lasts(line, state, starts))
        shapes += [FreeResponse(line.run.name, start, states) for start in starts if states]
    return Hypothesis("free response", "unnamed", "", tuple(shapes))


def _lasts(line: Line, state: str, starts: Sequence[int]) -> bool:
    """Whether a state is seen, and mostly still there a block of time later."""
    if len(starts) < 2:
        return False
    moved = line.linear.released(state, starts[:-1])
    left = moved[state][starts[1:], np.arange(len(starts) - 1)]
    return bool(np.median(np.abs(left)) > LASTS and np.any(line.of_states(moved)))
