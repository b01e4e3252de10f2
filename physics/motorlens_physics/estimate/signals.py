"""How noisy a signal is, and the signal without its noise, its steps kept."""

from collections.abc import Iterable
from math import comb
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Array = NDArray[np.float64]

# Of which differences of a signal noise is told.
ORDERS = (2, 3, 4, 5, 6)
# Parts of a signal between which its noise is looked at.
PARTS = 16
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
# Share of white noise in all noise, at least.
LEAST = 1e-3
# Samples in a piece of a coarsely converted signal; within how many steps, or deviations of its noise, it is steady;
# how many such pieces are needed.
STEADY, WITHIN, APART, FEWEST = 16, 3.0, 8.0, 8


def decaying(y: Array, remains: float) -> Array:
    """(N,) a signal, and of all that came before it the share that remains from each sample to the next.

    The filter 1 / (1 - remains / z) as what it solves: `scipy.signal`, which has it too, takes a second to import.

    >>> decaying(np.array([1.0, 0.0, 0.0, 2.0]), 0.5)
    array([1.   , 0.5  , 0.25 , 2.125])
    """
    return np.asarray(solve_banded((1, 0), np.outer([1.0, -remains], np.ones(len(y))), y))


def noise_sd(y: Array, step: float = 0.0) -> float:
    """Standard deviation of white noise on a signal that is mostly smooth, from its differences.

    Of several orders those that show the least: to the lower ones what a fast drive bends by adds, to all of them what is
    rough besides.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous. Noise below it shows in how often a steady
            signal toggles between two levels.
    """
    return _noise_sd(y, step, 0.0)


def most_noise_sd(y: Array, step: float = 0.0) -> float:
    """The same of the most that it may be: two standard deviations more of its variance, as parts of the signal scatter.

    Args: as of `noise_sd`.

    >>> noise = np.random.default_rng(0).standard_normal(4000)
    >>> bool(1.0 < most_noise_sd(noise) < 1.1)
    True
    """
    return _noise_sd(y, step, 2.0)


def _noise_sd(y: Array, step: float, deviations: float) -> float:
    if len(y) < 16:
        return 0.0
    if step > 0:
        pieces = len(y) // STEADY
        cut = y[: pieces * STEADY].reshape(pieces, STEADY)
        steady = cut[np.ptp(cut, axis=1) <= max(WITHIN * step, APART * _from_differences(np.diff(y, 2)))]
        if len(steady) >= FEWEST:
            toggling = [
                np.mean(np.diff(steady, order, axis=1) ** 2, axis=1) / _gain(order) for order in ORDERS
            ]
            least = min(toggling, key=lambda each: float(np.mean(each)))
            return _before_conversion(float(np.mean(least)) + deviations * _of_mean(least), step)
    least_sd, order = min((_from_differences(np.diff(y, order), order), order) for order in ORDERS)
    if not deviations:
        return least_sd
    parts = np.array_split(np.diff(y, order), min(PARTS, len(y) // (2 * max(ORDERS))))
    scatter = _of_mean(np.array([_from_differences(part, order) ** 2 for part in parts]))
    return float(np.sqrt(least_sd**2 + deviations * scatter))


def _of_mean(each: Array) -> float:
    """Standard deviation of the mean of some numbers."""
    return float(np.std(each, ddof=1) / np.sqrt(len(each))) if len(each) > 1 else 0.0


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
    seen = _from_differences(y[2 * lag :] - 2 * y[lag:-lag] + y[: -2 * lag])
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
    return float(np.sqrt(np.mean(moves)) * _from_differences(np.diff(error, 2)[moves]))


def _from_differences(differences: Array, order: int = 2) -> float:
    """Standard deviation of white noise whose differences of an order scatter as these, by their median."""
    deviation = 1.4826 * np.median(np.abs(differences - np.median(differences)))
    return float(deviation / np.sqrt(_gain(order)))


def _gain(order: int) -> int:
    """Variance of differences of white noise of 1."""
    return comb(2 * order, order)


def _before_conversion(toggling: float, step: float) -> float:
    """Standard deviation of the noise under a converter whose output scatters with the variance `toggling`.

    Averaged over where the signal lies between two levels: small noise toggles near a level's border only, with the variance
    step sd / sqrt(pi); large noise is scattered once more by the converter, with step^2 / 12.
    """
    small = toggling * np.sqrt(np.pi) / step
    return float(small if small < 0.5 * step else np.sqrt(max(toggling - step**2 / 12, 0.25 * step**2)))


class Lasting(NamedTuple):
    """Coloured noise of a signal.

    Attributes:
        sd: its standard deviation.
        remains: share of it that remains at the next sample.
    """

    sd: float
    remains: float


NOTHING_LASTS = Lasting(0.0, 0.0)


def smoothed(y: Array, step: float = 0.0, sd: float | None = None, lasting: Lasting = NOTHING_LASTS) -> Array:
    """(N,) evenly sampled, without its noise and that of a converter of this `step`; what turns or steps at once does so.

    Fixed-interval smoother of a level whose slope wanders as a random walk, a cubic spline where samples are many (Durbin
    and Koopman 2012, doi:10.1093/acprof:oso/9780199641178.001.0001, chapters 3 and 4): either evenly, or with steps of the
    walk from heavy tails, Cauchy's for the slope, and of the level as well, by expectation and maximisation (Lange, Little
    and Taylor 1989, doi:10.1080/01621459.1989.10478852). Which, and how fast, is told by how well every other sample, or
    stretch of as many as coloured noise lasts, foretells those between; if evenly, how fast by generalised
    cross-validation (Craven and Wahba 1978, doi:10.1007/BF01404567), or beside coloured noise by the likelihood. A signal
    whose samples foretell the next no better than those tell themselves, with errors of sqrt(2) deviations of the noise, is
    left as it is.

    Args:
        y: (N,) evenly sampled.
        step: least significant bit of its converter, 0 if it looks continuous.
        sd: standard deviation of all its white noise, if known.
        lasting: its coloured noise.

    >>> time, noise = np.arange(4000) / 1000, np.random.default_rng(0).standard_normal(4000)
    >>> steep = np.where(time < 2, 0.0, 100.0) + 50 * np.abs(np.sin(time))
    >>> bool(np.std(smoothed(steep + noise, sd=1.0) - steep) < 0.2)
    True
    """
    if sd is None:
        sd = float(np.hypot(noise_sd(y, step), step / np.sqrt(12)))
    all_sd = float(np.hypot(sd, lasting.sd))
    if all_sd <= 0 or len(y) < SHORTEST:
        return y.copy()
    z = y / all_sd
    # White noise is never quite nothing beside coloured noise.
    noise = (max((sd / all_sd) ** 2, LEAST), (lasting.sd / all_sd) ** 2, lasting.remains)
    apart = round(1 / (1 - lasting.remains))
    # Of a settled smoother: the walk's variance in a sample over the noise's is that number of samples to the power -4 which
    # it averages.
    walks = (2.0 ** (-4 * np.arange(FASTEST, np.log2(len(z) / 4)))).tolist()
    look = LOOK * apart
    begins = np.linspace(0, len(z) - look, LOOKS).astype(int) if len(z) > LOOKS * look else [0]
    looks = [z[begin : begin + look] if len(begins) > 1 else z for begin in begins]

    def missed(walk: float, rounds: int) -> float:
        return float(sum(_loss(_foretold(look, walk, rounds, apart, noise)) for look in looks))

    first = int(np.argmin([missed(walk, 1) for walk in walks]))
    # Between steps of its own a slope wanders no faster than without them.
    unevenly = walks[first + _first_least(missed(walk, ROUNDS) for walk in walks[first:])]
    evenly = walks[first]
    even, uneven = _foretold(z, evenly, 1, apart, noise), _foretold(z, unevenly, ROUNDS, apart, noise)
    if _loss(uneven) < _loss(even) and np.median(uneven) < FORETOLD:
        return np.asarray(all_sd * _trend(z, unevenly, ROUNDS, 0, *noise)[0])
    # Of what is linear in the samples, all of them tell.
    told = [_trend(z, walk, 1, 0, *noise) for walk in walks]
    level, _, error, _ = min(told, key=lambda one: one[3] if lasting.sd else one[2])
    return y.copy() if error > 2 and not lasting.sd else np.asarray(all_sd * level)


def _first_least(values: Iterable[float]) -> int:
    """The position of the first of some numbers that the next one does not fall below; those after it are not asked for.

    >>> _first_least(iter([3.0, 2.0, 2.5, 1.0]))
    1
    """
    k, least = -1, float("inf")
    for value in values:
        if value >= least:
            break
        k, least = k + 1, value
    return max(k, 0)


def _foretold(z: Array, walk: float, rounds: int, apart: int, noise: tuple[float, float, float]) -> Array:
    """Squared errors of samples with unit noise, of those in every second stretch as the others foretell them."""
    unknown = np.arange(len(z)) // apart % 2 == 1
    return np.asarray(_trend(z, walk, rounds, apart, *noise)[1][unknown] ** 2)


def _loss(squares: Array) -> float:
    # Where a signal steps, a sample may be of either level.
    return float(np.sum(np.log1p(squares / FAR**2)))


@njit(cache=True, nogil=True, error_model="numpy")
def _trend(z, walk, rounds, apart, own, lasting, remains):  # type: ignore[no-untyped-def]
    """Level of a noisy signal whose slope wanders, all at once or, in more than one round, with steps.

    A round is a filter forwards, and backwards the smoothed steps of slope and level with their variances; the next one
    takes what is expected of their squares for the variances that they had.

    Args:
        z: (N,) samples.
        walk: variance of the slope's steps.
        rounds: how many; in one, every step has the same variance, and the level none.
        apart: only every second stretch of so many samples is known; 0 is all.
        own, lasting, remains: variances of white and coloured noise, and what remains of that at the next sample.

    Returns:
        (N,) the level, (N,) what level and coloured noise leave, the squared error with which samples foretell others
        (generalised cross-validation; white noise, all known), and twice the negative logarithmic likelihood.
    """
    samples = len(z)
    known = np.ones(samples, np.bool_) if apart == 0 else np.arange(samples) // apart % 2 == 0
    of_slope, of_level = np.full(samples, walk), np.full(samples, STEPS if rounds > 1 else 0.0)
    before, error = np.empty((samples, 6)), np.empty(samples)
    out, rest, unlikely = np.empty(samples), np.empty(samples), 0.0
    for still in range(rounds - 1, -1, -1):
        # Level, slope and coloured noise, and their covariance, given the samples before.
        level, slope, drift = z[0], 0.0, 0.0
        a, b, c, d, e, f = ANY, 0.0, ANY, 0.0, 0.0, lasting
        for k in range(samples):
            at = before[k]
            at[0], at[1], at[2], at[3], at[4], at[5] = a, b, c, d, e, f
            out[k], rest[k], error[k] = level, drift, z[k] - level - drift
            if known[k]:
                p, q, w = a + d, b + e, d + f
                scale = p + w + own
                counts = 1.0 / scale
                gain, turn = counts * p, counts * q
                level, slope = level + gain * error[k], slope + turn * error[k]
                # Without differences of large numbers: where a level steps, its variance is large.
                if lasting > 0:
                    drift += counts * w * error[k]
                    a, b, c, d, e, f = (
                        counts * (a * (own + f) - d * d), counts * (b * (own + d + f) - p * e), c - turn * q,
                        counts * (d * (own + d) - a * f), counts * (e * (own + p) - b * w), counts * (f * (own + a) - d * d),
                    )  # fmt: skip
                else:
                    a, b, c = counts * a * own, counts * b * own, c - turn * q
                if not still:
                    unlikely += np.log(scale) + counts * error[k] ** 2
            level += slope
            a, b, c = a + 2 * b + c + of_level[k], b + c, c + of_slope[k]
            if lasting > 0:
                drift *= remains
                d, e, f = remains * (d + e), remains * e, remains**2 * f + (1 - remains**2) * lasting
        # Their scores, and the variances of these, given the samples after.
        r, s, m = 0.0, 0.0, 0.0
        rr, rs, ss, rm, sm, mm = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        squares, others = 0.0, 0.0
        for k in range(samples - 1, -1, -1):
            if still:
                of_level[k] = 0.5 * ((of_level[k] * r) ** 2 + of_level[k] - of_level[k] ** 2 * rr)
                of_slope[k] = 0.5 * (walk + (of_slope[k] * s) ** 2 + of_slope[k] - of_slope[k] ** 2 * ss)
            a, b, c, d, e, f = before[k]
            # From after to before the step ahead.
            s += r
            ss, rs = rr + 2 * rs + ss, rr + rs
            if lasting > 0:
                m *= remains
                sm, rm, mm = remains * (rm + sm), remains * rm, remains**2 * mm
            if known[k]:
                p, q, w = a + d, b + e, d + f
                counts = 1.0 / (p + w + own)
                # What the level after this sample keeps of that before it.
                gain, turn, keep = counts * p, counts * q, counts * (w + own)
                if lasting > 0:
                    more, stay = counts * w, counts * (p + own)
                    x, y, n = (
                        keep * rr - turn * rs - more * rm,
                        keep * rs - turn * ss - more * sm,
                        keep * rm - turn * sm - more * mm,
                    )
                    first = -gain * rr - turn * rs + stay * rm
                    other = -gain * rs - turn * ss + stay * sm
                    last = -gain * rm - turn * sm + stay * mm
                    others += counts + gain * (gain * rr + 2 * turn * rs + 2 * more * rm)
                    others += turn * (turn * ss + 2 * more * sm) + more * more * mm
                    r, m = (
                        counts * error[k] + keep * r - turn * s - more * m,
                        counts * error[k] - gain * r - turn * s + stay * m,
                    )
                    rr, rs, rm = (
                        counts + keep * x - turn * y - more * n,
                        y,
                        counts - gain * x - turn * y + stay * n,
                    )
                    sm, mm = other, counts - gain * first - turn * other + stay * last
                else:
                    x, y = keep * rr - turn * rs, keep * rs - turn * ss
                    others += counts + gain * (gain * rr + 2 * turn * rs) + turn * turn * ss
                    r = counts * error[k] + keep * r - turn * s
                    rr, rs = counts + keep * x - turn * y, y
            out[k] += a * r + b * s + d * m
            rest[k] = z[k] - out[k] - rest[k] - d * r - e * s - f * m
            squares += rest[k] ** 2
    return out, rest, samples * squares / others**2, unlikely


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
