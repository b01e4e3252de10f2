"""Write a sensor as C99 for the drive itself.

A folder that compiles with any C99 compiler: the sensor's tables, the estimator, an example and a test with golden values,
which is run at once where there is a compiler. No allocation, no globals.

example: motorlens export mellah2016 --c sensor_c
"""

import argparse
from pathlib import Path

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "sensor", metavar="SENSOR", type=Path, help="a sensor file, or the name of a shipped one"
    )
    parser.add_argument("--c", required=True, metavar="DIR", type=Path, help="a new folder for the C files")
    parser.add_argument(
        "--double", action="store_true", help="the network in double precision, too (default: single)"
    )
    parser.add_argument(
        "--name", default="motor", metavar="NAME", help="prefix of the sensor's identifiers (default: motor)"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_runtime.sensor.export import export_c

    found = export_c(arguments.sensor, arguments.c, not arguments.double, arguments.name)
    if arguments.json != "-":
        proof = found["proof"]
        said = "no compiler here: run golden_test there"
        if proof is not None:
            said = f"golden values within {proof['estimate_error']:.1e} of scale ({proof['compiler']})"
        print(f"{arguments.c}: {len(found['files'])} files, {found['precision']} precision; {said}")
    write_json(found, arguments.json)
    return 0
