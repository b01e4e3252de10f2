"""Calibration: whether two standard deviations hold what they promise.

    python benchmarks/calibration.py            200 motors at each of four noise levels, the README's tour on 20 seeds
    python benchmarks/calibration.py --quick    20 motors, 4 seeds

The motors differ from the motor file they are calibrated from by up to 30 % in each of ten parameters and come from an
integrator of its own (`tests/helpers/plain_motor.py`). The file says so: what was known before must be true for intervals to
hold what they promise, where recordings tell little more. For the same reason the room's temperature is recorded. Each makes
one recording of random voltages and loads: 6 s at 1 kHz or 20 min at 10 Hz, with inputs that hold between samples or run
linearly, in turn. All channels are noisy, voltage and load too, by 0, 0.2, 1 or 3 % of their rated values, white unless
`--colour` is given; nothing is told about the noise, the inputs or the start. Of every parameter that is not said to be
unidentified the share within two deviations is 95.4 % for a perfect calibration; Wilson's 95 % interval stands beside it.
"""

import argparse
import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL, Test, recorded, scattered  # noqa: E402

from motorlens_physics.estimate.estimate import Estimate, estimate  # noqa: E402
from motorlens_physics.estimate.prepare import prepare_all  # noqa: E402
from motorlens_physics.estimate.prior import base_prior  # noqa: E402
from motorlens_physics.estimate.report import findings  # noqa: E402
from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import Knowledge, MotorFile, read_motor_file  # noqa: E402
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_physics.recording import Recording, read_recording  # noqa: E402

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
# Up to 30 % off, each equally often.
SPREAD = 0.3 / np.sqrt(3)
FILE = MotorFile(
    "plate",
    Motor(**TYPICAL),
    PLATE,
    knowledge={key: Knowledge(SPREAD * y, "plate") for key, y in TYPICAL.items()},
)
LEVELS = (0.0, 0.002, 0.01, 0.03)
RATES = {"1 kHz": (1e-3, 6000, 250), "10 Hz": (0.1, 12_000, 150)}
WAYS = {"held": True, "linear": False}
TOUR = Path("models/motors/mellah2016.toml")


def one_motor(
    seed: int, noise: float, rate: str, way: str, colour: float = 0.0, first: int = 1000
) -> tuple[Estimate, dict[str, float], float]:
    """The estimate, the true values, and the seconds of processor time."""
    rng = np.random.default_rng([first + seed, round(1e4 * noise)])
    truth = scattered(rng)
    time_s, channels = recorded(truth, Test(*RATES[rate], WAYS[way], noise, colour), rng)
    channels["ambient"] = AMBIENT_C + noise * RATED["temperature"] * rng.standard_normal(len(time_s))
    runs = prepare_all([Recording(f"{rate}, {way}", time_s, channels)], FILE)
    begun = time.process_time()
    found = estimate(FILE, runs, base_prior(FILE, runs))
    return found, truth, time.process_time() - begun


def wilson(hits: int, of: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""
    z, share = 1.96, hits / of
    middle = (share + z**2 / (2 * of)) / (1 + z**2 / of)
    half = z / (1 + z**2 / of) * np.sqrt(share * (1 - share) / of + z**2 / (4 * of**2))
    return middle - half, middle + half


def table(off: Sequence[dict[str, float]]) -> None:
    """Per parameter: identified in how many, share within two deviations, root mean square and largest deviation."""
    for key in TYPICAL:
        z = np.array([row[key] for row in off if key in row])
        if not len(z):
            print(f"  {key:6} not identified")
            continue
        inside = int(np.sum(np.abs(z) <= 2))
        low, high = wilson(inside, len(z))
        print(
            f"  {key:6} {inside / len(z):6.1%} ({low:.1%} to {high:.1%}) within 2 sd of {len(z)} identified, "
            f"{len(off) - len(z)} not; rms {np.sqrt(np.mean(z**2)):.2f}, mean {np.mean(z):+.2f}, most {np.abs(z).max():.1f}"
        )


def coverage(
    noise: float, motors: int, verbose: bool, cells: Sequence[str], colour: float, first: int
) -> None:
    rows: dict[str, list[dict[str, float]]] = {}
    failed, wrong, spent = 0, 0, 0.0
    for seed in range(motors):
        rate, way = list(RATES)[seed % 2], list(WAYS)[seed // 2 % 2]
        if cells and f"{rate} {way}" not in cells:
            continue
        found, truth, seconds = one_motor(seed, noise, rate, way, colour, first)
        spent += seconds
        failed += not found.converged
        said = findings(found.fit)
        value, sd = found.fit.model.values(), found.fit.sd()
        off = {key: (value[key] - truth[key]) / sd[key] for key in TYPICAL if key not in said.untold}
        held = found.fit.model.held[0]
        wrong += held[:2] != (WAYS[way],) * 2
        rows.setdefault(f"{rate}, {way}", []).append(off)
        if verbose:
            print(
                f"{noise:.1%} {rate:6} {way:6} seed {seed} {seconds:.1f} s, converged {found.converged}, held {held[:2]}, "
                f"outliers {found.outliers}: " + " ".join(f"{k} {v:+.1f}" for k, v in off.items()),
                flush=True,
            )
    everything = [row for part in rows.values() for row in part]
    print(f"noise {noise:.1%}: {len(everything)} motors, {failed} not converged, {wrong} with an input taken to run "
          f"differently from how it did, {spent / len(everything):.2f} s of processor time each")  # fmt: skip
    for name, part in rows.items():
        z = np.array([x for row in part for x in row.values()])
        print(f"  {name}: {np.mean(np.abs(z) <= 2):.1%} of {len(z)} within 2 sd")
    table(everything)


def tour(seeds: int) -> None:
    """The README's first two commands."""
    from motorlens_physics.commands.simulate import add_arguments, run

    parser = argparse.ArgumentParser()
    add_arguments(parser)
    file = read_motor_file(TOUR)
    worst: dict[str, float] = {}
    good = 0
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(seeds):
            path = str(Path(folder) / "tour.csv")
            line = [str(TOUR), "--scenario", "load_steps", "--noise", "0.2%", "--seed", str(seed), "-o", path]
            with contextlib.redirect_stdout(io.StringIO()):
                run(parser.parse_args(line))
            runs = prepare_all([read_recording(path)], file)
            found = estimate(file, runs, base_prior(file, runs))
            values, truth, sd = found.fit.model.values(), file.values(), found.fit.sd()
            off = {key: (values[key] - truth[key]) / sd[key] for key in truth if key in sd}
            good += max(map(abs, off.values())) <= 3
            worst = {key: max(worst.get(key, 0.0), abs(x)) for key, x in off.items()}
    print(
        f"the README's tour: all parameters within 3 sd in {good} of {seeds} seeds; farthest of each, in sd:"
    )
    print("  " + ", ".join(f"{key} {x:.2f}" for key, x in worst.items()))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="20 motors, 4 seeds")
    parser.add_argument("--motors", type=int, help="how many motors at each level")
    parser.add_argument("--seed", type=int, default=1000, help="of the first motor")
    parser.add_argument("--levels", type=float, nargs="*", default=LEVELS, help="noise levels, as shares")
    parser.add_argument("--cells", nargs="*", default=(), help='only these, such as "1 kHz held"')
    parser.add_argument(
        "--colour", type=float, default=0.0, help="correlation of neighbouring samples of the inputs' noise"
    )
    parser.add_argument("--no-tour", action="store_true", help="leave the tour out")
    parser.add_argument("--verbose", action="store_true", help="a line for every motor")
    arguments = parser.parse_args()
    motors = arguments.motors or (20 if arguments.quick else 200)
    for level in arguments.levels:
        coverage(level, motors, arguments.verbose, arguments.cells, arguments.colour, arguments.seed)
    if not arguments.no_tour:
        tour(4 if arguments.quick else 20)


if __name__ == "__main__":
    main()
