"""How noisy a signal is, and the signal without its noise, its steps kept."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import chdtri

Array = NDArray[np.float64]

# How often a signal is taken to jump anywhere where it does not.
CHANCE = 0.01
# Samples of the shortest signal that is smoothed.
SHORTEST = 8
# Variance of a slope that nothing is known of, in those of the noise.
ANY_SLOPE = 1e12
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

    Fixed-interval smoother of a level whose slope wanders as a random walk (Durbin and Koopman 2012,
    doi:10.1093/acprof:oso/9780199641178.001.0001, chapter 3), a cubic spline where samples are many. How fast the slope
    wanders is told by generalised cross-validation (Craven and Wahba 1978, doi:10.1007/BF01404567); where a sample is
    farther from what is expected than chance would have it in the whole signal, the level begins anew.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous.
        sd: standard deviation of all its noise, if known.

    >>> time, noise = np.arange(4000) / 1000, np.random.default_rng(0).standard_normal(4000)
    >>> jumps = np.where(time < 2, 0.0, 100.0) + 50 * np.sin(time)
    >>> bool(np.std(smoothed(jumps + noise, sd=1.0) - jumps) < 0.2)
    True
    """
    if sd is None:
        sd = float(np.hypot(noise_sd(y, step), step / np.sqrt(12)))
    if sd <= 0 or len(y) < SHORTEST:
        return y.copy()
    z, jump = y / sd, float(chdtri(1, CHANCE / len(y)))
    # Of a settled smoother: the walk's variance in a sample over the noise's is that number of samples to the power -4 which
    # it averages.
    walks = 2.0 ** (-4 * np.arange(np.log2(len(y) / 4)))
    # A slope that changes at once is taken for a jump a few samples late, by the same number both ways.
    ways = [
        (_trend(z, walk, far), _trend(z[::-1].copy(), walk, far))
        for walk in walks.tolist()
        for far in (jump, np.inf)
    ]
    ahead, back = min(ways, key=lambda one: one[0][1] + one[1][1])
    return np.asarray(0.5 * sd * (ahead[0] + back[0][::-1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _trend(z, walk, jump):  # type: ignore[no-untyped-def]
    """The level (N,) of samples with unit noise, and the error by generalised cross-validation.

    Where a squared innovation exceeds `jump` of its variances the level begins anew.
    """
    samples = len(z)
    state, covariance, anew = np.zeros((samples, 2)), np.zeros((samples, 3)), np.zeros(samples, np.bool_)
    level, slope, a, b, c = z[0], 0.0, 1.0, 0.0, ANY_SLOPE
    state[0, 0], covariance[0, 0], covariance[0, 2] = level, a, c
    for k in range(1, samples):
        level += slope
        a, b, c = a + 2 * b + c, b + c, c + walk
        error, scale = z[k] - level, a + 1.0
        anew[k] = error * error > jump * scale
        if anew[k]:
            level, slope, a, b, c = z[k], 0.0, 1.0, 0.0, ANY_SLOPE
        else:
            of_level, of_slope = a / scale, b / scale
            level, slope = level + of_level * error, slope + of_slope * error
            a, b, c = of_level, of_slope, c - of_slope * b
        state[k, 0], state[k, 1] = level, slope
        covariance[k, 0], covariance[k, 1], covariance[k, 2] = a, b, c

    # Backwards (Rauch, Tung and Striebel 1965, doi:10.2514/3.3166), with the variances d, e, f of level and slope.
    out = state[:, 0].copy()
    d, e, f = a, b, c
    squares, own = (z[-1] - level) ** 2, d
    for k in range(samples - 2, -1, -1):
        before, rise = state[k]
        a, b, c = covariance[k]
        if anew[k + 1]:
            # What comes after tells nothing of it.
            level, slope, d, e, f = before, rise, a, b, c
        else:
            p, q, r = a + 2 * b + c, b + c, c + walk
            size = p * r - q * q
            g, h = ((a + b) * r - b * q) / size, (b * p - (a + b) * q) / size
            u, v = ((b + c) * r - c * q) / size, (c * p - (b + c) * q) / size
            more, steeper = level - before - rise, slope - rise
            level, slope = before + g * more + h * steeper, rise + u * more + v * steeper
            p, q, r = d - p, e - q, f - r
            d = a + g * g * p + 2 * g * h * q + h * h * r
            e = b + g * u * p + (g * v + h * u) * q + h * v * r
            f = c + u * u * p + 2 * u * v * q + v * v * r
        out[k] = level
        squares += (z[k] - level) ** 2
        # The variance of a level, in those of the noise, is the share that its own sample has in it.
        own += d
    return out, squares / (1.0 - own / samples) ** 2


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
