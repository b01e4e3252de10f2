"""What one pass of a fit costs beside the plain simulation of the same inputs, in processor time.

    python benchmarks/sensitivities.py            90 s at 1 kHz and 3 h at 10 Hz
    python benchmarks/sensitivities.py --quick    a tenth of each

The inputs are those of a recording: noise on the voltage and the load, linear between samples. A pass is a simulation in
the smooth form with the derivatives to the textbook's ten parameters, the start temperature and two inputs, and the matrices
that the screen of effects needs; then the response to 60 forcings of the balances. One structure more is what a refit pays
when an effect joins the model: its machine code, made with an empty cache.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from motorlens_physics.effect import catalogue
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import parameters
from motorlens_physics.sensitivity import linearise_and_differentiate, sensitivities
from motorlens_physics.simulation import Inputs, simulate

KEYS = [*parameters(Motor), "initial.theta", "input.voltage", "input.load_torque"]
FORCINGS = 60


def recorded(seconds: float, rate_Hz: float) -> Inputs:
    """A duty cycle of steps of voltage and load, both with measurement noise."""
    rng = np.random.default_rng(0)
    time_s = np.arange(0.0, seconds, 1 / rate_Hz)
    step = (np.arange(time_s.size) / (max(seconds / 200, 0.5) * rate_Hz)).astype(int)
    volts = rng.uniform(40.0, 240.0, step[-1] + 1)[step] + 0.5 * rng.standard_normal(time_s.size)
    load = rng.uniform(0.0, 6.0, step[-1] + 1)[step] + 0.01 * rng.standard_normal(time_s.size)
    return Inputs(time_s, volts, load, np.full(time_s.size, 20.0))


def seconds(work: Callable[[], Any], repeats: int = 3) -> float:
    """The least processor time of some repetitions."""
    taken = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        taken.append(time.process_time() - start)
    return min(taken)


def one_pass(name: str, inputs: Inputs) -> None:
    """Print the costs for one recording."""
    motor = Motor()
    plain = seconds(lambda: simulate(motor, inputs, smooth=True))
    derived = seconds(lambda: sensitivities(motor, inputs, None, KEYS, smooth=True))
    whole = seconds(lambda: linearise_and_differentiate(motor, inputs, None, KEYS, smooth=True))
    _, _, linear = linearise_and_differentiate(motor, inputs, None, KEYS, smooth=True)
    forcing = np.random.default_rng(1).standard_normal((inputs.time_s.size, FORCINGS))
    screened = seconds(lambda: linear.respond(voltage_V=forcing, torque_Nm=forcing, heat_W=forcing), 2)
    print(
        f"{name}, {inputs.time_s.size} samples: plain {plain:.3f} s; {len(KEYS)} derivatives {derived:.3f} s "
        f"({derived / plain:.1f} times); with matrices {whole:.3f} s ({whole / plain:.1f} times); "
        f"response to {FORCINGS} forcings {screened:.3f} s ({screened / plain:.1f} times)"
    )


def compiling() -> None:
    """Print what structures cost whose machine code is not in the cache."""
    inputs = recorded(0.1, 100.0)
    start = time.process_time()
    sensitivities(Motor(), inputs, None, KEYS, smooth=True)
    print(f"the loops, once for a version on a machine: {time.process_time() - start:.1f} s")
    effects = catalogue()
    for names in (
        ("coulomb_friction",),
        ("coulomb_friction", "brush_voltage_drop", "two_node_thermal"),
        ("cogging_torque", "contact_resistance", "iron_core", "stribeck_friction"),
        tuple(effects),
    ):
        motor = Motor(effects=tuple(effects[name]() for name in names))
        start = time.process_time()
        simulate(motor, inputs, smooth=True)
        sensitivities(motor, inputs, None, KEYS, smooth=True)
        what = ", ".join(names) if len(names) < 5 else f"all {len(names)} effects at once"
        print(f"one structure more, {what}: {time.process_time() - start:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of each recording")
    share = 0.1 if parser.parse_args().quick else 1.0
    with tempfile.TemporaryDirectory() as empty:
        os.environ["XDG_CACHE_HOME"] = empty
        compiling()
        one_pass("90 s at 1 kHz", recorded(90.0 * share, 1000.0))
        one_pass("3 h at 10 Hz", recorded(10800.0 * share, 10.0))


if __name__ == "__main__":
    main()
