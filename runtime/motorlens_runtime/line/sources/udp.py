"""`udp://:5555`: datagrams of whole frames sent to this port; listens on this machine only unless an address is given."""

import select
import socket
from contextlib import suppress
from urllib.parse import SplitResult

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.line.sources import Options, address, broken


def open_url(parts: SplitResult, options: Options) -> "UdpSource":
    """See `sources`."""
    return UdpSource(*address(parts, "127.0.0.1"))


class UdpSource:
    """A bound socket; answers go to whoever sent last."""

    lasting = True

    def __init__(self, host: str, port: int) -> None:
        self.name = f"udp://{host}:{port}"
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._peer: tuple[str, int] | None = None
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise DeviceError(f"{self.name}: cannot listen there: {error.strerror}") from None
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes | None:
        """See `Source.read`."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            parts = []
            for _ in range(64):
                data, self._peer = self._socket.recvfrom(1 << 16)
                parts.append(data)
        except BlockingIOError:
            pass
        except OSError as error:
            raise broken(self.name, error) from None
        return b"".join(parts)

    def write(self, data: bytes) -> None:
        """See `Source.write`."""
        if self._peer is not None:
            with suppress(BlockingIOError):
                self._socket.sendto(data, self._peer)

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()
