"""The multilayer perceptron with Levenberg-Marquardt: the trainer of this project with skips off and no history.

What a static map of voltage and current can do, as most published virtual sensors are.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_train.baselines.method import Array, Estimate, inputs, residual_sd, truth
from motorlens_train.cascade import Architecture
from motorlens_train.source import Arrays
from motorlens_train.trainer import Settings, Trained, train


@dataclass(frozen=True)
class Perceptron:
    """Inputs v and i of the same instant, two hidden layers of tanh units; outputs that were measured."""

    trained: Trained | None = None
    outputs: tuple[int, ...] = ()
    hidden: tuple[int, ...] = (12, 8)
    rows: int = 60_000
    seed: int = 0
    sd: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "Perceptron":
        """Trained on evenly spread samples of the recordings. See `Method.fit`."""
        x = np.concatenate([_inputs(recording) for recording in recordings])
        y = np.concatenate([truth(recording, motor_file) for recording in recordings])
        outputs = tuple(k for k in range(3) if np.isfinite(y[:, k]).any())
        good = np.isfinite(y[:, outputs]).all(axis=1)
        stride = max(1, int(good.sum()) // self.rows)
        x, y = x[good][::stride], y[good][::stride][:, outputs]
        architecture = Architecture(2, self.hidden, len(outputs), skips=False)
        trained = train(Arrays(x, y), architecture, self.seed, Settings(iterations=100))
        fitted = replace(self, trained=trained, outputs=outputs)
        s = residual_sd(fitted, recordings, motor_file)
        return replace(fitted, sd=(float(s[0]), float(s[1]), float(s[2])))

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`."""
        if self.trained is None:
            raise RuntimeError("fit the perceptron first")
        values = np.full((len(recording), 3), np.nan)
        values[:, self.outputs] = self.trained.predict(torch.from_numpy(_inputs(recording))).numpy()
        return Estimate.of(values, np.outer(np.ones(len(recording)), np.asarray(self.sd)))


def _inputs(recording: Recording) -> Array:
    _, v, i = inputs(recording)
    return np.column_stack([v, i])
