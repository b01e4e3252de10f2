"""Whether `compare` says that a model follows to the noise where nothing is missing, and how much has to be missing.

    python benchmarks/floors.py            100 recordings with nothing missing, 20 with a hidden friction
    python benchmarks/floors.py --quick    8 and 4

The motors are those of `calibration.py`, from an integrator of their own; the motor file is the motor's own, exactly. Every
recording has noise on all channels, voltage and load too, of 0.2, 1 or 3 % of their rated values; its inputs hold between
samples or run linearly; 6 s at 1 kHz, or 10 min at 10 Hz. The hidden friction is a larger b, of 5 % of the rated torque at
rated speed.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.plain_motor import RATED, Test, recorded, scattered  # noqa: E402

from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import MotorFile  # noqa: E402
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_physics.recording import Recording  # noqa: E402
from motorlens_workbench.compare.comparison import compare  # noqa: E402

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
LEVELS = (0.002, 0.01, 0.03)
RATES = {"1 kHz": (1e-3, 6000, 250), "10 Hz": (0.1, 6000, 150)}
HIDDEN = 0.05


def times_its_noise(seed: int, *, hidden: float) -> tuple[str, bool, dict[str, float]]:
    """What kind of recording, whether the model follows to the noise, and each channel's error in units of its floor."""
    rng = np.random.default_rng([2000, seed])
    noise, rate, held = LEVELS[seed % 3], list(RATES)[seed // 3 % 2], bool(seed // 6 % 2)
    truth = scattered(rng)
    file = MotorFile("exact", Motor(**truth), PLATE)
    more = truth | {"b": truth["b"] + hidden * RATED["load_torque"] / RATED["speed"]}
    kind = f"{noise:.1%} {rate} {'held' if held else 'linear'}"
    time_s, channels = recorded(more, Test(*RATES[rate], held, noise), rng)
    found = compare(file, [Recording(kind, time_s, channels)])
    return kind, found.follows, {name: c.times_noise for name, c in found.channels.items()}


def study(count: int, *, hidden: float, verbose: bool) -> None:
    begun, good, worst = time.process_time(), 0, []
    for seed in range(count):
        kind, followed, times = times_its_noise(seed, hidden=hidden)
        good += followed
        worst.append(max(times.values()))
        if verbose or followed == bool(hidden):
            said = ", ".join(f"{name} {x:.3f}" for name, x in times.items())
            print(
                f"  {seed} {kind}: {'follows' if followed else 'does not follow'}; in units of the floor: {said}",
                flush=True,
            )
    spent = (time.process_time() - begun) / count
    what = f"{hidden:.0%} of the rated torque missing" if hidden else "nothing missing"
    print(
        f"{what}: the model follows to the noise in {good} of {count}; largest error over floor, median "
        f"{np.median(worst):.3f}, most {max(worst):.3f}; {spent:.2f} s of processor time each"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="8 and 4 recordings")
    parser.add_argument("--count", type=int, default=100, help="recordings with nothing missing")
    parser.add_argument("--verbose", action="store_true", help="a line for every recording")
    arguments = parser.parse_args()
    study(8 if arguments.quick else arguments.count, hidden=0.0, verbose=arguments.verbose)
    study(4 if arguments.quick else max(arguments.count // 5, 1), hidden=HIDDEN, verbose=arguments.verbose)


if __name__ == "__main__":
    main()
