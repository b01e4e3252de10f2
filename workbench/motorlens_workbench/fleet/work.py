"""What is done with one recording: it is read, the motor is fitted to it, and what was found becomes a document.

A document follows from the bytes of the recording, the motor file, how columns are read, and the code; it names no path and
no time, so that whoever computes it writes the same bytes.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from motorlens_physics.estimate.estimate import Estimate, beside, estimate
from motorlens_physics.estimate.free_run import free_runs, free_runs_of
from motorlens_physics.estimate.prepare import prepare_to_fit
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.report import findings
from motorlens_physics.estimate.run import UNIT_OF
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.ranges import within
from motorlens_physics.recording import Recording, read_recording
from motorlens_runtime.errors import DataError, MotorlensError
from motorlens_workbench.fleet.store import canonical, code_version, digest
from motorlens_workbench.fleet.summary import candidates, ended, parabola, where_it_ended

SCHEMA = "motorlens.fleet.recording/1"


def content_of(file: MotorFile) -> bytes:
    """All of a motor file that a result follows from: not its comments, nor how its numbers are spelled.

    Every recording of a fleet asks, in every round: its TOML, which keeps the comments, takes seventy times as long.
    """
    known = {key: asdict(what) for key, what in file.knowledge.items()}
    values = {key: float(value) for key, value in file.values().items()}
    parts = [part.name() for part in file.parts]
    return json.dumps([file.name, asdict(file.rated), parts, values, known], sort_keys=True).encode()


@dataclass(frozen=True)
class Job:
    """One recording to be fitted.

    Attributes:
        path: of the recording.
        file: the motor file.
        columns: `QUANTITY=NAME` each, see `--column`.
        no_values: numbers that stand for a missing value; None: looked for.
        compare: whether the motor file as it is is held against the recording as well.
        seconds: only so much of the recording, from its first sample on; None: all of it.
    """

    path: Path
    file: MotorFile
    columns: tuple[str, ...] = ()
    no_values: tuple[float, ...] | None = None
    compare: bool = False
    seconds: float | None = None

    def key(self) -> str:
        """The name of its result. Raises OSError: the recording cannot be read."""
        beside = self.path.with_name(self.path.name + ".columns.toml")
        how = json.dumps([self.columns, self.no_values, self.compare, self.seconds])
        mapping = beside.read_bytes() if beside.exists() else b""
        content = (self.path.read_bytes(), mapping, content_of(self.file))
        return digest(
            SCHEMA.encode(), code_version().encode(), how.encode(), self.path.suffix.encode(), *content
        )

    @property
    def paths(self) -> tuple[Path, ...]:
        """Of the recordings, one."""
        return (self.path,)

    def recording(self) -> Recording:
        """Read it. Raises DataError: it is none, or holds too few samples."""
        whole = read_recording(self.path, self.columns, self.no_values)
        return whole if self.seconds is None else within(whole, whole.name, {"": (0.0, self.seconds)})

    def result(self) -> dict[str, Any]:
        """What it says of the motor, see `analysed`."""
        return _fitted(self)


@dataclass(frozen=True)
class Again:
    """A recording that was fitted, looked at again where its motor is likeliest given all recordings of the make.

    Attributes:
        job: as it was fitted.
        values: of the motor's parameters there.
        before: the result then.
    """

    job: Job
    values: Mapping[str, float]
    before: Mapping[str, Any]

    @property
    def paths(self) -> tuple[Path, ...]:
        """Of the recordings, one."""
        return self.job.paths

    def key(self) -> str:
        """The name of its result. Raises OSError: the recording cannot be read."""
        return digest(
            SCHEMA.encode(), self.job.key().encode(), canonical(dict(self.values)), canonical(self.before)
        )

    def result(self) -> dict[str, Any]:
        """The parabola there; only what belongs to the recording alone, its start and its noise, is fitted."""
        file = self.job.file
        runs = prepare_to_fit([self.job.recording()], file)
        prior = base_prior(file, runs)
        end = {**self.before["end"], "values": {**self.before["end"]["values"], **self.values}}
        own = prior.only([key for key in prior.keys if "@" in key])
        found = beside(*where_it_ended(end, file, runs, prior), own)
        told = parabola(found, self.before["candidates"], prior)
        return {"schema": SCHEMA, "converged": found.converged, "parabola": told.as_json()}


class Task(Protocol):
    """What the queue does: one result, that follows from content."""

    @property
    def paths(self) -> tuple[Path, ...]:
        """Of the recordings."""

    def key(self) -> str:
        """The name of its result. Raises OSError: a recording cannot be read."""

    def result(self) -> dict[str, Any]:
        """The result, without a path or a time. Raises MotorlensError: recordings or model are at fault."""


def analysed(job: Task) -> dict[str, Any]:
    """The result of a job; where its recordings or the model are at fault, {"failed": why}.

    Raises:
        OSError: the recording cannot be read now.
    """
    try:
        return job.result()
    except MotorlensError as error:
        # Without paths, which are no part of the content.
        text = str(error)
        for path in job.paths:
            text = text.replace(str(path), path.name if len(job.paths) > 1 else "")
        return {"schema": SCHEMA, "failed": " ".join(text.split()).lstrip(":, ")}


def _fitted(job: Job) -> dict[str, Any]:
    file = job.file
    recording = job.recording()
    runs = prepare_to_fit([recording], file)
    run = runs[0]
    if not any(
        np.ptp(run.measured[run.there[:, c], c]) > 0
        for c in range(len(run.channels))
        if run.there[:, c].any()
    ):
        raise DataError("nothing can be told; no current, speed or temperature ever changes")
    found = estimate(file, runs)
    said = findings(found.fit)
    if not said.told:
        raise DataError("nothing can be told; the recording leaves every parameter where it was")
    names = candidates(file, run.channels)
    document = {
        "schema": SCHEMA,
        "seconds": float(recording.time_s[-1] - recording.time_s[0]),
        "samples": len(recording),
        "channels": list(run.channels),
        "notes": [note.replace(str(job.path), recording.name) for note in recording.notes],
        "converged": found.converged,
        "outliers": found.outliers,
        "parameters": {
            key: {"value": said.value[key], "sd": said.sd[key], "unit": file.meaning(key).unit, "told": key in said.told}
            for key in said.keys
        },
        "sentences": [*said.at_bound.values(), *said.confounded],
        "fitted": _errors(found),
        "parabola": parabola(found, names).as_json(),
        "candidates": list(names),
        "end": ended(found),
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
