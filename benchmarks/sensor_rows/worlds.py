"""Sensor files in worlds they were not made in: the runtime itself, on a plant that shares no code with the packages."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sensor_rows.common import MELLAH

from motorlens_physics.queue import Work
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.progress import Progress
from motorlens_runtime.sensor.sensor import Sensor, load_sensor
from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.judge import ROWS, Verdict, verdict
from motorlens_train.evaluation.worlds.plant import Array
from motorlens_train.evaluation.worlds.table import cells as cells_of
from motorlens_train.evaluation.worlds.table import text
from motorlens_train.evaluation.worlds.world import Recorded, World, at, drawn, noise, record

DRIVE = Drive.of(MELLAH)
_BLOCK = 65536
# Where good quality is asked for: noise of at most so many times the drive's.
USUAL = 3.0


@dataclass(frozen=True)
class Published:
    """What the runtime says at some `rows` (M,) of a recording: `values` (M, 3), their deviations `sds`, and which of
    them (M,) are `good`."""

    rows: NDArray[np.intp]
    values: Array
    sds: Array
    good: NDArray[np.bool_]


def judged(sensor: Sensor, world: World, recorded: Recorded) -> Verdict:
    """What the runtime publishes in a world, held against the truth."""
    found = published(sensor, world, recorded)
    return verdict(world, recorded, found.rows, found.values, found.sds, found.good)


def published(sensor: Sensor, world: World, recorded: Recorded) -> Published:
    """What the runtime publishes in a world."""
    time_ns = np.round(recorded.time_s * 1e9).astype(np.int64)
    estimator = open_estimator(sensor, 1 / float(world.factors["rate"]))
    rows = np.unique(np.linspace(0, len(time_ns) - 1, ROWS).astype(np.intp))
    values, sds, words = [], [], []
    for first in range(0, len(time_ns), _BLOCK):
        part = slice(first, first + _BLOCK)
        samples = Samples(
            time_ns[part], recorded.voltage_V[part], recorded.current_A[part], recorded.ambient_C[part]
        )
        mine = rows[(rows >= first) & (rows < first + _BLOCK)] - first
        found = estimator.push(samples, mine)
        values.append(found.values)
        sds.append(found.sigma)
        words.append(found.quality)
    # A motor that did start cold is known to have: a sensor that takes every start for one is judged there.
    known = int(Quality.ASSUMED_COLD) if world.factors["start"] == "cold" else 0
    good = (np.concatenate(words) & ~np.uint32(known)) == 0
    return Published(rows, np.concatenate(values), np.concatenate(sds), good)


def judged_alone(number: int, path: str, seed: int, chosen: Mapping[str, str]) -> Verdict:
    """One world of a seed, by its number: a task of the queue."""
    world = at(drawn(seed, number), **chosen)
    return judged(_sensor(path), world, record(world, DRIVE))


@cache
def _sensor(path: str) -> Sensor:
    return load_sensor(path)


def worlds(path: Path, count: int, seed: int, cells: Sequence[str], work: Work) -> int:
    """Judge a sensor file in `count` worlds drawn from a seed, some `FACTOR=CELL` chosen; the number it is confidently
    wrong in.

    Prints the table by factor, and one line for every world in which it is confidently wrong.
    """
    chosen = dict(cell.split("=", 1) for cell in cells)
    found: dict[int, Verdict] = {}
    failed = []
    with Progress(count, f"{path.stem} in worlds") as progress:
        for done in work(judged_alone, range(count), str(path.resolve()), seed, chosen):
            if done.value is None:
                failed.append(f"  world {done.number}: {done.failure}")
            else:
                found[done.number] = done.value
            progress.update(len(found) + len(failed))
    lines = [_line(number, one) for number, one in sorted(found.items()) if one.confidently_wrong]
    wrong = len(lines)
    print(f"\n## {path.name} in {count} worlds of seed {seed}: confidently wrong in {wrong}")
    print(text(cells_of([found[number] for number in sorted(found)])))
    print("\n".join([*lines, _usual(list(found.values())), *failed]), flush=True)
    return wrong + len(failed)


def _usual(found: Sequence[Verdict]) -> str:
    """Share of good samples where nothing speaks against it: the file's motor, noise of at most USUAL times the drive's."""
    usual = [
        one for one in found if one.world.factors["motor"] == "the file's" and max(noise(one.world)) <= USUAL
    ]
    plain = [one for one in usual if one.world.factors["lacks"] == "nothing"]
    shares = (
        f"{100 * np.mean([one.good for one in part]):.1f} %" if part else "none" for part in (usual, plain)
    )
    return "  the file's motor, noise at most {:g} times: good {}; of those that lack nothing {}".format(
        USUAL, *shares
    )


def _line(number: int, one: Verdict) -> str:
    return (
        f"  world {number}: good {100 * one.good:.0f} %, rms {one.rms[0]:.3g} rad/s {one.rms[1]:.3g} K, wrong in "
        f"{100 * one.wrong[0]:.0f} / {100 * one.wrong[1]:.0f} %: {', '.join(one.world.factors.values())}"
    )
