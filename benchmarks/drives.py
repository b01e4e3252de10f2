"""Calibration on drives of every kind: steps, ramps, triangles, one sinusoid or two, a chirp, a start and then nothing.

    python benchmarks/drives.py                     140 recordings (minutes)
    python benchmarks/drives.py --count 20          a sample
    python benchmarks/drives.py --first 65 --count 1 --verbose
    python benchmarks/drives.py --lasts 20          three quarters of all noise forget within 20 samples, as drifts do

Each recording is drawn from its seed alone: a motor up to 30 % from its file in ten parameters, a kind of drive, 200, 500 or
1000 samples a second for 6 to 16 s (8000 samples at most), inputs that hold between samples or run linearly, 0.1, 0.3 or 1 %
of noise on every channel, a temperature or none, no converter or one of 12 bit; where the drive is one start, also a brake.
The motors come from an integrator of its own (`tests/helpers/plain_motor.py`). Printed is, by kind of drive, how many
calibrations converge, in how many how the voltage ran is told right, and how far the parameters are off that are identified:
one that converges with one of them beyond four of its deviations is confidently wrong.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), str(HERE), *(p for p in sys.path if Path(p).resolve() != HERE)]

from calibration import FILE, wilson  # noqa: E402
from helpers.plain_motor import AMBIENT_C, RATED, Test, scattered, simulated  # noqa: E402

from motorlens_physics.estimate.estimate import estimate  # noqa: E402
from motorlens_physics.estimate.prepare import prepare_all  # noqa: E402
from motorlens_physics.estimate.report import findings  # noqa: E402
from motorlens_physics.recording import Recording  # noqa: E402

Array = NDArray[np.float64]

KINDS = ("steps", "ramps", "triangle", "one sinusoid", "two sinusoids", "chirp", "one start")
WRONG = 4.0


@dataclass(frozen=True)
class World:
    """A recording and what is true of it."""

    kind: str
    held: bool
    truth: dict[str, float]
    recording: Recording


def drive(kind: str, time: Array, rng: np.random.Generator) -> Array:
    """(N,) a voltage, or anything else that is driven, between -1 and 1."""
    last = time[-1]
    if kind == "steps":
        dwell = round(0.5 / (time[1] - time[0]))
        return np.repeat(rng.uniform(-1, 1, len(time) // dwell + 1), dwell)[: len(time)]
    if kind == "ramps":
        knots = np.arange(0, last + 2, rng.uniform(1, 2))
        return np.interp(time, knots, rng.uniform(-1, 1, len(knots)))
    if kind == "triangle":
        return 0.8 * (2 * np.abs(2 * ((time / rng.uniform(2, 5)) % 1) - 1) - 1)
    if kind == "one sinusoid":
        return 0.7 * np.sin(2 * np.pi * time / rng.uniform(1, 5))
    if kind == "two sinusoids":
        slow = 0.5 * np.sin(2 * np.pi * time / rng.uniform(2, 6))
        return slow + 0.3 * np.sin(2 * np.pi * time / rng.uniform(0.3, 1.5) + 1)
    if kind == "chirp":
        slow, fast = 0.1, rng.uniform(2, 10)
        return 0.6 * np.sin(2 * np.pi * (slow * time + (fast - slow) * time**2 / 2 / last))
    return np.full(len(time), rng.uniform(0.3, 0.9))


def world(seed: int, lasts: float = 0.0) -> World:
    """The one of a seed; with noise that lasts so many samples beside a quarter of white noise, if any."""
    rng = np.random.default_rng([417, seed])
    kind = str(rng.choice(KINDS))
    period_s, noise = float(rng.choice([0.001, 0.002, 0.005])), float(rng.choice([0.001, 0.003, 0.01]))
    samples = min(int(rng.uniform(6, 16) / period_s), 8000)
    held, warm, coarse = bool(rng.random() < 0.5), bool(rng.random() < 0.5), bool(rng.random() < 1 / 3)
    time, truth = np.arange(samples) * period_s, scattered(rng)
    voltage, load = RATED["voltage"] * drive(kind, time, rng), np.zeros(samples)
    if kind == "one start":
        load = RATED["load_torque"] * np.abs(drive(str(rng.choice(KINDS)), time, rng))
    states = simulated(truth, voltage, load, Test(period_s, samples, 1, held, noise))
    shown = {"voltage": voltage, "current": states[:, 0], "speed": states[:, 1]}
    if load.any():
        shown["load_torque"] = load
    if warm:
        shown["temperature"] = AMBIENT_C + states[:, 2]
    channels = {
        q: y + noise * RATED[q] * noisy(rng.standard_normal(samples), lasts) for q, y in shown.items()
    }
    if coarse:
        channels = {
            q: np.round(y / (3 * RATED[q] / 2**12)) * (3 * RATED[q] / 2**12) for q, y in channels.items()
        }
    channels["ambient"] = np.full(samples, AMBIENT_C)
    return World(kind, held, truth, Recording(f"{kind} {seed}", time, channels))


def noisy(white: Array, lasts: float) -> Array:
    """(N,) unit noise, of unit white noise."""
    if not lasts:
        return white
    keep = np.exp(-1 / lasts)
    drift = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white)
    # Drawn once, used twice: white noise is its own, later by half.
    return 0.5 * np.roll(white, len(white) // 2) + np.sqrt(0.75) * drift


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=140, help="how many")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument("--lasts", type=float, default=0.0, help="samples for which noise lasts; 0: white")
    parser.add_argument("--verbose", action="store_true", help="a line for every recording")
    arguments = parser.parse_args()
    rows: dict[str, list[tuple[bool, bool, list[float]]]] = {kind: [] for kind in KINDS}
    wrong: list[str] = []
    for seed in range(arguments.first, arguments.first + arguments.count):
        made = world(seed, arguments.lasts)
        found = estimate(FILE, prepare_all([made.recording], FILE))
        value, sd, said = found.fit.model.values(), found.fit.sd(), findings(found.fit)
        off = {k: (value[k] - made.truth[k]) / sd[k] for k in made.truth if k not in said.untold}
        told = found.fit.model.held[0][0] == made.held
        rows[made.kind].append((found.converged, told, list(off.values())))
        worst = max(off, key=lambda k: abs(off[k]))
        if abs(off[worst]) > WRONG and found.converged:
            wrong.append(f"{seed} ({made.kind}): {worst} {off[worst]:+.1f}")
        if arguments.verbose:
            print(f"{seed} {made.kind}, held {made.held}: converged {found.converged}, told right {told}, "
                  f"{worst} {off[worst]:+.1f} sd", flush=True)  # fmt: skip
    for kind, part in rows.items():
        if part:
            z = np.array([x for row in part for x in row[2]])
            print(f"{kind:14}{len(part):4} recordings, {sum(row[0] for row in part)} converge, how inputs ran told in "
                  f"{sum(row[1] for row in part)}; {np.mean(np.abs(z) <= 2):.1%} of {len(z)} within 2 sd, most "
                  f"{np.abs(z).max():.1f}")  # fmt: skip
    low, high = wilson(len(wrong), arguments.count)
    print(
        f"confidently wrong (beyond {WRONG:g} sd): {len(wrong)} of {arguments.count} ({low:.1%} to {high:.1%})"
    )
    for line in wrong:
        print(f"  {line}")


if __name__ == "__main__":
    main()
