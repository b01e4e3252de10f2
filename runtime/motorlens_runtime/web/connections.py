"""Connections of a small server: one thread waits for requests on all of them, a bounded number of threads answers.

A connection that has not sent a whole request costs a place in a table, not a thread; it is closed at one deadline, however
slowly its bytes come. So neither half-open connections nor many clients at once keep anybody from being answered.
"""

import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

# Requests answered at once; further ones wait in a queue.
MOST_SERVED = 64
# Connections held without a request, below the usual limit of 1024 open files; beyond, one is closed: of those that have
# never been let in the one that has waited longest, for a crowd of them must not cost a page its connection.
MOST_WAITING = 512
# Connections that the kernel holds until they are accepted.
BACKLOG = 128
MOST_HEAD_OCTETS = 1 << 16
# From the last answer, or from its opening, until a connection must have sent the head of a request.
HEAD_S = 15.0
# Until a body must have come, an answer must have been taken, and the thread that waits must have ended.
BODY_S = 30.0
_HEAD_END = b"\r\n\r\n"


class Connection:
    """One connection whose next request is complete as far as its head; `octets` is what has come and is not used yet.

    `user` is whose program is at the other end, for who finds out; `let_in` whether any request of it has been.
    """

    def __init__(self, line: socket.socket) -> None:
        self.line = line
        self.octets = b""
        self.user: int | None = None
        self.let_in = False

    def readline(self, most: int = -1) -> bytes:
        """A line of what has come, its end included."""
        end = self.octets.find(b"\n") + 1 or len(self.octets)
        return self._taken(end if most < 0 else min(end, most))

    def read(self, count: int) -> bytes:
        """`count` octets; fewer if the other side has closed.

        Raises:
            TimeoutError: they have not come within `BODY_S`.
        """
        deadline = time.monotonic() + BODY_S
        while len(self.octets) < count:
            if (left_s := deadline - time.monotonic()) <= 0:
                raise TimeoutError
            self.line.settimeout(left_s)
            if not (more := self.line.recv(1 << 16)):
                break
            self.octets += more
        return self._taken(count)

    def write(self, octets: bytes) -> int:
        """Send it all within `BODY_S`."""
        self.line.settimeout(BODY_S)
        self.line.sendall(octets)
        return len(octets)

    def flush(self) -> None:
        """Nothing is held back."""

    def has_head(self) -> bool:
        """Whether the head of a request has come."""
        return _HEAD_END in self.octets

    def close(self) -> None:
        """Hang up."""
        with suppress(OSError):
            self.line.close()

    def _taken(self, count: int) -> bytes:
        taken, self.octets = self.octets[:count], self.octets[count:]
        return taken


@dataclass
class _Wait:
    connection: Connection
    deadline_s: float


class Connections:
    """Listens on 127.0.0.1 from the moment it is made until `close`.

    Args:
        port: 0 is a free one.
        serve: answers the request at the head of a connection, in one of `MOST_SERVED` threads; returns whether the
            connection stays open.
        too_long: what is sent to who sends more than `MOST_HEAD_OCTETS` without an end.

    Raises:
        OSError: the port is taken.
    """

    def __init__(self, port: int, serve: Callable[[Connection], bool], too_long: bytes) -> None:
        self._serve, self._too_long = serve, too_long
        self._listener = socket.create_server(("127.0.0.1", port), backlog=BACKLOG)
        self._listener.setblocking(False)
        self.port = int(self._listener.getsockname()[1])
        self._bell, self._rope = socket.socketpair()
        self._bell.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self._selector.register(self._bell, selectors.EVENT_READ)
        # In the order in which they began to wait, so the first one's deadline comes first.
        self._waiting: dict[socket.socket, _Wait] = {}
        self._answered: deque[Connection] = deque()
        self._served: set[Connection] = set()
        self._closed = self._ended = False
        self._pool = ThreadPoolExecutor(MOST_SERVED, "pages")
        self._thread = threading.Thread(target=self._work, name="pages", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening and hang up everywhere."""
        self._closed = True
        self._ring()
        self._thread.join(BODY_S)
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _ring(self) -> None:
        with suppress(OSError):
            self._rope.send(b"!")

    def _work(self) -> None:
        while not self._closed:
            due_s = next((wait.deadline_s for wait in self._waiting.values()), None)
            patience_s = None if due_s is None else max(0.0, due_s - time.monotonic())
            for key, _ in self._selector.select(patience_s):
                if key.fileobj is self._listener:
                    self._accept()
                elif key.fileobj is self._bell:
                    with suppress(BlockingIOError):
                        self._bell.recv(1 << 12)
                elif key.fileobj in self._waiting:  # it may have been closed for another one a moment ago
                    assert isinstance(key.fileobj, socket.socket)
                    self._receive(key.fileobj)
            while self._answered:
                self._wait_for(self._answered.popleft())
            now_s = time.monotonic()
            for wait in [wait for wait in self._waiting.values() if wait.deadline_s <= now_s]:
                self._give_up(wait.connection)
        for wait in list(self._waiting.values()):
            self._drop(wait.connection)
        self._ended = True
        while self._answered:
            self._answered.popleft().close()
        for connection in list(self._served):  # whoever reads or writes there is woken by it
            with suppress(OSError):
                connection.line.shutdown(socket.SHUT_RDWR)
        for end in (self._listener, self._bell, self._rope):
            end.close()
        self._selector.close()

    def _accept(self) -> None:
        for _ in range(BACKLOG):
            try:
                line, _ = self._listener.accept()
            except OSError:  # none is left, or it has gone again, or there are no more files
                return
            self._wait_for(Connection(line))

    def _wait_for(self, connection: Connection) -> None:
        """Wait for its next request, which may be there already."""
        if connection.has_head():
            self._hand_over(connection)
            return
        if len(self._waiting) >= MOST_WAITING:
            waiting = [wait.connection for wait in self._waiting.values()]
            self._give_up(next((one for one in waiting if not one.let_in), waiting[0]))
        connection.line.setblocking(False)
        self._waiting[connection.line] = _Wait(connection, time.monotonic() + HEAD_S)
        self._selector.register(connection.line, selectors.EVENT_READ)

    def _receive(self, line: socket.socket) -> None:
        connection = self._waiting[line].connection
        try:
            octets = line.recv(1 << 16)
        except BlockingIOError:
            return
        except OSError:
            octets = b""
        connection.octets += octets
        if not octets:
            self._drop(connection)
        elif connection.has_head():
            self._leave(connection)
            self._hand_over(connection)
        elif len(connection.octets) > MOST_HEAD_OCTETS:
            with suppress(OSError):
                line.send(self._too_long)
            self._drop(connection)

    def _hand_over(self, connection: Connection) -> None:
        self._served.add(connection)

        def never_answered(future: Future[None]) -> None:
            if future.cancelled():
                connection.close()

        self._pool.submit(self._answer, connection).add_done_callback(never_answered)

    def _answer(self, connection: Connection) -> None:
        stays = False
        with suppress(OSError):  # a browser that went away is no concern of ours
            stays = self._serve(connection)
        self._served.discard(connection)
        if stays:
            self._answered.append(connection)
            self._ring()
        if self._ended or not stays:  # nobody is left who takes up what has been answered
            connection.close()

    def _leave(self, connection: Connection) -> None:
        self._selector.unregister(connection.line)
        del self._waiting[connection.line]

    def _give_up(self, connection: Connection) -> None:
        """Close it, unless its request has come since anybody looked."""
        self._receive(connection.line)
        if connection.line in self._waiting:
            self._drop(connection)

    def _drop(self, connection: Connection) -> None:
        self._leave(connection)
        connection.close()
