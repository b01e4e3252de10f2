"""The fleet: what is recovered of a population that is known, what is odd, what a killed run leaves, what the queue costs.

    python benchmarks/fleet.py                      200 motors of 5 recordings, 50 and 12 kills, 1000 tasks
    python benchmarks/fleet.py --quick              40 motors, 50 and 3 kills, 300 tasks
    python benchmarks/fleet.py --only regbot        real robots (../shared/recordings), see real_recordings.py

The motors come from an integrator of its own (`tests/helpers/plain_fleet.py`): four recordings of 6 s at 200 Hz and one of
five minutes at 10 Hz each, 0.5 % noise on every channel (2 % for each fifth motor); the motor file is 10 % off. One motor in
forty is broken: twice the viscous friction, 1.25 times the resistance, 0.88 times the motor constant, Coulomb friction, a
shorted winding. Each study is a file in `fleet_studies/`.
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "tests"))

from fleet_studies.forked_kills import killed_often  # noqa: E402
from fleet_studies.kills import killed  # noqa: E402
from fleet_studies.new_motor import new_motor  # noqa: E402
from fleet_studies.population import population, told_apart  # noqa: E402
from fleet_studies.rate import queue, simulated  # noqa: E402
from fleet_studies.regbot import regbot, regbot_crossed  # noqa: E402


def main() -> None:
    """Run the studies that are asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a sample")
    parser.add_argument("--motors", type=int, help="how many motors")
    parser.add_argument("--kills", type=int, help="how many kills")
    parser.add_argument("--workers", type=int, default=0, help="processes (default: this one)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--keep", type=Path, metavar="DIR", help="work there and keep it; a study that was stopped goes on"
    )

    def motors() -> int:
        return a.motors or (40 if a.quick else 200)

    def tasks() -> int:
        return 300 if a.quick else 1000

    studies: dict[str, Callable[[Path], None]] = {
        "population": lambda place: population(place, motors(), a.seed, a.workers),
        "effects": lambda place: told_apart(place, a.motors or max(motors() // 4, 20), a.seed, a.workers),
        "new_motor": lambda place: new_motor(place, 4 if a.quick else 12, a.seed, a.workers),
        "killed_often": lambda place: killed_often(place, a.kills or 50, a.seed),
        "killed": lambda place: killed(place, a.kills or (3 if a.quick else 12), a.seed),
        "queue": lambda place: queue(tasks(), 0.5),
        "simulated": lambda place: simulated(1000, a.seed),
        "regbot": lambda place: regbot(place, a.workers),
        "regbot_crossed": lambda place: regbot_crossed(place, a.workers),
    }
    parser.add_argument("--only", nargs="+", choices=studies, default=list(studies), help="some of it")
    a = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="fleet-") as folder:
        for name in a.only:
            place = (a.keep or Path(folder)) / name
            place.mkdir(parents=True, exist_ok=True)
            studies[name](place)


if __name__ == "__main__":
    main()
