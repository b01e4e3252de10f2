"""The task that trainers are compared on."""

from collections.abc import Callable

import numpy as np

INPUTS, OUTPUTS, HIDDEN = 16, 3, (12, 8)
# Told how to predict, and the processor time if it is not this process's own.
Report = Callable[..., None]


def data(rows: int, seed: int, correlation: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs of unit variance and noisy targets, float32; `correlation` is that of neighbouring inputs."""
    teacher = np.random.default_rng(99)
    a, b, c = (
        teacher.standard_normal(shape) / size for shape, size in (((16, 10), 4), ((10, 3), 3), ((16, 3), 6))
    )
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((rows, INPUTS)).astype(np.float32)
    f = np.tanh(x @ a) @ b + 0.5 * np.sin(x @ c)
    place = np.arange(INPUTS)
    mixed = x @ np.linalg.cholesky(correlation ** np.abs(place[:, None] - place)).T
    return mixed.astype(np.float32), (f + 0.1 * rng.standard_normal(f.shape)).astype(np.float32)
