"""A speed that is the mean since the sample before: what a controller gets that counts an encoder's lines.

The mean of the speed over a sample is known from what is simulated at its ends, but for how the speed bends in between. A
held voltage that jumps lets the current go to where it settles by an exponential, and the speed follows its integral. With
r the electrical time constant in samples, a the acceleration by the change of the current, and e = exp(-1/r), the mean is

    (w_before + w_after) / 2 + a (r^2 - r/2 coth(1/(2 r)))

of which -a/12 is left where the current bends slowly, or runs linearly as the voltage does (Hermite's rule).
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Shortest electrical time constant, in samples, that is told from none: below, nothing bends.
BRIEFEST = 1e-6


def mean_since_last(
    time_s: Array, speed: Array, current: Array, spun: Array, decay_s: float, *, held: bool
) -> Array:
    """The mean speed since the sample before; at the first the speed there.

    Args:
        time_s: (N,) of the samples.
        speed, current: (N, ...) at the samples, or changes of them.
        spun: (N - 1,) by how much a current at each sample has changed the speed at the next, rad/s/A: nothing where the
            rotor is held.
        decay_s: the electrical time constant.
        held: whether the voltage holds from one sample to the next, or runs linearly.

    >>> mean_since_last(np.arange(3.0), np.array([0.0, 2.0, 4.0]), np.ones(3), np.ones(2), 0.1, held=True)
    array([0., 1., 3.])
    """
    decay = np.maximum(decay_s / np.diff(time_s), BRIEFEST)
    # Of the current that was there before a share of decay (1 - e) has acted on the speed.
    acted = -decay * np.expm1(-1 / decay)
    bend = spun / acted * (_bend(decay) if held else -1 / 12)
    mean = speed.copy()
    mean[1:] = 0.5 * (speed[1:] + speed[:-1])
    mean[1:] += bend.reshape(-1, *(1,) * (speed.ndim - 1)) * (current[1:] - current[:-1])
    return mean


def _bend(decay: Array) -> Array:
    """r^2 - r/2 coth(1/(2 r)), by its series where that cancels."""
    slow = np.maximum(decay, 10.0)
    half = np.minimum(decay, 10.0)
    return np.where(decay > 10.0, -1 / 12 + 1 / (720 * slow**2), half**2 - 0.5 * half / np.tanh(0.5 / half))
