"""Innovations of a linearised motor: what is new in every sample, given all samples before it.

The errors of a simulated motor are not white. Noise on a measured input drives the simulation but did not drive the motor,
and a torque that nobody measured drove the motor but not the simulation: both reach every channel through the motor. Along
a trajectory the motor is a linear system x' = Phi x + Gamma f, so the errors are the output of a state-space model whose
disturbances f and sensor noises are white, and its Kalman filter turns them into innovations that are white (Kailath 1968,
doi:10.1109/TAC.1968.1099025). The same filter, applied to sensitivities, makes least squares efficient. The filter run
backwards gives the disturbances themselves (de Jong 1988, doi:10.1093/biomet/75.3.594), and with them the exact score of
every variance (Koopman and Shephard 1992, doi:10.1093/biomet/79.4.823).

The state of the filter is the motor's n states, one value for every input (the error of its latest sample) and one for
every slow disturbance. Measured channels are taken in one by one, so that no matrix is inverted and a missing sample
is left out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class StateSpace:
    """A motor along a trajectory, with what disturbs it.

    Attributes:
        matrices: (N - 1, n, n + 6) Phi and the Gammas of `sensitivity.Linearisation`.
        shows: (C,) the state that each channel shows.
        balances: (D,) the balance (0 voltage, 1 torque, 2 heat) that each disturbance enters.
        holds: (D,) whether a disturbance holds from its sample to the next, or runs linearly.
        keeps: (N - 1, D) share of a disturbance that remains at the next sample; 0 is white.
        variance: (D,) of a disturbance, stationary.
        noise: (N, C) variance of the sensors' white noise; infinite where nothing was measured.
        start: (n,) variance of the motor's states at the first sample beside what is fitted.
    """

    matrices: Array
    shows: NDArray[np.int64]
    balances: NDArray[np.int64]
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


def innovations(space: StateSpace, columns: Array) -> Filtered:
    """Filter columns (N, C, m), such as errors and sensitivities of all channels."""
    samples, channels = space.noise.shape
    states = space.matrices.shape[1] + len(space.balances)
    white = np.empty((samples, channels, columns.shape[2]))
    scale, gain = np.empty((samples, channels)), np.zeros((samples, channels, states))
    _filter(
        space.matrices, space.shows, space.balances, space.holds, space.keeps, space.variance, space.noise, space.start,
        np.ascontiguousarray(columns), white, scale, gain,
    )  # fmt: skip
    return Filtered(white, scale, gain)


def disturbances(space: StateSpace, filtered: Filtered) -> tuple[Array, Array, Array]:
    """Look back from the end: the disturbances, and the scores of all variances, from the first column.

    Returns:
        (N, D) expected disturbance at each sample given all samples; of a slow one, what is new in it.
        (2, D): sums over the samples of the squared score and of its expectation, per disturbance.
        (2, C): the same per channel. A variance times the root of the ratio of the two is the next step of its
        maximum-likelihood estimate, which never falls (Zhou, Hu, Zhou and Lange 2019, doi:10.1080/10618600.2018.1529601).
    """
    count, channels = len(space.balances), space.noise.shape[1]
    seen, of_inputs, of_channels = (
        np.zeros((len(space.noise), count)), np.zeros((2, count)), np.zeros((2, channels))
    )  # fmt: skip
    _smooth(
        space.matrices, space.shows, space.balances, space.holds, space.keeps, space.variance,
        np.ascontiguousarray(filtered.white[:, :, 0]), filtered.scale, filtered.gain, seen, of_inputs, of_channels,
    )  # fmt: skip
    return seen, of_inputs, of_channels


@njit(cache=True, nogil=True)
def _transition(matrices, balances, holds, keeps, k, F, B):  # type: ignore[no-untyped-def]
    """F (s, s) from sample k to k + 1, and B (s, D): where the new part of each disturbance enters."""
    n, count = matrices.shape[1], len(balances)
    for r in range(n + count):
        for c in range(n + count):
            F[r, c] = 0.0
        for d in range(count):
            B[r, d] = 0.0
    for r in range(n):
        for c in range(n):
            F[r, c] = matrices[k, r, c]
    for d in range(count):
        j, keep = balances[d], keeps[k, d]
        for r in range(n):
            first, last = matrices[k, r, n + j], matrices[k, r, n + 3 + j]
            if holds[d]:
                F[r, n + d] = first + last
            else:
                F[r, n + d] = first + last * keep
                B[r, d] = last
        F[n + d, n + d] = keep
        B[n + d, d] = 1.0


@njit(cache=True, nogil=True)
def _filter(matrices, shows, balances, holds, keeps, variance, noise, start, y, white, scale, gain):  # type: ignore[no-untyped-def]
    samples, channels = noise.shape
    n, count, width = matrices.shape[1], len(balances), y.shape[2]
    s = n + count
    P, F, B, T = np.zeros((s, s)), np.zeros((s, s)), np.zeros((s, count)), np.zeros((s, s))
    z, ahead = np.zeros((s, width)), np.zeros((s, width))
    for r in range(n):
        P[r, r] = start[r]
    for d in range(count):
        P[n + d, n + d] = variance[d]
    for k in range(samples):
        if k:
            _transition(matrices, balances, holds, keeps, k - 1, F, B)
            # F is zero below the motor's states but for its diagonal.
            for r in range(n):
                for c in range(s):
                    total = 0.0
                    for q in range(s):
                        total += F[r, q] * P[q, c]
                    T[r, c] = total
            for r in range(n, s):
                for c in range(s):
                    T[r, c] = F[r, r] * P[r, c]
            for r in range(s):
                for c in range(r, s):
                    if c < n:
                        total = 0.0
                        for q in range(s):
                            total += T[r, q] * F[c, q]
                    else:
                        total = T[r, c] * F[c, c]
                    for d in range(count):
                        total += B[r, d] * B[c, d] * variance[d] * (1.0 - keeps[k - 1, d] ** 2)
                    P[r, c] = total
                    P[c, r] = total
            for r in range(s):
                for m in range(width):
                    ahead[r, m] = 0.0
                for q in range(s if r < n else r + 1):
                    f = F[r, q]
                    if f != 0.0:
                        for m in range(width):
                            ahead[r, m] += f * z[q, m]
            for r in range(s):
                for m in range(width):
                    z[r, m] = ahead[r, m]
        for c in range(channels):
            h = shows[c]
            if not noise[k, c] < np.inf:
                scale[k, c] = np.inf
                for m in range(width):
                    white[k, c, m] = 0.0
                continue
            power = P[h, h] + noise[k, c]
            root = np.sqrt(power)
            scale[k, c] = root
            for r in range(s):
                gain[k, c, r] = P[r, h] / power
            for m in range(width):
                white[k, c, m] = (y[k, c, m] - z[h, m]) / root
            for r in range(s):
                g = gain[k, c, r] * root
                if g != 0.0:
                    for m in range(width):
                        z[r, m] += g * white[k, c, m]
            for r in range(s):
                for q in range(r, s):
                    P[r, q] -= gain[k, c, r] * gain[k, c, q] * power
                    P[q, r] = P[r, q]


@njit(cache=True, nogil=True)
def _smooth(  # type: ignore[no-untyped-def]
    matrices, shows, balances, holds, keeps, variance, white, scale, gain, seen, of_inputs, of_channels
):
    samples, channels = white.shape
    n, count = matrices.shape[1], len(balances)
    s = n + count
    F, B = np.zeros((s, s)), np.zeros((s, count))
    u, past = np.zeros(s), np.zeros(s)
    L, T, W = np.zeros((s, s)), np.zeros((s, s)), np.zeros(s)
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
                W[r] = 0.0
                for q in range(s):
                    W[r] += L[r, q] * gain[k, c, q]
            for r in range(s):
                across += gain[k, c, r] * W[r]
            error = white[k, c] / scale[k, c] - along
            of_channels[0, c] += error**2
            of_channels[1, c] += 1.0 / power + across
            u[h] += error
            for r in range(s):
                L[r, h] -= W[r]
                L[h, r] -= W[r]
            L[h, h] += 1.0 / power + across
        if k:
            _transition(matrices, balances, holds, keeps, k - 1, F, B)
        else:
            for d in range(count):
                for r in range(s):
                    B[r, d] = 1.0 if r == n + d else 0.0
        for d in range(count):
            fresh = variance[d] * (1.0 - keeps[k - 1, d] ** 2) if k else variance[d]
            share = fresh / variance[d] if variance[d] > 0 else 0.0
            score, spread = 0.0, 0.0
            for r in range(s):
                if B[r, d] != 0.0:
                    score += B[r, d] * u[r]
                    for q in range(s):
                        spread += B[r, d] * L[r, q] * B[q, d]
            seen[k, d] = fresh * score
            of_inputs[0, d] += share * score**2
            of_inputs[1, d] += share * spread
        if k:
            for c in range(s):
                past[c] = F[c, c] * u[c] if c >= n else 0.0
                for q in range(n):
                    past[c] += F[q, c] * u[q]
            for r in range(s):
                for c in range(s):
                    T[r, c] = L[r, c] * F[c, c] if c >= n else 0.0
                    for q in range(n):
                        T[r, c] += L[r, q] * F[q, c]
            for r in range(s):
                u[r] = past[r]
                for c in range(r, s):
                    total = F[r, r] * T[r, c] if r >= n else 0.0
                    for q in range(n):
                        total += F[q, r] * T[q, c]
                    L[r, c] = total
                    L[c, r] = total


def share_that_remains(time_s: Array, lasts_s: Array) -> Array:
    """(N - 1, D) `keeps` of disturbances that forget within `lasts_s` (D,) seconds; 0 s is white."""
    steps = np.diff(time_s)[:, None]
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(lasts_s > 0, np.exp(-steps / lasts_s), 0.0))


__all__: list[Any] = ["Filtered", "StateSpace", "disturbances", "innovations", "share_that_remains"]
