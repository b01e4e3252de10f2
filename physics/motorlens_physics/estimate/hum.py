"""Hum: a line of the mains' frequency, or of its harmonics, in what a sensor shows.

A motor answers what drives it. A line at the frequency of the mains that stands out of all beside it comes with the
measurement, below the Nyquist frequency or folded there (aliasing).
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import czt

from motorlens_physics.estimate.weighed import CHANCE, Errors

Array = NDArray[np.float64]

# Frequencies of the mains, how far they are off at most, as a share, and the harmonics that are looked at.
MAINS_HZ, WANDERS, HARMONICS = (50.0, 60.0), 0.004, (1, 2, 3)
# Half as wide is what a line must stand out of, as a share of its frequency.
BESIDE = 0.1
# Samples in which lines are looked for, at most, and seconds; and how long a line keeps its phase, in s.
LOOKED_AT, LOOKED_AT_S, STEADY_S = 1 << 15, 60.0, 5.0
# Steps of time that are uneven by more than this share are no even sampling.
UNEVEN = 0.5
# Frequencies looked at in one over the time that is looked at.
FINER = 4


@dataclass(frozen=True)
class Hum:
    """A line in a channel.

    Attributes:
        channel: which.
        frequency_Hz: of the line.
        line: (N,) what it adds.
    """

    channel: str
    frequency_Hz: float
    line: Array


def hum_of_channels(part: Errors) -> list[Hum]:
    """The lines in a run; of each frequency the one in the channel that shows it most.

    Args:
        part: the run near the best parameters.
    """
    run = part.run
    steps = np.diff(run.inputs.time_s)
    # Beside uneven steps a line is spread over all frequencies.
    if np.ptp(steps) > UNEVEN * np.median(steps):
        return []
    rate_Hz = float(1 / np.mean(steps))
    most = min(LOOKED_AT, int(LOOKED_AT_S * rate_Hz))
    first = max((len(run.measured) - most) // 2, 0)
    rows = slice(first, first + most)
    white = part.read.filtered.white[rows, :, 0]
    drive = [run.inputs.voltage_V[rows], run.inputs.load_torque_Nm[rows]]
    # What a line of the drive stirs up is no hum; the drive is smooth, and no line of it is small beside noise.
    shown = np.column_stack([white, *(y - np.mean(y) for y in drive)])
    least = np.append(np.ones(white.shape[1]), np.zeros(len(drive)) + 1e-12)
    found: list[Hum] = []
    for nominal in _apart((mains * harmonic for harmonic in HARMONICS for mains in MAINS_HZ), rate_Hz):
        near, beside = _frequencies(nominal, len(white) / rate_Hz, rate_Hz)
        if not near.size:
            continue
        lines, others = _power(shown, near, rate_Hz), _power(shown, beside, rate_Hz)
        # What the line itself spreads to is none beside it.
        others = others[np.abs(beside - nominal) > near[-1] - nominal + 2 * rate_Hz / len(white)]
        # Those beside are of noise, or of what the model lacks; the largest is what a line is measured by.
        told = np.max(lines, axis=0) / np.maximum(np.max(others, axis=0), least)
        least_told = np.log(len(near) * len(MAINS_HZ) * len(HARMONICS) * white.shape[1] / CHANCE)
        driven, c = told[white.shape[1] :], int(np.argmax(told[: white.shape[1]]))
        if told[c] > least_told and np.all(driven <= least_told):
            frequency = float(near[np.argmax(lines[:, c])])
            found.append(Hum(run.channels[c], frequency, _line(part, c, frequency)))
    return found


def _apart(nominal_Hz: Iterable[float], rate_Hz: float) -> list[float]:
    """Those of some frequencies that are not one with an earlier one when they are sampled.

    >>> _apart((50.0, 60.0, 100.0, 120.0, 150.0, 180.0), 200.0)
    [50.0, 60.0, 100.0, 120.0, 180.0]
    """
    kept: list[float] = []
    for one in nominal_Hz:
        if all(
            abs(_folded(one, rate_Hz) - _folded(other, rate_Hz)) > WANDERS * (one + other) for other in kept
        ):
            kept.append(one)
    return kept


def _folded(frequency_Hz: float, rate_Hz: float) -> float:
    return abs(frequency_Hz - rate_Hz * round(frequency_Hz / rate_Hz))


def _frequencies(nominal: float, lasts_s: float, rate_Hz: float) -> tuple[Array, Array]:
    """Those at which a line may be, and about it, evenly; none where it is folded to what lasts, or too little tells."""
    wanders, wide = WANDERS * nominal, BESIDE * nominal
    if wide * lasts_s < 10 or _folded(nominal, rate_Hz) < wide or rate_Hz < 2 * wide:
        return np.zeros(0), np.zeros(0)
    near = nominal + np.linspace(-wanders, wanders, 1 + 2 * int(np.ceil(FINER * wanders * lasts_s)))
    return near, nominal + np.linspace(-wide, wide, 1 + 2 * int(np.ceil(wide * lasts_s)))


def _power(columns: Array, frequencies_Hz: Array, rate_Hz: float) -> Array:
    """(F, C) of columns (N, C) at even frequencies (F,): 1 in the mean of white ones."""
    turn = 2j * np.pi / rate_Hz
    step, first = frequencies_Hz[1] - frequencies_Hz[0], frequencies_Hz[0]
    spectrum = czt(columns, len(frequencies_Hz), np.exp(-turn * step), np.exp(turn * first), axis=0)
    total = np.maximum(np.sum(columns**2, axis=0), 1e-300)
    return np.asarray(np.abs(spectrum) ** 2 / total)


def _line(part: Errors, c: int, frequency_Hz: float) -> Array:
    """(N,) the line in the errors of a channel, by least squares beside a level and a slope, a stretch of time at a time.

    Its amplitude and phase may change along a stretch: the frequency is not quite the line's.
    """
    line = np.zeros(len(part.error))
    for rows in _stretches(part.run.inputs.time_s):
        time, there = part.run.inputs.time_s[rows], part.run.there[rows, c]
        turn, along = 2 * np.pi * frequency_Hz * time, time - time.mean()
        waves = np.column_stack([np.cos(turn), np.sin(turn), along * np.cos(turn), along * np.sin(turn)])
        columns = np.column_stack([waves, np.ones_like(time), along])
        size = np.linalg.lstsq(columns[there], part.error[rows, c][there], rcond=1e-9)[0]
        line[rows] = waves @ size[:4]
    return line


def _stretches(time_s: Array) -> Iterator[slice]:
    count = max(1, int((time_s[-1] - time_s[0]) / STEADY_S))
    edges = np.linspace(0, len(time_s), count + 1).astype(int)
    for first, last in itertools.pairwise(edges):
        yield slice(int(first), int(last))
