"""Tasks for workers in other processes, which import this module by its name."""

import os
import signal
import time

from motorlens_runtime.errors import DataError


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
