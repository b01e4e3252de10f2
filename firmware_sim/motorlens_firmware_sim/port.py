"""A pseudo-terminal as the drive's serial port: to any program it is a serial device."""

import errno
import fcntl
import os
import pty
import select
import struct
import termios
import time
import tty
from collections.abc import Callable
from types import TracebackType
from typing import Self

from motorlens_runtime.errors import DeviceError

# Who has had the port open for so long without flushing it reads what is there.
_UNFLUSHED_S = 3.0


class PtyPort:
    """The drive's end of a pseudo-terminal; `name` is the path that the other side opens.

    Args:
        link: a symbolic link to make beside it, so that the path can be known beforehand.

    Raises:
        DeviceError: the link cannot be made.
    """

    def __init__(self, link: str | None = None) -> None:
        self._master, slave = pty.openpty()
        # Raw before anybody listens: the settings outlive the closing of this end, and echo must never come back.
        tty.setraw(slave)
        # From here on, what happens at the other end is told (tty_ioctl(4), packet mode).
        fcntl.ioctl(self._master, termios.TIOCPKT, struct.pack("i", 1))
        self.name = os.ttyname(slave)
        os.close(slave)
        os.set_blocking(self._master, False)
        self.link = link
        if link is not None:
            try:
                if os.path.islink(link):
                    os.unlink(link)
                os.symlink(self.name, link)
            except OSError as error:
                os.close(self._master)
                raise DeviceError(f"--link {link}: {error.strerror}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Unplug."""
        if self.link is not None and os.path.islink(self.link):
            os.unlink(self.link)
        os.close(self._master)

    def has_reader(self) -> bool:
        """Whether anybody has the port open."""
        poll = select.poll()
        poll.register(self._master, select.POLLIN)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def wait_for_reader(self, give_up: Callable[[], bool] = lambda: False) -> None:
        """Return when somebody has opened the port and flushed it, as serial libraries do on opening.

        What was sent before would be lost, however long a busy machine takes from the one to the other.
        """
        opened_s: float | None = None
        while not give_up() and not self._flushed():
            if not self.has_reader():
                opened_s = None
            elif opened_s is None:
                opened_s = time.monotonic()
            elif time.monotonic() - opened_s > _UNFLUSHED_S:
                return
            time.sleep(0.02)

    def _flushed(self) -> bool:
        """Whether the other end has been flushed since this was asked before."""
        try:
            return bool(os.read(self._master, 1)[0] & termios.TIOCPKT_FLUSHREAD)
        except OSError:  # nobody has it open, or nothing has happened
            return False

    def write(self, data: bytes, patience_s: float) -> int:
        """Write what the line takes within `patience_s`; returns the number of bytes taken."""
        poll = select.poll()
        poll.register(self._master, select.POLLOUT)
        taken = 0
        while taken < len(data):
            try:
                taken += os.write(self._master, data[taken:])
            except BlockingIOError:
                if not poll.poll(1000 * patience_s):
                    break
            except OSError as error:
                if error.errno != errno.EIO:  # EIO: nobody has the other end open
                    raise
                break
        return taken
