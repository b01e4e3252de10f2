"""Write a directory with all that a drive PC without network needs.

It holds wheels for that PC, the sensor, settings, a hardened systemd service with watchdog, a udev rule, install and
uninstall scripts and checksums. Copy it over and run `sh install.sh`.

example: motorlens bundle mellah2016 -o bundle --source serial:///dev/ttyUSB0?baud=921600
"""

import argparse
from pathlib import Path

from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("sensor", metavar="SENSOR.onnx", help="sensor, or the name of a shipped one")
    parser.add_argument("-o", "--output", required=True, metavar="DIR", type=Path, help="a new directory")
    parser.add_argument(
        "--source",
        default="serial:///dev/ttyUSB0?baud=921600",
        metavar="URL",
        help="where the samples come from there",
    )
    parser.add_argument(
        "--publish",
        action="append",
        metavar="URL",
        help="where estimates go (default: Prometheus on that PC)",
    )
    parser.add_argument(
        "--option",
        action="append",
        default=[],
        metavar="TEXT",
        help="a further option of `motorlens run` there, as --option=--rate=10",
    )
    parser.add_argument("--target", metavar="MACHINE", help="x86_64 or aarch64 (default: as this PC)")
    parser.add_argument("--python", metavar="VERSION", help="Python of that PC, as 3.11 (default: as here)")
    parser.add_argument(
        "--glibc", default="2.31", metavar="VERSION", help="its C library is at least this (default 2.31)"
    )
    parser.add_argument(
        "--wheels", type=Path, metavar="DIR", help="take wheels from here instead of a package index"
    )
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    import re

    from motorlens_runtime.errors import DataError
    from motorlens_runtime.files.shipped import sensor_path
    from motorlens_runtime.progress import Progress
    from motorlens_runtime.sensor.bundle import MACHINES, Target, write_bundle

    target = Target()
    machine, python = arguments.target or target.machine, arguments.python or target.python
    if machine not in MACHINES:
        raise DataError(f"--target {machine}: choose one of {', '.join(MACHINES)}")
    if not re.fullmatch(r"3\.\d+", python):
        raise DataError(f"--python {python}: write it as 3.11")
    if not re.fullmatch(r"2\.\d+", arguments.glibc):
        raise DataError(f"--glibc {arguments.glibc}: write it as 2.31")
    target = Target(machine, python, int(arguments.glibc.partition(".")[2]))
    publish = arguments.publish or ["prometheus://127.0.0.1:9464"]
    with Progress(0, "fetching wheels") as progress:
        progress.update(0)
        found = write_bundle(
            arguments.output,
            sensor_path(arguments.sensor),
            target,
            arguments.source,
            publish,
            arguments.option,
            arguments.wheels,
        )
    if arguments.json != "-":
        assert isinstance(found["bytes"], int)
        print(
            f"{arguments.output}: {found['bytes'] / 1e6:.0f} MB for {target.machine}, Python {target.python}, "
            f"{'with' if found['core'] else 'without'} the C core; "
            "copy it over and run: sh install.sh"
        )
    write_json(found, arguments.json)
    return 0
