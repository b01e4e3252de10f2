"""Work on all cores: compiled code runs without the interpreter's lock, so threads are enough."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextvars import ContextVar, copy_context
from typing import TypeVar

T = TypeVar("T")
U = TypeVar("U")

# Whether all cores have work from further out: more threads would only wait for each other.
_BUSY: ContextVar[bool] = ContextVar("busy", default=False)


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _at_once() -> int:
    """How many threads: a core each, or as many as `OMP_NUM_THREADS` lets numerical libraries have."""
    most = os.environ.get("OMP_NUM_THREADS", "")
    return min(cores(), int(most)) if most.isdecimal() and int(most) > 0 else cores()


def on_all_cores(function: Callable[[T], U], items: Iterable[T]) -> list[U]:
    """What the function makes of each item, in their order; each in the context of the caller, numpy's of errors included.

    One after the other where there is but one item, or where this is itself part of work that goes on on every core.
    `OMP_NUM_THREADS` limits the threads.

    Raises:
        Exception: the first that the function raises.

    >>> on_all_cores(abs, [-1, 2])
    [1, 2]
    """
    items, threads = list(items), _at_once()
    if min(len(items), threads) < 2 or _BUSY.get():
        return [function(item) for item in items]

    def one(item: T) -> U:
        _BUSY.set(len(items) >= threads)
        return function(item)

    contexts = [copy_context() for _ in items]
    with ThreadPoolExecutor(min(threads, len(items))) as pool:
        return list(pool.map(lambda context, item: context.run(one, item), contexts, items))
