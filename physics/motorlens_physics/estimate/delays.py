"""Channels that were recorded late: loggers that are not synchronised, buses that queue.

A channel whose samples match the simulation better when all of them are taken some whole samples earlier is taken so; what
is left of a sample is a nuisance that the fit finds (`prior`, "skew"). Knapp and Carter (1976), The generalized
correlation method for estimation of time delay, doi:10.1109/TASSP.1976.1162830.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from motorlens_physics.estimate.fit import NEAR, Fit, fit, inverse
from motorlens_physics.estimate.innovations import in_blocks
from motorlens_physics.estimate.points import at, needed
from motorlens_physics.estimate.prior import SKEW, Prior, around
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Errors, Weighed

Array = NDArray[np.float64]

# The longest delay that is looked for, as a share of the recording.
LONGEST = 0.1
# A skew by more than this share of a sample is a delay by a whole one: near half a sample, noise would decide.
MOST_OF_A_SAMPLE = 0.75
# A delay is said if by this many standard deviations, and more than converters usually have.
SURE = 4.0
# How often late channels are moved on, and how many samples a delay is first unsure by (one standard deviation).
REALIGNED, UNSURE = 6, 4.0


@dataclass(frozen=True)
class Lag:
    """A channel of a run that looks late by whole samples.

    Attributes:
        r: position of the run.
        channel: of its outputs.
        samples: by how many; negative is early.
        gain: twice the gain in logarithmic likelihood that it seems to bring.
        tried: how many lags were looked at.
    """

    r: int
    channel: str
    samples: int
    gain: float
    tried: int


def likeliest_lag(point: Weighed, prior: Prior) -> Lag | None:
    """The channel that seems to win most by a delay of more than a sample; None if none wins beyond chance.

    A sample less or more is how inputs ran between samples, or a skew. What seems so is to be fitted in full.
    """
    best, inflation = None, point.tempered().inflation
    for r, part in enumerate(point.parts):
        steps = np.diff(part.run.inputs.time_s)
        most = int(LONGEST * len(part.error))
        # Beside uneven steps a signal that is moved is not what it would have been; there delays are fitted (`timing`).
        if most < 2 or np.ptp(steps) > 0.5 * np.median(steps):
            continue
        lags, tried = np.arange(-most, most + 1), (2 * most + 1) * len(part.run.channels)
        free = [j for j, k in enumerate(part.mine) if not prior.keys[k].startswith("skew.")]
        width = prior.width(point.model.values())[[part.mine[j] for j in free]]
        for c, channel in enumerate(part.run.channels):
            if channel != "temperature":
                gains = gains_of_lags(part, c, most, part.columns[:, :, free], width)
                # A gain beside a larger one is of the same delay, be that one sample or less.
                peak = np.r_[False, (gains[1:-1] >= gains[:-2]) & (gains[1:-1] >= gains[2:]), False]
                gains = np.where(peak & (np.abs(lags) > 1), gains, 0.0)
                k = int(np.argmax(gains))
                lag = Lag(r, channel, int(lags[k]), float(gains[k]) / inflation, tried)
                if lag.gain > max(needed(tried), best.gain if best else 0.0):
                    best = lag
    return best


def gains_of_lags(part: Errors, c: int, most: int, columns: Array, width: Array) -> Array:
    """(2 most + 1,) fall of the whitened squares if channel c showed what it does that many samples later.

    It is the simulation that is moved: its inputs are independent of the errors as they are, of no others. The parameters
    go where they are best for each lag, one step away, for a delay bends them until it hardly shows. The filter is taken not
    to change with time, so that a signal moved is its innovations moved.

    Args:
        part: the run.
        c: position of the channel.
        most: the longest delay, samples.
        columns: (N, C, k) sensitivities to the parameters.
        width: (k,) their standard deviations before.
    """
    shown = part.run.measured[:, c] - part.difference[:, c]
    signal = np.zeros((*part.error.shape, 1))
    signal[:, c, 0] = shown - np.median(shown)
    seen, rows = part.read, len(shown)
    (white,) = in_blocks(
        seen.space, seen.filtered, np.concatenate([signal, columns], axis=2), [slice(0, rows)]
    )
    error, moved, slopes = seen.filtered.white[:, :, 0], white[:, :, 0], white[:, :, 1:]
    rest = error + moved
    lags = np.arange(-most, most + 1)
    first, last = np.maximum(lags, 0), rows + np.minimum(lags, 0)

    size = next_fast_len(rows + most, real=True)
    spectrum = np.conj(rfft(moved, size, axis=0))

    def across(y: Array) -> Array:
        """Sums of the products of (N, C) and the moved signal, at each lag."""
        products = irfft(np.sum(rfft(y, size, axis=0) * spectrum, axis=1), size)
        return np.asarray(products[lags])

    left = _between(rest, first, last) + _between(moved, first - lags, last - lags) - 2 * across(rest)
    gram = np.tensordot(slopes, slopes, axes=([0, 1], [0, 1])) + np.diag(width**-2.0)
    score = np.array(
        [float(np.sum(slope * rest)) - across(slope) for slope in np.moveaxis(slopes, 2, 0)]
    ).reshape(-1, len(lags))
    by_step = np.sum(score * (inverse(gram) @ score), axis=0) if len(width) else np.zeros(len(lags))
    return np.asarray(_between(error, first, last) - left + by_step - by_step[most])


def _between(y: Array, first: NDArray[np.int64], last: NDArray[np.int64]) -> Array:
    """Sums of squares of the rows of (N, C) from each first to each last."""
    total = np.concatenate([[0.0], np.cumsum(np.sum(y * y, axis=1))])
    return np.asarray(total[last] - total[first])


def nearer(runs: tuple[Run, ...], found: Fit, prior: Prior) -> tuple[tuple[Run, ...], Fit]:
    """Runs with late channels, and their fit, with the delays that fit best: a motor unlike its file has bent the first.

    Their delays are fitted beside the parameters, and whole samples of them moved, until less than one is left.
    """
    late = [(r, channel) for r, run in enumerate(runs) for channel in run.late if channel in run.channels]
    for r, channel in late:
        prior = prior.joined(around(f"skew.{channel}@{r}", 0.0, UNSURE * runs[r].period_s))
    for _ in range(REALIGNED):
        found = fit(found.model, runs, prior, rounds=NEAR, enough=0.1)
        left = {(r, channel): found.model.own[r][f"skew.{channel}"] for r, channel in late}
        moves = {(r, channel): round(skew / runs[r].period_s) for (r, channel), skew in left.items()}
        if not any(moves.values()):
            break
        for (r, channel), samples in moves.items():
            runs = (*runs[:r], runs[r].delayed(channel, samples), *runs[r + 1 :])
        rest = {
            f"skew.{channel}@{r}": skew - moves[r, channel] * runs[r].period_s
            for (r, channel), skew in left.items()
        }
        found = replace(found, model=found.model.with_values(rest))
    return runs, found


def realigned(point: Weighed, prior: Prior) -> Weighed:
    """The point with channels moved by the whole samples that their skew has come to; itself if there are none."""
    parts, values = list(point.parts), {}
    for r, part in enumerate(parts):
        for channel in part.run.channels:
            key = f"skew.{channel}"
            skew = point.model.own[r].get(key, 0.0)
            if abs(skew) > MOST_OF_A_SAMPLE * part.run.period_s:
                samples = round(skew / part.run.period_s)
                run = parts[r].run.delayed(channel, samples)
                parts[r] = replace(parts[r], run=run, used=run.there)
                values[f"{key}@{r}"] = skew - samples * part.run.period_s
    if not values:
        return point
    return at(point.model.with_values(values), replace(point, parts=tuple(parts)), prior)


@dataclass(frozen=True)
class Delay:
    """By how much a channel of a recording comes after its voltage, with its standard deviation, in seconds.

    `lag_refused` says that the lag of a sensor was estimated in its place, and is not likelier beyond chance.
    """

    recording: str
    channel: str
    value_s: float
    sd_s: float
    lag_refused: bool = False

    @property
    def sentence(self) -> str:
        """For the reader."""
        size = f"{abs(self.value_s):.4g} +- {self.sd_s:.2g} s"
        way, why = "after", "but a lag of its sensor looks alike"
        if self.value_s < 0:
            # Nothing answers before it is driven.
            way, why = "before", "but the voltage was recorded late, or its sensor lags"
        if self.lag_refused:
            why = "and a lag of a sensor in its place is not likelier beyond chance"
        return f"{self.recording}: {self.channel} comes {size} {way} its voltage; it was moved by as much, {why}."


def _lasting(run: Run, samples: int) -> float:
    """How long so many samples of a run mostly last, in seconds: stamps may jitter."""
    apart = abs(samples)
    lasts = run.inputs.time_s[apart:] - run.inputs.time_s[: len(run.measured) - apart]
    return float(np.sign(samples) * np.median(lasts))


def delays_of(found: Fit, runs: Sequence[Run]) -> tuple[Delay, ...]:
    """The channels of fitted runs that are late, or early, beyond doubt and by more than converters usually are."""
    sd = found.sd()
    late = []
    for r, run in enumerate(runs):
        for channel in run.channels:
            skew = found.model.own[r].get(f"skew.{channel}", 0.0)
            value = _lasting(run, run.late.get(channel, 0)) + skew
            spread = sd.get(f"skew.{channel}@{r}", 0.0)
            if abs(value) > max(SKEW * run.period_s, SURE * spread):
                late.append(Delay(run.name, channel, value, spread))
    return tuple(late)
