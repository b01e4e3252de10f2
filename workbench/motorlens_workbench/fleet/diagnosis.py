"""What is missing from the make in one motor: `diagnose` on all of its recordings together, a job of the queue."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from motorlens_physics.motor_file import MotorFile
from motorlens_workbench.fleet.store import Store, code_version, digest

if TYPE_CHECKING:
    from motorlens_workbench.fleet.study import Fleet, Work
    from motorlens_workbench.fleet.work import Job

SCHEMA = "motorlens.fleet.diagnosis/1"
# What is kept of a diagnosis; `motorlens diagnose` on the same recordings says the rest.
_KEPT = ("verdict", "sentence", "chosen", "groups", "equation", "cannot_tell", "error")


@dataclass(frozen=True)
class Diagnosis:
    """A motor to be diagnosed.

    Attributes:
        jobs: its recordings, as they were fitted.
        file: the make, with what may be expected of a motor of it.
    """

    jobs: "tuple[Job, ...]"
    file: MotorFile

    @property
    def paths(self) -> tuple[Path, ...]:
        """Of the recordings."""
        return tuple(job.path for job in self.jobs)

    def key(self) -> str:
        """The name of its result. Raises OSError: a recording cannot be read."""
        import motorlens_workbench
        from motorlens_workbench.fleet.work import content_of

        keys = (job.key().encode() for job in self.jobs)
        return digest(
            SCHEMA.encode(), code_version(motorlens_workbench).encode(), content_of(self.file), *keys
        )

    def result(self) -> dict[str, Any]:
        """Its verdict in words and names. Raises MotorlensError: the recordings or the model are at fault."""
        from motorlens_workbench.diagnose import diagnose
        from motorlens_workbench.report.json import to_json
        from motorlens_workbench.verdict import settle

        recordings = [job.recording() for job in self.jobs]
        found = diagnose(self.file, recordings)
        said = to_json(found, settle(found), None, [path.name for path in self.paths], self.file.name)
        return {"schema": SCHEMA, **{name: said[name] for name in _KEPT}}


def diagnosed(
    fleet: "Fleet", motors: Sequence[str], template: "Job", store: Store, work: "Work",
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Mapping[str, Mapping[str, Any]]:  # fmt: skip
    """What is missing from the make in each of some motors, or {"failed": why}, from the recordings that could be used."""
    from motorlens_workbench.fleet.study import results

    make, jobs = fleet.make, []
    for motor in motors:
        mine = [o.entry for o in fleet.outcomes if o.entry.motor == motor and not o.failure]
        each = tuple(replace(template, path=entry.path) for entry in mine)
        jobs.append((mine[0], Diagnosis(each, make)))
    outcomes = results(jobs, store, work, progress)
    return {o.entry.motor: o.document or {"failed": o.failure} for o in outcomes}
