"""Innovations of a linearised motor: what is new in every sample, given all samples before it.

The errors of a simulated motor are not white. Noise on a measured input drives the simulation but did not drive the motor,
and a torque that nobody measured drove the motor but not the simulation: both reach every channel through the motor. Along
a trajectory the motor is a linear system x' = Phi x + Gamma f, so the errors are the output of a state-space model whose
disturbances f and sensor noises are white, and its Kalman filter turns them into innovations that are white (Kailath 1968,
doi:10.1109/TAC.1968.1099025). The same filter, applied to sensitivities, makes least squares efficient. The filter run
backwards gives the disturbances themselves (de Jong 1988, doi:10.1093/biomet/75.3.594), and with them the exact score of
every variance (Koopman and Shephard 1992, doi:10.1093/biomet/79.4.823).

What a converter shows is no number but an interval: the truth lies within half a step of the reading. `read` puts in its
place what says as much, near the errors as they are: a reading and a noise of it that have the same score and the same
information, and so leave the state where the mean and the variance of the truth within the interval are (Curry 1970,
Estimation and Control with Quantized Measurements, MIT Press). A signal that stays between two levels then tells no more
than that, however long it stays.

The state of the filter is the motor's n states, one value for every input (the error of its latest sample) and one for
every slow disturbance. Measured channels are taken in one by one, so that no matrix is inverted and a missing sample
is left out.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.estimate.run import STATE_OF

Array = NDArray[np.float64]

# Disturbances of which the compiler is told the number: unrolled, loops over few are faster. With more, a machine compiles
# once for all.
FEW = 5
# Sums in any order; what is infinite stays so.
FAST = {"contract", "reassoc", "nsz", "arcp"}
# Information of a reading, as a share of that of its truth, below which it tells nothing; deviations from which on a tail is
# taken as its asymptote.
TELLS_NOTHING, TAIL = 1e-12, 25.0
# What a filter that reads nothing writes.
NOTHING = np.zeros((0, 0))


@dataclass(frozen=True)
class StateSpace:
    """A motor along a trajectory, with what disturbs it.

    Attributes:
        matrices: (N - 1, n, n + 6) Phi and the Gammas of `sensitivity.Linearisation`.
        shows: (C,) the state that each channel shows.
        balances: (D,) the balance (0 voltage, 1 torque, 2 heat) that each disturbance enters; -1 is none.
        drifts: (C, T) disturbances that each channel shows besides its state, as they are; -1 is none.
        steps: (C,) least significant bit of each channel's converter; 0 is none, or that it was `read`.
        holds: (D,) whether a disturbance holds from its sample to the next, or runs linearly.
        keeps: (N - 1, D) share of a disturbance that remains at the next sample; 0 is white.
        variance: (D,) of a disturbance, stationary.
        noise: (N, C) variance of the sensors' white noise, their converters' included; infinite where nothing was measured.
        start: (n,) variance of the motor's states at the first sample beside what is fitted.
    """

    matrices: Array
    shows: NDArray[np.int64]
    balances: NDArray[np.int64]
    drifts: NDArray[np.int64]
    steps: Array
    holds: NDArray[np.bool_]
    keeps: Array
    variance: Array
    noise: Array
    start: Array


@dataclass(frozen=True)
class Filtered:
    """What the Kalman filter leaves.

    Attributes:
        white: (N, C, m) innovations of m columns, in units of their standard deviation; 0 where nothing was measured.
        scale: (N, C) that standard deviation, infinite where nothing was measured.
        gain: (N, C, n + D) of each channel in its turn.
    """

    white: Array
    scale: Array
    gain: Array


@dataclass(frozen=True)
class Read:
    """Errors as converters let them be told.

    Attributes:
        space: with the noise that readings have near these errors, and no converter.
        error: (N, C) with readings that say as much as the intervals do.
        filtered: their innovations, one column.
        deviance: (N, C) twice the logarithm by which each sample would be likelier if it showed just what is expected.
        unlikely: (N, C) twice the negative logarithmic likelihood of each sample, but for a constant; 0 where nothing was
            measured.
    """

    space: StateSpace
    error: Array
    filtered: Filtered
    deviance: Array
    unlikely: Array


@dataclass(frozen=True)
class Sums:
    """Sums over white columns z (rows, k) and white errors e (rows,).

    Attributes:
        gram: (k, k) of z'z.
        scores: (B, k) of z'e, over each block of time.
        squares: of e'e.
    """

    gram: Array
    scores: Array
    squares: float


def innovations(space: StateSpace, columns: Array) -> Filtered:
    """Filter columns (N, C, m), such as errors of all channels."""
    return _filtered(space, columns, np.zeros(columns.shape[1]))


def in_blocks(space: StateSpace, known: Filtered, columns: Array, blocks: Iterable[slice]) -> Iterator[Array]:
    """The innovations of columns (N, C, m), (len, C, m) of each block of samples, one after another from the first on.

    Of a filter that has been through these samples, scales and gains are `known`: they are the same for all columns.
    """
    balances, each = _balances(space), _each(space)
    states = np.zeros((known.gain.shape[2], columns.shape[2]))
    for rows in blocks:
        white = np.empty((rows.stop - rows.start, *columns.shape[1:]))
        _filter_on(
            each, space.matrices, space.shows, space.drifts, balances, space.holds, space.keeps, known.scale, known.gain,
            rows.start, states, np.ascontiguousarray(columns[rows]), white,
        )  # fmt: skip
        yield white


def read(space: StateSpace, error: Array) -> Read:
    """What readings (N, C) less what is expected of them tell, sample by sample."""
    error, noise = np.array(error, order="C"), space.noise.copy()
    deviance, unlikely = np.zeros(error.shape), np.zeros(error.shape)
    filtered = _filtered(replace(space, noise=noise), error[:, :, None], space.steps, deviance, unlikely)
    told = replace(space, noise=noise, steps=np.zeros(len(space.steps)))
    return Read(told, error, filtered, deviance, unlikely)


def sums(space: StateSpace, known: Filtered, columns: Array, blocks: int) -> Sums:
    """What least squares needs of innovations of columns (N, C, k), beside those `known` of the errors; none is kept."""
    samples, _, count = columns.shape
    edges = np.unique(np.linspace(0, samples, min(blocks, samples) + 1).astype(int))
    parts = [slice(first, last) for first, last in pairwise(edges.tolist())]
    gram, scores = np.zeros((count, count)), np.empty((len(parts), count))
    for block, white in enumerate(in_blocks(space, known, columns, parts)):
        flat = white.reshape(-1, count)
        gram += flat.T @ flat
        scores[block] = known.white[parts[block]].reshape(-1) @ flat
    return Sums(gram, scores, float(np.sum(known.white**2)))


def spread(space: StateSpace) -> Array:
    """(C,) mean variance that the disturbances bring about in what the channels show, beside the sensors' white noise."""
    power = np.zeros(len(space.shows))
    _spread(
        _each(space), space.matrices, space.shows, space.drifts, _balances(space), space.holds,
        space.keeps, space.variance, np.diag(np.concatenate([space.start, space.variance])), power,
    )  # fmt: skip
    return power


def _each(space: StateSpace) -> tuple[float, ...] | Array:
    """As long as there are states: a tuple, whose length the compiler knows, for the textbook's; else one code for all."""
    n = space.matrices.shape[1]
    return (0.0,) * n if n == len(STATE_OF) else np.zeros(n)


def _balances(space: StateSpace) -> tuple[int, ...] | NDArray[np.int64]:
    """The balances: a tuple, likewise, of as many disturbances as there mostly are; else one code for all."""
    return tuple(space.balances.tolist()) if len(space.balances) <= FEW else space.balances


def _filtered(
    space: StateSpace, columns: Array, steps: Array, deviance: Array = NOTHING, unlikely: Array = NOTHING
) -> Filtered:
    """Filter columns (N, C, m); with `steps`, one column is read and the others are written."""
    n, count, (samples, channels, width) = space.matrices.shape[1], len(space.balances), columns.shape
    white, scale = np.empty(columns.shape), np.empty((samples, channels))
    gain = np.zeros((samples, channels, n + count))
    covariance = np.diag(np.concatenate([space.start, space.variance]))
    _filter(
        _each(space), space.matrices, space.shows, space.drifts, _balances(space), space.holds, space.keeps,
        space.variance, space.noise, covariance, np.zeros((n + count, width)), np.ascontiguousarray(columns), white,
        scale, gain, steps, deviance, unlikely,
    )  # fmt: skip
    return Filtered(white, scale, gain)


def disturbances(space: StateSpace, filtered: Filtered) -> tuple[Array, Array, Array]:
    """Look back from the end: the disturbances, and the scores of all variances, from the first column.

    Returns:
        (N, D) expected disturbance at each sample given all samples.
        (2, D): sums over the samples of the squared score and of its expectation, per disturbance.
        (2, C): the same per channel. A variance times the root of the ratio of the two is the next step of its
        maximum-likelihood estimate, which never falls (Zhou, Hu, Zhou and Lange 2019, doi:10.1080/10618600.2018.1529601).
    """
    count, channels = len(space.balances), space.noise.shape[1]
    seen, of_inputs, of_channels = (
        np.zeros((len(space.noise), count)), np.zeros((2, count)), np.zeros((2, channels))
    )  # fmt: skip
    _smooth(
        _each(space), space.matrices, space.shows, space.drifts, _balances(space), space.holds,
        space.keeps, space.variance,
        np.ascontiguousarray(filtered.white[:, :, 0]), filtered.scale, filtered.gain, seen, of_inputs, of_channels,
    )  # fmt: skip
    return seen, of_inputs, of_channels


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _entering(matrices, balances, holds, keeps, k, G, late):  # type: ignore[no-untyped-def]
    """Where disturbances enter the states (n, D) from sample k to k + 1: as they were at k, and what is new at k + 1."""
    for d in range(len(balances)):
        j = balances[d]
        for r in range(len(G)):
            if j < 0:
                G[r, d], late[r, d] = 0.0, 0.0
                continue
            first, last = matrices[k, r, len(G) + j], matrices[k, r, len(G) + 3 + j]
            if holds[d]:
                G[r, d], late[r, d] = first + last, 0.0
            else:
                G[r, d], late[r, d] = first + last * keeps[k, d], last


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _states_ahead(each, matrices, balances, k, G, z, ahead):  # type: ignore[no-untyped-def]
    """What the states become (n, m) of columns z of states and disturbances, from sample k - 1 to k."""
    n = len(each)
    for r in range(n):
        for m in range(z.shape[1]):
            total = 0.0
            for q in range(n):
                total += matrices[k - 1, r, q] * z[q, m]
            for d in range(len(balances)):
                total += G[r, d] * z[n + d, m]
            ahead[r, m] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _ahead(each, matrices, balances, keeps, variance, k, G, late, A, P):  # type: ignore[no-untyped-def]
    """The covariance P of states and disturbances, from sample k - 1 to k."""
    n, count = len(each), len(balances)
    # What the states become of states and disturbances, times their covariance.
    _states_ahead(each, matrices, balances, k, G, P, A)
    for d in range(count):
        keep = keeps[k - 1, d]
        fresh = variance[d] * (1.0 - keep * keep)
        for e in range(d + 1):
            total = keep * keeps[k - 1, e] * P[n + e, n + d]
            if d == e:
                total += fresh
            P[n + d, n + e] = total
            P[n + e, n + d] = total
        for r in range(n):
            total = keep * A[r, n + d] + late[r, d] * fresh
            P[r, n + d] = total
            P[n + d, r] = total
    for r in range(n):
        for c in range(r, n):
            total = 0.0
            for q in range(n):
                total += A[r, q] * matrices[k - 1, c, q]
            for d in range(count):
                keep = keeps[k - 1, d]
                total += A[r, n + d] * G[c, d]
                total += late[r, d] * late[c, d] * variance[d] * (1.0 - keep * keep)
            P[r, c] = total
            P[c, r] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _spread(  # type: ignore[no-untyped-def]
    each, matrices, shows, drifts, balances, holds, keeps, variance, P, power
):
    n, count = len(each), len(balances)
    A, G, late = np.zeros((n, n + count)), np.zeros((n, count)), np.zeros((n, count))
    samples = len(keeps) + 1
    for k in range(samples):
        if k:
            _entering(matrices, balances, holds, keeps, k - 1, G, late)
            _ahead(each, matrices, balances, keeps, variance, k, G, late, A, P)
        for c in range(len(shows)):
            h = shows[c]
            power[c] += P[h, h] / samples
            for d in drifts[c]:
                if d >= 0:
                    power[c] += (2.0 * P[h, n + d] + P[n + d, n + d]) / samples


@njit(cache=True, nogil=True, error_model="numpy")
def _interval(error, power, step):  # type: ignore[no-untyped-def]
    """A reading so far from where it is expected, with a variance, that tells the truth within half a step of itself.

    Returns:
        How far from there the mean of the truth is, its share of information, the logarithm of the probability density
        of the reading, but for a constant, and the largest that this can be.
    """
    root = np.sqrt(power)
    a, b = (abs(error) - 0.5 * step) / root, (abs(error) + 0.5 * step) / root
    width = np.log(step / np.sqrt(2 * np.pi))
    most = np.log(math.erf(0.5 * step / (root * np.sqrt(2.0)))) - width
    if a > TAIL:
        mean, share = a + 1.0 / a, 1.0 - 1.0 / (a * a)
        chance = -0.5 * a * a - np.log(a * np.sqrt(2 * np.pi)) - width
    else:
        within = 0.5 * (math.erfc(a / np.sqrt(2.0)) - math.erfc(b / np.sqrt(2.0)))
        below = np.exp(-0.5 * a * a) / np.sqrt(2 * np.pi)
        above = np.exp(-0.5 * b * b) / np.sqrt(2 * np.pi)
        mean = (below - above) / within
        share = mean * mean + (b * above - a * below) / within
        chance = np.log(within) - width
    return np.copysign(mean * root, error), min(share, 1.0), chance, most


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _columns_ahead(each, matrices, balances, keeps, k, G, z, ahead):  # type: ignore[no-untyped-def]
    """The columns z of states and disturbances, from sample k - 1 to k."""
    n, width = len(each), z.shape[1]
    _states_ahead(each, matrices, balances, k, G, z, ahead)
    for r in range(n):
        for m in range(width):
            z[r, m] = ahead[r, m]
    for d in range(len(balances)):
        for m in range(width):
            z[n + d, m] *= keeps[k - 1, d]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _filter(  # type: ignore[no-untyped-def]
    each,
    matrices,
    shows,
    drifts,
    balances,
    holds,
    keeps,
    variance,
    noise,
    P,
    z,
    y,
    white,
    scale,
    gain,
    steps,
    deviance,
    unlikely,
):
    # The compiler unrolls loops over tuples.
    n, count = len(each), len(balances)
    s, channels, width = n + count, y.shape[1], y.shape[2]
    A, G, late = np.zeros((n, s)), np.zeros((n, count)), np.zeros((n, count))
    ahead, K = np.zeros((n, width)), np.zeros(s)
    for k in range(y.shape[0]):
        if k:
            _entering(matrices, balances, holds, keeps, k - 1, G, late)
            _ahead(each, matrices, balances, keeps, variance, k, G, late, A, P)
            _columns_ahead(each, matrices, balances, keeps, k, G, z, ahead)
        for c in range(channels):
            h = shows[c]
            if not noise[k, c] < np.inf:
                scale[k, c] = np.inf
                for m in range(width):
                    white[k, c, m] = 0.0
                continue
            for r in range(s):
                K[r] = P[r, h]
            for m in range(width):
                white[k, c, m] = y[k, c, m] - z[h, m]
            for d in drifts[c]:
                if d >= 0:
                    for r in range(s):
                        K[r] += P[r, n + d]
                    for m in range(width):
                        white[k, c, m] -= z[n + d, m]
            known = K[h]
            for d in drifts[c]:
                if d >= 0:
                    known += K[n + d]
            power = known + noise[k, c]
            if steps[c] > 0:
                power -= steps[c] ** 2 / 12
                best, share, chance, most = _interval(white[k, c, 0], power, steps[c])
                deviance[k, c] = 2.0 * (most - chance)
                unlikely[k, c] = -2.0 * chance
                if share < TELLS_NOTHING:
                    noise[k, c], scale[k, c], white[k, c, 0] = np.inf, np.inf, 0.0
                    continue
                y[k, c, 0] += best / share - white[k, c, 0]
                white[k, c, 0] = best / share
                power /= share
                noise[k, c] = power - known
            elif len(deviance):
                deviance[k, c] = white[k, c, 0] ** 2 / power
                unlikely[k, c] = deviance[k, c] + np.log(power)
            root = np.sqrt(power)
            scale[k, c] = root
            for r in range(s):
                K[r] /= root
                gain[k, c, r] = K[r] / root
            for m in range(width):
                white[k, c, m] /= root
            for r in range(s):
                for m in range(width):
                    z[r, m] += K[r] * white[k, c, m]
            for r in range(s):
                for q in range(s):
                    P[r, q] -= K[r] * K[q]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _filter_on(  # type: ignore[no-untyped-def]
    each, matrices, shows, drifts, balances, holds, keeps, scale, gain, begin, z, y, white
):
    """As `_filter`, with its scales and gains as it has found them."""
    n, count = len(each), len(balances)
    s, channels, width = n + count, y.shape[1], y.shape[2]
    G, late, ahead = np.zeros((n, count)), np.zeros((n, count)), np.zeros((n, width))
    for row in range(y.shape[0]):
        k = begin + row
        if k:
            _entering(matrices, balances, holds, keeps, k - 1, G, late)
            _columns_ahead(each, matrices, balances, keeps, k, G, z, ahead)
        for c in range(channels):
            h, root = shows[c], scale[k, c]
            if not root < np.inf:
                for m in range(width):
                    white[row, c, m] = 0.0
                continue
            for m in range(width):
                white[row, c, m] = y[row, c, m] - z[h, m]
            for d in drifts[c]:
                if d >= 0:
                    for m in range(width):
                        white[row, c, m] -= z[n + d, m]
            for m in range(width):
                white[row, c, m] /= root
            for r in range(s):
                # A gain is that of an innovation in the channel's unit.
                of_white = gain[k, c, r] * root
                for m in range(width):
                    z[r, m] += of_white * white[row, c, m]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _smooth(  # type: ignore[no-untyped-def]
    each,
    matrices,
    shows,
    drifts,
    balances,
    holds,
    keeps,
    variance,
    white,
    scale,
    gain,
    seen,
    of_inputs,
    of_channels,
):
    n, count = len(each), len(balances)
    s, samples, channels = n + count, white.shape[0], white.shape[1]
    G, late, fresh, share = np.zeros((n, count)), np.zeros((n, count)), np.zeros(count), np.zeros(count)
    u, past, W = np.zeros(s), np.zeros(s), np.zeros(s)
    L, T, at = np.zeros((s, s)), np.zeros((s, s)), np.zeros(1 + drifts.shape[1], np.int64)
    for back in range(samples):
        k = samples - 1 - back
        for step in range(channels):
            c = channels - 1 - step
            if not scale[k, c] < np.inf:
                continue
            h, power = shows[c], scale[k, c] ** 2
            # u <- H' v / power + (I - K H)' u, and the same of its covariance L.
            along, across = 0.0, 0.0
            for r in range(s):
                along += gain[k, c, r] * u[r]
                total = 0.0
                for q in range(s):
                    total += L[r, q] * gain[k, c, q]
                W[r] = total
                across += gain[k, c, r] * total
            error = white[k, c] / scale[k, c] - along
            of_channels[0, c] += error**2
            of_channels[1, c] += 1.0 / power + across
            at[0], shown = h, 1
            for d in drifts[c]:
                if d >= 0:
                    at[shown] = n + d
                    shown += 1
            for a in range(shown):
                u[at[a]] += error
                for r in range(s):
                    L[r, at[a]] -= W[r]
                    L[at[a], r] -= W[r]
                for b in range(shown):
                    L[at[a], at[b]] += 1.0 / power + across
        if k:
            _entering(matrices, balances, holds, keeps, k - 1, G, late)
        for d in range(count):
            # What is new in a disturbance at this sample; at the first, all of it.
            share[d] = 1.0
            if k:
                share[d] -= keeps[k - 1, d] ** 2
            fresh[d] = variance[d] * share[d]
            score, spread = u[n + d], L[n + d, n + d]
            if k and not holds[d]:
                for r in range(n):
                    score += late[r, d] * u[r]
                    spread += 2.0 * late[r, d] * L[r, n + d]
                    for q in range(n):
                        spread += late[r, d] * L[r, q] * late[q, d]
            seen[k, d] = fresh[d] * score
            of_inputs[0, d] += share[d] * score**2
            of_inputs[1, d] += share[d] * spread
        if k:
            for c in range(n):
                total = 0.0
                for q in range(n):
                    total += matrices[k - 1, q, c] * u[q]
                past[c] = total
            for d in range(count):
                total = keeps[k - 1, d] * u[n + d]
                for q in range(n):
                    total += G[q, d] * u[q]
                past[n + d] = total
            for r in range(s):
                u[r] = past[r]
                for c in range(n):
                    total = 0.0
                    for q in range(n):
                        total += L[r, q] * matrices[k - 1, q, c]
                    T[r, c] = total
                for d in range(count):
                    total = keeps[k - 1, d] * L[r, n + d]
                    for q in range(n):
                        total += L[r, q] * G[q, d]
                    T[r, n + d] = total
            for c in range(s):
                for r in range(n):
                    total = 0.0
                    for q in range(n):
                        total += matrices[k - 1, q, r] * T[q, c]
                    L[r, c] = total
                for d in range(count):
                    total = keeps[k - 1, d] * T[n + d, c]
                    for q in range(n):
                        total += G[q, d] * T[q, c]
                    L[n + d, c] = total
    for k in range(1, samples):
        for d in range(count):
            seen[k, d] += keeps[k - 1, d] * seen[k - 1, d]


def share_that_remains(time_s: Array, lasts_s: Array) -> Array:
    """(N - 1, D) `keeps` of disturbances that forget within `lasts_s` (D,) seconds; 0 s is white."""
    steps, keeps = np.diff(time_s), np.zeros((len(time_s) - 1, len(lasts_s)))
    for d in np.flatnonzero(lasts_s > 0):
        keeps[:, d] = np.exp(-steps / lasts_s[d])
    return keeps


__all__: list[Any] = [
    "Filtered",
    "Read",
    "StateSpace",
    "Sums",
    "disturbances",
    "in_blocks",
    "innovations",
    "read",
    "share_that_remains",
    "spread",
    "sums",
]
