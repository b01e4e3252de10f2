"""`serial:///dev/ttyUSB0?baud=921600`: a serial port, also by the serial number of its USB adapter: `serial://FT3K2M1?baud=...`.

pyserial finds, opens and configures the port; reading is done on its file descriptor, everything that is there at once.
"""

import fcntl
import os
import select
from contextlib import suppress
from pathlib import Path
from urllib.parse import SplitResult, unquote

import serial
from serial.tools import list_ports

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.line.sources import Options, broken, number_of

_AT_ONCE = 1 << 16


def open_url(parts: SplitResult, options: Options) -> "SerialSource":
    """See `sources`. Option `baud`, default 115200; it does not matter on USB and pseudo-terminals."""
    baud = number_of(options, "baud", 115200)
    path = unquote(parts.path) if parts.path else _by_serial_number(unquote(parts.netloc))
    if not path:
        raise DataError(f"--source {parts.geturl()}: name a port, for example serial:///dev/ttyUSB0")
    return SerialSource(path, round(baud))


class SerialSource:
    """An open serial port, ours alone."""

    lasting = True

    def __init__(self, path: str, baud: int) -> None:
        self.name = path
        if not os.path.exists(path):
            ports = ", ".join(port.device for port in list_ports.comports())
            raise DeviceError(
                f"{path}: no such port; {f'there are {ports}' if ports else 'no serial port is there'}"
            )
        try:
            # Without exclusive, for pyserial would not say who has it.
            self._port = serial.Serial(path, baud, timeout=0)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(_why_not(path, error)) from None
        self._fd = self._port.fileno()
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._port.close()
            raise DeviceError(f"{path}: taken by {_owner(path)}; close it there") from None
        if (other := _owner(path)) and other.startswith("process"):
            # It did not lock the port, but the two of us would each get half of the bytes.
            self._port.close()
            raise DeviceError(f"{path}: taken by {other}; close it there")
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._port.set_low_latency_mode(True)  # else USB adapters deliver every 16 ms only
        self._poll = select.poll()
        self._poll.register(self._fd, select.POLLIN)

    def read(self, timeout_s: float) -> bytes | None:
        """See `Source.read`."""
        events = self._poll.poll(timeout_s * 1000)
        if not events:
            return b""
        try:
            data = os.read(self._fd, _AT_ONCE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise broken(self.name, error) from None
        if not data:
            raise DeviceError(f"{self.name}: the device is gone; is it still plugged in?")
        return data

    def write(self, data: bytes) -> None:
        """See `Source.write`."""
        try:
            os.write(self._fd, data)
        except BlockingIOError:
            pass  # a device that does not listen must not stop us
        except OSError as error:
            raise broken(self.name, error) from None

    def close(self) -> None:
        """Let go of the port."""
        with suppress(OSError, serial.SerialException):
            self._port.close()


def _by_serial_number(number: str) -> str:
    if not number:
        return ""
    ports = list_ports.comports()
    for port in ports:
        if port.serial_number == number:
            return str(port.device)
    known = ", ".join(f"{port.device} ({port.serial_number})" for port in ports if port.serial_number)
    raise DeviceError(
        f"no port of serial number {number}; {f'there are {known}' if known else 'no USB serial port is there'}"
    )


def _why_not(path: str, error: Exception) -> str:
    number = getattr(error, "errno", None)
    if number == 13:
        return f"{path}: no permission; add yourself to the group {_group(path)}: sudo usermod -a -G {_group(path)} $USER"
    if number == 16:
        return f"{path}: taken by {_owner(path)}; close it there"
    return f"{path}: is not a usable serial port: {os.strerror(number) if number else error}"


def _group(path: str) -> str:
    try:
        return Path(path).group()
    except (OSError, KeyError):
        return "dialout"


def _owner(path: str) -> str:
    """The program that has a port open, as far as this user may know."""
    target = os.path.realpath(path)
    for process in Path("/proc").glob("[0-9]*"):
        if process.name == str(os.getpid()):
            continue
        with suppress(OSError):
            if any(os.path.realpath(fd) == target for fd in (process / "fd").iterdir()):
                return f"process {process.name} ({(process / 'comm').read_text().strip()})"
    return "this process" if _mine(target) else "another program"


def _mine(target: str) -> bool:
    with suppress(OSError):
        return any(os.path.realpath(fd) == target for fd in Path("/proc/self/fd").iterdir())
    return False
