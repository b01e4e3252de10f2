"""Add effects to a motor file, everything refitted, and show what each was worth.

example:
  motorlens add coulomb_friction --motor motor.toml --fit bench1.csv bench2.csv --judge bench3.csv -o better.toml
  motorlens add coulomb_friction brush_voltage_drop --motor motor.toml --fit bench1.csv -o better.toml

The ladder shows the error on blocks of time held out (and on the recordings of --judge, run freely) for the textbook alone
and for each effect so far. Of several, each is judged beside the others. What the data do not support is not written, unless
--force is given: exit status 1. `--remove` takes effects out again. The old file is kept.
"""

import argparse
import shlex
from pathlib import Path

from motorlens_physics.command_inputs import add_input_arguments
from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_workbench.telling import add_page_arguments, teller


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "effect", nargs="+", metavar="EFFECT", help="names of effects or sensor faults of the catalogue"
    )
    add_input_arguments(parser)
    parser.add_argument("--fit", nargs="+", required=True, metavar="REC", help="recordings to fit to")
    parser.add_argument(
        "--judge", nargs="+", default=[], metavar="REC", help="recordings to judge by, not fitted to"
    )
    parser.add_argument(
        "--differing",
        nargs="+",
        default=[],
        metavar="KEY",
        help="parameters that each motor of --judge has of its own (ke, J): fitted to its recording, judged on blocks of "
        "time held out",
    )
    parser.add_argument("-o", "--output", required=True, metavar="NEW.toml", help="the new motor file")
    parser.add_argument("--remove", action="store_true", help="take them out instead")
    parser.add_argument(
        "--force", action="store_true", help="write the file even if the data do not support it"
    )
    parser.add_argument(
        "--driven",
        action="store_true",
        help="impose current and speed as measured and look at the thermal equation alone (the voltage is not the motor's)",
    )
    add_page_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.command_inputs import input_words, inputs_from, print_notes
    from motorlens_physics.motor_file import write_motor_file
    from motorlens_runtime.errors import DataError
    from motorlens_workbench import ladder as ladders
    from motorlens_workbench.driven import driven, freed
    from motorlens_workbench.report.ladder import before_and_after, to_html, to_json, to_text
    from motorlens_workbench.report.page import write

    if Path(arguments.output).resolve() == Path(arguments.motor).resolve():
        raise DataError(
            f"{arguments.output} is the motor file itself, which is kept; give another name with -o"
        )
    given = inputs_from(arguments)
    say = teller("add")
    file = given.file
    fitted, judge = given.recordings(arguments.fit, say), given.recordings(arguments.judge, say)
    plain = file
    if arguments.driven:
        file, fitted = driven(file, fitted)
        judge = driven(plain, judge)[1] if judge else judge
    if arguments.remove:
        found = ladders.remove(file, arguments.effect, fitted, judge, say, arguments.differing)
    else:
        found = ladders.add(file, arguments.effect, fitted, judge, given.effects, say, arguments.differing)
    written = found.supported or (arguments.force and found.new == len(arguments.effect))
    document = to_json(found, arguments.effect, arguments.motor, arguments.output if written else None)
    if written:
        better = found.rungs[-1].file
        write_motor_file(freed(better, plain) if arguments.driven else better, arguments.output)
    write_json(document, arguments.json)
    if arguments.html:
        words = ["motorlens", "add", *arguments.effect, *input_words(arguments), "--fit", *arguments.fit]
        words += ["--judge", *arguments.judge] if arguments.judge else []
        words += ["--differing", *arguments.differing] if arguments.differing else []
        words += ["--driven"] if arguments.driven else []
        words += ["--remove"] if arguments.remove else []
        words += ["--force"] if arguments.force else []
        words += ["-o", arguments.output]
        overlays = before_and_after(found, fitted)
        write(
            to_html(document, shlex.join(words), overlays),
            arguments.html,
            every_sample=arguments.every_sample,
        )
    # Last, so that a reader who turns away (| head) loses no file.
    if arguments.json != "-":
        print_notes((*fitted, *judge))
        print(to_text(document))
    return 0 if written else 1
