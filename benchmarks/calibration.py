"""Calibration: speed, and whether two deviations hold what they promise.

    python benchmarks/calibration.py            200 synthetic motors (minutes)
    python benchmarks/calibration.py --quick    20 motors

Synthetic motors differ from the motor file they are calibrated from by up to 30 % in each of ten parameters. Each makes two
recordings: 6 s at 500 Hz and 83 min at 0.5 Hz of random voltages and loads, with noise of 0.05 A, 0.5 rad/s and 0.3 K. The
share of parameters within two deviations is 95.4 % for a perfect calibration. The speed is that of one motor with 90 000
rows in two recordings.
"""

import argparse
import sys
import time
from dataclasses import replace

import numpy as np

from motorlens_physics.calibration import calibrate
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated, parameters
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_physics.threads import cores

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
NOISE = {"current": 0.05, "speed": 0.5, "temperature": 0.3}
KEYS = tuple(parameters(Motor))
FILE = MotorFile("plate", Motor(), PLATE)


def scattered(rng: np.random.Generator) -> Motor:
    return replace(Motor(), **{key: getattr(Motor(), key) * rng.uniform(0.7, 1.3) for key in KEYS})


def record(motor: Motor, rng: np.random.Generator, dt: float, samples: int, hold: int) -> Recording:
    blocks = samples // hold + 1
    volts = np.repeat(rng.uniform(-240.0, 240.0, blocks), hold)[:samples]
    load = np.repeat(rng.uniform(0.0, 6.0, blocks), hold)[:samples] * np.sign(volts)
    run = simulate(motor, Inputs(np.arange(samples) * dt, volts, load, np.full(samples, 20.0), held=True))
    truth = {"current": run.current_A, "speed": run.speed_rad_s, "temperature": run.temperature_C}
    measured = {c: truth[c] + NOISE[c] * rng.standard_normal(samples) for c in NOISE}
    return Recording(f"{dt:g} s", run.inputs.time_s, {"voltage": volts, "load_torque": load} | measured)


def speed() -> None:
    rng = np.random.default_rng(0)
    truth = scattered(rng)
    recordings = [record(truth, rng, 2e-3, 60_000, 250), record(truth, rng, 1.0, 30_000, 600)]
    calibrate(FILE, [recordings[0].part(slice(0, 500))], KEYS, held=True)
    begun, busy = time.perf_counter(), time.process_time()
    found = calibrate(FILE, recordings, KEYS, held=True)
    clock, busy = time.perf_counter() - begun, time.process_time() - busy
    print(
        f"{len(KEYS)} parameters, 90 000 rows: {clock:.1f} s by the clock on {cores()} cores, {busy:.1f} s of processor "
        f"time, {found.iterations} steps from 30 % off"
    )


def coverage(motors: int) -> None:
    off, failed = [], 0
    for seed in range(motors):
        rng = np.random.default_rng(1000 + seed)
        truth = scattered(rng)
        recordings = [record(truth, rng, 2e-3, 3000, 250), record(truth, rng, 2.0, 2500, 100)]
        found = calibrate(FILE, recordings, KEYS, held=True)
        failed += not found.converged
        off.append([(found.value[key] - getattr(truth, key)) / found.sd[key] for key in KEYS])
        if seed % 20 == 19:
            print(f"{seed + 1} motors", file=sys.stderr)
    table = np.abs(np.array(off))
    inside = table <= 2
    print(f"{motors} motors, {failed} not converged; share of parameters within two deviations")
    for key, column in zip(KEYS, inside.T, strict=True):
        print(f"  {key:6} {column.mean():6.1%}")
    error = np.sqrt(inside.mean() * (1 - inside.mean()) / inside.size)
    print(
        f"  all    {inside.mean():6.1%} +- {error:.1%}; root mean square {np.sqrt(np.mean(table**2)):.2f} deviations"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="20 motors")
    speed()
    coverage(20 if parser.parse_args().quick else 200)


if __name__ == "__main__":
    main()
