"""What an analogue-to-digital converter does to a channel: its step, the end of its range, and the error that lasts.

What its readings tell of an output is in `innovations.read`; of an input, which drives the simulation, its error is noise
that lasts while the input stays between two levels.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from motorlens_physics.estimate.signals import noise_sd, smoothed

Array = NDArray[np.float64]

# A channel with more distinct values than this share of its samples is no converter's.
FEW = 0.5
# A difference of two values by this share of the largest is rounding: converters have up to 24 bits.
ROUNDING = 1e-9
# Gaps between values by which the step is told, in steps; the last holds all of them.
WIDER = (25, 250, 2500, np.inf)
# Steps to the end of the range of the coarsest converter that is told, and how near to a whole number of steps that is.
COARSEST_RANGE, WHOLE = 256, 0.2
# Harmonics of a converter's error that are looked at.
HARMONICS = 20
# What lasts is left out where it adds less than this share to the power of the slowest.
NEGLIGIBLE = 0.1


def quantisation_step(y: Array) -> float:
    """The least significant bit of a channel; 0 if its values look continuous.

    A quantised channel has few distinct values, all whole multiples of the smallest difference between two of them. The
    decimals of a file blur that one; ever wider gaps, counted in it, tell it better.

    >>> codes = np.concatenate([np.arange(400), [700, 2048]])
    >>> quantisation_step(np.tile(np.round(0.34375 * codes, 3), 3))
    0.34375
    """
    values = np.unique(y[np.isfinite(y)])
    if len(values) < 2 or len(values) > FEW * len(y):
        return 0.0
    steps = np.diff(values)
    step = float(np.median(steps[steps < 2.5 * np.min(steps)]))
    # Numbers that differ by their rounding alone are continuous.
    if step <= ROUNDING * float(np.abs(values).max()):
        return 0.0
    for widest in WIDER:
        told = steps < widest * step
        step = float(np.sum(steps[told]) / np.sum(np.round(steps[told] / step)))
    whole = steps / step
    return step if np.max(np.abs(whole - np.round(whole))) < 0.1 else 0.0


def counted_step(angle: Array) -> float:
    """The least significant bit of a signal that goes on and on, from what it changes by; 0 if that looks continuous.

    >>> counts = np.cumsum(np.random.default_rng(0).integers(-20, 40, 4000))
    >>> round(counted_step(2 * np.pi / 512 * counts) * 512 / (2 * np.pi), 6)
    1.0
    """
    rounding = ROUNDING * max(float(np.nanmax(np.abs(angle))), np.finfo(float).tiny)
    return quantisation_step(rounding * np.round(np.diff(angle) / rounding))


def saturated(y: Array) -> NDArray[np.bool_]:
    """(N,) where a channel shows the end of its converter's range: the truth may be anything beyond.

    The range of n bits ends a power of two of steps from zero, or one step less. By chance a channel's own extreme lies
    there once in a hundred recordings or less, and then costs the samples that show it twice in a row.

    >>> codes = np.round(1400 * np.sin(np.arange(9000) / 400))
    >>> bool(saturated(0.01 * codes).any()), int(saturated(0.01 * np.minimum(codes, 1024)).sum())
    (False, 2403)
    """
    step = quantisation_step(y)
    ends = np.zeros(len(y), dtype=bool)
    if not step:
        return ends
    there = y[np.isfinite(y)]
    for end in (there.min(), there.max()):
        codes = abs(end) / step
        whole = 2.0 ** np.ceil(np.log2(max(codes - 0.5, 1.0)))
        if codes > COARSEST_RANGE - 1.5 and min(abs(codes - whole), abs(codes - whole + 1)) < WHOLE:
            at = y == end
            ends |= at & (np.append(at[1:], False) | np.insert(at[:-1], 0, False))
    return ends


@dataclass(frozen=True, eq=False)
class LastingError:
    """The part of a converter's error that no noise blurs: it stays while the signal stays between two levels.

    Attributes:
        variance: in the unit of the channel squared.
        stays: (N,) for how many samples the signal stays within a step.
    """

    variance: float
    stays: Array

    def keeps(self) -> Array:
        """(N - 1,) share of the error that remains at the next sample, so that all the time that it stays is one sample."""
        stays = np.minimum(self.stays[1:], self.stays[:-1])
        return np.asarray((stays - 1) / (stays + 1))


def lasting_error(y: Array, step: float, tells: NDArray[np.bool_] | None = None) -> LastingError | None:
    """What lasts of a converter's error; None if that does not matter.

    Noise makes the error another one at every sample. What it does not blur stays while the signal stays between two
    levels: Schuchman (1964), doi:10.1109/TCOM.1964.1088973; Gray and Stockham (1993), doi:10.1109/18.256489.

    Args:
        y: (N,) as recorded, without gaps.
        step: least significant bit; 0 if it has no converter.
        tells: (N,) samples that tell its noise; None is all.

    >>> held, noise = np.repeat(np.arange(40) * 7.3, 100), np.random.default_rng(0).standard_normal(4000)
    >>> lasts = lasting_error(np.round(held + 0.1 * noise), 1.0)
    >>> round(lasts.variance * 12, 1), float(np.median(lasts.stays))
    (0.5, 100.0)
    >>> lasting_error(np.round(held + 0.5 * noise), 1.0) is None
    True
    """
    if not step:
        return None
    # Harmonics of the mean error between two levels: without noise, their squares add up to step^2 / 12.
    order = np.arange(1, HARMONICS + 1)
    noise = noise_sd(y if tells is None else y[tells], step)
    mean = np.exp(-2 * (np.pi * order * noise / step) ** 2)
    share = float(np.sum((mean / order) ** 2) / np.sum(1.0 / order**2))
    stays = _stays(smoothed(y, step), step)
    if share * (float(np.mean(stays)) - 1) < NEGLIGIBLE:
        return None
    return LastingError(share * step**2 / 12, stays)


@njit(cache=True, nogil=True, error_model="numpy")
def _stays(y, step):  # type: ignore[no-untyped-def]
    """(N,) for how many samples a signal (N,) stays before it has gone on by a step."""
    stays, since = np.empty(len(y)), 0
    for k in range(1, len(y) + 1):
        if k == len(y) or abs(y[k] - y[since]) >= step:
            stays[since:k] = k - since
            since = k
    return stays
