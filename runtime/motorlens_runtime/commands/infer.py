"""Estimate speed, temperature and resistance from a recorded file, CSV or Parquet.

The file may be of any length: it is streamed. Output is CSV, or Parquet if OUT ends in .parquet. Rows whose voltage or
current is missing are estimated from what came before and flagged; the exit status is then 1.

example: motorlens infer recording.csv --sensor mellah2016 -o estimates.csv
"""

import argparse
import math
import os
import sys
from pathlib import Path

from motorlens_runtime.cli import add_json_argument, write_json
from motorlens_runtime.errors import DataError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "recording",
        metavar="REC.csv",
        help="time, voltage and current, one row a sample; .gz and Parquet too",
    )
    parser.add_argument("--sensor", required=True, metavar="S.onnx", help="the virtual sensor")
    parser.add_argument(
        "-o", "--output", required=True, metavar="OUT", help="estimates; - is standard output"
    )
    parser.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="QUANTITY=NAME",
        help="which column holds a quantity, e.g. speed=wL_rad_s",
    )
    parser.add_argument(
        "--ambient", type=float, metavar="DEGREES_C", help="for a sensor that needs it and a file without it"
    )
    parser.add_argument(
        "--backend", choices=("auto", "core", "numpy", "onnxruntime"), default="auto", help="default: auto"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_runtime.files.infer import infer

    if arguments.output == "-" and arguments.json == "-":
        raise DataError("-o and --json cannot both be standard output")
    if arguments.ambient is not None and not math.isfinite(arguments.ambient):
        raise DataError(f"--ambient {arguments.ambient:g}: no temperature")
    target = None if arguments.output == "-" else Path(arguments.output)
    # A file appears under its name only when it is complete; a pipe or a device is written to as it is.
    part = None
    if target is not None and (target.is_file() or not target.exists()):
        target = target.resolve()
        part = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        summary = infer(
            arguments.recording, arguments.sensor, part or target, arguments.column, arguments.ambient, arguments.backend,
            parquet=arguments.output.endswith(".parquet"),
        )  # fmt: skip
        if part is not None and target is not None:
            part.replace(target)
    except BrokenPipeError:
        raise
    except OSError as error:
        raise DataError(f"{arguments.output}: cannot be written: {error.strerror or error}") from None
    finally:
        if part is not None:
            part.unlink(missing_ok=True)
    for note in summary["notes"]:
        print(f"motorlens infer: {arguments.recording}: {note}", file=sys.stderr)
    write_json(summary, arguments.json)
    if summary["first_missing_row"] is not None:
        # The estimates are written, flagged where they had to do without: the data are at fault all the same.
        print(
            f"motorlens infer: {arguments.recording}: row {summary['first_missing_row']}: no number for voltage or current; "
            f"{summary['quality']['not_finite']} of {summary['rows']} rows are estimated without and flagged not_finite",
            file=sys.stderr,
        )
        return 1
    return 0
