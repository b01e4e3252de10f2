"""Say what is missing from a motor file, given recordings.

example:
  motorlens diagnose bench1.csv bench2.csv --motor mellah2016 --html diagnosis.html

The base parameters are fitted along; every effect of the catalogue and every sensor fault is tested. The verdict is one of
named, group (the recordings cannot tell between a few), sensor_fault, unknown (its shape is shown), adequate (nothing above
the sizes listed) and not_testable. `motorlens add` puts an effect into the motor file.
"""

import argparse
import shlex

from motorlens_physics.command_inputs import add_input_arguments
from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_workbench.telling import add_page_arguments, teller


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="+", metavar="REC", help="recordings: CSV, Parquet, MAT, MDF")
    add_input_arguments(parser)
    parser.add_argument(
        "--driven",
        action="store_true",
        help="impose current and speed as measured and look at the thermal equation alone (the voltage is not the motor's)",
    )
    add_page_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import numpy as np

    from motorlens_physics.command_inputs import inputs_from, option_words, print_notes
    from motorlens_workbench.diagnose import diagnose
    from motorlens_workbench.driven import driven
    from motorlens_workbench.experiments import propose
    from motorlens_workbench.report.json import to_json, to_text
    from motorlens_workbench.verdict import settle

    given = inputs_from(arguments)
    say = teller("diagnose")
    file, recordings = given.file, given.recordings(arguments.recordings, say)
    if arguments.driven:
        file, recordings = driven(file, recordings)
    found = diagnose(file, recordings, given.effects, say)
    verdict = settle(found)
    if any(len(group) > 1 for group in verdict.groups):
        say("looking for the test that tells the group apart")
    experiment = propose(found, verdict, np.random.default_rng(0))
    options = [*option_words(arguments), *(["--driven"] if arguments.driven else [])]
    document = to_json(found, verdict, experiment, arguments.recordings, arguments.motor, options)
    write_json(document, arguments.json)
    if arguments.html:
        from motorlens_workbench.report.diagnosis import to_html
        from motorlens_workbench.report.page import write

        words = ["motorlens", "diagnose", *arguments.recordings, "--motor", arguments.motor, *options]
        write(
            to_html(found, verdict, document, shlex.join(words)),
            arguments.html,
            every_sample=arguments.every_sample,
        )
    # Last, so that a reader who turns away (| head) loses no file.
    if arguments.json != "-":
        print_notes(recordings)
        print(to_text(document))
    return 0
