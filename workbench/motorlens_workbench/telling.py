"""Progress of long commands, on standard error."""

import sys
import time

from motorlens_workbench.contest import Progress


def teller(command: str) -> Progress:
    """A function that prints what is being done and since when, one line each."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"motorlens {command}: {time.monotonic() - begun:5.1f} s  {text}", file=sys.stderr, flush=True)

    return say
