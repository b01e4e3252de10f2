"""Nothing is missing, and the speed is counted from an encoder: what `diagnose` says, and how right the motor is.

    python benchmarks/encoder.py --count 40 --seed 1

Two motors, of 240 V and of 24 V, each parameter off by up to 30 %, by the integrator of the tests (other code); the motor
file is off by up to 10 %, and says so. Random steps of a voltage that is held from sample to sample. A controller counts the
edges of an encoder and divides their difference by its period: a mean over it, in whole edges, of which none is lost.
Voltage and current have white noise. Some 10 s of processor time a world.
"""

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.hidden.score import Rate  # noqa: E402
from helpers.nothing_missing import coverage, told, verdicts  # noqa: E402
from helpers.plain_motor import TYPICAL, Test, simulated  # noqa: E402

from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import Knowledge, MotorFile  # noqa: E402
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_physics.recording import Recording  # noqa: E402
from motorlens_workbench.diagnose import diagnose  # noqa: E402

SMALL = {
    "R_a0": 2.3, "L": 9e-4, "ke": 0.03, "J": 2e-5, "b": 1.5e-5, "alpha": 0.0039, "k0": 0.25, "kT": 1e-4, "k_ir": 1e-7,
    "H": 12.0,
}  # fmt: skip
MOTORS = {"240 V": (TYPICAL, 240.0), "24 V": (SMALL, 24.0)}
# What a motor file states, and how far it and the motor are off.
STATED, OFF, SCATTER = ("R_a0", "L", "ke", "J"), 0.1, 0.3
RATES_HZ, LINES, EDGES = (100.0, 200.0, 500.0, 1000.0), (100, 500, 2500), 4
SAMPLES, FINE = 6000, 20
NOISE_V, NOISE_A = 0.001, 0.003  # of the rated voltage, and of the current of a locked rotor


@dataclass(frozen=True)
class World:
    """A recording and what is true of it: its motor, the angle (N,) of its shaft, and where in an edge that begins."""

    motor: str
    rate_Hz: float
    lines: int
    file: MotorFile
    recording: Recording
    truth: dict[str, float]
    angle: np.ndarray
    phase: float


def world(seed: int, number: int) -> World:
    """One of them, with a speed that is counted."""
    one = turned(seed, number)
    edge, period_s = 2 * np.pi / (EDGES * one.lines), 1 / one.rate_Hz
    counted = np.diff(np.floor(one.angle / edge + one.phase), prepend=0.0) * edge / period_s
    return replace(
        one, recording=replace(one.recording, channels=one.recording.channels | {"speed": counted})
    )


def turned(seed: int, number: int) -> World:
    """One of them, with the true speed."""
    rng = np.random.default_rng([seed, number])
    name = str(rng.choice(list(MOTORS)))
    typical, volts = MOTORS[name]
    rate_Hz, lines = float(rng.choice(RATES_HZ)), int(rng.choice(LINES))
    truth = {key: value * rng.uniform(1 - SCATTER, 1 + SCATTER) for key, value in typical.items()}
    voltage = np.zeros(0)
    while len(voltage) < SAMPLES:
        dwell = int(rng.uniform(0.2, 1.5) * rate_Hz)
        voltage = np.append(voltage, np.full(dwell, rng.uniform(-volts, volts)))
    voltage, period_s = voltage[:SAMPLES], 1 / rate_Hz
    fine = Test(period_s / FINE, SAMPLES * FINE, 1, True, 0.0)
    states = simulated(truth, np.repeat(voltage, FINE), np.zeros(SAMPLES * FINE), fine)
    speed = states[:, 1]
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1])) * fine.period_s])[::FINE]
    phase = float(rng.random())
    channels = {
        "voltage": voltage + NOISE_V * volts * rng.standard_normal(SAMPLES),
        "current": states[::FINE, 0] + NOISE_A * volts / truth["R_a0"] * rng.standard_normal(SAMPLES),
        "speed": speed[::FINE],
    }
    written = {key: value * rng.uniform(1 - OFF, 1 + OFF) for key, value in truth.items()}
    rated = Rated(
        voltage_V=volts, current_A=0.1 * volts / typical["R_a0"], speed_rad_s=0.9 * volts / typical["ke"],
        torque_Nm=0.09 * typical["ke"] * volts / typical["R_a0"], rise_K=60.0,
    )  # fmt: skip
    known = {key: Knowledge(OFF * written[key], "rating plate") for key in STATED}
    recording = Recording("counted.csv", np.arange(SAMPLES) * period_s, channels)
    return World(
        name,
        rate_Hz,
        lines,
        MotorFile("plate", Motor(**written), rated, knowledge=known),
        recording,
        truth,
        angle,
        phase,
    )


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    every, averaged = [], 0
    print("motor  rate     lines  edge a sample  mean verdict        R, L, ke, J off by so many sd")
    for number in range(args.count):
        one, began = world(args.seed, number), time.process_time()
        found = diagnose(one.file, [one.recording])
        every.append(told(found, one.truth, STATED))
        mean = found.base.runs[0].mean_speed
        averaged += mean
        edge = 2 * np.pi / (EDGES * one.lines) * one.rate_Hz
        print(
            f"{one.motor:6s} {one.rate_Hz:4.0f} Hz {one.lines:5d} {edge:8.3g} rad/s  {'yes' if mean else 'no':4s}"
            f" {every[-1].row}  {time.process_time() - began:4.0f} s",
            flush=True,
        )
    print(verdicts(every))
    print(f"speed taken as a mean: {Rate(averaged, args.count)}")
    print(coverage(every))
    return 0


if __name__ == "__main__":
    sys.exit(main())
