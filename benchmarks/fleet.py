"""The fleet: what is recovered of a population that is known, what is odd, what a killed run leaves, what the queue costs.

    python benchmarks/fleet.py                      200 motors of 5 recordings, 50 kills, 1000 tasks
    python benchmarks/fleet.py --quick              40 motors, 5 kills, 100 tasks
    python benchmarks/fleet.py --only regbot        real robots (../shared/recordings), see real_recordings.py

The motors come from an integrator of its own (`tests/helpers/plain_fleet.py`): four recordings of 6 s at 200 Hz and one of
five minutes at 10 Hz each, 0.5 % noise on every channel (2 % for each fifth motor); the motor file is 10 % off. One motor in
forty is broken: twice the viscous friction, 1.25 times the resistance, 0.88 times the motor constant, Coulomb friction, a
shorted winding.
"""

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path = [str(ROOT / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.fleet_tasks import sleeps  # noqa: E402
from helpers.plain_fleet import RATED, SPREAD, TYPICAL, World  # noqa: E402

from motorlens_physics.motor import Motor  # noqa: E402
from motorlens_physics.motor_file import (  # noqa: E402
    MotorFile,
    read_motor_file,
    with_overrides,
    write_motor_file,
)
from motorlens_physics.parameter import Rated  # noqa: E402
from motorlens_runtime.cli import main as motorlens  # noqa: E402
from motorlens_workbench.fleet.queue import cluster, worked  # noqa: E402

PLATE = Rated(RATED["voltage"], RATED["current"], RATED["speed"], RATED["load_torque"], RATED["temperature"])
BREAKS = ({"b": 2.0}, {"R_a0": 1.25}, {"ke": 0.88}, {"tau_c": 0.4}, {"L": 0.7, "R_a0": 0.85})
# Between samples of the one recording of a motor that warms it up.
HEATED_S = 0.1
RECORDINGS = ROOT.parent / "shared" / "recordings" / "regbot"


def make_file(path: Path) -> Path:
    """A motor file of the make that is 8 % below or 10 % above it; copper is copper."""
    off = {key: 0.92 if k % 2 else 1.1 for k, key in enumerate(TYPICAL)} | {"alpha": 1.0}
    write_motor_file(MotorFile("make", Motor(**{k: v * off[k] for k, v in TYPICAL.items()}), PLATE), path)
    return path


def fleet(folder: Path, motor: Path, out: Path, *words: str) -> dict:
    status = motorlens(
        ["fleet", str(folder), "--motor", str(motor), "-o", str(out), "--json", str(out) + ".json", *words]
    )
    return json.loads(Path(str(out) + ".json").read_text()) if status == 0 else {}


def population(place: Path, motors: int, seed: int, workers: int) -> None:
    broken = {40 * k + 13: BREAKS[k % len(BREAKS)] for k in range(max(motors // 40, 1))}
    world = World(motors, 5, broken=broken, heated_s=HEATED_S)
    world.write(place / "plant", seed)
    begun, spent = time.monotonic(), time.process_time()
    found = fleet(place / "plant", make_file(place / "make.toml"), place / "out", "--workers", str(workers))
    print(f"{motors} motors, {5 * motors} recordings: {time.monotonic() - begun:.0f} s on {workers or 1} workers"
          + (f", {time.process_time() - spent:.0f} s of processor time" if workers == 0 else ""))  # fmt: skip
    truth = {f"motor_{m:03d}": world.motor(m, seed) for m in range(motors)}
    sound = [m for m in found["motors"] if int(m["motor"][-3:]) not in broken]
    inside, scarce = [], []
    for key, what in found["population"].items():
        if key not in TYPICAL:
            continue
        actual = np.array([truth[m["motor"]][key] for m in sound])
        own = [m["parameters"][key] for m in sound]
        covered = [
            low <= x <= high for x, o in zip(actual, own, strict=True) for low, high in [o["interval_95"]]
        ]
        narrower = np.array([o["sd"] / m["alone"][key] for o, m in zip(own, sound, strict=True)])
        # Poor data: a motor's own recordings tell it worse than knowing that it is one of the make.
        poor = np.array([m["alone"][key] for m in sound]) > SPREAD[key] * np.mean(actual)
        seen = what["between_motors"] > 0
        inside += covered if seen else []
        scarce += narrower[poor].tolist()
        off = (what["value"] - TYPICAL[key]) / what["sd"]
        spread = f"{what['between_motors']:.4f} +- {what['between_motors_sd']:.4f}" if seen else "not told"
        print(f"  {key:6} mean {off:+5.2f} sd off ({what['sd'] / what['value']:.2%}); spread {spread} "
              f"({np.std(actual, ddof=1) / np.mean(actual):.4f} true); {np.mean(covered):6.1%} of motors inside; "
              f"sd {np.median(narrower):.2f} of alone"
              + (f", {np.median(narrower[poor]):.2f} where poor ({np.mean(poor):.0%})" if any(poor) else ""))  # fmt: skip
    print(f"  95 % intervals, parameters whose spread is told: {np.mean(inside):.1%} of {len(inside)} hold the truth; "
          f"where data are poor they are {1 - np.median(scarce):.0%} narrower than alone")  # fmt: skip
    order = sorted(found["motors"], key=lambda m: -m["oddness"])
    first = [m["motor"] for m in order[: len(broken)]]
    hits = sum(int(name[-3:]) in broken for name in first)
    odd = [m["motor"] for m in found["motors"] if m["odd"]]
    strangers = [name for name in odd if int(name[-3:]) not in broken]
    print(
        f"  broken: {hits} of {len(broken)} are ranked first; said to be odd: {len(odd)}, {len(strangers)} of them are not"
    )
    for m in order[: len(broken) + 1]:
        print(f"    {m['motor']} {m['oddness']:.1f} {[d['parameter'] for d in m['differences']]}")


def told_apart(place: Path, motors: int, seed: int, workers: int) -> None:
    """All have a drop at the brushes; one in ten drags."""
    drags = {m: {"tau_c": 0.4} for m in range(7, motors, 10)}
    World(motors, 5, make={"V_b": 1.0}, broken=drags, poor=0).write(place / "plant", seed)
    found = fleet(place / "plant", make_file(place / "make.toml"), place / "out", "--workers", str(workers))
    print(f"effects of all, of {motors} motors: {[e['parameter'] for e in found['effects_of_the_make']]}")
    right = 0
    for m in found["motors"]:
        named = {name for d in m["differences"] for name in (d["parameter"], *d["alike"])}
        drag = int(m["motor"][-3:]) in drags
        right += "coulomb_friction.tau_c" in named if drag else not named
    print(f"  effect of one told from that of all: {right} of {motors} motors")


def killed(place: Path, kills: int, seed: int) -> None:
    """A run killed at random with its workers, against one in peace."""
    World(4, 3, samples=300).write(place / "plant", seed)
    make, rng = make_file(place / "make.toml"), random.Random(seed)
    fleet(place / "plant", make, place / "peace", "--workers", "1")
    words = [
        str(Path(sys.executable).with_name("motorlens")),
        "fleet",
        str(place / "plant"),
        "--motor",
        str(make),
    ]
    for _ in range(kills):
        with subprocess.Popen([*words, "-o", str(place / "war"), "--workers", "1"], start_new_session=True,
                              stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as program:  # fmt: skip
            try:
                program.wait(rng.uniform(1.0, 15.0))
            except subprocess.TimeoutExpired:
                os.killpg(program.pid, signal.SIGKILL)
    fleet(place / "plant", make, place / "war", "--workers", "1")

    def content(out: Path) -> dict[str, bytes]:
        return {
            str(p.relative_to(out)): p.read_bytes()
            for p in out.rglob("*")
            if p.is_file() and p.name != "index.html"
        }

    same = content(place / "peace") == content(place / "war")
    print(f"killed {kills} times with its workers: {'the same' if same else 'OTHER'} bytes as in peace")


def queue(tasks: int, seconds: float) -> None:
    """Tasks that sleep as long as real ones take: the rate of one worker and of more, overhead of a task, memory."""
    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    rates = {}
    for workers, count in ((1, max(tasks // 8, 8)), (2, max(tasks // 4, 16)), (8, tasks)):
        with cluster(workers=workers) as client:
            list(worked(client, sleeps, [0.0] * workers))
            before = _memory(client)
            begun = time.monotonic()
            list(worked(client, sleeps, [seconds] * count))
            spent = time.monotonic() - begun
            rates[workers] = count / spent
            each = (spent * workers / count - seconds) * 1e3
            efficiency, memory = rates[workers] * seconds / workers, (before, _memory(client))
            print(f"queue: {workers} workers, {count} tasks of {seconds:g} s: efficiency {efficiency:.3f}, "
                  f"{each:.1f} ms a task, memory {memory[0]:.0f} to {memory[1]:.0f} MB a worker")  # fmt: skip


def _memory(client) -> float:
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return float(np.mean([w["metrics"]["memory"] for w in workers])) / 1e6


def regbot(place: Path, workers: int) -> None:
    """Robots 01, 03 and 04 are the make; each other is calibrated on its first 100 ms, and judged on the rest."""
    if not RECORDINGS.is_dir():
        print(f"regbot: {RECORDINGS} is not there, skipped")
        return
    for robot in (1, 3, 4):
        for side in "LR":
            wheel(robot, side, place / "plant" / f"robot_{robot:02d}_{side}" / "run.csv")
    motor = with_overrides(
        read_motor_file(ROOT / "examples/hidden_effect/regbot.toml"),
        {"coulomb_friction.tau_c": 0.0, "brush_voltage_drop.V_b": 0.0},
    )
    write_motor_file(motor, place / "motor.toml")
    fleet(place / "plant", place / "motor.toml", place / "out", "--as-it-is", "--workers", str(workers))
    make = place / "out" / "population.toml"
    errors = []
    for robot, side in ((5, "L"), (5, "R"), (10, "L"), (11, "L")):
        recording, own, said = (
            place / f"{robot}{side}.csv",
            place / f"{robot}{side}.toml",
            place / "said.json",
        )
        wheel(robot, side, recording)
        words = [
            "--motor",
            str(place / "motor.toml"),
            "--make",
            str(make),
            "--range",
            "0:0.1",
            "-o",
            str(own),
        ]
        motorlens(["calibrate", str(recording), *words, "--accept-unconverged"])  # fmt: skip
        row = []
        for file in (make, own):
            motorlens(
                ["compare", str(recording), "--motor", str(file), "--range", "0.1:10", "--json", str(said)]
            )
            row.append(json.loads(said.read_text())["channels"]["speed"]["rmse"])
        errors.append(row)
        print(
            f"regbot robot {robot:02d} {side}: speed {row[0]:.2f} rad/s as the make, {row[1]:.2f} after its first 100 ms"
        )
    whole = np.sqrt(np.mean(np.square(errors), axis=0))
    print(
        f"regbot, robots not seen: {whole[0]:.2f} rad/s as the make, {whole[1]:.2f} after 100 ms (goal 1.6)"
    )


def wheel(robot: int, side: str, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    single = RECORDINGS / f"robot_{robot:02d}_{side}.csv"
    if single.exists():
        path.write_bytes(single.read_bytes())
        return
    with (RECORDINGS / f"robot_{robot:02d}.csv").open() as file:
        rows = [
            [row[name] for name in ("t_s", f"v{side}_V", f"i{side}_A", f"w{side}_rad_s")]
            for row in csv.DictReader(file)
        ]
    lines = ["time_s,voltage_V,current_A,speed_rad_s", *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    studies = ("population", "effects", "killed", "queue", "regbot")
    parser.add_argument("--quick", action="store_true", help="a sample")
    parser.add_argument("--only", nargs="+", choices=studies, default=studies, help="some of it")
    parser.add_argument("--motors", type=int, help="how many motors")
    parser.add_argument("--kills", type=int, help="how many kills")
    parser.add_argument("--workers", type=int, default=0, help="processes (default: this one)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="work there and keep it; a study that was stopped goes on"
    )
    a = parser.parse_args()
    motors = a.motors or (40 if a.quick else 200)
    with tempfile.TemporaryDirectory(prefix="fleet-") as folder:
        for study in a.only:
            place = (a.keep or Path(folder)) / study
            place.mkdir(parents=True, exist_ok=True)
            if study == "population":
                population(place, motors, a.seed, a.workers)
            elif study == "effects":
                told_apart(place, max(motors // 4, 20), a.seed, a.workers)
            elif study == "killed":
                killed(place, a.kills or (5 if a.quick else 50), a.seed)
            elif study == "queue":
                queue(100 if a.quick else 1000, 0.5)
            else:
                regbot(place, a.workers)


if __name__ == "__main__":
    main()
