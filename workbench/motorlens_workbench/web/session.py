"""A session at the workbench: which steps were taken, what came of each, the command that repeats it, and what is chosen."""

import json
import os
import re
import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from motorlens_runtime.errors import DataError
from motorlens_workbench.web.job import Job
from motorlens_workbench.web.shelf import Shelf
from motorlens_workbench.web.step import Choice, Order, Step, choice_of, step_of, to_json, words_of
from motorlens_workbench.web.uploads import Uploads

SCHEMA = "motorlens.session/1"


class Busy(Exception):
    """A step is under way."""


class Session:
    """Takes one step at a time, each as the command it stands for.

    Args:
        shelf: the files it may use.
        folder: where it keeps itself: `session.json`, results, and what the page sends. Made with the first step or file;
            a session that is there is continued.
        effects_from: the user's own effects.
        choice: what the user has named; of a session that is there, the rest stays.

    Raises:
        DataError: what is there is no session.
    """

    def __init__(
        self, shelf: Shelf, folder: Path, effects_from: str | None = None, choice: Choice | None = None
    ) -> None:
        self._folder, self._effects_from = folder, effects_from
        self.shelf = replace(shelf, sent=str(folder / "files"))
        self.uploads = Uploads(folder / "files")
        self._steps: list[Step] = []
        self._choice = choice or Choice()
        self._job: Job | None = None
        self._lock = threading.Lock()
        self._continue()

    @property
    def steps(self) -> list[Step]:
        """All steps so far, the oldest first."""
        with self._lock:
            return list(self._steps)

    @property
    def choice(self) -> Choice:
        """What is chosen."""
        return self._choice

    @property
    def progress(self) -> Sequence[str]:
        """What the step under way has said."""
        job = self._job
        return [] if job is None else _plain(job.progress)

    @property
    def seconds(self) -> float:
        """How long the step under way has taken."""
        job = self._job
        return 0.0 if job is None else job.seconds

    def choose(self, choice: Choice) -> None:
        """Remember what is chosen."""
        with self._lock:
            self._choice = choice
            if self._folder.exists():
                self._save()

    def take(self, order: Order) -> Step:
        """Begin a step.

        Raises:
            Busy: one is under way.
            DataError: see `words_of`.
        """
        with self._lock:
            if self._job is not None and self._job.status is None:
                raise Busy
            words = words_of(order, self.shelf, self._effects_from)
            step = Step(len(self._steps) + 1, order, words)
            files = [
                word for kind in ("json", "html") for word in (f"--{kind}", str(self.file(step.number, kind)))
            ]
            (self._folder / "results").mkdir(parents=True, exist_ok=True, mode=0o700)
            for kind in ("json", "html"):
                self.file(step.number, kind).unlink(missing_ok=True)
            self._steps.append(step)
            self._save()
            self._job = Job((*words, *files, "--every-sample"), lambda job: self._ended(step, job))
            return step

    def cancel(self) -> None:
        """Stop the step under way, if there is one."""
        job = self._job
        if job is not None:
            job.cancel()

    def join(self) -> None:
        """Wait for the step under way."""
        job = self._job
        if job is not None:
            job.join()

    def file(self, number: int, kind: str) -> Path:
        """Where the page (`html`) or the document (`json`) of a step lies."""
        return self._folder / "results" / f"{number}.{kind}"

    def _continue(self) -> None:
        path = self._folder / "session.json"
        try:
            document = json.loads(path.read_text(encoding="utf-8"))
        except FileNotFoundError:
            return
        except (OSError, ValueError) as error:
            raise DataError(
                f"{path}: cannot be continued: {error}; move it away, or name another with --session"
            ) from None
        try:
            if document["schema"] != SCHEMA:
                raise ValueError
            steps = [step_of(entry) for entry in document["steps"]]
            given = {name: value for name, value in vars(self._choice).items() if value}
            self._choice = replace(choice_of(document["choice"]), **given)
        except (KeyError, TypeError, ValueError, DataError):
            raise DataError(
                f"{path}: is no session of this version; move it away, or name another with --session"
            ) from None
        for step in steps:
            if step.state == "running":  # when the workbench ended
                step = replace(step, state="cancelled", sentence="Cancelled: the workbench was ended.")
            self._steps.append(replace(step, result=self._result(step.number)))
            if step.written is not None and Path(step.written).exists():
                self.shelf = self.shelf.with_file(step.written)
        for name in {
            name for step in steps for name in (step.order.motor, *step.order.recordings, *step.order.judge)
        }:
            if Path(name).is_file():
                self.shelf = self.shelf.with_file(name)

    def _save(self) -> None:
        document = {
            "schema": SCHEMA, "choice": vars(self._choice), "steps": [to_json(step) for step in self._steps],
        }  # fmt: skip
        part = self._folder / ".session.json.part"
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        os.replace(part, self._folder / "session.json")

    def _result(self, number: int) -> Mapping[str, Any] | None:
        try:
            found = json.loads(self.file(number, "json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return found if isinstance(found, dict) else None

    def _ended(self, step: Step, job: Job) -> None:
        seconds = round(job.seconds, 1)
        if job.cancelled and job.status != 0:
            ended = replace(step, state="cancelled", sentence="Cancelled.", seconds=seconds)
        else:
            ended = replace(self._judged(step, job), seconds=seconds)
        with self._lock:
            self._steps[step.number - 1] = ended
            if ended.written is not None:
                self.shelf = self.shelf.with_file(ended.written)
            self._save()

    def _judged(self, step: Step, job: Job) -> Step:
        """With what the command left behind. An effect that the data do not support is an answer, not a failure."""
        result = self._result(step.number)
        if result is None or (step.order.kind == "look" and result["error"]):
            said = [line for line in job.progress if line.strip()]
            why = said[-1] if said else "it said nothing"
            if job.status not in (1, 2):
                why = f"ended with status {job.status}; the last it said: {why}"
            return replace(step, state="failed", sentence=re.sub(r"^motorlens \w+: ", "", why), result=result)
        before, _, _ = job.output.partition("\n\n")
        *notes, sentence = before.splitlines() or [""]
        return replace(
            step,
            state="done",
            sentence=sentence,
            notes=tuple(notes),
            written=result.get("written"),
            result=result,
        )


def _plain(lines: Sequence[str]) -> list[str]:
    return [re.sub(r"^motorlens \w+: +", "", line) for line in lines]
