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
# Longest, in samples, that the closed form is used for: there the series of two terms has seven digits of it.
SLOW = 10.0


def bend_of(time_s: Array, spun: Array, decay_s: float, *, held: bool) -> tuple[Array, Array]:
    """What a change of the current over each sample adds to the mean of the speed at its ends.

    Args:
        time_s: (N,) of the samples.
        spun: (N - 1,) by how much a current at each sample has changed the speed at the next, rad/s/A: nothing where the
            rotor is held.
        decay_s: the electrical time constant.
        held: whether the voltage holds from one sample to the next, or runs linearly.

    Returns:
        (N - 1,) that, rad/s/A: in proportion to the torque constant over the inertia; and its change with the logarithm of
        the time constant.
    """
    decay = np.maximum(decay_s / np.diff(time_s), BRIEFEST)
    # Of the current that was there before, a share of this has acted on the speed.
    gain = spun / (-decay * np.expm1(-1 / decay))
    bend, slope = _bend(decay) if held else (np.full(len(spun), -1 / 12), np.zeros(len(spun)))
    return gain * bend, gain * slope * decay


def mean_since_last(speed: Array, current: Array, bend: Array) -> Array:
    """The mean speed since the sample before; at the first the speed there.

    Args:
        speed, current: (N, ...) at the samples, or changes of them.
        bend: (N - 1,) see `bend_of`.

    >>> mean_since_last(np.array([0.0, 2.0, 4.0]), np.ones(3), np.ones(2))
    array([0., 1., 3.])
    """
    mean = speed.copy()
    mean[1:] = 0.5 * (speed[1:] + speed[:-1])
    mean[1:] += bend.reshape(-1, *(1,) * (speed.ndim - 1)) * (current[1:] - current[:-1])
    return mean


def _bend(decay: Array) -> tuple[Array, Array]:
    """r^2 - r/2 coth(1/(2 r)) and its derivative, by the series where that cancels."""
    slow, fast = np.maximum(decay, SLOW), np.minimum(decay, SLOW)
    half = np.minimum(0.5 / fast, 300.0)
    value = fast**2 - 0.5 * fast / np.tanh(half)
    slope = 2 * fast - 0.5 / np.tanh(half) - 0.25 / (fast * np.sinh(half) ** 2)
    return (
        np.where(decay > SLOW, -1 / 12 + 1 / (720 * slow**2), value),
        np.where(decay > SLOW, -1 / (360 * slow**3), slope),
    )
