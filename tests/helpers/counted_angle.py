"""Recordings of a logger that writes the voltage it commands and the counts of an encoder, by `plain_motor`'s integrator.

Every sample has its stamp in whole milliseconds, at steady or at uneven steps. At each the voltage may change, and holds
until the next; or it changes at any moment. What is counted is the angle of the shaft; no speed is written, and not always
a current.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from helpers.plain_motor import RATED, TYPICAL, Test, scattered, simulated
from numpy.typing import NDArray

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated

Array = NDArray[np.float64]

# What the motor file states, how far it is off at most, and how uneven steps of time are.
STATED, OFF, UNEVEN = ("R_a0", "L", "ke", "J"), 0.1, 0.25
# Parts of a millisecond in which the motor is simulated, and the noise of a current that is written, 1 sigma.
FINE, NOISE_A = 4, 0.05
PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip


@dataclass(frozen=True)
class Log:
    """What a logger wrote, and of which motor.

    Attributes:
        period_ms: between samples, the mean.
        uneven: whether steps of time vary.
        counts: of a revolution.
        current: whether it was written.
        between: whether the command changes at any moment, not at a sample.
        truth: the motor.
        file: what its file says.
        lines: the log, with a heading.
    """

    period_ms: int
    uneven: bool
    counts: int
    current: bool
    between: bool
    truth: dict[str, float]
    file: MotorFile
    lines: tuple[str, ...]

    @property
    def columns(self) -> tuple[str, ...]:
        """What `--column` is told."""
        return (f"angle=angle_counts[counts]/{self.counts}[counts/rev]",)

    def write(self, path: Path) -> Path:
        """The log as a file."""
        path.write_text("\n".join(self.lines) + "\n", encoding="utf-8")
        return path


def logged(seed: int, number: int, *, between: bool = False, samples: int = 2500) -> Log:
    """One of them; the command of another program changes `between` samples, and each shows what it then was."""
    rng = np.random.default_rng([seed, number])
    truth = scattered(rng)
    # As nimble as motors are whose rotor settles within a few samples.
    truth["J"] *= 10 ** rng.uniform(-1, 0)
    period_ms, counts = int(rng.choice([2, 5, 10, 20])), int(rng.choice([48, 512, 2048, 8192]))
    uneven, current, smooth, one_way = (bool(rng.integers(2)) for _ in range(4))
    least, most = (round(period_ms * (1 + sign * UNEVEN * uneven)) for sign in (-1, 1))
    stamps = np.cumsum(rng.integers(max(least, 1), most + 1, samples))
    dwell = int(rng.integers(600, 2000) / period_ms)
    at, fine = (stamps - stamps[0]) * FINE, (stamps[-1] + 1 - stamps[0]) * FINE
    if between:
        changes = np.sort(rng.choice(fine, samples // dwell, replace=False))
        levels = rng.uniform(-RATED["voltage"], RATED["voltage"], len(changes) + 1).round(1)
        driven = levels[np.searchsorted(changes, np.arange(fine), side="right")]
        voltage = driven[at]
    else:
        voltage = _voltage(rng, samples, dwell, smooth, one_way)
        driven = np.repeat(voltage, np.diff(at, append=fine))
    states = simulated(truth, driven, np.zeros(fine), Test(1e-3 / FINE, fine, 1, True, 0.0))
    speed = states[:, 1]
    turns = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]))) * 1e-3 / FINE / (2 * np.pi)
    channels = {
        "time_ms": stamps.astype(str),
        "voltage_V": voltage.astype(str),
        "angle_counts": np.floor(turns[at] * counts + rng.random()).astype(int).astype(str),
    }
    if current:
        shown = states[at, 0] + NOISE_A * rng.standard_normal(samples)
        channels["current_A"] = shown.round(3).astype(str)
    written = {
        key: truth[key] * rng.uniform(1 - OFF, 1 + OFF) if key in STATED else truth[key] for key in TYPICAL
    }
    known = {key: Knowledge(OFF * written[key], "rating plate") for key in STATED}
    lines = (",".join(channels), *(",".join(row) for row in zip(*channels.values(), strict=True)))
    return Log(
        period_ms,
        uneven,
        counts,
        current,
        between,
        truth,
        MotorFile("plate", Motor(**written), PLATE, knowledge=known),
        lines,
    )


def _voltage(rng: np.random.Generator, samples: int, dwell: int, smooth: bool, one_way: bool) -> Array:
    """(N,) steps, or the mean over half a step of such, V."""
    least = 0.0 if one_way else -RATED["voltage"]
    steps = np.repeat(rng.uniform(least, RATED["voltage"], samples // dwell + 1), dwell)
    if smooth:
        steps = np.convolve(steps, np.full(dwell // 2, 1 / (dwell // 2)), "same")
    return steps[:samples].round(1)
