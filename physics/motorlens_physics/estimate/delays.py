"""Channels that were recorded late: loggers that are not synchronised, buses that queue.

A channel whose samples match the simulation better when all of them are taken some whole samples earlier is taken so; what
is left of a sample is a nuisance that the fit finds (`prior`, "skew"). Knapp and Carter (1976), The generalized
correlation method for estimation of time delay, doi:10.1109/TASSP.1976.1162830.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import correlate

from motorlens_physics.estimate.fit import NEAR, Fit, fit
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.prior import Prior, around
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed, at

Array = NDArray[np.float64]

# The longest delay that is looked for, as a share of the recording.
LONGEST = 0.1
# A skew by more than this share of a sample is a delay by a whole one, and said, if by this many standard deviations.
MOST_OF_A_SAMPLE, SURE = 0.75, 4.0
# Gain in log likelihood, twice, that a delay must bring: the 1 % level of the best of as many lags as there are.
LEVEL = 6.6
# How often late channels are moved on, and how many samples a delay is first unsure by (one standard deviation).
REALIGNED, UNSURE = 6, 4.0


def late_channels(model: Model, runs: Sequence[Run]) -> tuple[Run, ...]:
    """The runs with the channels moved that follow the simulation late (or early) by a sample or more."""
    return tuple(_moved(model, run, r) for r, run in enumerate(runs))


def _moved(model: Model, run: Run, r: int) -> Run:
    steps = np.diff(run.inputs.time_s)
    if np.ptp(steps) > 0.5 * np.median(steps):
        # Without even steps a delay is no number of samples.
        return run
    _, shown = predict(model, run, r)
    for c, channel in enumerate(run.channels):
        if channel != "temperature":
            run = run.delayed(channel, lag_of(run.measured[:, c], shown[:, c], run.there[:, c]))
    return run


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


def lag_of(measured: Array, shown: Array, there: NDArray[np.bool_]) -> int:
    """By how many samples what was measured (N,) comes after what is shown by the simulation; 0 unless beyond chance.

    >>> t = np.arange(4000) * 0.01
    >>> wave = np.sin(t + t**2 / 9)
    >>> noise = 0.05 * np.random.default_rng(0).standard_normal(4000)
    >>> there = np.ones(4000, dtype=bool)
    >>> lag_of(np.roll(wave, 7) + noise, wave, there), lag_of(wave + noise, wave, there)
    (7, 0)
    """
    rows = len(measured)
    most = int(LONGEST * rows)
    if most < 2 or np.ptp(shown) == 0:
        return 0
    y = np.where(there, measured - np.mean(measured[there]), 0.0)
    # Before its start the motor is taken to have been as it starts, and after its end as it ends.
    x = np.pad(shown - np.mean(shown), most, mode="edge")
    cross = correlate(x, y, mode="valid", method="fft")[::-1]
    power = (_windows(x * x, rows) - _windows(x, rows) ** 2 / rows)[::-1]
    error = np.maximum(y @ y - np.maximum(cross, 0.0) ** 2 / np.maximum(power, 1e-300), 1e-300)
    lags = np.arange(-most, most + 1)
    best, here = int(np.argmin(error)), most
    x = x[most:-most]
    residual = y - cross[best] / power[best] * _shifted(x, int(lags[best]))
    won = _independent(residual) * np.log(error[here] / error[best])
    # A lag of one sample is how the input ran between samples, or a skew.
    return int(lags[best]) if abs(lags[best]) > 1 and won > LEVEL + 2 * np.log(len(lags)) else 0


@dataclass(frozen=True)
class Delay:
    """By how much a channel of a recording comes after its voltage, with its standard deviation, in seconds."""

    recording: str
    channel: str
    value_s: float
    sd_s: float

    @property
    def sentence(self) -> str:
        """For the reader."""
        way = "after" if self.value_s > 0 else "before"
        late = f"{abs(self.value_s):.4g} +- {self.sd_s:.2g} s {way} its voltage"
        return f"{self.recording}: {self.channel} comes {late}; it was moved by as much. A lag of its sensor looks alike."


def delays_of(found: Fit, runs: Sequence[Run]) -> tuple[Delay, ...]:
    """The channels of fitted runs that are late, or early, beyond doubt and by most of a sample."""
    sd = found.sd()
    late = []
    for r, run in enumerate(runs):
        for channel in run.channels:
            skew = found.model.own[r].get(f"skew.{channel}", 0.0)
            value = run.late.get(channel, 0) * run.period_s + skew
            spread = sd.get(f"skew.{channel}@{r}", 0.0)
            if abs(value) > max(MOST_OF_A_SAMPLE * run.period_s, SURE * spread):
                late.append(Delay(run.name, channel, value, spread))
    return tuple(late)


def gain(before: Sequence[Array], after: Sequence[Array]) -> float:
    """Twice the gain in logarithmic likelihood from residuals (rows, C) of each run to others of the same run."""
    total = 0.0
    for one, other in zip(before, after, strict=True):
        for c in range(one.shape[1]):
            ratio = float(np.mean(one[:, c] ** 2)) / max(float(np.mean(other[:, c] ** 2)), 1e-300)
            total += _independent(other[:, c]) * float(np.log(max(ratio, 1e-300)))
    return total


def _independent(residual: Array) -> float:
    """As how many independent samples residuals (N,) count whose neighbours are alike."""
    alike = float(np.mean(residual[1:] * residual[:-1]) / max(float(np.mean(residual**2)), 1e-300))
    alike = min(max(alike, 0.0), 1 - 2 / len(residual))
    return len(residual) * (1 - alike) / (1 + alike)


def _windows(x: Array, rows: int) -> Array:
    """Sums over all windows of this many rows."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    return np.asarray(total[rows:] - total[:-rows])


def _shifted(x: Array, lag: int) -> Array:
    return np.asarray(x[np.clip(np.arange(len(x)) - lag, 0, len(x) - 1)])
