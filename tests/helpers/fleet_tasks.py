"""Tasks for workers in other processes, which import this module by its name."""

import os
import signal
import time
from dataclasses import dataclass

from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.work import Job


def task(what):
    """Number 3 cannot be used; number 5 kills whoever works on it, number 6 the first who does."""
    number, folder = what
    if number == 3:
        raise DataError("three.csv: cannot be used")
    mark = os.path.join(folder, "died")
    if number == 5 or (number == 6 and not os.path.exists(mark)):
        open(mark, "w").close()
        os.kill(os.getpid(), signal.SIGKILL)
    return number, os.getpid(), os.environ["OMP_NUM_THREADS"]


def sleeps(seconds):
    """As long as a real task takes, without its work."""
    time.sleep(seconds)
    return seconds


@dataclass(frozen=True)
class Hungry(Job):
    """A recording of which huge.csv takes ever more memory, until its worker is ended."""

    def result(self):
        if self.path.name == "huge.csv":
            taken = []
            while True:
                # Written to, so that it is truly taken.
                taken.append(b"\1" * 20_000_000)
                time.sleep(0.01)
        return super().result()
