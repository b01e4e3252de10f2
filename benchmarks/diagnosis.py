"""How long `motorlens diagnose` takes on one minute at 500 Hz and one hour at 1 Hz, cold and warm.

    python benchmarks/diagnosis.py            nothing hidden, friction, friction and a brush drop (minutes)
    python benchmarks/diagnosis.py --quick    friction only

The recordings come from the generator of the blind benchmark, which shares no code with the model. Cold means that the
caches of machine code are empty, as on a fresh machine; warm, that the same command has run before. Seconds are those a user
waits, Python's start and the reading of the files included, and beside them the processor's; those of the screen are from
its line of progress to the next. They count only on a machine that does nothing else: the load at the start is printed.

The peer is what one would write with scipy for the first step alone, the fit of the textbook's ten parameters: solve_ivp
(LSODA) in least_squares, on the first tenth of each recording. Its ratio is to the first step of the diagnosis.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.hidden import Case, generate_experiment  # noqa: E402

# The last sample of 30 000 at 500 Hz and of 3600 at 1 Hz.
TESTS = {"load_steps": 59.998, "heat_soak": 3599.0}
FRICTION = {"name": "coulomb_friction", "size": 0.0188, "shape": {}}
BRUSHES = {"name": "brush_voltage_drop", "size": 0.24, "shape": {"brush_i": 0.16}}
HIDDEN = {"nothing": [], "friction": [FRICTION], "friction, brushes": [FRICTION, BRUSHES]}


@dataclass(frozen=True)
class Timing:
    """Seconds of one diagnosis: `base_fit` and `screen` between lines of progress, the others of the whole process."""

    verdict: str
    base_fit: float
    screen: float
    whole: float
    processor: float


def recordings(name: str, folder: Path) -> tuple[list[Path], Path, Case]:
    """The two recordings and the motor file of a case."""
    case = Case(id=name, seed=4, motor="servo_24V", kind="none", noise=0.01, small=True)
    truth = {"case": case.as_json(), "hidden": HIDDEN[name]}
    folder.mkdir()
    motor = case.of_motor().write_datasheet(folder / "motor.toml")
    return [generate_experiment(truth, test, seconds, folder) for test, seconds in TESTS.items()], motor, case


def diagnosed(paths: list[Path], motor: Path, cache: Path) -> Timing:
    """Run the command as a user does, and time it by its lines of progress."""
    told = motor.with_name("told.json")
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "NUMBA_CACHE_DIR": str(cache / "numba")}
    words = [
        str(Path(sys.executable).with_name("motorlens")),
        "diagnose",
        *map(str, paths),
        "--motor",
        str(motor),
        "--json",
        str(told),
    ]
    spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    begun = time.monotonic()
    stamps: list[tuple[float, str]] = []
    with subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as process:
        assert process.stderr is not None and process.stdout is not None
        for line in process.stderr:
            stamps.append((time.monotonic() - begun, line))
        process.stdout.read()
    whole = time.monotonic() - begun
    if process.returncode:
        raise SystemExit("".join(line for _, line in stamps))
    begins = [at for at, _ in stamps] + [whole]
    screen = next(k for k, (_, line) in enumerate(stamps) if "weighing every" in line)
    processor = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - spent
    return Timing(
        json.loads(told.read_text(encoding="utf-8"))["verdict"],
        begins[screen] - begins[0],
        begins[screen + 1] - begins[screen],
        whole,
        processor,
    )


def scipy_base_fit(paths: list[Path], motor: Mapping[str, float]) -> float:
    """Seconds of a fit of the textbook's parameters to a tenth of each recording by scipy alone."""
    tables = [np.genfromtxt(path, delimiter=",", names=True) for path in paths]
    tables = [table[: len(table) // 10] for table in tables]
    start = np.array([motor[name] for name in ("R", "L", "ke", "J", "b", "alpha", "k0", "kT", "k_ir", "H")])

    def run(p: np.ndarray, d: np.ndarray) -> np.ndarray:
        R, L, ke, J, b, alpha, k0, kT, k_ir, H = p
        time_s, volts, load = d["time_s"], d["voltage_V"], d["load_torque_Nm"]

        def rates(t: float, x: np.ndarray) -> list[float]:
            i, w, theta = x
            v, torque = np.interp(t, time_s, volts), np.interp(t, time_s, load)
            hot = R * (1 + alpha * theta)
            heat = hot * i * i + k_ir * w * w - k0 * (1 + kT * abs(w)) * theta
            return [(v - hot * i - ke * w) / L, (ke * i - b * w - torque) / J, heat / H]

        found = solve_ivp(
            rates, (time_s[0], time_s[-1]), [0.0, 0.0, 0.0], "LSODA", t_eval=time_s, rtol=1e-6, atol=1e-6,
            max_step=5 * (time_s[1] - time_s[0]),
        )  # fmt: skip
        return found.y.T

    def residual(factors: np.ndarray) -> np.ndarray:
        left = []
        for d in tables:
            shown = np.column_stack([d["current_A"], d["speed_rad_s"], d["temperature_C"] - d["ambient_C"]])
            left.append(((run(start * factors, d) - shown) / shown.std(axis=0)).ravel())
        return np.concatenate(left)

    begun = time.monotonic()
    least_squares(residual, np.ones(len(start)), bounds=(0.3, 3.0), max_nfev=4)
    return time.monotonic() - begun


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="one case, and no peer")
    arguments = parser.parse_args()
    print(f"load of the machine before: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    print(
        f"{'hidden':20s}{'cache':8s}{'base fit':>10s}{'screen':>10s}{'whole':>10s}{'processor':>11s}  s   verdict"
    )
    with tempfile.TemporaryDirectory(prefix="diagnosis-") as scratch:
        for name in ("friction",) if arguments.quick else HIDDEN:
            paths, motor, case = recordings(name, Path(scratch) / name.replace(", ", "_"))
            cache = Path(scratch) / "cache" / name
            cache.mkdir(parents=True)
            for state in ("cold", "warm"):
                found = diagnosed(paths, motor, cache)
                figures = (found.base_fit, found.screen, found.whole, found.processor)
                print(
                    f"{name:20s}{state:8s}"
                    + "".join(f"{s:10.1f}" for s in figures)
                    + f"      {found.verdict}",
                    flush=True,
                )
        if not arguments.quick:
            peer = scipy_base_fit(paths, case.of_motor().textbook)
            print(f"scipy, base fit, a tenth of the samples, four rounds at most: {peer:.1f} s", end="")
            print(f"; per sample {10 * peer / found.base_fit:.0f} times the warm base fit")


if __name__ == "__main__":
    main()
