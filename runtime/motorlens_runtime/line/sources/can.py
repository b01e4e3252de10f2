"""`can://can0?dialect=can&dbc=drive.dbc&voltage=Drive.Voltage&current=Drive.Current`: a CAN interface of Linux.

It is only listened to. What the frames mean is the dialect's; option `fd=1` where the bus speaks CAN FD.
"""

import select
import socket
from contextlib import suppress
from urllib.parse import SplitResult

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.line.sources import Options, broken


def open_url(parts: SplitResult, options: Options) -> "CanSource":
    """See `sources`."""
    name = parts.netloc
    if not name:
        raise DataError(f"--source {parts.geturl()}: name an interface, for example can://can0")
    if not hasattr(socket, "AF_CAN"):
        raise DeviceError(f"can://{name}: this system has no SocketCAN")
    try:
        bus = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    except OSError as error:
        raise DeviceError(f"can://{name}: this kernel has no CAN: {error.strerror}") from None
    try:
        if options.get("fd") == "1":
            bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        bus.bind((name,))
    except OSError as error:
        bus.close()
        raise DeviceError(
            f"can://{name}: {error.strerror}; is it up? ip link set {name} up type can"
        ) from None
    return CanSource(bus, name)


class CanSource:
    """A raw CAN socket; each datagram is one frame of the kernel's layout."""

    lasting = True

    def __init__(self, bus: socket.socket, name: str) -> None:
        self.name = f"can://{name}"
        self._socket = bus
        self._socket.setblocking(False)

    def read(self, timeout_s: float) -> bytes | None:
        """See `Source.read`."""
        frames: list[bytes] = []
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            while len(frames) < 256:
                frames.append(self._socket.recv(72))
        except BlockingIOError:
            pass
        except OSError as error:
            raise broken(self.name, error) from None
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        """A bus is only listened to."""

    def close(self) -> None:
        """Let go of the interface."""
        with suppress(OSError):
            self._socket.close()
