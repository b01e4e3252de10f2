"""Nothing is missing, and a log holds the voltage commanded and the counts of an encoder: what `diagnose` says of it.

    python benchmarks/counted_angle.py --count 40 --seed 1

Motors, drives, encoders and loggers are drawn anew for each, see `tests/helpers/counted_angle.py` (other code): each
parameter of the motor is off by up to 30 %, its rotor up to ten times as nimble, the motor file by up to 10 %, and says so.
Steps of time of 2 to 20 ms are steady or vary by a quarter; in every second log the command changes between samples. Some
10 s of processor time a log.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path = [str(HERE.parent / "tests"), *(p for p in sys.path if Path(p).resolve() != HERE)]

from helpers.counted_angle import STATED, logged  # noqa: E402
from helpers.nothing_missing import coverage, told, verdicts  # noqa: E402

from motorlens_physics.motor_file import voltage_commanded  # noqa: E402
from motorlens_physics.recording import read_recording  # noqa: E402
from motorlens_workbench.diagnose import diagnose  # noqa: E402


def main() -> int:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    every = []
    print("steps   uneven counts current changes verdict        R, L, ke, J off by so many sd")
    for number in range(args.count):
        one, began = logged(args.seed, number, between=number % 2 == 1), time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            recording = read_recording(one.write(Path(folder) / "log.csv"), one.columns)
        every.append(told(diagnose(voltage_commanded(one.file), [recording]), one.truth, STATED))
        uneven, current = ("yes" if it else "no" for it in (one.uneven, one.current))
        changes = "between" if one.between else "at them"
        print(
            f"{one.period_ms:2d} ms   {uneven:6s} {one.counts:6d} {current:7s} {changes:7s} {every[-1].row}"
            f"  {time.process_time() - began:4.0f} s",
            flush=True,
        )
    print(verdicts(every))
    print(coverage(every))
    return 0


if __name__ == "__main__":
    sys.exit(main())
