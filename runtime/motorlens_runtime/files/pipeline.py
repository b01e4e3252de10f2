"""Reading ahead and writing behind, each in a thread of its own with a short queue: memory stays bounded.

Parsing, estimating and writing spend most of their time in libraries that let other threads run meanwhile.
"""

import queue
import threading
from collections.abc import Iterable, Iterator
from typing import TypeVar

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.publish import Publisher
from motorlens_runtime.worker import Worker

T = TypeVar("T")
_AHEAD = 1


def ahead(items: Iterable[T]) -> Iterator[T]:
    """The same items, made in a thread. What making one raises is raised here, in its place.

    The thread ends with the items, or when this iterator is closed.
    """
    made: queue.Queue[tuple[T | None, BaseException | None, bool]] = queue.Queue(_AHEAD)
    closing = threading.Event()

    def make() -> None:
        error: BaseException | None = None
        try:
            for item in items:
                made.put((item, None, False))
                if closing.is_set():
                    return
        except BaseException as raised:
            error = raised
        made.put((None, error, True))

    thread = threading.Thread(target=make, name="reader", daemon=True)
    thread.start()
    try:
        while True:
            item, error, last = made.get()
            if error is not None:
                raise error
            if last:
                return
            yield item  # type: ignore[misc]
    finally:
        closing.set()
        while thread.is_alive():
            try:
                made.get(timeout=0.01)
            except queue.Empty:
                continue


class Behind:
    """A publisher whose work is done in a thread. The first thing it raises is raised by the next call, or by `close`; after
    that nothing more is written, whatever waits."""

    def __init__(self, publisher: Publisher) -> None:
        self._publisher = publisher
        self._raised = False
        self._worker: Worker[Estimates] = Worker(
            "writer", publisher.publish, _AHEAD, waits=True, ends=(Exception,)
        )

    def publish(self, estimates: Estimates) -> None:
        """Hand over rows; waits where the writer is slower."""
        self._raise()
        self._worker.put(estimates)

    def flush(self) -> None:
        """Nothing: all is written by `close`."""

    def close(self) -> None:
        """Write what waits, and finish."""
        self._worker.close()
        self._publisher.close()
        self._raise()

    def _raise(self) -> None:
        if self._worker.error is not None and not self._raised:
            self._raised = True
            raise self._worker.error
