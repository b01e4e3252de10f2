"""What long commands say on standard error, and the pages that they write."""

import argparse
import sys
import time
from collections.abc import Callable

Progress = Callable[[str], None]


def add_page_arguments(parser: argparse.ArgumentParser) -> None:
    """Give a subcommand `--html FILE` and `--every-sample`."""
    parser.add_argument("--html", metavar="FILE", help="write one self-contained page")
    parser.add_argument(
        "--every-sample",
        action="store_true",
        help="put all of a long recording into the page, however large that is",
    )


def teller(command: str) -> Progress:
    """A function that prints what is being done and since when, one line each."""
    begun = time.monotonic()

    def say(text: str) -> None:
        print(f"motorlens {command}: {time.monotonic() - begun:5.1f} s  {text}", file=sys.stderr, flush=True)

    return say
