"""One step of a session: what the page asks for, and the command that it is."""

import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.words import WORDS
from motorlens_workbench.web.shelf import Shelf

KINDS = ("look", "compare", "diagnose", "add", "remove")
_NAME = re.compile(r"[a-z][a-z0-9_]*")
_COLUMN = re.compile(r"[^=-][^=]*=.+")
# Between a recording and a column of it.
OF = "::"
_RANGE = re.compile(r"[^-].*:.*")


@dataclass(frozen=True)
class Choice:
    """What is chosen on the page; names are those of the shelf, `columns` and `ranges` as they are typed in a command.

    A column of one recording alone is written `REC::QUANTITY=NAME`. The last three are the flags of that name, for all
    recordings; "" is as recorded.
    """

    motor: str = ""
    recordings: tuple[str, ...] = ()
    judge: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    ranges: tuple[str, ...] = ()
    voltage_commanded: bool = False
    terminal: str = ""
    shaft: str = ""


@dataclass(frozen=True)
class Order(Choice):
    """What the page asks for. `effect` (names, a blank between them), `output` and `force` are for add and remove."""

    kind: str = ""
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


def choice_of(document: Mapping[str, Any]) -> Choice:
    """Read what a page has chosen. Raises DataError if it is not of the right form."""
    return Choice(**_read(document))


def order_of(document: Mapping[str, Any]) -> Order:
    """Read what a page asks for. Raises DataError if it is not of the right form."""
    kind, effect, output = (_text(document.get(name, "")) for name in ("kind", "effect", "output"))
    force = document.get("force", False) is True
    return Order(**_read(document), kind=kind, effect=effect, output=output, force=force)


def to_json(step: Step) -> dict[str, Any]:
    """A step as the page sees it, and as a session keeps it; without its result."""
    return {
        **{name: list(value) if isinstance(value, tuple) else value for name, value in vars(step.order).items()},
        "number": step.number, "words": list(step.words), "command": step.command, "state": step.state,
        "sentence": step.sentence, "notes": list(step.notes), "written": step.written, "seconds": step.seconds,
    }  # fmt: skip


def step_of(document: Mapping[str, Any]) -> Step:
    """The reverse of `to_json`. Raises DataError, KeyError, TypeError or ValueError if it is none."""
    written = document["written"]
    return Step(
        int(document["number"]), order_of(document), _texts(document["words"]), _text(document["state"]),
        _text(document["sentence"]), _texts(document["notes"]), None if written is None else _text(written),
        float(document["seconds"]),
    )  # fmt: skip


def words_of(order: Order, shelf: Shelf, effects_from: str | None = None) -> tuple[str, ...]:
    """The command, without `motorlens`.

    Raises:
        DataError: a file is not on the shelf, a name is no name, or something is not chosen.
    """
    if order.kind not in KINDS:
        raise DataError(f"{order.kind!r} is no step; there are {', '.join(KINDS)}")
    recordings = shelf.chosen(order.recordings)
    if not recordings:
        raise DataError("no recording is chosen; choose at least one")
    for text in order.ranges:
        if not _RANGE.fullmatch(text):
            raise DataError(f"{text}: write REC=FROM:TO, in seconds")
    if order.kind == "look":
        return ("look", recordings[0], *_columns(order.columns, recordings[:1]))
    motor = shelf.motor(order.motor)
    judge = shelf.chosen(order.judge)
    used = [*recordings, *(judge if order.kind in ("add", "remove") else ())]
    more = _columns(order.columns, used)
    for text in order.ranges:
        more += ["--range", text] if text.rpartition("=")[0] in ("", *used) else []
    more += ["--effects-from", effects_from] if effects_from else []
    more += ["--voltage-commanded"] if order.voltage_commanded else []
    for flag in WORDS:
        if word := getattr(order, flag):
            if word not in WORDS[flag]:
                raise DataError(f"{flag} {word!r}: one of {', '.join(WORDS[flag])}")
            more += [f"--{flag}", word]
    if order.kind in ("compare", "diagnose"):
        return (order.kind, *recordings, "--motor", motor.name, *more)
    effects = order.effect.split(" ")
    if not all(map(_NAME.fullmatch, effects)):
        raise DataError(f"{order.effect or 'no effect'}: choose an effect or sensor fault of the catalogue")
    words = ["add", *effects, "--motor", motor.name, "--fit", *recordings]
    words += ["--judge", *judge] if judge else []
    words += ["--remove"] if order.kind == "remove" else []
    words += ["--force"] if order.force and order.kind == "add" else []
    return (*words, "-o", shelf.new_motor(order.output), *more)


def _columns(columns: Sequence[str], recordings: Sequence[str]) -> list[str]:
    """The options `--column`, which are for all recordings of a command."""
    own: dict[tuple[str, ...], str] = {}
    for recording in recordings:
        mapping = []
        for text in columns:
            name, mark, column = text.rpartition(OF)
            if not _COLUMN.fullmatch(column):
                raise DataError(f"{column}: write QUANTITY=NAME, for example speed=wL_rad_s")
            if not mark or name == recording:
                mapping.append(column)
        own.setdefault(tuple(mapping), recording)
    if len(own) > 1:
        one, other, *_ = own.values()
        raise DataError(
            f"{one} and {other} name their columns differently: choose recordings of one kind, or put a file "
            f'{other.rpartition("/")[2]}.columns.toml beside it with a table [columns], as in speed = "wL_rad_s"'
        )
    return [word for column in next(iter(own), ()) for word in ("--column", column)]


def _read(document: Mapping[str, Any]) -> dict[str, Any]:
    lists = {name: _texts(document.get(name, ())) for name in ("recordings", "judge", "columns", "ranges")}
    words = {name: _text(document.get(name, "")) for name in ("motor", *WORDS)}
    return {**words, **lists, "voltage_commanded": document.get("voltage_commanded", False) is True}


def _texts(values: Any) -> tuple[str, ...]:
    if not isinstance(values, Sequence):
        raise DataError("the request is not of the form that the page sends")
    return tuple(map(_text, values))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise DataError("the request is not of the form that the page sends")
    return value
