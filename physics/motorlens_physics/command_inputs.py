"""What the commands are given that hold a motor file against recordings: the same flags, read the same way."""

import argparse
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.words import WORDS

# Only for names of types: the overview of all commands loads this module, and must not wait for scipy and numba.
if TYPE_CHECKING:
    from motorlens_physics.effect import Effect
    from motorlens_physics.motor_file import MotorFile
    from motorlens_physics.recording import Recording

Spans = Mapping[str, tuple[float, float]]

# A file that is larger takes a moment to be read.
LARGE_BYTES = 10_000_000


def add_input_arguments(parser: argparse.ArgumentParser, motor_required: bool = True) -> None:
    """Give a command `--motor`, what its recordings mean, how they were made, and the user's own effects."""
    parser.add_argument(
        "--motor",
        required=motor_required,
        metavar="MOTOR.toml",
        help="motor file, or the name of a shipped one: mellah2016",
    )
    parser.add_argument(
        "--make", metavar="POPULATION.toml",
        help="what motorlens fleet says of motors of this make: a prior for what the motor file knows less of",
    )  # fmt: skip
    parser.add_argument(
        "--voltage-commanded", action="store_true",
        help="the voltage is what was commanded (duty times supply): no sensor, so no error of one is looked for",
    )  # fmt: skip
    add_reading_arguments(parser)
    parser.add_argument(
        "--range", action="append", default=[], metavar="[REC=]FROM:TO",
        help="use only this part, in seconds since the first sample; of that recording, or of all: --range 2:8.5",
    )  # fmt: skip
    parser.add_argument("--effects-from", metavar="FILE.py", help="a file of your own with further effects")


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """Give a command what a recording's columns mean, and how it was made."""
    parser.add_argument(
        "--column", action="append", default=[], metavar="QUANTITY=NAME",
        help="which column holds what, or a formula over columns: 'voltage=duty_pct*vbat_V/100', "
        "'time=row*0.001[s]'; none for nothing: temperature=none; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--no-value", action="append", metavar="NUMBER",
        help="a number that stands for a missing value, as in --no-value=-9999; 'none' looks for none (default: found)",
    )  # fmt: skip
    add_condition_arguments(parser)


def add_condition_arguments(parser: argparse.ArgumentParser) -> None:
    """Give a command `--terminal` and `--shaft`."""
    parser.add_argument(
        "--terminal", metavar="WORD",
        help=f"what the terminals are tied to throughout: {', '.join(WORDS['terminal'])} (default: as planned or recorded)",
    )  # fmt: skip
    parser.add_argument(
        "--shaft", metavar="WORD",
        help=f"what the shaft is tied to throughout: {', '.join(WORDS['shaft'])} (default: as planned or recorded)",
    )  # fmt: skip


@dataclass(frozen=True)
class CommandInputs:
    """The motor file, the user's own effects, and how recordings are read."""

    file: "MotorFile"
    effects: "tuple[type[Effect], ...]"
    columns: tuple[str, ...]
    no_values: tuple[float, ...] | None
    terminal: str | None = None
    shaft: str | None = None
    spans: Spans = field(default_factory=dict)

    def recordings(
        self, paths: Sequence[str], say: Callable[[str], None] = lambda text: None
    ) -> "list[Recording]":
        """Read recordings; `say` is told of large ones. Raises DataError and OSError, see `recording.read_recording`."""
        from motorlens_physics.ranges import within
        from motorlens_physics.recording import read_recording, under

        found = []
        for path in paths:
            if os.path.isfile(path) and os.path.getsize(path) > LARGE_BYTES:
                say(f"reading {path}")
            read = read_recording(path, self.columns, self.no_values, self.terminal)
            whole = under(read, shaft=self.shaft)
            found.append(within(whole, path, self.spans))
        return found


def inputs_from(arguments: argparse.Namespace, file: "MotorFile | None" = None) -> CommandInputs:
    """What the flags of `add_input_arguments` name; `file` in place of that of `--motor`.

    Raises:
        DataError, ModelError, OSError: a file is not there or not usable, or a flag is not understood.
    """
    from motorlens_physics.effect import load_effects
    from motorlens_physics.make import of_make
    from motorlens_physics.motor_file import read_motor_file, voltage_commanded
    from motorlens_physics.ranges import parse_ranges

    own = tuple(load_effects(arguments.effects_from).values()) if arguments.effects_from else ()
    file = file or read_motor_file(arguments.motor, own)
    if arguments.make:
        file = of_make(file, read_motor_file(arguments.make, own))
    if arguments.voltage_commanded:
        file = voltage_commanded(file)
    named = [name for kind in ("recordings", "fit", "judge") for name in getattr(arguments, kind, None) or ()]
    return CommandInputs(
        file, own, tuple(arguments.column), no_values(arguments.no_value),
        arguments.terminal, arguments.shaft, parse_ranges(arguments.range, named),
    )  # fmt: skip


def input_words(arguments: argparse.Namespace) -> list[str]:
    """The flags as they were typed, for the line that repeats a command."""
    return ["--motor", arguments.motor, *option_words(arguments)]


def option_words(arguments: argparse.Namespace) -> list[str]:
    """All of them but the motor file."""
    words = ["--make", arguments.make] if arguments.make else []
    words += ["--voltage-commanded"] if arguments.voltage_commanded else []
    words += reading_words(arguments)
    words += [word for span in arguments.range for word in ("--range", span)]
    return words + (["--effects-from", arguments.effects_from] if arguments.effects_from else [])


def reading_words(arguments: argparse.Namespace) -> list[str]:
    """The flags of `add_reading_arguments`."""
    words = [word for column in arguments.column for word in ("--column", column)]
    words += [f"--no-value={number}" for number in arguments.no_value or ()]
    for flag in ("terminal", "shaft"):
        words += [f"--{flag}", getattr(arguments, flag)] if getattr(arguments, flag) else []
    return words


def print_notes(recordings: "Sequence[Recording]") -> None:
    """What was found while reading, one line each; what holds for several recordings is said once."""
    from motorlens_physics.recording import said_once

    for line in said_once((recording.name, note) for recording in recordings for note in recording.notes):
        print(line)


def no_values(texts: Sequence[str] | None) -> tuple[float, ...] | None:
    """What `--no-value` says: numbers; None if it was not given. Raises DataError: no number."""
    if texts is None:
        return None
    if list(texts) == ["none"]:
        return ()
    try:
        return tuple(float(text) for text in texts)
    except ValueError:
        raise DataError(
            f"--no-value {' '.join(texts)}: write a number, as in --no-value=-9999, or none"
        ) from None
