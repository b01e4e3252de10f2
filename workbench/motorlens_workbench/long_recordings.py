"""Long recordings beside a model: what is no matter of the motor is found in their beginning, then the model runs along all.

The start, delays, how inputs ran between samples and the noise are those of some tens of thousands of samples as well as of
a million, and the linear problem behind a free force in an equation takes a kilobyte a sample.
"""

from collections.abc import Sequence
from dataclasses import replace

from motorlens_physics.estimate.free_run import FreeRun
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.run import Run, prepare, prepare_all
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording

# Samples of a beginning: a minute at a kilohertz, three hours at five hertz.
FIRST = 60_000


def is_long(recording: Recording) -> bool:
    """Whether only a beginning of it is fitted to."""
    return len(recording) > FIRST


def beginnings(recordings: Sequence[Recording], file: MotorFile) -> tuple[Run, ...]:
    """The first samples of each, prepared. Raises DataError, see `prepare`."""
    return prepare_all([recording.part(slice(0, FIRST)) for recording in recordings], file)


def along(recording: Recording, model: Model, r: int, begun: FreeRun) -> FreeRun:
    """The model along a whole recording, from the start that its beginning has.

    Args:
        recording: all of it.
        model: fitted to the beginning.
        r: its position in the model.
        begun: its beginning beside the model.

    Raises:
        DataError: see `prepare`.
        ModelError: the simulation cannot go on.
    """
    found = begun.run
    run = replace(
        prepare(recording, model.file), turns=found.turns, converters=found.converters, noise=found.noise
    )
    for channel, samples in found.late.items():
        run = run.delayed(channel, samples)
    run = run.holding(found.inputs.hold)
    trajectory, predicted = predict(model, run, r)
    return FreeRun(run, trajectory, predicted, begun.floor)
