"""The virtual sensor against other methods, the bound and its goals: one row of the table after the other.

    python benchmarks/sensor.py                 all rows
    python benchmarks/sensor.py unseen wheels   some of them
    python benchmarks/sensor.py --quick         all rows, trained on little

Errors count from one second after the first voltage step. Every start temperature is unknown to every method. The bound's
genie is told when and by how much the load jumps; no estimator knows that. The paper's row alone is judged by the largest
error, as the paper is.
"""

import argparse
import sys
import time
from collections.abc import Callable

from sensor_rows.common import Size
from sensor_rows.motor import ambient, hot_restart, paper, unseen
from sensor_rows.others import brush, magnet, node, tolerance
from sensor_rows.wheels import fra233, wheels

ROWS: dict[str, Callable[[Size, bool], None]] = {
    row.__name__: row
    for row in (paper, unseen, hot_restart, ambient, tolerance, magnet, brush, node, wheels, fra233)
}


def main() -> int:
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
