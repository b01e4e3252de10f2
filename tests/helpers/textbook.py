"""The textbook's motor on a recording of another plant that has more to it, and the same with a name added."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from helpers.hidden import Case, generate_experiment

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, stand


def textbook_on(
    folder: Path,
    motor: str,
    hidden: Sequence[dict[str, Any]],
    test: str,
    seconds: float,
    late: int = 0,
    noise: float = 0.01,
) -> Standing:
    """The textbook fitted to a test of a motor in which effects are hidden, with this share of noise on all channels.

    Its speed is recorded `late` by so many samples.
    """
    case = Case(id="textbook", seed=4, motor=motor, kind="none", noise=noise, small=True)
    path = generate_experiment({"case": case.as_json(), "hidden": list(hidden)}, test, seconds, folder)
    file = read_motor_file(case.of_motor().write_datasheet(folder / "motor.toml"))
    recording = read_recording(path)
    speed = recording.channels["speed"]
    delayed = np.concatenate([np.full(late, speed[0]), speed[: len(speed) - late]])
    recording = replace(recording, channels={**recording.channels, "speed": delayed})
    return stand(fitted_of(estimate(file, prepare_all([recording], file))))


def with_name(bare: Standing, name: str) -> tuple[Score, Fitted]:
    """What a look says of a name, and the model that has it, fitted in full."""
    score = best_of(bare.scores)[name]
    fitted = with_hypothesis(bare.fitted, bare.book.beside(), score)
    assert fitted is not None
    return score, settled(fitted)
