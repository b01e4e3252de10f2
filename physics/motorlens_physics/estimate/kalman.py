"""The Kalman filter of `innovations`, forwards and backwards, in machine code.

States are the motor's n, then one value for every disturbance: s in all. Arguments are those of `innovations.StateSpace`.
`own` and `every` are tuples of these lengths, and s is a length of rows, see `rows`.
"""

import math

import numpy as np
from numba import njit

from motorlens_physics.estimate.rows import add_to_row, set_row, set_row_by_column

# Sums in any order; what is infinite stays so.
FAST = {"contract", "reassoc", "nsz", "arcp"}
# Information of a reading, as a share of that of its truth, below which it tells nothing; deviations from which on a tail is
# taken as its asymptote.
TELLS_NOTHING, TAIL = 1e-12, 25.0
# The density of a standard normal deviate at 0, and the share of the deviate of which the error function is asked.
DENSITY, ROOT_HALF = 1 / math.sqrt(2 * math.pi), math.sqrt(0.5)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _transition(own, every, matrices, balances, holds, keeps, k, F, late):  # type: ignore[no-untyped-def]
    """What the states become at sample k + 1: of all as they are at k (n, s), of what is new in disturbances by then (D, s).

    What is new is part of the disturbance, and of the states where it runs linearly.
    """
    n = len(own)
    for r in range(n):
        for q in range(n):
            F[r, q] = matrices[k, r, q]
    for d in range(len(every) - n):
        j = balances[d]
        late[d, n + d] = 1.0
        for r in range(n):
            first, last = 0.0, 0.0
            if j >= 0:
                first, last = matrices[k, r, n + j], matrices[k, r, n + 3 + j]
            if holds[d]:
                F[r, n + d], late[d, r] = first + last, 0.0
            else:
                F[r, n + d], late[d, r] = first + last * keeps[k, d], last


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def _ahead(own, every, matrices, jumps, keeps, variance, k, F, late, fresh, A, P):  # type: ignore[no-untyped-def]
    """The covariance P of states and disturbances, from sample k - 1 to k."""
    n, s = len(own), len(every)
    for d in range(s - n):
        fresh[d] = variance[d] * (1.0 - keeps[k - 1, d] * keeps[k - 1, d])
    for r in range(n):
        set_row(every, every, A, r, F, r, P)
    for r in range(n):
        for c in range(r, n):
            total = 0.0
            for m in range(s):
                total += A[r, m] * F[c, m]
            for d in range(s - n):
                total += late[d, r] * late[d, c] * fresh[d]
            for j in range(jumps.shape[1]):
                jump = jumps[k - 1, j]
                if jump > 0:
                    first = matrices[k - 1, r, n + j] * matrices[k - 1, c, n + j]
                    last = matrices[k - 1, r, n + 3 + j] * matrices[k - 1, c, n + 3 + j]
                    total += jump * jump * (first + last)
            P[r, c] = total
            P[c, r] = total
    for d in range(s - n):
        keep = keeps[k - 1, d]
        for e in range(d):
            P[n + d, n + e] *= keep * keeps[k - 1, e]
            P[n + e, n + d] = P[n + d, n + e]
        P[n + d, n + d] = keep * keep * P[n + d, n + d] + fresh[d]
        # What is new at sample k is part of the states as well, where a disturbance runs linearly.
        for r in range(n):
            P[r, n + d] = keep * A[r, n + d] + late[d, r] * fresh[d]
            P[n + d, r] = P[r, n + d]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def spread(own, every, matrices, jumps, shows, drifts, balances, holds, keeps, variance, P, power):  # type: ignore[no-untyped-def]
    """Add to `power` (C,) the mean variance of what the channels show, from the covariance P (s, s) at the first sample."""
    n, s = len(own), len(every)
    F, A, late, fresh = np.zeros((n, s)), np.zeros((n, s)), np.zeros((s - n, s)), np.zeros(s - n)
    samples = len(keeps) + 1
    for k in range(samples):
        if k:
            _transition(own, every, matrices, balances, holds, keeps, k - 1, F, late)
            _ahead(own, every, matrices, jumps, keeps, variance, k, F, late, fresh, A, P)
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
def forward(  # type: ignore[no-untyped-def]
    own, every, matrices, jumps, shows, drifts, balances, holds, keeps, variance, noise, P, y, white, scale, gain, steps,
    deviance, unlikely,
):  # fmt: skip
    """Filter one column y (N, C), channel by channel.

    P (s, s) is the covariance at the first sample. Written are `white` (N, C), `scale` and `gain` (N, C, s), see
    `innovations.Filtered`; with converters' `steps` (C,) also what is read, in y and in `noise`. `deviance` and `unlikely`
    are those of `innovations.Read`, or empty.
    """
    n, s = len(own), len(every)
    count = s - n
    F, A, late, fresh = np.zeros((n, s)), np.zeros((n, s)), np.zeros((s - n, s)), np.zeros(s - n)
    # Of one row each: the state, and its covariance with what a channel shows.
    z, K, ahead = np.zeros((1, s)), np.zeros((1, s)), np.zeros(n)
    for k in range(y.shape[0]):
        if k:
            _transition(own, every, matrices, balances, holds, keeps, k - 1, F, late)
            _ahead(own, every, matrices, jumps, keeps, variance, k, F, late, fresh, A, P)
            for r in range(n):
                ahead[r] = 0.0
                for m in range(s):
                    ahead[r] += F[r, m] * z[0, m]
            for r in range(n):
                z[0, r] = ahead[r]
            for d in range(count):
                z[0, n + d] *= keeps[k - 1, d]
        for c in range(y.shape[1]):
            h = shows[c]
            if not noise[k, c] < np.inf:
                scale[k, c], white[k, c] = np.inf, 0.0
                continue
            for r in range(s):
                K[0, r] = P[h, r]
            error = y[k, c] - z[0, h]
            for d in drifts[c]:
                if d >= 0:
                    for r in range(s):
                        K[0, r] += P[n + d, r]
                    error -= z[0, n + d]
            known = K[0, h]
            for d in drifts[c]:
                if d >= 0:
                    known += K[0, n + d]
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
            root, one = np.sqrt(power), 1.0 / power
            scale[k, c], white[k, c] = root, error / root
            for r in range(s):
                gain[k, c, r] = one * K[0, r]
            add_to_row(every, z, 0, error * one, K, 0)
            for r in range(s):
                add_to_row(every, P, r, -one * K[0, r], K, 0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def forward_again(  # type: ignore[no-untyped-def]
    own, every, matrices, shows, drifts, balances, holds, keeps, scale, gain, begin, z, y, white
):
    """As `forward` of columns y (rows, C, m) from sample `begin` on, with its scales and gains as it has found them.

    z (s, m) are the states, before and after; written is `white` (rows, C, m).
    """
    n, s = len(own), len(every)
    count, channels, width = s - n, y.shape[1], y.shape[2]
    F, late, ahead = np.zeros((n, s)), np.zeros((s - n, s)), np.zeros((n, width))
    for row in range(y.shape[0]):
        k = begin + row
        if k:
            _transition(own, every, matrices, balances, holds, keeps, k - 1, F, late)
            for r in range(n):
                for m in range(width):
                    ahead[r, m] = F[r, 0] * z[0, m]
                for q in range(1, s):
                    for m in range(width):
                        ahead[r, m] += F[r, q] * z[q, m]
            for r in range(n):
                for m in range(width):
                    z[r, m] = ahead[r, m]
            for d in range(count):
                for m in range(width):
                    z[n + d, m] *= keeps[k - 1, d]
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
    own,
    every,
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
    """From the end of one filtered column (N, C) to its begin: write what `innovations.disturbances` returns."""
    n, s = len(own), len(every)
    count, samples, channels = s - n, white.shape[0], white.shape[1]
    F, late, share = np.zeros((n, s)), np.zeros((s - n, s)), np.zeros(count)
    # The score of the state, its covariance, and that times a gain: of one row u, past and W.
    u, past, W = np.zeros((1, s)), np.zeros((1, s)), np.zeros((1, s))
    L, T = np.zeros((s, s)), np.zeros((s, s))
    at = np.zeros(1 + drifts.shape[1], np.int64)
    for back in range(samples):
        k = samples - 1 - back
        for step in range(channels):
            c = channels - 1 - step
            if not scale[k, c] < np.inf:
                continue
            h, power = shows[c], scale[k, c] ** 2
            # u <- H' v / power + (I - K H)' u, and the same of its covariance L.
            along, across = 0.0, 0.0
            set_row(every, every, W, 0, gain[k], c, L)
            for r in range(s):
                along += gain[k, c, r] * u[0, r]
                across += gain[k, c, r] * W[0, r]
            error = white[k, c] / scale[k, c] - along
            of_channels[0, k, c] = error**2
            of_channels[1, k, c] = 1.0 / power + across
            at[0], shown = h, 1
            for d in drifts[c]:
                if d >= 0:
                    at[shown] = n + d
                    shown += 1
            for a in range(shown):
                u[0, at[a]] += error
                add_to_row(every, L, at[a], -1.0, W, 0)
                for r in range(s):
                    L[r, at[a]] -= W[0, r]
                for b in range(shown):
                    L[at[a], at[b]] += 1.0 / power + across
        if k:
            _transition(own, every, matrices, balances, holds, keeps, k - 1, F, late)
        for d in range(count):
            # What is new in a disturbance at this sample; at the first, all of it.
            share[d] = 1.0
            if k:
                share[d] -= keeps[k - 1, d] ** 2
            score, spread = u[0, n + d], L[n + d, n + d]
            if k and not holds[d]:
                for r in range(n):
                    score += late[d, r] * u[0, r]
                    spread += 2.0 * late[d, r] * L[r, n + d]
                    for q in range(n):
                        spread += late[d, r] * L[r, q] * late[d, q]
            seen[k, d] = variance[d] * share[d] * score
            of_inputs[0, d] += share[d] * score**2
            of_inputs[1, d] += share[d] * spread
        if k:
            set_row(every, own, past, 0, u, 0, F)
            for d in range(count):
                past[0, n + d] += keeps[k - 1, d] * u[0, n + d]
            for r in range(s):
                u[0, r] = past[0, r]
            # L <- of what states and disturbances become: before it, and then behind.
            for r in range(s):
                set_row(every, own, T, r, L, r, F)
                for d in range(count):
                    T[r, n + d] += keeps[k - 1, d] * L[r, n + d]
            for r in range(s):
                set_row_by_column(every, own, L, r, F, r, T)
                if r >= n:
                    add_to_row(every, L, r, keeps[k - 1, r - n], T, r)
    for k in range(1, samples):
        for d in range(count):
            seen[k, d] += keeps[k - 1, d] * seen[k - 1, d]
