"""How noisy a signal is, and the signal without its noise, its steps kept."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Samples of the shortest signal that is smoothed; the logarithm to base 2 of the fewest samples that are averaged.
SHORTEST, FASTEST = 8, -2
# Rounds of expectation and maximisation: the variance of a level that does not step is halved in each. What it begins with,
# in variances of the noise.
ROUNDS, STEPS = 10, 0.01
# Squared errors beyond this many deviations of the noise count little; the median of the squares of errors of sqrt(2)
# deviations, 2 chi2(1).median().
FAR, FORETOLD = 3.0, 0.91
# How fast a long signal wanders is told from so many stretches of so many samples.
LOOKS, LOOK = 4, 512
# Variance of a level and a slope that nothing is known of, in those of the noise.
ANY = 1e10
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
    """(N,) evenly sampled, without its noise and that of a converter of this `step`; what turns or steps at once does so.

    Fixed-interval smoother of a level whose slope wanders as a random walk, a cubic spline where samples are many (Durbin
    and Koopman 2012, doi:10.1093/acprof:oso/9780199641178.001.0001, chapters 3 and 4): either evenly, or with steps of the
    walk from heavy tails, Cauchy's for the slope, and of the level as well, by expectation and maximisation (Lange, Little
    and Taylor 1989, doi:10.1080/01621459.1989.10478852). Which, and how fast, is told by how well every other sample
    foretells the samples between; if evenly, how fast by generalised cross-validation (Craven and Wahba 1978,
    doi:10.1007/BF01404567). A signal whose samples foretell the next no better than those tell themselves, with errors of
    sqrt(2) deviations of the noise, is left as it is.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous.
        sd: standard deviation of all its noise, if known.

    >>> time, noise = np.arange(4000) / 1000, np.random.default_rng(0).standard_normal(4000)
    >>> steep = np.where(time < 2, 0.0, 100.0) + 50 * np.abs(np.sin(time))
    >>> bool(np.std(smoothed(steep + noise, sd=1.0) - steep) < 0.2)
    True
    """
    if sd is None:
        sd = float(np.hypot(noise_sd(y, step), step / np.sqrt(12)))
    if sd <= 0 or len(y) < SHORTEST:
        return y.copy()
    z = y / sd
    # Of a settled smoother: the walk's variance in a sample over the noise's is that number of samples to the power -4 which
    # it averages.
    walks = (2.0 ** (-4 * np.arange(FASTEST, np.log2(len(z) / 4)))).tolist()
    begins = np.linspace(0, len(z) - LOOK, LOOKS).astype(int) if len(z) > LOOKS * LOOK else [0]
    looks = [z[begin : begin + LOOK] if len(begins) > 1 else z for begin in begins]

    def likeliest(rounds: int) -> float:
        losses = [sum(_loss(_foretold(look, walk, rounds)) for look in looks) for walk in walks]
        return float(walks[int(np.argmin(losses))])

    evenly, unevenly = likeliest(1), likeliest(ROUNDS)
    even, uneven = _foretold(z, evenly, 1), _foretold(z, unevenly, ROUNDS)
    if _loss(uneven) < _loss(even) and np.median(uneven) < FORETOLD:
        return np.asarray(sd * _trend(z, unevenly, ROUNDS, 1)[0])
    # Of what is linear in the samples, all of them tell.
    level, error = min((_trend(z, walk, 1, 1) for walk in walks), key=lambda one: one[1])
    return y.copy() if error > 2 else np.asarray(sd * level)


def _foretold(z: Array, walk: float, rounds: int) -> Array:
    """Squared errors of samples with unit noise, of every second one as the others foretell it."""
    return np.asarray((z - _trend(z, walk, rounds, 2)[0])[1::2] ** 2)


def _loss(squares: Array) -> float:
    # Where a signal steps, a sample may be of either level.
    return float(np.sum(np.log1p(squares / FAR**2)))


@njit(cache=True, nogil=True, error_model="numpy")
def _trend(z, walk, rounds, every):  # type: ignore[no-untyped-def]
    """Level of a signal with unit noise whose slope wanders, all at once or, in more than one round, with steps.

    A round is a filter forwards, and backwards the smoothed steps of slope and level with their variances; the next one
    takes what is expected of their squares for the variances that they had.

    Args:
        z: (N,) samples.
        walk: variance of the slope's steps.
        rounds: how many; in one, every step has the same variance, and the level none.
        every: only each so-manieth sample is known.

    Returns:
        (N,) the level, and the squared error with which samples foretell others (generalised cross-validation; all known).
    """
    samples = len(z)
    of_slope, of_level = np.full(samples, walk), np.full(samples, STEPS if rounds > 1 else 0.0)
    before, error, out = np.empty((samples, 3)), np.empty(samples), np.empty(samples)
    for still in range(rounds - 1, -1, -1):
        level, slope = z[0], 0.0
        # Variances of level and slope, and between them, given the samples before.
        a, b, c = ANY, 0.0, ANY
        for k in range(samples):
            before[k, 0], before[k, 1], before[k, 2] = a, b, c
            out[k], error[k] = level, z[k] - level
            if k % every == 0:
                gain, turn = a / (a + 1.0), b / (a + 1.0)
                level, slope = level + gain * error[k], slope + turn * error[k]
                a, b, c = gain, turn, c - turn * b
            level += slope
            a, b, c = a + 2 * b + c + of_level[k], b + c, c + of_slope[k]
        # Scores of level and slope, and their variances, given the samples after.
        r, s, rr, rs, ss = 0.0, 0.0, 0.0, 0.0, 0.0
        squares, others = 0.0, 0.0
        for k in range(samples - 1, -1, -1):
            if still:
                of_level[k] = 0.5 * ((of_level[k] * r) ** 2 + of_level[k] - of_level[k] ** 2 * rr)
                of_slope[k] = 0.5 * (walk + (of_slope[k] * s) ** 2 + of_slope[k] - of_slope[k] ** 2 * ss)
            a, b, _ = before[k]
            counts = 1.0 / (a + 1.0) if k % every == 0 else 0.0
            # What the level and the slope after this sample keep of the level before it.
            keep, turn = 1.0 - (a + b) * counts, -b * counts
            others += counts + (1.0 - keep) ** 2 * rr - 2 * (1.0 - keep) * turn * rs + turn * turn * ss
            r, s = counts * error[k] + keep * r + turn * s, r + s
            rr, rs, ss = (
                counts + keep * keep * rr + 2 * keep * turn * rs + turn * turn * ss,
                keep * (rr + rs) + turn * (rs + ss),
                rr + 2 * rs + ss,
            )
            out[k] += a * r + b * s
            squares += (z[k] - out[k]) ** 2
    return out, samples * squares / others**2


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
