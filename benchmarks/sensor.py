"""The virtual sensor against other methods, the bound and its goals: one row of the table after the other.

    python benchmarks/sensor.py                 all rows
    python benchmarks/sensor.py unseen wheels   some of them
    python benchmarks/sensor.py --quick         all rows, trained on little
    python benchmarks/sensor.py worlds --count 400 --seed 1 [--cell noise=2-4] [--workers 2] [SENSOR.onnx ...]
                                                sensor files (the shipped ones) in worlds they were not made in
    python benchmarks/sensor.py changes [--drives 12] [--day] [SENSOR.onnx ...]
                                                noise that jumps, a voltage scale that is off, a drop that the motor
                                                file lacks, a day at constant load
    python benchmarks/sensor.py bounds [--drives 10] [SENSOR.onnx ...]
                                                beside the posterior Cramer-Rao bound, by excitation

Errors count from one second after the first voltage step. Every start temperature is unknown to every method. The bound's
genie is told when and by how much the load jumps; no estimator knows that. The paper's row alone is judged by the largest
error, as the paper is.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

from sensor_rows.bounds import bounds
from sensor_rows.changes import changes
from sensor_rows.common import ROOT, Size
from sensor_rows.motor import ambient, hot_restart, paper, unseen
from sensor_rows.others import brush, magnet, node, tolerance
from sensor_rows.wheels import fra233, wheels
from sensor_rows.worlds import worlds

from motorlens_physics.queue import add_queue_arguments, queue

OBSERVER = ROOT / "models" / "sensors" / "mellah2016_observer.onnx"
ROWS: dict[str, Callable[[Size, bool], None]] = {
    row.__name__: row
    for row in (paper, unseen, hot_restart, ambient, tolerance, magnet, brush, node, wheels, fra233)
}


def _worlds(arguments: list[str]) -> int:
    """`worlds`: sensor files on a plant that shares no code with the packages; 1 where one is confidently wrong."""
    parser = argparse.ArgumentParser(prog="sensor.py worlds", description=_worlds.__doc__)
    parser.add_argument("sensors", nargs="*", type=Path, metavar="SENSOR.onnx")
    parser.add_argument("--count", type=int, default=400, help="of worlds")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--cell", action="append", default=[], metavar="FACTOR=CELL", help="chosen, not drawn"
    )
    add_queue_arguments(parser)
    parser.set_defaults(workers=0)
    chosen = parser.parse_args(arguments)
    shipped = [OBSERVER, OBSERVER.with_name("mellah2016.onnx")]
    # What workers import by name.
    os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT / "tests"), str(ROOT / "benchmarks")])
    with queue(chosen.scheduler, chosen.workers, chosen.memory) as work:
        wrong = [
            worlds(path, chosen.count, chosen.seed, chosen.cell, work) for path in chosen.sensors or shipped
        ]
    return int(any(wrong))


def _changes(arguments: list[str]) -> int:
    """`changes`: what becomes of a sensor file's intervals when the drive changes; 1 where one is confidently wrong."""
    parser = argparse.ArgumentParser(prog="sensor.py changes", description=_changes.__doc__)
    parser.add_argument("sensors", nargs="*", type=Path, metavar="SENSOR.onnx")
    parser.add_argument("--drives", type=int, default=12, help="of each row")
    parser.add_argument("--day", action="store_true", help="24 h at constant load as well")
    chosen = parser.parse_args(arguments)
    wrong = [changes(path, chosen.drives, chosen.day) for path in chosen.sensors or [OBSERVER]]
    return int(any(wrong))


def _bounds(arguments: list[str]) -> int:
    """`bounds`: a sensor file's errors beside the least possible; 1 where a ratio is larger than asked."""
    parser = argparse.ArgumentParser(prog="sensor.py bounds", description=_bounds.__doc__)
    parser.add_argument("sensors", nargs="*", type=Path, metavar="SENSOR.onnx")
    parser.add_argument("--drives", type=int, default=10, help="of each row")
    chosen = parser.parse_args(arguments)
    missed = [bounds(path, chosen.drives) for path in chosen.sensors or [OBSERVER]]
    return int(any(missed))


def main() -> int:
    if sys.argv[1:2] == ["bounds"]:
        return _bounds(sys.argv[2:])
    if sys.argv[1:2] == ["worlds"]:
        return _worlds(sys.argv[2:])
    if sys.argv[1:2] == ["changes"]:
        return _changes(sys.argv[2:])
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("rows", nargs="*", choices=[*ROWS, []], metavar="ROW", help=f"of {', '.join(ROWS)}")
    parser.add_argument("--quick", action="store_true", help="train on little, show a part")
    arguments = parser.parse_args()
    # As many cycles to test on: a start shows the temperature well or badly, and six starts are few enough.
    size = Size(12, 6, 400.0, 20) if arguments.quick else Size(30, 6, 400.0, 40)
    started = time.monotonic()
    for name in arguments.rows or ROWS:
        ROWS[name](size, arguments.quick)
        print(f"{name}: done after {time.monotonic() - started:.0f} s", file=sys.stderr, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
