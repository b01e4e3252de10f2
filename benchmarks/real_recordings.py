"""Real motors: what the workbench says of other people's recordings, and how far the error falls on those not fitted.

example:
  python benchmarks/real_recordings.py ../shared/recordings

Everything goes through the ordinary commands (`diagnose`, `add`), one block per motor. The recordings are not part of this
repository: their sources are named in the README of that folder. Without the folder there is nothing to do, and status 0.
"""

import argparse
import contextlib
import gzip
import io
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.signal import butter, filtfilt

from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_runtime.cli import main as motorlens

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
WHEEL = EXAMPLES / "hidden_effect" / "regbot.toml"
MOTORS = EXAMPLES / "real_recordings"
# Of EMPS, by its owners (README of the recordings); their friction turns at once.
PUBLISHED = {
    "J": 0.0951, "b": 0.2035, "coulomb_friction.tau_c": 0.0204, "coulomb_friction.w_s": 1e-3,
    "constant_torque.tau_0": -0.00316,
}  # fmt: skip


def side(letter: str) -> list[str]:
    return [
        f"--column=voltage=v{letter}_V",
        f"--column=current=i{letter}_A",
        f"--column=speed=w{letter}_rad_s",
    ]


def quietly(words: Sequence[str]) -> int:
    """The status of a command; what it says is printed where it fails."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        status = motorlens(list(words))
    if status != 0:
        print(said.getvalue(), end="", flush=True)
    return status


def diagnose(recordings: Sequence[Path], motor: Path, *options: str) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "answer.json"
        words = ["diagnose", *map(str, recordings), "--motor", str(motor), *options, "--json", str(path)]
        status = quietly(words)
        return (
            json.loads(path.read_text()) if status == 0 else {"verdict": f"status {status}", "sentence": ""}
        )


def add(
    effects: Sequence[str], fitted: Sequence[Path], judge: Sequence[Path], motor: Path, *options: str
) -> list[dict]:
    """The ladder: the textbook first, then each effect."""
    with tempfile.TemporaryDirectory() as folder:
        rungs: list[dict] = []
        for k, effect in enumerate(effects):
            better, path = Path(folder) / f"{k}.toml", Path(folder) / f"{k}.json"
            words = [
                "add",
                effect,
                "--motor",
                str(motor),
                "--fit",
                *map(str, fitted),
                "--judge",
                *map(str, judge),
            ]
            status = quietly([*words, *options, "-o", str(better), "--json", str(path)])
            rungs = json.loads(path.read_text())["ladder"] if path.exists() else rungs
            if status != 0:
                break
            motor = better
        return rungs


def tell(motor: str, answer: dict) -> None:
    print(f"\n## {motor}: {answer['verdict']}\n{answer['sentence']}", flush=True)
    if "separating_experiment" in answer:
        print(f"experiment: {answer['separating_experiment']['why']}")
    if "unknown_shape" in answer:
        shape = answer["unknown_shape"]
        print(f"shape against {shape['against']}, {shape['unit']}: {[round(y, 3) for y in shape['y']]}")


def ladder(title: str, rungs: Sequence[dict], channel: str, unit: str) -> None:
    print(f"\n{title} ({unit}; on recordings not fitted, relative to the textbook)")
    for rung in rungs:
        error, first = rung["judged"][channel], rungs[0]["judged"][channel]
        print(
            f"  {rung['added'] or 'textbook':<24}{error:8.3f}{100 * (error / first - 1):8.1f} %", flush=True
        )


def regbot(folder: Path) -> None:
    robots = {n: folder / "regbot" / f"robot_{n:02d}.csv" for n in (1, 3, 4, 5, 10)}
    fitted, judge = [robots[1], robots[4]], [robots[3], robots[5], robots[10]]
    tell("regbot, left wheels of robots 01 and 04", diagnose(fitted, WHEEL, *side("L")))
    tell("regbot, right wheel of robot 10", diagnose([robots[10]], WHEEL, *side("R")))
    both = ["coulomb_friction", "brush_voltage_drop"]
    rungs = add(both, fitted, judge, WHEEL, *side("L"))
    ladder("regbot, free-run speed of robots 03, 05 and 10, nothing fitted", rungs, "speed", "rad/s")
    for n in (3, 5, 10):
        rungs = add(both, fitted, [robots[n]], WHEEL, *side("L"))
        ladder(f"regbot, free-run speed of robot {n:02d} alone", rungs, "speed", "rad/s")
    rungs = add(both, fitted, judge, WHEEL, *side("L"), "--differing", "ke")
    ladder("regbot, the same, ke of each robot its own (blocks of time held out)", rungs, "speed", "rad/s")


def fra233(folder: Path) -> None:
    runs = {
        n: folder / "fra233" / f"studyV4_{n}_1.csv.gz" for n in ("Chirp", "Stair", "Ramp", "Sine", "Step")
    }
    fitted = [runs["Chirp"], runs["Stair"]]
    tell("fra233, chirp and stair, voltage and speed only", diagnose(fitted, MOTORS / "fra233.toml"))
    rungs = add(["coulomb_friction"], fitted, [runs["Ramp"]], MOTORS / "fra233.toml")
    ladder("fra233, free-run speed of the ramp", rungs, "speed", "rad/s")


def ksu_thermal(folder: Path) -> None:
    runs = sorted((folder / "ksu_thermal").glob("Spike-Mega-*.csv"))
    fitted, judge = runs[0::2], runs[1::2]
    options = ["--driven", "--column=temperature=4LHE Temp (ºF)", "--column=ambient=66NA Temp (ºF)"]
    tell("ksu_thermal, Mega, one run of each day", diagnose(fitted, MOTORS / "mega.toml", *options))
    rungs = add(["iron_core"], fitted, judge, MOTORS / "mega.toml", *options)
    ladder("ksu_thermal, coil, the other run of each day", rungs, "temperature", "degC")


def undcmotor(folder: Path) -> None:
    names = ("prbs_open", "step_closed", "stairs_closed", "profile_closed")
    runs = [folder / "undcmotor" / f"DCmotor_{name}_exp.csv" for name in names]
    answer = diagnose(runs, MOTORS / "undcmotor.toml", "--column=voltage=u", "--column=speed_deg_s=y")
    tell("undcmotor, open and closed loop", answer)


def emps(folder: Path) -> None:
    """A drive of which the owners' estimates are published: 1 "N m" is 1 kN."""
    run, motor = folder / "emps" / "train_iw.csv.gz", folder / "emps" / "emps.toml"
    tell("emps, published: Coulomb friction 20.4 N, offset 3.2 N", diagnose([run], motor))
    with tempfile.TemporaryDirectory() as place:
        half, models = Path(place) / "half.csv", [motor]
        rows = gzip.decompress(run.read_bytes()).decode().splitlines()
        half.write_text("\n".join(rows[: len(rows) // 2]) + "\n")
        for effect in ("coulomb_friction", "constant_torque"):
            models.append(Path(place) / f"{effect}.toml")
            words = ["--motor", str(models[-2]), "--fit", str(half), "-o", str(models[-1])]
            if quietly(["add", effect, *words]) != 0:
                print(f"emps, the first half alone does not support {effect}", flush=True)
                models.pop()
                break
        for model in models[1:]:
            share = _force_off(read_motor_file(model), rows)
            print(f"emps, fitted to the first half, + {model.stem}: force {share:.1%} off in the second")
        if len(models) == 3:
            share = _force_off(read_motor_file(models[-1]).with_values(PUBLISHED), rows)
            print(f"emps, as published, fitted to all of it: force {share:.1%} off in the second", flush=True)


def _force_off(file: MotorFile, rows: Sequence[str]) -> float:
    """Share of the force of the second half that a motor file's mechanical equation leaves, everything below 60 Hz."""
    time, volts, _, speed = np.array([[float(y) for y in row.split(",")] for row in rows[1:]]).T
    value, slope = file.values(), np.gradient(speed, time)
    friction = value["coulomb_friction.tau_c"] * np.tanh(speed / value["coulomb_friction.w_s"])
    needed = value["J"] * slope + value["b"] * speed + friction + value.get("constant_torque.tau_0", 0.0)
    force = value["ke"] / value["R_a0"] * (volts - value["ke"] * speed)
    low = butter(4, 60.0, fs=1 / np.median(np.diff(time)))
    off, whole = (filtfilt(*low, y)[len(time) // 2 :] for y in (force - needed, force))
    return float(np.linalg.norm(off) / np.linalg.norm(whole))


STUDIES = {
    "regbot": regbot,
    "fra233": fra233,
    "ksu_thermal": ksu_thermal,
    "undcmotor": undcmotor,
    "emps": emps,
}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "folder", type=Path, help="the folder with regbot/, fra233/, ksu_thermal/, undcmotor/ and emps/"
    )
    parser.add_argument(
        "--only", choices=sorted(STUDIES), nargs="+", default=list(STUDIES), help="some of the motors"
    )
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        print(
            f"{arguments.folder}: no such folder; the recordings are not part of this repository, nothing was done"
        )
        return 0
    for name in arguments.only:
        if (arguments.folder / name).is_dir():
            STUDIES[name](arguments.folder)
        else:
            print(f"\n{name}: not in {arguments.folder}, skipped")
    return 0


if __name__ == "__main__":
    sys.exit(main())
