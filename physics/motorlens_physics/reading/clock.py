"""Time stamps of a steady clock that were read late or coarsely."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Stamps within so many periods of a steady clock are its own, read late; a row that was lost, or two that were swapped far
# apart, are further off. Over a hundred rows a line fitted to them follows neither by chance.
_PERIODS, _ROWS = 3.0, 100


def steady(time: Array) -> tuple[Array, float] | None:
    """The steady clock behind stamps that repeat or run back, and how far they were off; None if there is none.

    Args:
        time: (N,) as recorded.

    Returns:
        (N,) strictly increasing at a constant step, and the largest distance (s) between the two. The stamps of a coarse
        clock (10 ms at 1 kHz) are within one of its steps, those of a jittering one within a few periods.
    """
    if len(time) < _ROWS or not np.isfinite(time).all():
        return None
    rows = np.arange(len(time)) - (len(time) - 1) / 2
    period = float(rows @ (time - time.mean()) / (rows @ rows))
    if period <= 0:
        return None
    line = time.mean() + period * rows
    off = float(np.abs(time - line).max())
    forward = np.diff(time)
    coarse = float(np.median(forward[forward > 0]))
    return (line, off) if off <= max(coarse, _PERIODS * period) else None
