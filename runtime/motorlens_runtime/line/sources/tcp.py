"""`tcp://192.168.4.1:5555`: a serial server or a drive with a network port; this side connects."""

import select
import socket
from contextlib import suppress
from urllib.parse import SplitResult

from motorlens_runtime.errors import DeviceError
from motorlens_runtime.line.sources import Options, address, broken


def open_url(parts: SplitResult, options: Options) -> "TcpSource":
    """See `sources`."""
    return TcpSource(*address(parts, "127.0.0.1"))


class TcpSource:
    """A connection."""

    lasting = True

    def __init__(self, host: str, port: int) -> None:
        self.name = f"tcp://{host}:{port}"
        try:
            self._socket = socket.create_connection((host, port), timeout=3.0)
        except OSError as error:
            raise DeviceError(f"{self.name}: no connection: {error.strerror or error}") from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes | None:
        """See `Source.read`."""
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            data = self._socket.recv(1 << 16)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise broken(self.name, error) from None
        if not data:
            raise DeviceError(f"{self.name}: the other side closed the connection")
        return data

    def write(self, data: bytes) -> None:
        """See `Source.write`."""
        try:
            self._socket.send(data)
        except BlockingIOError:
            pass
        except OSError as error:
            raise broken(self.name, error) from None

    def close(self) -> None:
        """Hang up."""
        with suppress(OSError):
            self._socket.close()
