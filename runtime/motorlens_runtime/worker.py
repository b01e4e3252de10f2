"""One thing after another in a thread of its own, behind a queue with an end: slow or failing, it delays nobody.

What cannot be done, because a disk is full or a line has gone, is counted and kept as the last error, and the next is tried:
a disk may have room again. Errors that are for good end the work.
"""

import threading
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

T = TypeVar("T")


class Worker(Generic[T]):
    """Does what it is handed, in order.

    Attributes:
        done, lost: weight of what was done, and of what was dropped or failed.
        errors: how often something failed.
        error: the last one.
        dead: an error for good came; nothing is done any more.
    """

    def __init__(
        self, name: str, do: Callable[[T], None], most: int, *, weight: Callable[[T], int] = lambda item: 1,
        waits: bool = False, ends: tuple[type[Exception], ...] = (), settle: Callable[[], None] | None = None,
        every_s: float | None = None, gather_s: float = 0.0, finish: Callable[[], None] | None = None,
    ) -> None:  # fmt: skip
        """Start the thread.

        Args:
            name: of the thread.
            do: what is done with an item.
            most: weight that may wait; one item may, however heavy.
            weight: of an item.
            waits: where there is no room, `put` waits for it; otherwise what has waited longest is dropped.
            ends: errors that are for good.
            settle: called after all that waited was done, and every `every_s` without anything to do.
            gather_s: pause after that, so that more comes together.
            finish: called last, in the thread.
        """
        self._do, self._most, self._weight, self._waits, self._ends = do, most, weight, waits, ends
        self._settle, self._every_s, self._gather_s, self._finish = settle, every_s, gather_s, finish
        self._items: deque[T] = deque()
        self._waiting = 0
        self._nudged = False
        self._change = threading.Condition()
        self._closing = threading.Event()
        self.done = self.lost = self.errors = 0
        self.error: Exception | None = None
        self.dead = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def put(self, item: T) -> None:
        """Hand over an item; returns at once, unless it `waits`."""
        heavy = self._weight(item)
        with self._change:
            while self._waits and self._items and self._waiting + heavy > self._most and not self.dead:
                self._change.wait()
            if self.dead:
                self.lost += heavy
                return
            self._items.append(item)
            self._waiting += heavy
            while self._waiting > self._most and len(self._items) > 1:
                dropped = self._weight(self._items.popleft())
                self._waiting -= dropped
                self.lost += dropped
            self._change.notify_all()

    def nudge(self) -> None:
        """Have `settle` called soon."""
        with self._change:
            self._nudged = True
            self._change.notify_all()

    def close(self, patience_s: float | None = None) -> int:
        """Do what waits, for `patience_s` at most, and end; the weight of what was given up."""
        self._closing.set()
        with self._change:
            self._change.notify_all()
        self._thread.join(patience_s)
        if not self._thread.is_alive():
            return 0
        with self._change:
            self.lost += self._waiting
            return self._waiting

    def _work(self) -> None:
        while True:
            with self._change:
                while not self._items and not self._nudged and not self._closing.is_set():
                    if not self._change.wait(self._every_s):
                        break
                batch, self._items = self._items, deque()
                self._waiting, self._nudged = 0, False
                closing = self._closing.is_set()
                self._change.notify_all()
            for item in batch:
                if self.dead:
                    self.lost += self._weight(item)
                else:
                    self._attempt(self._do, item, weight=self._weight(item))
            if self._settle is not None and not self.dead:
                self._attempt(self._settle)
            if closing and not self._items:
                if self._finish is not None:
                    self._attempt(self._finish)
                return
            if self._gather_s:
                # Nobody waits for `_change` meanwhile, so that no item wakes this thread.
                self._closing.wait(self._gather_s)

    def _attempt(self, action: Callable[..., None], *arguments: T, weight: int = 0) -> None:
        try:
            action(*arguments)
            self.done += weight
        except Exception as error:  # whatever a library raises must not end the thread
            if self.dead:
                return  # that it is over was noted when it came
            self.lost += weight
            self.errors += 1
            self.error = error
            if isinstance(error, self._ends):
                with self._change:
                    self.dead = True
                    self._change.notify_all()
