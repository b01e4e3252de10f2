"""Whether `compare` says that a model follows to the noise where nothing is missing, and how much has to be missing.

    python benchmarks/floors.py            100 recordings with nothing missing, 20 with a hidden friction, 4 in every command
    python benchmarks/floors.py --quick    8, 4 and 1

The motors are those of `calibration.py`, from an integrator of their own; the motor file is the motor's own, exactly. Every
recording has noise on all channels, voltage and load too, of 0.2, 1 or 3 % of their rated values; its inputs hold between
samples or run linearly; 6 s at 1 kHz, or 10 min at 10 Hz. The hidden friction is a larger b, of 5 % of the rated torque at
rated speed. What it truly changes, and the true floor, come from simulations of both motors, along the inputs with
and without their noise: a model follows where the true error over the true floor is less than `FOLLOWS`.

Of a few recordings the floors of `compare`, `diagnose`, `add` and `remove` are compared, and the errors that `add --judge`
and `compare` state of one motor file.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.plain_motor import RATED, Array, Test, recorded, scattered, simulated  # noqa: E402

from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import MotorFile  # noqa: E402
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_physics.recording import Recording  # noqa: E402
from motorlens_workbench.compare.comparison import FOLLOWS, compare  # noqa: E402
from motorlens_workbench.diagnose import diagnose  # noqa: E402
from motorlens_workbench.ladder import add, remove  # noqa: E402

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
LEVELS = (0.002, 0.01, 0.03)
RATES = {"1 kHz": (1e-3, 6000, 250), "10 Hz": (0.1, 6000, 150)}
HIDDEN = 0.05
CHANNELS = ("current", "speed", "temperature")


def drawn(seed: int, hidden: float) -> tuple[MotorFile, Recording, dict[str, float]]:
    """The motor's file, a recording of it with some friction more, and each channel's true error over its true floor."""
    rng = np.random.default_rng([2000, seed])
    noise, rate, held = LEVELS[seed % 3], list(RATES)[seed // 3 % 2], bool(seed // 6 % 2)
    truth = scattered(rng)
    more = truth | {"b": truth["b"] + hidden * RATED["load_torque"] / RATED["speed"]}
    test, after = Test(*RATES[rate], held, noise), rng.bit_generator.state
    time_s, channels = recorded(more, test, rng)
    rng.bit_generator.state = after
    clean = recorded(more, replace(test, noise=0.0), rng)[1]
    lacking = _states(truth, clean, test) - _states(more, clean, test)
    stirred = _states(truth, channels, test) - _states(truth, clean, test)
    own = noise * np.array([RATED[name] for name in CHANNELS])
    times = np.sqrt(1 + np.mean(lacking**2, axis=0) / (np.mean(stirred**2, axis=0) + own**2))
    kind = f"{noise:.1%} {rate} {'held' if held else 'linear'}"
    file = MotorFile("exact", Motor(**truth), PLATE)
    return file, Recording(kind, time_s, channels), dict(zip(CHANNELS, times.tolist(), strict=True))


def _states(motor: dict[str, float], channels: dict[str, Array], test: Test) -> Array:
    return simulated(motor, channels["voltage"], channels["load_torque"], test)


def study(count: int, *, hidden: float, verbose: bool) -> None:
    begun, good, right, worst = time.process_time(), 0, 0, []
    for seed in range(count):
        file, recording, true = drawn(seed, hidden)
        found = compare(file, [recording])
        times = {name: c.times_noise for name, c in found.channels.items()}
        good += found.follows
        right += found.follows == (max(true.values()) < FOLLOWS)
        worst.append(max(times.values()))
        if verbose or found.follows == bool(hidden):
            said = ", ".join(f"{name} {x:.3f} (truly {true[name]:.3f})" for name, x in times.items())
            verdict = "follows" if found.follows else "does not follow"
            print(f"  {seed} {recording.name}: {verdict}; in units of the floor: {said}", flush=True)
    spent = (time.process_time() - begun) / count
    what = f"{hidden:.0%} of the rated torque missing" if hidden else "nothing missing"
    print(
        f"{what}: the model follows to the noise in {good} of {count}; largest error over floor, median "
        f"{np.median(worst):.3f}, most {max(worst):.3f}; said as it truly is in {right}; "
        f"{spent:.2f} s of processor time each"
    )


def every_command(count: int) -> None:
    """How far the floors of the commands are from that of `compare`, and `add --judge` from `compare`, largest shares."""
    apart: dict[str, float] = {}
    judged = 0.0
    for seed in range(count):
        file, recording, _ = drawn(seed, HIDDEN)
        found = diagnose(file, [recording])
        with_it = add(file, ["coulomb_friction"], [recording], [recording])
        last = with_it.rungs[-1]
        without = remove(last.file, ["coulomb_friction"], [recording])
        here = compare(last.file, [recording])
        judged = max(judged, *(abs(last.judged[name] / c.rmse - 1) for name, c in here.channels.items()))
        floors = {
            "diagnose": found.outcome.last.floor,
            "add": with_it.noise_floor,
            "remove": without.noise_floor,
        }
        for command, floor in floors.items():
            off = max(abs(floor[name] / c.noise_floor - 1) for name, c in here.channels.items())
            apart[command] = max(apart.get(command, 0.0), off)
    said = ", ".join(f"{command} {off:.2%}" for command, off in apart.items())
    print(
        f"floors of {count} recordings, farthest from that of compare: {said}; errors of add --judge: {judged:.2%}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="8, 4 and 1 recordings")
    parser.add_argument("--count", type=int, default=100, help="recordings with nothing missing")
    parser.add_argument("--verbose", action="store_true", help="a line for every recording")
    arguments = parser.parse_args()
    study(8 if arguments.quick else arguments.count, hidden=0.0, verbose=arguments.verbose)
    study(4 if arguments.quick else max(arguments.count // 5, 1), hidden=HIDDEN, verbose=arguments.verbose)
    every_command(1 if arguments.quick else 4)


if __name__ == "__main__":
    main()
