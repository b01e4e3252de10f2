"""Real robots: three are the make, each other is judged as one of it, and after its first 100 ms."""

import csv
import json
from pathlib import Path

import numpy as np
from fleet_studies.plant import fleet

from motorlens_physics.motor_file import read_motor_file, with_overrides, write_motor_file
from motorlens_runtime.cli import main as motorlens

ROOT = Path(__file__).resolve().parents[2]
RECORDINGS = ROOT.parent / "shared" / "recordings" / "regbot"


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
    fleet(place / "plant", place / "motor.toml", place / "out", "--brief", "0.1", "--workers", str(workers))
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
