"""Compare a motor file with recordings: overlay, errors, and where the model fails.

example:
  motorlens compare bench1.csv bench2.csv --motor models/motors/mellah2016.toml --html compare.html

The model runs freely from the first samples, driven by the measured voltage, load torque and ambient; nothing is fitted.
`motorlens diagnose` says what is missing.
"""

import argparse
import shlex

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="+", metavar="REC", help="recordings, CSV or Parquet")
    parser.add_argument("--motor", required=True, metavar="MOTOR.toml", help="motor file")
    parser.add_argument(
        "--column", action="append", default=[], metavar="QUANTITY=NAME", help="which column holds what"
    )
    parser.add_argument("--effects-from", metavar="FILE.py", help="a file of your own with further effects")
    parser.add_argument("--html", metavar="FILE", help="write one self-contained page")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.effect import load_effects
    from motorlens_physics.motor_file import read_motor_file
    from motorlens_physics.recording import read_recording
    from motorlens_workbench.comparison import compare
    from motorlens_workbench.report.comparison import to_html, to_json, to_text
    from motorlens_workbench.report.page import write

    own = load_effects(arguments.effects_from) if arguments.effects_from else {}
    file = read_motor_file(arguments.motor, own.values())
    recordings = [read_recording(path, arguments.column) for path in arguments.recordings]
    found = compare(file, recordings)
    write_json(to_json(found, arguments.recordings, arguments.motor), arguments.json)
    if arguments.html:
        words = ["motorlens", "compare", *arguments.recordings, "--motor", arguments.motor]
        words += [word for column in arguments.column for word in ("--column", column)]
        words += ["--effects-from", arguments.effects_from] if arguments.effects_from else []
        write(to_html(found, arguments.recordings, arguments.motor, shlex.join(words)), arguments.html)
    # Last, so that a reader who turns away (| head) loses no file.
    if arguments.json != "-":
        for recording in recordings:
            for note in recording.notes:
                print(f"{recording.name}: {note}")
        print(to_text(found))
    return 0
