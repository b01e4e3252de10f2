"""How noisy a signal is, and the signal without its noise, its steps kept.

Each sample is replaced by the value at the end of a line through as many samples to its left, and to its right, as are
compatible with one line: local polynomials with the intersection of confidence intervals, Katkovnik (1999),
doi:10.1109/78.782208; one-sided windows keep steps, Katkovnik, Egiazarian and Astola (2006), ISBN 978-0-8194-6042-1.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

WINDOWS = (1, 3, 5, 9, 17, 33, 65, 129, 257, 513)
# Half width of a confidence interval, in standard deviations. Narrow: what smoothing leaves of the noise is known and
# allowed for, what it takes from the signal is not.
CONFIDENCE = 1.5
# Samples in a piece of a coarsely converted signal; within how many steps, or deviations of its noise, it is steady;
# how many such pieces are needed.
STEADY, WITHIN, APART, FEWEST = 16, 3.0, 8.0, 8


def noise_sd(y: Array, step: float = 0.0) -> float:
    """Standard deviation of white noise on a signal that is mostly smooth, from its second differences.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous. Noise below it shows in how often a steady
            signal toggles between two levels.
    """
    if len(y) < 16:
        return 0.0
    at_first_sight = _of_second_differences(np.diff(y, 2))
    if step > 0:
        pieces = len(y) // STEADY
        cut = y[: pieces * STEADY].reshape(pieces, STEADY)
        steady = cut[np.ptp(cut, axis=1) <= max(WITHIN * step, APART * at_first_sight)]
        if len(steady) >= FEWEST:
            return _before_conversion(float(np.mean(np.diff(steady, 2, axis=1) ** 2)) / 6, step)
    return at_first_sight


def coloured_sd(y: Array, samples: float, step: float = 0.0) -> float:
    """Standard deviation of noise that forgets within so many samples, beside white noise, on a mostly smooth signal.

    From second differences over half as many samples, beside those over one sample, which see the white noise.

    Args:
        y: (N,) evenly sampled.
        samples: time constant of the coloured noise.
        step: least significant bit of its converter, 0 if it looks continuous.

    >>> rng, keep = np.random.default_rng(0), np.exp(-1 / 30)
    >>> drift = rng.standard_normal(40_000) * np.sqrt(1 - keep**2)
    >>> for k in range(1, 40_000): drift[k] += keep * drift[k - 1]
    >>> round(coloured_sd(drift + 0.5 * rng.standard_normal(40_000), 30.0), 1)
    1.0
    """
    lag = max(2, round(samples / 2))
    if len(y) < 16 * lag:
        return 0.0
    seen = _of_second_differences(y[2 * lag :] - 2 * y[lag:-lag] + y[: -2 * lag])
    white = np.hypot(noise_sd(y, step), step / np.sqrt(12))
    near, far = np.exp(-1 / samples), np.exp(-lag / samples)
    share = (8 * (near - far) - 2 * (near**2 - far**2)) / 6
    return float(np.sqrt(max(seen**2 - white**2, 0.0) / share))


def roughness(error: Array, shown: Array) -> float:
    """Root mean square of white noise on a mostly smooth error of a sensor that may rest at one number without any.

    A speed taken from an encoder is exactly 0 at rest. Its noise shows where the number changes, and counts for as much of
    the time as that.

    Args:
        error: (N,) evenly sampled.
        shown: (N,) what the sensor showed.

    >>> noise = np.random.default_rng(0).standard_normal(4000)
    >>> half = np.where(np.arange(4000) < 1000, noise, 0.0)
    >>> round(roughness(noise, noise), 2), round(roughness(half, half), 2)
    (0.98, 0.5)
    """
    same = np.diff(shown) == 0
    moves = ~(same[1:] & same[:-1])
    if np.count_nonzero(moves) < 14:
        return noise_sd(error)
    return float(np.sqrt(np.mean(moves)) * _of_second_differences(np.diff(error, 2)[moves]))


def _of_second_differences(second: Array) -> float:
    return float(1.4826 * np.median(np.abs(second - np.median(second))) / np.sqrt(6))


def _before_conversion(toggling: float, step: float) -> float:
    """Standard deviation of the noise under a converter whose output scatters with the variance `toggling`.

    Averaged over where the signal lies between two levels: small noise toggles near a level's border only, with the variance
    step sd / sqrt(pi); large noise is scattered once more by the converter, with step^2 / 12.
    """
    small = toggling * np.sqrt(np.pi) / step
    return float(small if small < 0.5 * step else np.sqrt(max(toggling - step**2 / 12, 0.25 * step**2)))


def smoothed(y: Array, step: float = 0.0, sd: float | None = None) -> Array:
    """(N,) evenly sampled, without its noise and that of a converter of this `step`; steps stay where they are.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous.
        sd: standard deviation of all its noise, if known.
    """
    if sd is None:
        sd = float(np.hypot(noise_sd(y, step), step / np.sqrt(12)))
    if sd <= 0 or len(y) < 2 * WINDOWS[4]:
        return y.copy()
    right, right_variance = _one_sided(y, sd)
    left, left_variance = _one_sided(y[::-1], sd)
    left, left_variance = left[::-1], left_variance[::-1]
    weight = left_variance / (left_variance + right_variance)
    return np.asarray(weight * right + (1 - weight) * left)


def _one_sided(y: Array, sd: float) -> tuple[Array, Array]:
    """Value at each sample of the longest believable line to its right, and its variance in units of sd^2."""
    sums = np.concatenate([[0.0], np.cumsum(y)])
    moments = np.concatenate([[0.0], np.cumsum(np.arange(len(y)) * y)])
    value, variance = y.copy(), np.ones(len(y))
    _longest_line(sums, moments, CONFIDENCE * sd, np.array(WINDOWS[1:]), value, variance)
    return value, variance


@njit(cache=True, nogil=True, error_model="numpy")
def _longest_line(sums, moments, width, windows, value, variance):  # type: ignore[no-untyped-def]
    for t in range(len(value)):
        low, high = value[t] - width, value[t] + width
        for h in windows:
            if t + h > len(value):
                break
            total = sums[t + h] - sums[t]
            first = moments[t + h] - moments[t] - t * total
            here = (2 * (2 * h - 1) * total - 6 * first) / (h * (h + 1))
            share = 2 * (2 * h - 1) / (h * (h + 1))
            low, high = max(low, here - width * np.sqrt(share)), min(high, here + width * np.sqrt(share))
            if low > high:
                break
            value[t], variance[t] = here, share


def level_of(time_s: Array, y: Array, fastest_s: float) -> Array:
    """(N,) the level about which a channel is noisy, if the level wanders as a random walk and the noise is white.

    Fixed-interval smoother of the local level model (Durbin and Koopman 2012, doi:10.1093/acprof:oso/9780199641178.001.0001,
    chapter 2), its time constant that under which the channel is likeliest: a level that rests is averaged over all of it.

    Args:
        time_s: (N,) ascending.
        y: (N,) measured.
        fastest_s: the level follows no faster than with this time constant.

    >>> time, noise = np.arange(4000.0), np.random.default_rng(0).standard_normal(4000)
    >>> bool(np.all(abs(level_of(time, 20 + noise, 60.0) - 20) < 0.1))
    True
    """
    steps_s = np.diff(time_s)
    if np.ptp(y) == 0 or not steps_s.size:
        return y.copy()
    step_s, span_s = float(np.median(steps_s)), float(time_s[-1] - time_s[0])
    # Of a settled filter: the walk's variance in a step over the noise's is the square of a step over the time constant.
    longer = fastest_s * 2.0 ** np.arange(1 + max(0, int(np.log2(max(span_s / fastest_s, 1.0)))))
    walks = np.append((step_s / longer) ** 2, 0.0) / step_s
    walk = min(walks.tolist(), key=lambda walk: _filtered(y, steps_s, walk)[2])
    level, variance, _ = _filtered(y, steps_s, walk)
    return np.asarray(_smoothed_back(level, variance, steps_s, walk))


@njit(cache=True, nogil=True, error_model="numpy")
def _filtered(y, steps_s, walk):  # type: ignore[no-untyped-def]
    """Level (N,) and its variance (N,) given all until then, and twice the negative logarithmic likelihood."""
    level, variance = y.copy(), np.ones(len(y))
    squares, spread = 0.0, 0.0
    for k in range(1, len(y)):
        before = variance[k - 1] + walk * steps_s[k - 1]
        error, scale = y[k] - level[k - 1], before + 1.0
        level[k] = level[k - 1] + before / scale * error
        variance[k] = before / scale
        squares += error * error / scale
        spread += np.log(scale)
    return level, variance, (len(y) - 1) * np.log(squares) + spread


@njit(cache=True, nogil=True, error_model="numpy")
def _smoothed_back(level, variance, steps_s, walk):  # type: ignore[no-untyped-def]
    out = level.copy()
    for k in range(len(level) - 2, -1, -1):
        share = variance[k] / (variance[k] + walk * steps_s[k])
        out[k] = level[k] + share * (out[k + 1] - level[k])
    return out
