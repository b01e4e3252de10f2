"""What is done with one recording: it is read, the motor is fitted to it, and what was found becomes a document.

A document follows from the bytes of the recording, the motor file, how columns are read, and the code; it names no path and
no time, so that whoever computes it writes the same bytes.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.free_run import free_runs, free_runs_of
from motorlens_physics.estimate.report import findings
from motorlens_physics.estimate.run import UNIT_OF, prepare_all
from motorlens_physics.motor_file import MotorFile, to_toml
from motorlens_physics.recording import read_recording
from motorlens_runtime.errors import DataError, MotorlensError
from motorlens_workbench.fleet.store import code_version, digest
from motorlens_workbench.fleet.summary import candidates, parabola

SCHEMA = "motorlens.fleet.recording/1"


@dataclass(frozen=True)
class Job:
    """One recording to be fitted.

    Attributes:
        path: of the recording.
        file: the motor file.
        columns: `QUANTITY=NAME` each, see `--column`.
        no_values: numbers that stand for a missing value; None: looked for.
        compare: whether the motor file as it is is held against the recording as well.
    """

    path: Path
    file: MotorFile
    columns: tuple[str, ...] = ()
    no_values: tuple[float, ...] | None = None
    compare: bool = False

    def key(self) -> str:
        """The name of its result. Raises OSError: the recording cannot be read."""
        beside = self.path.with_name(self.path.name + ".columns.toml")
        how = json.dumps([self.columns, self.no_values, self.compare])
        mapping = beside.read_bytes() if beside.exists() else b""
        content = (self.path.read_bytes(), mapping, to_toml(self.file).encode())
        return digest(
            SCHEMA.encode(), code_version().encode(), how.encode(), self.path.suffix.encode(), *content
        )


def analysed(job: Job) -> dict[str, Any]:
    """The result of a recording; where it or the model is at fault, {"failed": why}.

    Raises:
        OSError: the recording cannot be read now.
    """
    try:
        return _analysed(job)
    except MotorlensError as error:
        # Without the path, which is no part of the content.
        return {
            "schema": SCHEMA,
            "failed": " ".join(str(error).replace(str(job.path), "").split()).lstrip(":, "),
        }


def _analysed(job: Job) -> dict[str, Any]:
    recording = read_recording(job.path, job.columns, job.no_values)
    runs = prepare_all([recording], job.file)
    run = runs[0]
    if not any(
        np.ptp(run.measured[run.there[:, c], c]) > 0
        for c in range(len(run.channels))
        if run.there[:, c].any()
    ):
        raise DataError("nothing can be told; no current, speed or temperature ever changes")
    found = estimate(job.file, runs)
    said = findings(found.fit)
    if not said.told:
        raise DataError("nothing can be told; the recording leaves every parameter where it was")
    names = candidates(job.file, run.channels)
    document = {
        "schema": SCHEMA,
        "seconds": float(recording.time_s[-1] - recording.time_s[0]),
        "samples": len(recording),
        "channels": list(run.channels),
        "notes": [note.replace(str(job.path), recording.name) for note in recording.notes],
        "converged": found.converged,
        "outliers": found.outliers,
        "parameters": {
            key: {"value": said.value[key], "sd": said.sd[key], "unit": job.file.meaning(key).unit, "told": key in said.told}
            for key in said.keys
        },
        "sentences": [*said.at_bound.values(), *said.confounded],
        "fitted": _errors(found),
        "parabola": parabola(found, names).as_json(),
        "candidates": list(names),
    }  # fmt: skip
    if job.compare:
        beside = free_runs(job.file, runs)[1][0]
        document["compared"] = _channels(beside.run.channels, beside.error[beside.run.valid], beside.floor)
    return document


def _errors(found: Estimate) -> dict[str, Any]:
    beside = free_runs_of(found)[0]
    return _channels(beside.run.channels, beside.error[beside.run.valid], beside.floor)


def _channels(channels: tuple[str, ...], error: Any, floor: Any) -> dict[str, Mapping[str, Any]]:
    if not len(error):
        raise DataError("no row holds all measured outputs")
    return {
        channel: {
            "unit": UNIT_OF[channel], "rmse": float(np.sqrt(np.mean(error[:, k] ** 2))), "noise_floor": float(floor[k]),
        }
        for k, channel in enumerate(channels)
    }  # fmt: skip
