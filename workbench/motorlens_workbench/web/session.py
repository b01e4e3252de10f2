"""A session at the workbench: which steps were taken, what came of each, and the command that repeats it."""

import json
import re
import shlex
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from motorlens_runtime.errors import DataError
from motorlens_workbench.web.job import Job
from motorlens_workbench.web.shelf import Shelf

KINDS = ("compare", "diagnose", "add", "remove")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COLUMN = re.compile(r"\w+=.+")


class Busy(Exception):
    """A step is under way."""


@dataclass(frozen=True)
class Order:
    """What the page asks for; names are those of the shelf. From `judge` on, for add and remove."""

    kind: str
    motor: str
    recordings: tuple[str, ...]
    columns: tuple[str, ...] = ()
    judge: tuple[str, ...] = ()
    effect: str = ""
    output: str = ""
    force: bool = False


@dataclass(frozen=True)
class Step:
    """One step. `state` is running, done, failed or cancelled; `sentence` what came of it, or the error in one line."""

    number: int
    order: Order
    words: tuple[str, ...]
    state: str = "running"
    sentence: str = ""
    notes: tuple[str, ...] = ()
    written: str | None = None
    seconds: float = 0.0
    result: Mapping[str, Any] | None = field(default=None, repr=False)

    @property
    def command(self) -> str:
        """What to type to take this step again."""
        return shlex.join(["motorlens", *self.words])


def order_of(document: Mapping[str, Any]) -> Order:
    """Read what a page sent. Raises DataError if it is not of the right form."""
    try:
        lists = {
            name: tuple(map(_text, document.get(name, ()))) for name in ("recordings", "columns", "judge")
        }
        texts = {name: _text(document.get(name, "")) for name in ("kind", "motor", "effect", "output")}
        return Order(**texts, **lists, force=document.get("force", False) is True)  # type: ignore[arg-type]
    except TypeError:
        raise DataError("the request is not of the form that the page sends") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def words_of(order: Order, shelf: Shelf, effects_from: str | None = None) -> tuple[str, ...]:
    """The command, without `motorlens`.

    Raises:
        DataError: a file is not on the shelf, a name is no name, or something is not chosen.
    """
    if order.kind not in KINDS:
        raise DataError(f"{order.kind!r} is no step; there are {', '.join(KINDS)}")
    motor = shelf.motor(order.motor)
    recordings = shelf.chosen(order.recordings)
    if not recordings:
        raise DataError("no recording is chosen; choose at least one")
    for column in order.columns:
        if not _COLUMN.fullmatch(column):
            raise DataError(f"{column}: write QUANTITY=NAME, for example speed=wL_rad_s")
    more = [word for column in order.columns for word in ("--column", column)]
    more += ["--effects-from", effects_from] if effects_from else []
    if order.kind in ("compare", "diagnose"):
        return (order.kind, *recordings, "--motor", motor.name, *more)
    if not _NAME.fullmatch(order.effect):
        raise DataError(f"{order.effect or 'no effect'}: choose an effect or sensor fault of the catalogue")
    words = ["add", order.effect, "--motor", motor.name, "--fit", *recordings]
    judge = shelf.chosen(order.judge)
    words += ["--judge", *judge] if judge else []
    words += ["--remove"] if order.kind == "remove" else []
    words += ["--force"] if order.force and order.kind == "add" else []
    return (*words, "-o", shelf.new_motor(order.output), *more)


class Session:
    """Takes one step at a time, each as the command it stands for; results lie in `folder`, which the caller owns."""

    def __init__(self, shelf: Shelf, folder: Path, effects_from: str | None = None) -> None:
        self.shelf = shelf
        self._folder, self._effects_from = folder, effects_from
        self._steps: list[Step] = []
        self._job: Job | None = None
        self._lock = threading.Lock()

    @property
    def steps(self) -> list[Step]:
        """All steps so far, the oldest first."""
        with self._lock:
            return list(self._steps)

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
            self._steps.append(step)
            self._job = Job((*words, *files), lambda job: self._ended(step, job))
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
        return self._folder / f"{number}.{kind}"

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

    def _judged(self, step: Step, job: Job) -> Step:
        """With what the command left behind. An effect that the data do not support is an answer, not a failure."""
        try:
            result = json.loads(self.file(step.number, "json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            said = [line for line in job.progress if line.strip()]
            why = said[-1] if said else f"ended with status {job.status} and said nothing"
            return replace(step, state="failed", sentence=re.sub(r"^motorlens \w+: ", "", why))
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
