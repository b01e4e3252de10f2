"""The service manager's side of `motorlens run`: ready, alive, stopping. Nothing happens where no systemd listens.

Protocol: sd_notify(3); datagrams to the socket in NOTIFY_SOCKET, `@` standing for an abstract one.
"""

import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress


class Notifier:
    """Tells systemd; `environment` is that of the process."""

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        own = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        text = environment.get("WATCHDOG_USEC", "")
        # Half the time allowed, as sd_watchdog_enabled(3) advises.
        self._period_ns = int(text) * 500 if own and text.isdigit() else None
        self._next_ns = 0

    def tell(self, message: str) -> None:
        """Send lines such as `READY=1`; whoever does not listen is no error."""
        if not self._address:
            return
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as out:
            out.setblocking(False)
            out.sendto(message.encode(), self._address)

    def alive(self, now_ns: int) -> None:
        """To be called in every round of the loop: feeds the watchdog when it is due."""
        if self._period_ns is not None and now_ns >= self._next_ns:
            self._next_ns = now_ns + self._period_ns
            self.tell("WATCHDOG=1")

    def while_running(self, stop: Callable[[], bool], clock: Callable[[], int]) -> Callable[[], bool]:
        """`stop` of a loop, such that each round of the loop feeds the watchdog and the end is told."""
        self.tell("READY=1")

        def round_() -> bool:
            self.alive(clock())
            ending = stop()
            if ending:
                self.tell("STOPPING=1")
            return ending

        return round_
