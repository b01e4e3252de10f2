"""Write two recordings of a motor with something in it that its motor file does not know.

    python examples/hidden_effect/make_recordings.py /tmp/riddle [SEED]

`day1.csv` and `day2.csv` are load steps at several voltages, noise included; `motor.toml` is the datasheet, off by up to
15 %. Do not read on if you want to find it.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import read_motor_file, write_motor_file
from motorlens_physics.recording import write_recording
from motorlens_physics.scenario import measure, perform, scenarios

NOISE = {"voltage": 0.5, "current": 0.05, "speed": 0.5, "temperature": 0.3, "load_torque": 0.02}
HIDDEN = {
    "brush_voltage_drop": 2.4,
    "coulomb_friction": 0.25,
    "quadratic_drag": 2e-5,
    "armature_reaction": 3e-4,
}


def main(folder: Path, seed: int) -> None:
    """Draw what is hidden, and write the files."""
    file = read_motor_file(Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml")
    rng = np.random.default_rng(seed)
    name = str(rng.choice(sorted(HIDDEN)))
    effect = catalogue()[name].typical(file.rated)
    truth = replace(
        file, motor=file.motor.with_effect(replace(effect, **{effect.switch().name: HIDDEN[name]}))
    )
    folder.mkdir(parents=True, exist_ok=True)
    for day in ("day1", "day2"):
        scenario = scenarios()["load_steps"](duration_s=40.0, period_s=0.003)
        write_recording(measure(perform(truth, scenario, rng), (), NOISE, rng), folder / f"{day}.csv")
    rough = {
        key: value * rng.uniform(0.85, 1.15)
        for key, value in file.values().items()
        if key in ("R_a0", "ke", "J", "b")
    }
    write_motor_file(file.with_values(rough), folder / "motor.toml")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        raise SystemExit("usage: make_recordings.py FOLDER [SEED]")
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)
