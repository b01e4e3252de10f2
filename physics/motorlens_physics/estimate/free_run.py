"""A motor file beside recordings, with nothing of the motor fitted: what it would show, and how near that can be.

Only what belongs to a recording and not to the motor is found: its start, from all its samples; how its inputs ran between
samples; delays; an ambient that was not recorded; its noise. The floor is what a perfect model would miss by: the noise of
the sensor itself, and what the noise of the measured inputs stirs up in the simulation and did not stir up in the motor.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.innovations import spread
from motorlens_physics.estimate.model import Model, sensitivities_of
from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.prior import Prior, nuisance_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.signals import noise_sd, roughness
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.sensitivity import Linearisation
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FreeRun:
    """One recording beside a model.

    Attributes:
        run: the recording, with its inputs as measured.
        trajectory: simulated.
        predicted: (N, C) what the sensors would show.
        floor: (C,) standard deviation of the error that a perfect model would leave.
    """

    run: Run
    trajectory: Trajectory
    predicted: Array
    floor: Array

    @property
    def error(self) -> Array:
        """(N, C) measured less predicted; 0 where nothing was measured."""
        return np.where(self.run.valid[:, None], self.run.measured - self.predicted, 0.0)


def free_runs(
    file: MotorFile, runs: Sequence[Run], prior: Prior | None = None
) -> tuple[Model, tuple[FreeRun, ...]]:
    """The motor file beside recordings.

    Args:
        file: the motor.
        runs: prepared recordings.
        prior: what may be fitted; None is nothing of the motor, see `nuisance_prior`.

    Raises:
        ModelError: the motor cannot be simulated on one of them.
    """
    found = estimate(file, runs, nuisance_prior(file, runs) if prior is None else prior)
    return found.fit.model, free_runs_of(found)


def free_runs_of(found: Estimate) -> tuple[FreeRun, ...]:
    """The recordings of an estimate beside its model."""
    return tuple(_free_run(found.fit.model, run, r) for r, run in enumerate(found.runs))


def _free_run(model: Model, run: Run, r: int) -> FreeRun:
    plain = replace(run, corrections=None)
    trajectory, predicted, _, linear = sensitivities_of(model, plain, r, ())
    return FreeRun(plain, trajectory, predicted, floor_of(plain, linear, plain.measured - predicted))


def floor_of(run: Run, linear: Linearisation, error: Array) -> Array:
    """(C,) standard deviation that a perfect model's error has: of the sensors, and of the inputs through the motor.

    The slow torque is none of it, for nobody measured it, and a channel's own noise is no larger than its error is rough.

    Args:
        run: from an estimate, which found its noise.
        linear: the motor along its inputs as measured, through which their noise shows.
        error: (N, C) measured less predicted there.
    """
    assert run.noise is not None
    rough = np.array(
        [
            # The steps of a converter are no rest.
            noise_sd(e[there]) if step else roughness(e[there], y[there])
            for e, y, there, step in zip(error.T, run.measured.T, run.there.T, run.steps, strict=True)
        ]
    )
    white = np.minimum(run.noise.of_sensors(run), rough**2) + run.steps**2 / 12
    lasting = run.noise.lasting_of_channels(run)
    return np.asarray(np.sqrt(white + lasting + stirred_by_inputs(run, linear, run.noise)))


def stirred_by_inputs(run: Run, linear: Linearisation, noise: Noise) -> Array:
    """(C,) variance that noise of the measured inputs stirs up in what the model shows."""
    return spread(noise.of_inputs(len(run.channels)).space(run, linear, run.there))
