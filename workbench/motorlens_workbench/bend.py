"""A term without a name, and how much of what a model leaves it would explain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_workbench.curves import Curve
from motorlens_workbench.lasting import Lasting
from motorlens_workbench.variation import Variation

Array = NDArray[np.float64]

# A free curve in a balance, a term with a memory, a parameter that is no constant.
Free = Curve | Lasting | Variation


@dataclass(frozen=True)
class Bend:
    """A free curve against what is left: how much it would explain.

    Attributes:
        curve: the curve.
        gain: fall of the whitened sum of squares beyond chance.
        deviations: how many standard deviations that is.
        knots: (k,) those of its knots that the data know; the frequencies, in Hz, of a term with a memory.
        best: the robust statistic of its strongest single knot.
        value: (k,) the curve there, in the unit of its balance.
        sd: (k,) its standard deviation.
    """

    curve: Free
    gain: float
    deviations: float
    best: float
    knots: Array
    value: Array
    sd: Array
