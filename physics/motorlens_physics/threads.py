"""Work on all cores: compiled code runs without the interpreter's lock, so threads are enough."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> list[U]:
    """What the function makes of each item, in their order; each in the context of the caller, numpy's of errors included.

    Raises:
        Exception: the first that the function raises.

    >>> on_all_cores(abs, [-1, 2])
    [1, 2]
    """
    each = [(copy_context(), item) for item in items]
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(lambda one: one[0].run(function, one[1]), each))
