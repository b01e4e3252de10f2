"""A sensor's answers against the truth, world by world."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_train.baselines.method import OUTPUTS
from motorlens_train.data import Rows
from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.plant import Array
from motorlens_train.evaluation.worlds.world import Recorded, World, drawn, record
from motorlens_train.features import feature_rows
from motorlens_train.specification import Bank, Envelope

# Confidently wrong: by more than so many stated deviations and more than matters, in more than a hundredth of the good
# samples.
DEVIATIONS, SHARE = 4.0, 0.01
# Rows that are judged in each world.
ROWS = 1500


class Sensing(Protocol):
    """A sensor as it is trained or as its file holds it."""

    @property
    def bank(self) -> Bank:
        """Signals, filters, observer and features."""

    @property
    def promised(self) -> tuple[str, ...]:
        """Names of the outputs."""

    @property
    def envelope(self) -> Envelope:
        """Where it is for."""

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Estimate and sigma `[N, 3]` for features `[N, F]`."""


@dataclass(frozen=True)
class Verdict:
    """One world, over the samples that count: share that is good; of those: rms and largest error, share within 1.96 stated
    deviations, share confidently wrong, by output (3,) each (NaN where none is good, or where it is not promised)."""

    world: World
    good: float
    rms: Array
    largest: Array
    covered: Array
    wrong: Array

    @property
    def confidently_wrong(self) -> bool:
        """Whether it says good and is wrong."""
        return bool((np.nan_to_num(self.wrong) > SHARE).any())


def verdict(
    world: World, recorded: Recorded, rows: Rows, values: Array, sds: Array, good: NDArray[np.bool_]
) -> Verdict:
    """Judge answers (M, 3) with their deviations at some rows of a recording; `good` (M,) is whether the quality says so."""
    counted = recorded.counted[rows]
    error = np.abs(values - recorded.truth[rows])
    kept = counted & good
    if not kept.any():
        nothing = np.full(3, np.nan)
        return Verdict(world, 0.0, nothing, nothing, nothing, nothing)
    e, s = error[kept], sds[kept]
    wrong = ((e > DEVIATIONS * s) & (e > recorded.sizes)) | ~np.isfinite(e)
    return Verdict(
        world, float(kept.sum() / counted.sum()), np.sqrt((e**2).mean(0)), e.max(0), (e <= 1.96 * s).mean(0), wrong.mean(0)
    )  # fmt: skip


def judged(sensor: Sensing, world: World, recorded: Recorded) -> Verdict:
    """What a sensor says in a world, held against the truth; good is what its observer believes and its envelope holds.

    What it does not promise is NaN.
    """
    rows = np.unique(np.linspace(0, len(recorded.time_s) - 1, ROWS).astype(np.int64))
    voltage, current, fence = recorded.voltage_V, recorded.current_A, sensor.envelope
    ambient = recorded.ambient_C if sensor.bank.ambient else None
    period = 1 / float(world.factors["rate"])
    x = feature_rows(sensor.bank, recorded.time_s, voltage, current, rows, ambient, period)
    values, sds = sensor.evaluate(x)
    good = np.ones(len(rows), dtype=bool)
    for signal, (least, most) in ((voltage, fence.voltage_V), (current, fence.current_A)):
        good &= (signal[rows] >= least) & (signal[rows] <= most)
    if sensor.bank.distrust is not None:
        good &= x[:, sensor.bank.distrust] <= 0.0
    columns = [OUTPUTS.index(name) for name in sensor.promised]
    seen = replace(recorded, truth=recorded.truth[:, columns], sizes=recorded.sizes[columns])
    found = verdict(world, seen, rows, values, sds, good)

    def spread(figures: Array) -> Array:
        whole = np.full(len(OUTPUTS), np.nan)
        whole[columns] = figures[: len(columns)]
        return whole

    figures = (spread(each) for each in (found.rms, found.largest, found.covered, found.wrong))
    return Verdict(world, found.good, *figures)


def verdicts(
    sensor: Sensing, drive: Drive, count: int, seed: int, done: Callable[[int], None] = lambda number: None
) -> Iterator[Verdict]:
    """A sensor's verdicts in `count` worlds of its motor, drawn from a seed."""
    for number in range(count):
        world = drawn(seed, number)
        yield judged(sensor, world, record(world, drive))
        done(number + 1)
