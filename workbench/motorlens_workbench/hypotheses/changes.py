"""Whether a parameter changed at once, and when: magnets that weakened, a winding that shorted, a load that was coupled.

What a parameter explains before and after a moment is in the ledger already, block of time by block: its column, cut at
every boundary between two blocks, costs no simulation. But what a motor remembers does not change at once: a winding was
not warmed by the resistance that it has only from then on. What is remembered of the parameter is taken from what is cut.

The best of many moments: Andrews (1993), doi:10.2307/2951764.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.estimate.prior import RELATIVE_SD
from motorlens_workbench.criteria import INTERVAL
from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.evidence.score import Entry
from motorlens_workbench.hypotheses.courses import of_parameter
from motorlens_workbench.hypotheses.free_response import FreeResponse
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

# Blocks of time that must lie before a change and after it.
SHORTEST = 2


@dataclass(frozen=True)
class Change:
    """A parameter that changed at once in one recording.

    Attributes:
        term: the parameter.
        equation: where it belongs.
        unit: of the parameter.
        per: the parameter's size in units of its column.
        value: as fitted.
        recording: name of it.
        time_s: (4,) start of the recording, last sample before the change, first after it, end.
    """

    term: str
    equation: str
    unit: str
    per: float
    value: float
    recording: str
    time_s: Array
    against: str = "time"

    @property
    def width(self) -> int:
        """How many columns it has."""
        return 1

    @property
    def at_s(self) -> float:
        """When it changed, to about a block of time."""
        return float(self.time_s[2])

    def by(self, coefficient: float) -> float:
        """How much, as a share of the fitted value."""
        return coefficient * self.per / self.value if self.value else float("inf")

    def told(self, coefficient: float) -> str:
        """What happened, in words. What a motor does not do by itself is said by its moment: the parameter stands for it.

        >>> change = Change("R_a0", "electrical", "ohm", 1.0, 2.0, "a.csv", np.array([0.0, 0.1, 0.2, 0.9]))
        >>> change.told(0.2)
        'R_a0 changes at once, by +10 %, at 0.2 s of a.csv'
        >>> change.told(3.0)  # doctest: +ELLIPSIS
        'something happens at 0.2 s of a.csv: from then on it is as if R_a0 were 2.5 times what it was before, ...
        """
        by, when = self.by(coefficient), f"at {self.at_s:.4g} s of {self.recording}"
        if abs(by) <= INTERVAL * RELATIVE_SD.get(self.term, np.inf):
            return f"{self.term} changes at once, by {100 * by:+.2g} %, {when}"
        return (
            f"something happens {when}: from then on it is as if {self.term} were {1 + by:.2g} times what it was before, "
            "more than motors of a kind differ by; look there for what was switched, coupled or came loose, and whether "
            "all channels were recorded at the same time"
        )

    def columns(self, line: Line) -> Array:
        """(N, C, 1) what the change would do to the channels of its recording; nothing in another."""
        if line.run.name != self.recording:
            return np.zeros((*line.error.shape, 1))
        after = self.per * (line.run.inputs.time_s >= self.time_s[2])
        unit = of_parameter(line.trajectory, self.term)
        return line.of_forcing(Forcing(after * unit.voltage, after * unit.torque, after * unit.heat))

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return -np.inf, np.inf

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """(4,) time, how the parameter differs from its value before, and the standard deviation of that."""
        step = np.array([0.0, 0.0, 1.0, 1.0])
        size, sd = coefficient[0] * self.per, float(np.sqrt(covariance[0, 0])) * self.per
        return self.time_s, size * step, sd * step


def changes(book: Ledger, lines: Sequence[Line], equations: Mapping[str, str]) -> list[Entry]:
    """Every fitted parameter, changed at every boundary between two blocks of a recording.

    Args:
        book: the sums, with those of `free_responses`.
        lines: the runs about the model.
        equations: the parameters that cannot have changed unless something is missing, and the equation of each.
    """
    of_run = np.array([r for r, _ in book.blocks])
    values = lines[0].model.values()
    memory = {
        (entry.shape.recording, entry.shape.sample): (entry.shape.states, entry)
        for entry in book.entries
        if isinstance(entry.shape, FreeResponse)
    }
    entries = []
    for key in book.keys:
        if key not in equations:
            continue
        c, made, sums = book.keys.index(key), [], []
        for line in lines:
            mine, time = np.flatnonzero(of_run == line.r), line.run.inputs.time_s
            moved = _moved(line, key)
            for k in mine[SHORTEST : 1 - SHORTEST]:
                first = book.blocks[k][1].start
                made.append(
                    Change(
                        key,
                        equations[key],
                        line.model.file.meaning(key).unit,
                        book.unit[key],
                        values[key],
                        line.run.name,
                        time[[0, first - 1, first, -1]],
                    )
                )
                cross, inner = book.base[:, :, c], book.base[:, c, c]
                if (line.run.name, first) in memory:
                    states, entry = memory[line.run.name, first]
                    past = book.unit[key] * np.array([moved[state][first, 0] for state in states])
                    inner = inner - 2 * entry.cross[:, c] @ past + past @ entry.inner @ past
                    cross = cross - entry.cross @ past
                after = (of_run == line.r) & (np.arange(len(of_run)) >= k)
                sums.append(((cross * after[:, None])[:, :, None], (inner * after)[:, None, None]))
        hypothesis = Hypothesis(
            f"{key} changes at once",
            "unnamed",
            equations[key],
            tuple(made),
            typical=abs(values[key]) / book.unit[key],
        )
        entries += [Entry(hypothesis, shape, *of) for shape, of in zip(made, sums, strict=True)]
    return entries


def _moved(line: Line, key: str) -> Mapping[str, Array]:
    """(N, 1) what a unit of a parameter moves in each state, if it is there all the time."""
    unit = of_parameter(line.trajectory, key)
    return line.linear.respond(unit.voltage[:, None], unit.torque[:, None], unit.heat[:, None])
