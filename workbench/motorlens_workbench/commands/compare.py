"""Compare a motor file with recordings: overlay, errors, and where the model fails.

example:
  motorlens compare bench1.csv bench2.csv --motor mellah2016 --html compare.html

The model runs freely from the first samples, driven by the measured voltage, load torque and ambient; nothing is fitted.
`motorlens diagnose` says what is missing.
"""

import argparse
import shlex

from motorlens_physics.command_inputs import add_input_arguments
from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_workbench.telling import add_page_arguments, teller


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="+", metavar="REC", help="recordings: CSV, Parquet, MAT, MDF")
    add_input_arguments(parser)
    add_page_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.command_inputs import input_words, inputs_from, print_notes
    from motorlens_runtime.progress import patience
    from motorlens_workbench.compare.comparison import compare
    from motorlens_workbench.compare.long_recordings import is_long
    from motorlens_workbench.report.comparison import to_html, to_json, to_text
    from motorlens_workbench.report.page import write

    given = inputs_from(arguments)
    tell = teller("compare")
    recordings = given.recordings(arguments.recordings, tell)
    say = tell if any(map(is_long, recordings)) else lambda text: None
    with patience("compare"):
        found = compare(given.file, recordings, say)
    write_json(to_json(found, arguments.recordings, arguments.motor), arguments.json)
    if arguments.html:
        words = ["motorlens", "compare", *arguments.recordings, *input_words(arguments)]
        say("writing the page")
        # What is suspected first: of what was not used there may be much.
        noticed = [f"{one.name}: {note}" for one in recordings for note in one.notes]
        noticed.sort(key=lambda note: ": not used: " in note)
        write(
            to_html(found, arguments.recordings, arguments.motor, shlex.join(words), noticed),
            arguments.html,
            every_sample=arguments.every_sample,
        )
    # Last, so that a reader who turns away (| head) loses no file.
    if arguments.json != "-":
        print_notes(recordings)
        print(to_text(found))
    return 0
