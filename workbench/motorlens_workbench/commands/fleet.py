"""Fit many motors of one make: their population, the odd ones, what changed; on one machine or on a cluster.

example:
  motorlens fleet plant/ --motor make.toml -o fleet/

FOLDER holds a folder for each motor, and dates in the names of the recordings (motor_17/2026-03-01.csv); or it is a
manifest, a CSV with the columns motor, recording and date. DIR receives index.html, fleet.json, population.toml (the
motor file of the make: give it to other commands as --make) and results/, one file for each recording. What is in
results/ is never computed again: a run that was stopped goes on where it was. --scheduler is the address of a Dask cluster
whose workers see the same files; without it, processes on this machine do the work.
"""

import argparse
import shlex
import sys
from contextlib import ExitStack
from typing import Any

from motorlens_physics.queue import add_queue_arguments
from motorlens_runtime.cli import add_json_argument, write_json


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "folder", metavar="FOLDER", help="recordings, a folder for each motor; or a manifest (CSV, TOML)"
    )
    parser.add_argument(
        "--motor",
        required=True,
        metavar="MAKE.toml",
        help="motor file of the make, or the name of a shipped one",
    )
    parser.add_argument(
        "-o", "--output", required=True, metavar="DIR", help="where results, population and page go"
    )
    parser.add_argument(
        "--history", metavar="MOTOR", help="say of one motor how each parameter went over its dates"
    )
    parser.add_argument("--column", action="append", default=[], metavar="QUANTITY=NAME",
                        help="which column holds what, see motorlens calibrate; repeatable")  # fmt: skip
    parser.add_argument(
        "--voltage-commanded", action="store_true", help="the voltage is a command, not measured"
    )
    parser.add_argument(
        "--no-value", action="append", metavar="NUMBER", help="a number that stands for a missing value"
    )
    parser.add_argument(
        "--as-it-is",
        action="store_true",
        help="add no effects to the motor file, though most motors have them",
    )
    parser.add_argument(
        "--compare", action="store_true", help="hold the motor file as it is against every recording, too"
    )
    parser.add_argument(
        "--diagnose",
        choices=("odd", "all"),
        help="look for what is missing from the make in the odd motors, or in each, as motorlens diagnose does",
    )
    parser.add_argument(
        "--brief", type=float, metavar="SECONDS",
        help="new motors will be recorded for so long: say by how much a recording as brief leads away from its motor",
    )  # fmt: skip
    add_queue_arguments(parser)
    add_json_argument(parser)


def run(arguments: argparse.Namespace) -> int:
    from motorlens_physics.queue import checked_workers, single_threaded
    from motorlens_runtime.errors import DataError

    brief_s = arguments.brief
    if brief_s is not None and not 0 < brief_s < float("inf"):
        raise DataError(f"--brief {brief_s:g}: write seconds, more than 0")
    workers = checked_workers(arguments.workers)
    if workers == 0 and arguments.scheduler is None:
        single_threaded()
    from dataclasses import replace
    from pathlib import Path

    from motorlens_physics.command_inputs import no_values
    from motorlens_physics.motor_file import read_motor_file, to_toml, voltage_commanded
    from motorlens_physics.queue import queue
    from motorlens_runtime.progress import Progress
    from motorlens_workbench.fleet.diagnosis import diagnosed
    from motorlens_workbench.fleet.manifest import entries
    from motorlens_workbench.fleet.store import Store, write_atomically
    from motorlens_workbench.fleet.study import study
    from motorlens_workbench.fleet.work import Job, analysed
    from motorlens_workbench.report.fleet import history_lines, to_html, to_json, to_text

    file = read_motor_file(arguments.motor)
    if arguments.voltage_commanded:
        file = voltage_commanded(file)
    out = Path(arguments.output)
    found = entries(Path(arguments.folder), out)
    motors = {entry.motor for entry in found}
    if arguments.history is not None and arguments.history not in motors:
        raise DataError(
            f"--history {arguments.history}: no such motor; there are {', '.join(sorted(motors))}"
        )
    store = Store(out / "results")
    store.clear_halves()
    job = Job(Path(), file, tuple(arguments.column), no_values(arguments.no_value), arguments.compare)
    with (
        ExitStack() as stack,
        queue(
            arguments.scheduler, workers, arguments.memory,
            lambda client: print(f"motorlens fleet: dashboard {client.dashboard_link}", file=sys.stderr),
        ) as run,
    ):  # fmt: skip

        def work(jobs: Any) -> Any:
            return run(analysed, jobs)

        def say(text: str) -> None:
            stages.append(stack.enter_context(Progress(1.0, f"fleet: {text}")))

        stages: list[Progress] = []
        fleet = study(
            found, job, store, work, grow=not arguments.as_it_is, brief_s=brief_s, say=say,
            progress=lambda done, of: stages[-1].update(done / of, f"({done} of {of} recordings)"),
        )  # fmt: skip
        if arguments.diagnose:
            every = fleet.population.motors
            # The oddest first: in them there is most to be named, and that takes longest.
            order = fleet.by_oddness if arguments.diagnose == "all" else fleet.odd
            asked = tuple(every[m] for m in order)
            say(f"diagnosing {len(asked)} motors")
            fleet = replace(fleet, diagnoses=diagnosed(
                fleet, asked, job, store, work, lambda done, of: stages[-1].update(done / of, f"({done} of {of} motors)"),
            ))  # fmt: skip
    words = shlex.join(
        ["motorlens", "fleet", arguments.folder, "--motor", arguments.motor, "-o", arguments.output]
    )
    document = to_json(fleet, arguments.motor)
    write_atomically(out / "population.toml", to_toml(fleet.make).encode())
    write_json(document, str(out / "fleet.json"))
    write_atomically(out / "index.html", "".join(to_html(fleet, arguments.motor, words)).encode())
    write_json(document, arguments.json)
    if arguments.json != "-":
        print(
            "\n".join(
                to_text(fleet) if arguments.history is None else history_lines(fleet, arguments.history)
            )
        )
        print(f"{out / 'index.html'}, {out / 'population.toml'}")
    return 0
