"""`udp://127.0.0.1:9870`: each row as one flat JSON datagram with `timestamp` in seconds, as PlotJuggler reads it.

Nothing waits: a datagram that does not fit into the socket's buffer is dropped and counted.
"""

import json
import socket
from typing import Any
from urllib.parse import SplitResult

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.publish import Header, address_of, options_of
from motorlens_runtime.publish.jsonl import documents

PLOTJUGGLER_PORT = 9870


def open_url(url: SplitResult, header: Header) -> "UdpPublisher":
    """See `publish`. The port is PlotJuggler's unless given."""
    options_of(url)
    host, port = address_of(url, PLOTJUGGLER_PORT)
    try:
        family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        out = socket.socket(family, socket.SOCK_DGRAM)
    except OSError as error:
        raise DeviceError(f"{url.geturl()}: {error.strerror or error}") from None
    return UdpPublisher(out, address, header)


class UdpPublisher:
    """Sends to an address. `dropped` counts rows that could not be sent at once."""

    def __init__(self, out: socket.socket, address: Any, header: Header) -> None:
        self._socket = out
        self._socket.setblocking(False)
        self._address = address
        self._header = header
        self.dropped = 0

    def publish(self, estimates: Estimates) -> None:
        """One datagram per row."""
        for row in documents(estimates, self._header):
            self._send(row)

    def event(self, event: dict[str, object]) -> None:
        """One datagram per event."""
        self._send(event)

    def flush(self) -> None:
        """Nothing is held back."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, document: dict[str, object]) -> None:
        try:
            # Not connected, so that a listener that is absent is no error.
            self._socket.sendto(json.dumps(document).encode(), self._address)
        except OSError:
            self.dropped += 1
