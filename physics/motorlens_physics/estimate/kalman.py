"""The Kalman filter of `innovations`, forwards and backwards, in machine code.

States are the motor's n, then one value for every disturbance. Arguments are those of `innovations.StateSpace`. `each` is as
long as the motor has states, and `balances` as there are disturbances: of tuples the compiler knows the length, and unrolls.
One step ahead is written out for a covariance, a column and many columns, for loops of a length that is not known are slow.
"""

import math

import numpy as np
from numba import njit

# Sums in any order; what is infinite stays so.
FAST = {"contract", "reassoc", "nsz", "arcp"}
# Information of a reading, as a share of that of its truth, below which it tells nothing; deviations from which on a tail is
# taken as its asymptote.
TELLS_NOTHING, TAIL = 1e-12, 25.0
# The density of a standard normal deviate at 0, and the share of the deviate of which the error function is asked.
DENSITY, ROOT_HALF = 1 / math.sqrt(2 * math.pi), math.sqrt(0.5)


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
def _ahead(each, matrices, balances, keeps, variance, k, G, late, A, P):  # type: ignore[no-untyped-def]
    """The covariance P of states and disturbances, from sample k - 1 to k."""
    n, count = len(each), len(balances)
    # What the states become of states and disturbances, times their covariance.
    for r in range(n):
        for m in range(n + count):
            total = 0.0
            for q in range(n):
                total += matrices[k - 1, r, q] * P[q, m]
            for d in range(count):
                total += G[r, d] * P[n + d, m]
            A[r, m] = total
    for r in range(n):
        for c in range(r, n):
            total = 0.0
            for q in range(n):
                total += A[r, q] * matrices[k - 1, c, q]
            for d in range(count):
                total += A[r, n + d] * G[c, d]
            P[r, c] = total
            P[c, r] = total
    for d in range(count):
        keep = keeps[k - 1, d]
        fresh = variance[d] * (1.0 - keep * keep)
        for e in range(d):
            P[n + d, n + e] *= keep * keeps[k - 1, e]
            P[n + e, n + d] = P[n + d, n + e]
        P[n + d, n + d] = keep * keep * P[n + d, n + d] + fresh
        # What is new at sample k is part of the states as well, where a disturbance runs linearly.
        for r in range(n):
            P[r, n + d] = keep * A[r, n + d] + late[r, d] * fresh
            P[n + d, r] = P[r, n + d]
            for c in range(n):
                P[r, c] += late[r, d] * late[c, d] * fresh


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def spread(each, matrices, shows, drifts, balances, holds, keeps, variance, P, power):  # type: ignore[no-untyped-def]
    """Add to `power` (C,) the mean variance of what the channels show, from the covariance P at the first sample."""
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
        of the reading, but for a constant, and by how much that is less than it can be.
    """
    root = np.sqrt(power)
    a, b = (abs(error) - 0.5 * step) / root, (abs(error) + 0.5 * step) / root
    most = np.log(math.erf(0.5 * ROOT_HALF * step / root))
    if a > TAIL:
        mean, share = a + 1.0 / a, 1.0 - 1.0 / (a * a)
        chance = -0.5 * a * a - np.log(a / DENSITY)
    else:
        within = 0.5 * (math.erfc(a * ROOT_HALF) - math.erfc(b * ROOT_HALF))
        below, above = DENSITY * np.exp(-0.5 * a * a), DENSITY * np.exp(-0.5 * b * b)
        mean = (below - above) / within
        share = mean * mean + (b * above - a * below) / within
        chance = np.log(within)
    return np.copysign(mean * root, error), min(share, 1.0), chance - np.log(DENSITY * step), most - chance


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _columns_ahead(each, matrices, balances, keeps, k, G, z, ahead):  # type: ignore[no-untyped-def]
    """The columns z of states and disturbances, from sample k - 1 to k."""
    n, width = len(each), z.shape[1]
    for r in range(n):
        for m in range(width):
            total = 0.0
            for q in range(n):
                total += matrices[k - 1, r, q] * z[q, m]
            for d in range(len(balances)):
                total += G[r, d] * z[n + d, m]
            ahead[r, m] = total
    for r in range(n):
        for m in range(width):
            z[r, m] = ahead[r, m]
    for d in range(len(balances)):
        for m in range(width):
            z[n + d, m] *= keeps[k - 1, d]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def forward(  # type: ignore[no-untyped-def]
    each, matrices, shows, drifts, balances, holds, keeps, variance, noise, P, y, white, scale, gain, steps, deviance,
    unlikely,
):  # fmt: skip
    """Filter one column y (N, C), channel by channel.

    P is the covariance of the states at the first sample. Written are `white` (N, C), `scale` and `gain`, see
    `innovations.Filtered`; with converters' `steps` (C,) also what is read, in y and in `noise`. `deviance` and `unlikely`
    are those of `innovations.Read`, or empty.
    """
    n, count = len(each), len(balances)
    s, channels = n + count, y.shape[1]
    A, G, late = np.zeros((n, s)), np.zeros((n, count)), np.zeros((n, count))
    z, ahead, K = np.zeros(s), np.zeros(n), np.zeros(s)
    for k in range(y.shape[0]):
        if k:
            _entering(matrices, balances, holds, keeps, k - 1, G, late)
            _ahead(each, matrices, balances, keeps, variance, k, G, late, A, P)
            for r in range(n):
                total = 0.0
                for q in range(n):
                    total += matrices[k - 1, r, q] * z[q]
                for d in range(count):
                    total += G[r, d] * z[n + d]
                ahead[r] = total
            for r in range(n):
                z[r] = ahead[r]
            for d in range(count):
                z[n + d] *= keeps[k - 1, d]
        for c in range(channels):
            h = shows[c]
            if not noise[k, c] < np.inf:
                scale[k, c], white[k, c] = np.inf, 0.0
                continue
            for r in range(s):
                K[r] = P[h, r]
            error = y[k, c] - z[h]
            for d in drifts[c]:
                if d >= 0:
                    for r in range(s):
                        K[r] += P[n + d, r]
                    error -= z[n + d]
            known = K[h]
            for d in drifts[c]:
                if d >= 0:
                    known += K[n + d]
            power = known + noise[k, c]
            if steps[c] > 0:
                power -= steps[c] ** 2 / 12
                best, share, chance, less = _interval(error, power, steps[c])
                deviance[k, c] = 2.0 * less
                unlikely[k, c] = -2.0 * chance
                if share < TELLS_NOTHING:
                    noise[k, c], scale[k, c], white[k, c] = np.inf, np.inf, 0.0
                    continue
                y[k, c] += best / share - error
                error = best / share
                power /= share
                noise[k, c] = power - known
            elif len(deviance):
                deviance[k, c] = error**2 / power
                unlikely[k, c] = deviance[k, c] + np.log(power)
            root = np.sqrt(power)
            one = 1.0 / root
            scale[k, c], white[k, c] = root, error * one
            for r in range(s):
                K[r] *= one
                gain[k, c, r] = K[r] * one
                z[r] += K[r] * white[k, c]
                for q in range(r + 1):
                    P[r, q] -= K[r] * K[q]
                    P[q, r] = P[r, q]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def forward_again(  # type: ignore[no-untyped-def]
    each, matrices, shows, drifts, balances, holds, keeps, scale, gain, begin, z, y, white
):
    """As `forward`, with its scales and gains as it has found them."""
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
def backward(  # type: ignore[no-untyped-def]
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
    """From the end of one filtered column to its begin: write what `innovations.disturbances` returns."""
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
