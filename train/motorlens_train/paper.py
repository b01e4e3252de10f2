"""The paper's own protocol: one run at constant voltage and load, its samples split at random into 50/25/25
%.

Neighbouring samples of one trajectory end up on both sides of the split, so the errors say how well the run is remembered,
not how well another would be estimated. It is kept as one labelled row, to compare with the paper (Mellah,
Hemsas and Taleb 2016: below 0.04 rad/s once steady with 110 rad/s at the start, 0.6 degC, 0.004 ohm, training
error 1.6e-4 after 2000 epochs).
"""

from dataclasses import dataclass

import numpy as np
import torch

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import perform
from motorlens_physics.scenarios.direct_on_line import DirectOnLine
from motorlens_train.build import Recipe
from motorlens_train.data import Cycle, cycle, errors, paper_split
from motorlens_train.duty_cycles import Noise, with_noise
from motorlens_train.source import Arrays
from motorlens_train.trainer import train

# Training error of the paper: mean square of scaled outputs.
PAPER_ERROR = 1.6e-4


@dataclass(frozen=True)
class PaperRun:
    """What the paper's protocol gives.

    Attributes:
        table: errors on the test quarter by output, as `motorlens_train.build.measured` gives them, without
        coverage.
        steady: the same after the first five seconds.
        iterations: iterations until the mean square of the scaled errors on the validation quarter was below the
            paper's training error; None if never.
        training_error: mean square of the scaled training errors in the end.
    """

    table: dict[str, dict[str, float]]
    steady: dict[str, dict[str, float]]
    iterations: int | None
    training_error: float


def paper_run(file: MotorFile, recipe: Recipe, noise: Noise, seed: int) -> PaperRun:
    """Train a network of the recipe's size on the paper's run and test it on the quarter that was set aside."""
    rng = np.random.default_rng([seed, 77])
    run = cycle(with_noise(perform(file, DirectOnLine(), rng), noise, rng), recipe.bank, recipe.outputs)
    training, validation, test = paper_split(len(run.x), rng)
    trained = train(
        Arrays(run.x[training], run.y[training]),
        recipe.architecture,
        seed,
        recipe.settings,
        validation=Arrays(run.x[validation], run.y[validation]),
    )
    below = [
        r.iteration + 1 for r in trained.history if np.mean(np.square(r.validation or [1.0])) < PAPER_ERROR
    ]

    def table(rows: np.ndarray) -> dict[str, dict[str, float]]:
        part = Cycle(
            run.name, run.time_s[rows], run.x[rows], run.y[rows], run.voltage_V, run.current_A, run.rows
        )
        found = errors([part], [trained.predict(torch.from_numpy(part.x)).numpy()])
        return {
            name: {key: float(f"{values[k]:.4g}") for key, values in found.items()}
            for k, name in enumerate(recipe.outputs)
        }

    training_error = float((trained.evidence.squared_error / trained.evidence.rows).mean())
    steady = test[run.time_s[test] > 5.0]
    return PaperRun(table(test), table(steady), below[0] if below else None, training_error)
