"""Look at a recording before it is used: its columns, what they are taken for, gaps and suspicions, all samples as plots.

example:
  motorlens look bench.csv --html look.html

Columns that are named otherwise are mapped with --column, as in every command. Exit status 1 if the recording cannot be
used so; its columns are shown all the same.
"""

import argparse
import shlex

from motorlens_physics.command_inputs import add_reading_arguments
from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_workbench.telling import add_page_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recording", metavar="REC", help="recording")
    add_reading_arguments(parser)
    add_page_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.command_inputs import no_values, reading_words
    from motorlens_runtime.errors import DataError
    from motorlens_workbench.report.page import write
    from motorlens_workbench.report.recording import look, to_html, to_json, to_text

    sight = look(
        arguments.recording,
        arguments.column,
        no_values(arguments.no_value),
        arguments.terminal,
        arguments.shaft,
    )
    write_json(to_json(sight), arguments.json)
    if arguments.html:
        words = ["motorlens", "look", arguments.recording, *reading_words(arguments)]
        write(to_html(sight, shlex.join(words)), arguments.html, every_sample=arguments.every_sample)
    if arguments.json != "-":
        print(to_text(sight))
    if sight.error:
        raise DataError(sight.error)
    return 0
