"""What the readings of a channel tell before anything is fitted: whether it rests, hangs or repeats itself."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.signals import noise_sd

Array = NDArray[np.float64]

# Consecutive samples of exactly 0, at the start or the end, that are no chance.
AT_REST = 5
# Consecutive samples with the same number that are a channel that hangs, where noise keeps others from being equal: the
# share of equal neighbours elsewhere, and the noise as a share of the range.
HANGS, EQUAL, NOISY = 100, 0.2, 1e-4
# The share of readings that are a number of their own from which on a channel looks continuous. Equal neighbours are no new
# readings if there are so many times as many as that differ by its last digit, and by so many deviations of chance more; the
# digit is that of the numbers beyond this quantile.
DISTINCT, OFTEN, BEYOND_CHANCE, LARGE = 0.9, 2.0, 5.0, 0.9
# Times as long as the median, between two samples at which anything changes, that are rest and not a slow sensor.
LONG = 10


def resting(channels: Sequence[Array]) -> NDArray[np.bool_]:
    """(N,) samples amid many at which none of the channels (N,) changes."""
    changes = 1 + np.flatnonzero(np.any([np.diff(y) != 0 for y in channels], axis=0))
    edges = np.concatenate([[0], changes, [len(channels[0])]])
    lasting = np.diff(edges)
    return np.repeat(lasting > LONG * np.median(lasting), lasting)


def hanging(y: Array) -> NDArray[np.bool_]:
    """(N,) whether a channel shows one number, not 0, for so long that its noise cannot have let it.

    >>> noise = np.random.default_rng(0).standard_normal(1000)
    >>> stuck = np.where(np.arange(1000) < 700, noise, noise[700])
    >>> int(hanging(noise).sum()), int(hanging(stuck).sum()), int(hanging(np.round(noise)).sum())
    (0, 300, 0)
    """
    begins = np.flatnonzero(np.concatenate([[True], np.diff(y) != 0]))
    lengths = np.diff(np.append(begins, len(y)))
    hangs = np.repeat((lengths >= HANGS) & (y[begins] != 0), lengths)
    rest = y[~hangs & np.isfinite(y)]
    if not hangs.any() or len(rest) < HANGS or np.mean(np.diff(rest) == 0) > EQUAL:
        return np.zeros(len(y), dtype=bool)
    noisy = noise_sd(rest) > NOISY * float(np.ptp(rest))
    return np.asarray(hangs & noisy)


def repeating(y: Array, tells: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,) samples that are the one before again, to all digits, where noise makes that rare: no new readings.

    So does a log that is faster than its sensor, or than the bus between. Of 0, which a sensor may truly show for long, and
    of a channel with the levels of a converter, which shows one for as long as it changes slowly, nothing is said.

    Args:
        y: (N,) as recorded; what is missing is not a number.
        tells: (N,) where the motor does not rest.

    >>> noise = np.random.default_rng(0).standard_normal(1000)
    >>> slower, told = np.repeat(noise[::5], 5), np.ones(1000, dtype=bool)
    >>> [int(repeating(y, told).sum()) for y in (noise, slower, np.round(noise, 3), np.round(slower, 1))]
    [0, 800, 0, 0]
    """
    nowhere = np.zeros(len(y), dtype=bool)
    at = np.flatnonzero(np.isfinite(y))
    steps = np.diff(y[at])
    changes, fresh = np.abs(steps[steps != 0]), y[at[1:]][steps != 0]
    if len(np.unique(fresh)) <= DISTINCT * len(fresh):
        return nowhere
    again = nowhere.copy()
    again[at[1:]] = (steps == 0) & (y[at[1:]] != 0) & tells[at[1:]]
    # As many as are one up, or one down, in the last digit that large numbers have: small ones may have more.
    last = float(np.min(changes[np.abs(fresh) >= np.quantile(np.abs(fresh), LARGE)]))
    alike = 0.5 * float(np.sum(changes < 1.5 * last))
    return again if again.sum() > OFTEN * alike + BEYOND_CHANCE * np.sqrt(alike + 1.0) else nowhere


def largest_offset(y: Array) -> float | None:
    """The largest offset of a sensor that shows exactly 0 at the start or the end; None if it does not.

    A sensor with an offset shows the offset at rest, and noise around it; one that counts (an encoder) shows 0. An offset
    below half its smallest step could hide.

    >>> largest_offset(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.9, 1.4]))
    0.1
    """
    if not (np.all(y[:AT_REST] == 0) or np.all(y[-AT_REST:] == 0)):
        return None
    shown = np.abs(y[np.isfinite(y) & (y != 0)])
    return float(0.5 * shown.min()) if len(shown) else None
