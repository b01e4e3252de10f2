"""Hum: a line of the mains' frequency, or of its harmonics, in what a sensor shows.

A motor answers what drives it. A line at the frequency of the mains that stands out of all beside it comes with the
measurement, below the Nyquist frequency or folded there (aliasing).
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len, rfft

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
# Frequencies looked at in one over the time that is looked at, at least.
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
    power, step_Hz = _power(shown, rate_Hz)
    for nominal in _apart((mains * harmonic for harmonic in HARMONICS for mains in MAINS_HZ), rate_Hz):
        if not _told(nominal, len(white) / rate_Hz, rate_Hz):
            continue
        near, beside = (_multiples(nominal, share * nominal, step_Hz) for share in (WANDERS, BESIDE))
        lines, others = (power[_sampled(one, rate_Hz / step_Hz)] for one in (near, beside))
        # What the line itself spreads to is none beside it.
        others = others[np.abs(beside * step_Hz - nominal) > WANDERS * nominal + 2 * rate_Hz / len(white)]
        # Those beside are of noise, or of what the model lacks; the largest is what a line is measured by.
        told = np.max(lines, axis=0) / np.maximum(np.max(others, axis=0), least)
        least_told = np.log(len(near) * len(MAINS_HZ) * len(HARMONICS) * white.shape[1] / CHANCE)
        driven, c = told[white.shape[1] :], int(np.argmax(told[: white.shape[1]]))
        if told[c] > least_told and np.all(driven <= least_told):
            frequency = float(near[np.argmax(lines[:, c])] * step_Hz)
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


def _told(nominal: float, lasts_s: float, rate_Hz: float) -> bool:
    """Whether a line would be told: not where it is folded to what lasts, or too little is beside it."""
    wide = BESIDE * nominal
    return wide * lasts_s >= 10 and _folded(nominal, rate_Hz) >= wide and rate_Hz >= 2 * wide


def _multiples(about_Hz: float, within_Hz: float, step_Hz: float) -> NDArray[np.int64]:
    """The multiples of a step that are within so far of a frequency.

    >>> _multiples(50.0, 1.0, 0.4)
    array([123, 124, 125, 126, 127])
    """
    first, last = np.ceil((about_Hz - within_Hz) / step_Hz), np.floor((about_Hz + within_Hz) / step_Hz)
    return np.arange(int(first), int(last) + 1)


def _sampled(multiples: NDArray[np.int64], rate: float) -> NDArray[np.int64]:
    """What frequencies are folded to, all as multiples of a step; so is the rate.

    >>> _sampled(np.array([3, 7, 12, 19]), 10.0)
    array([3, 3, 2, 1])
    """
    whole = round(rate)
    return np.asarray(np.abs(multiples - whole * np.rint(multiples / whole).astype(np.int64)))


def _power(columns: Array, rate_Hz: float) -> tuple[Array, float]:
    """(F, C) of columns (N, C) at even frequencies from 0 on, 1 in the mean of white ones; and the step between these."""
    samples = next_fast_len(FINER * len(columns), real=True)
    total = np.maximum(np.sum(columns**2, axis=0), 1e-300)
    return np.abs(rfft(columns, samples, axis=0)) ** 2 / total, rate_Hz / samples


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
