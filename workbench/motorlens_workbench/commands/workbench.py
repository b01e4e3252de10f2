"""Compare, diagnose, add and compare again, as a page in the browser.

example:
  motorlens workbench --motor mellah2016 bench1.csv bench2.csv

The page opens by itself, for this machine only. It works with the files named here and with those in --folder, and writes
new motor files there; each step is a command of motorlens, and the page shows it. Ctrl-C ends it.
"""

import argparse

from motorlens_runtime.cli import add_json_argument


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("recordings", nargs="*", metavar="REC", help="recordings: CSV, Parquet, MAT, MDF")
    parser.add_argument("--motor", metavar="MOTOR.toml", help="motor file to begin with")
    parser.add_argument(
        "--folder", metavar="DIR",
        help="whose motor files and recordings can be chosen, and where new motor files go (default: only the files "
        "named; new ones go to the current folder)",
    )  # fmt: skip
    parser.add_argument(
        "--column", action="append", default=[], metavar="QUANTITY=NAME", help="which column holds what"
    )
    parser.add_argument(
        "--session", metavar="DIR",
        help="where steps, results and files sent by the page are kept, to go on another day (default: motorlens-session in "
        "--folder or the current folder; '' keeps nothing)",
    )  # fmt: skip
    parser.add_argument("--effects-from", metavar="FILE.py", help="a file of your own with further effects")
    parser.add_argument(
        "--port", type=int, default=0, metavar="PORT", help="of the page (default: a free one)"
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address, open no browser")
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_runtime.files.shipped import motor_path
    from motorlens_workbench.web.serve import serve

    if arguments.motor:
        arguments.motor = str(motor_path(arguments.motor))
    return serve(arguments)
