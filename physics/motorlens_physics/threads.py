"""Work on all cores: compiled code runs without the interpreter's lock, so threads are enough."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> list[U]:
    """What the function makes of each item, in their order.

    Raises:
        Exception: the first that the function raises.

    >>> on_all_cores(abs, [-1, 2])
    [1, 2]
    """
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(function, items))
