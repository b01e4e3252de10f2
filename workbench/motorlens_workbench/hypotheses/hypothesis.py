"""What every hypothesis has in common: shapes, each of which is a few columns of the linearised problem."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_workbench.criteria import CRITERIA
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]


class Shape(Protocol):
    """One form that a hypothesis may take."""

    @property
    def width(self) -> int:
        """How many columns it has, k."""

    def columns(self, line: Line) -> Array:
        """(N, C, k) what a unit of each column would change in the channels of a run."""

    def limits(self) -> tuple[float, float]:
        """Smallest and largest coefficient that is possible, of a shape with one column."""


@dataclass(frozen=True)
class Hypothesis:
    """One thing that may be missing.

    Attributes:
        name: an effect's or a sensor fault's in the catalogue, or what a term without a name is made of.
        kind: "effect", "sensor" or "unnamed".
        equation: "electrical", "mechanical", "thermal", "coupling", or the channel of a sensor.
        shapes: the forms it may take.
        key: the parameter that is its size, "" without a name.
        typical: size of one unit of its columns, away from null, in the unit of that parameter; without a name, the
            coefficient that would be as large as what drives the motor, or as the parameter that is no constant.
        holds: whether it may hold a rotor at rest, see `Effect.holds`.
        largest: multiple of its typical size that is known to be no wonder of nature; None: not known.
    """

    name: str
    kind: str
    equation: str
    shapes: tuple[Shape, ...]
    key: str = ""
    typical: float = float("inf")
    holds: bool = False
    largest: float | None = None

    @property
    def named(self) -> bool:
        """Whether a model can be built with it."""
        return self.kind != "unnamed"

    @property
    def most(self) -> float:
        """The largest multiple of its typical size that is no wonder of nature; a term without a name may have any."""
        if not self.named:
            return float("inf")
        return 3 * CRITERIA.largest if self.largest is None else self.largest
