"""Long recordings beside a model: what is no matter of the motor is found in two parts, then the model runs along all of it.

The start is found in the first samples. Delays, how the inputs ran between samples, and the noise are found where the inputs
change most: at rest nothing of that shows. Both are told as well by some thousands of samples as by a million. What
would take an error away is looked for along the means of blocks: the linear problem takes kilobytes a sample.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.free_run import FreeRun, free_runs
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.pieces import as_found
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.files.words import WORDS

Array = NDArray[np.float64]

# A recording of more samples is long; so many samples has each of its parts, and so many blocks its means.
LONG, PART, BLOCKS = 60_000, 8_000, 15_000


def is_long(recording: Recording) -> bool:
    """Whether only parts of it are fitted to."""
    return len(recording) > LONG


def block(recording: Recording) -> int:
    """How many samples are averaged to look for what would take an error away; 1 where it is not long."""
    return -(-len(recording) // BLOCKS) if is_long(recording) else 1


def means(recording: Recording) -> Recording:
    """The mean of each block of samples; of what the terminals and the shaft are tied to, the first."""
    size = block(recording)
    if size == 1:
        return recording

    def blocks(y: Array) -> Array:
        return y[: len(y) // size * size].reshape(-1, size)

    channels = {
        q: blocks(y)[:, 0] if q in WORDS else blocks(y).mean(axis=1) for q, y in recording.channels.items()
    }
    return replace(recording, time_s=blocks(recording.time_s).mean(axis=1), channels=channels)


def beside(
    file: MotorFile, recordings: Sequence[Recording], progress: Callable[[str], None]
) -> tuple[Model, list[FreeRun]]:
    """The motor file beside all samples of recordings, nothing of the motor fitted.

    Raises:
        DataError: see `prepare.prepare`.
        ModelError: the motor cannot be simulated on one of them.
    """
    long = [r for r, recording in enumerate(recordings) if is_long(recording)]
    runs = prepare_all(recordings, file)
    begins = [one.part(slice(0, PART)) if is_long(one) else one for one in recordings]
    lively = [recordings[r].part(runs[r].liveliest(PART, file.motor)) for r in long]
    progress("finding how each recording starts, and its noise")
    model, parts = free_runs(file, prepare_all([*begins, *lively], file) if long else runs)
    whole, own, held = list(parts[: len(runs)]), list(model.own[: len(runs)]), list(model.held[: len(runs)])
    for k, r in enumerate(long, start=len(runs)):
        skews = {name: value for name, value in model.own[k].items() if name.startswith("skew.")}
        own[r], held[r] = {**own[r], **skews}, model.held[k]
    along = replace(model, own=tuple(own), held=tuple(held))
    for k, r in enumerate(long, start=len(runs)):
        progress(f"running along {recordings[r].name}")
        whole[r] = _along(along, runs[r], r, parts[k])
    return along, whole


def _along(model: Model, run: Run, r: int, lively: FreeRun) -> FreeRun:
    """All of a run, with the timing and floor of its liveliest part."""
    run = replace(as_found(run, lively.run), noise=lively.run.noise)
    trajectory, predicted = predict(model, run, r)
    return FreeRun(run, trajectory, predicted, lively.floor)
