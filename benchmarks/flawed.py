"""Nothing is missing, and the recording is flawed as those of a bench are: what `diagnose` says, and how right the motor is.

    python benchmarks/flawed.py --count 40 --seed 1

Motors, drives and noise as in `encoder.py`, but the speed is measured at its sample, with white noise. Of each kind of flaw
there are as many worlds. Some 10 s of processor time a world.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE), str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from encoder import STATED, turned  # noqa: E402
from helpers.hidden.score import Rate  # noqa: E402

from motorlens_workbench.diagnose import diagnose  # noqa: E402
from motorlens_workbench.verdict import settle  # noqa: E402

Array = NDArray[np.float64]
Channels = dict[str, Array]

NOISE = 1e-3  # of the speed, of the fastest
# Spikes and missing cells: the share of samples, and how many deviations of a channel a spike is off.
RARE, MISSING, SPIKE = 0.002, 0.2, (0.2, 2.0)
# Repeated readings: the share, and the samples from one reading to the next.
STALE, LATEST = 0.3, (2, 5, 10)
# Bits of a converter over the range of a channel; degrees of freedom of heavy-tailed noise, by Student's t.
BITS, TAILS = 11, 3.0
MAINS_HZ, HUM = 50.0, 0.003  # of the range


def _at(rng: np.random.Generator, rows: int, share: float) -> NDArray[np.bool_]:
    return np.asarray(rng.random(rows) < share)


def spiked(name: str) -> Callable[[Array, Channels, np.random.Generator], None]:
    """Rare samples of a channel that are anywhere."""

    def flaw(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
        y = channels[name]
        at = _at(rng, len(y), RARE)
        y[at] += np.std(y) * rng.uniform(*SPIKE, at.sum()) * rng.choice([-1, 1], at.sum())

    return flaw


def repeated(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """The speed is logged faster than it is read."""
    every, rows = int(rng.choice(LATEST)), np.arange(len(time_s))
    channels["speed"] = channels["speed"][rows // every * every]


def stale(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """A bus hands on the last reading of current and speed, now and then."""
    for name in ("current", "speed"):
        rows = np.arange(len(time_s))
        last = np.maximum.accumulate(np.where(_at(rng, len(rows), STALE), 0, rows))
        channels[name] = channels[name][last]


def holes(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """Cells are missing."""
    for name in ("current", "speed"):
        channels[name][_at(rng, len(time_s), MISSING)] = np.nan


def converted(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """By a converter of few bits."""
    for name, y in channels.items():
        step = 2 * np.max(np.abs(y)) / 2**BITS
        channels[name] = step * np.round(y / step)


def heavy(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """Noise with heavy tails."""
    for name in ("current", "speed"):
        channels[name] += NOISE * np.max(np.abs(channels[name])) * rng.standard_t(TAILS, len(time_s))


def humming(time_s: Array, channels: Channels, rng: np.random.Generator) -> None:
    """The mains in the current's sensor."""
    y = channels["current"]
    y += HUM * np.max(np.abs(y)) * np.sin(2 * np.pi * MAINS_HZ * time_s + rng.uniform(0, 2 * np.pi))


FLAWS: dict[str, Callable[[Array, Channels, np.random.Generator], None]] = {
    "spikes of the current": spiked("current"), "of the speed": spiked("speed"), "of the voltage": spiked("voltage"),
    "speed read less often": repeated, "stale readings": stale, "missing cells": holes, "a coarse converter": converted,
    "heavy tails": heavy, "mains hum": humming,
}  # fmt: skip


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=36)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=list(FLAWS), help="one kind of flaw")
    args = parser.parse_args()
    said: dict[str, Counter[str]] = {name: Counter() for name in FLAWS}
    within: Counter[str] = Counter()
    kinds = [args.only] if args.only else list(FLAWS)
    print("motor  rate    flaw                   verdict        R, L, ke, J off by so many sd")
    for number in range(args.count):
        kind, began = kinds[number % len(kinds)], time.process_time()
        one = turned(args.seed, number)
        rng = np.random.default_rng([args.seed, number, 1])
        channels = {name: y.copy() for name, y in one.recording.channels.items()}
        channels["speed"] += (
            NOISE * np.max(np.abs(channels["speed"])) * rng.standard_normal(len(channels["speed"]))
        )
        FLAWS[kind](one.recording.time_s, channels, rng)
        found = diagnose(one.file, [replace(one.recording, channels=channels)])
        values, sd = found.base.fit.model.values(), found.base.fit.sd()
        off = {key: (values[key] - one.truth[key]) / sd[key] for key in STATED}
        word = settle(found).kind
        said[kind][word] += 1
        within.update(key for key in STATED if abs(off[key]) <= 2)
        off_by = " ".join(f"{off[key]:6.1f}" for key in STATED)
        print(
            f"{one.motor:6s} {one.rate_Hz:4.0f} Hz {kind:22s} {word:12s} {off_by}  {time.process_time() - began:4.0f} s",
            flush=True,
        )
    for kind in kinds:
        print(f"{kind:22s} " + ", ".join(f"{word} {count}" for word, count in said[kind].most_common()))
    missing = args.count - sum(words["adequate"] for words in said.values())
    print(f"something said to be missing: {Rate(missing, args.count)}")
    named = sum(words[word] for words in said.values() for word in ("named", "group", "sensor_fault"))
    print(f"by a name: {Rate(named, args.count)}")
    for key in STATED:
        print(f"{key:5s} within 2 sd of the truth: {Rate(within[key], args.count)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
