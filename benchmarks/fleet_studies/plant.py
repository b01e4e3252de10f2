"""A plant whose motors are known: the motor file of its make, the fleet command on it, and how motors are broken."""

import json
from pathlib import Path

from helpers.plain_fleet import RATED, TYPICAL

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile, write_motor_file
from motorlens_physics.parameter import Rated
from motorlens_runtime.cli import main as motorlens

PLATE = Rated(RATED["voltage"], RATED["current"], RATED["speed"], RATED["load_torque"], RATED["temperature"])
BREAKS = ({"b": 2.0}, {"R_a0": 1.25}, {"ke": 0.88}, {"tau_c": 0.4}, {"L": 0.7, "R_a0": 0.85})
# Between samples of the one recording of a motor that warms it up.
HEATED_S = 0.1


def make_file(path: Path) -> Path:
    """A motor file of the make that is 8 % below or 10 % above it; copper is copper."""
    off = {key: 0.92 if k % 2 else 1.1 for k, key in enumerate(TYPICAL)} | {"alpha": 1.0}
    write_motor_file(MotorFile("make", Motor(**{k: v * off[k] for k, v in TYPICAL.items()}), PLATE), path)
    return path


def fleet(folder: Path, motor: Path, out: Path, *words: str) -> dict:
    """What `motorlens fleet` says of a folder of recordings; empty if it fails."""
    said = out.with_name(out.name + ".json")
    status = motorlens(
        ["fleet", str(folder), "--motor", str(motor), "-o", str(out), "--json", str(said), *words]
    )
    return json.loads(said.read_text()) if status == 0 else {}
