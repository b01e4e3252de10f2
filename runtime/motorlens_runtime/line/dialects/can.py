"""CAN frames as Linux hands them out (struct can_frame), read with a DBC file. Needs the extra `can`.

Which signal is which quantity is said as `MESSAGE.SIGNAL`; units are the DBC's own. A sample is made by each message that
carries the current, with the newest of the other quantities. Source: Linux Documentation/networking/can.rst for the frame.

Options: `dbc`, the path of the file; `voltage`, `current`, `duty`, `supply_voltage`, `ambient`, each `MESSAGE.SIGNAL`;
`hold_s`, how old the other quantities may be (default 1); `fd=1` where the socket yields CAN FD frames.
"""

import math
import struct
from typing import Any

import numpy as np

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.dialects.quantities import (
    QUANTITIES,
    Assembler,
    conversion,
    empty_samples,
    require_channels,
)
from motorlens_runtime.options import Options, nearest

CLASSIC = struct.Struct("=IB3x8s")
FLEXIBLE = struct.Struct("=IBB2x64s")
EXTENDED_FLAG, _REMOTE_FLAG, _ERROR_FLAG = 0x80000000, 0x40000000, 0x20000000


def make(options: Options) -> "Can":
    """The dialect with its options."""
    chosen = {}
    for quantity in QUANTITIES:
        name = options.text(quantity, "") if quantity != "time" else ""
        if name:
            chosen[quantity] = name
    return Can(
        options.text("dbc"),
        chosen,
        hold_s=options.number("hold_s", 1.0, 1e-3, 3600.0),
        flexible=options.integer("fd", 0, 0, 1) == 1,
    )


class Can(Dialect):
    """Decoder of frames of one bus.

    Args:
        path: the DBC file.
        signals: quantity -> `MESSAGE.SIGNAL`.
        hold_s: how old a quantity of another message may be when the current comes.
        flexible: whether the frames are CAN FD's of 72 bytes.

    Raises:
        DataError: the file is not readable, a signal is not in it, or voltage and current cannot be had.
    """

    def __init__(
        self, path: str, signals: dict[str, str], hold_s: float = 1.0, flexible: bool = False
    ) -> None:
        super().__init__()
        require_channels(tuple(signals), path)
        self._layout = FLEXIBLE if flexible else CLASSIC
        self._hold_ns = round(hold_s * 1e9)
        # Frame identifier with its flag -> the message, and its (quantity, signal, factor, offset).
        self._messages: dict[int, tuple[Any, list[tuple[str, str, float, float]]]] = {}
        database = _load(path)
        for quantity, name in signals.items():
            message, signal = _find(database, name, path)
            factor, offset = conversion(
                quantity, signal.unit or ("1" if quantity == "duty" else ""), f"{path}: {name}"
            )
            identifier = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
            self._messages.setdefault(identifier, (message, []))[1].append(
                (quantity, signal.name, factor, offset)
            )
        self._order = tuple(signals)
        self._latest: dict[str, tuple[float, int]] = {}
        self._rest = b""
        self._assembler = Assembler()

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """Samples from whole frames; each read of a CAN socket yields one."""
        self.bytes_seen += len(data)
        data = self._rest + data
        size = self._layout.size
        rows = []
        for at in range(0, len(data) - size + 1, size):
            identifier, length = self._layout.unpack_from(data, at)[:2]
            payload = self._layout.unpack_from(data, at)[-1]
            row = self._frame(identifier, payload[:length], now_ns)
            if row is not None:
                rows.append(row)
        self._rest = data[len(data) - len(data) % size :]
        if not rows:
            return empty_samples()
        columns = dict(zip(self._order, np.array(rows, dtype=np.float64).T, strict=True))
        return self._assembler.samples(columns, now_ns)

    def _frame(self, identifier: int, payload: bytes, now_ns: int) -> list[float] | None:
        if identifier & (_REMOTE_FLAG | _ERROR_FLAG) or identifier not in self._messages:
            return None
        message, wanted = self._messages[identifier]
        try:
            values = message.decode(payload, decode_choices=False, allow_truncated=True)
        except (ValueError, KeyError, ArithmeticError, IndexError, _decode_error()):
            self.bad_frames += 1
            return None
        for quantity, signal, factor, offset in wanted:
            value = values.get(signal, math.nan)
            if isinstance(value, int | float):
                self._latest[quantity] = (factor * value + offset, now_ns)
        if not any(quantity == "current" for quantity, *_ in wanted):
            return None
        fresh = [self._latest.get(quantity, (0.0, now_ns - self._hold_ns - 1)) for quantity in self._order]
        return [value for value, _ in fresh] if all(now_ns - at <= self._hold_ns for _, at in fresh) else None


def frame_bytes(identifier: int, payload: bytes, *, extended: bool = False, flexible: bool = False) -> bytes:
    """A frame as the kernel hands it out."""
    identifier |= EXTENDED_FLAG if extended else 0
    if flexible:
        return FLEXIBLE.pack(identifier, len(payload), 0, payload)
    return CLASSIC.pack(identifier, len(payload), payload)


def _load(path: str) -> Any:
    import cantools

    try:
        return cantools.database.load_file(path, database_format="dbc", strict=False)
    except (OSError, ValueError, KeyError, cantools.Error) as error:
        raise DataError(f"{path}: {error}") from None


def _find(database: Any, name: str, path: str) -> tuple[Any, Any]:
    message_name, _, signal_name = name.partition(".")
    messages = {message.name: message for message in database.messages}
    if message_name not in messages:
        raise DataError(f"{path}: no message {message_name!r}{nearest(message_name, messages)}")
    signals = {signal.name: signal for signal in messages[message_name].signals}
    if signal_name not in signals:
        raise DataError(f"{path}: no signal {signal_name!r} in {message_name}{nearest(signal_name, signals)}")
    return messages[message_name], signals[signal_name]


def _decode_error() -> type[Exception]:
    import cantools

    error: type[Exception] = cantools.Error
    return error
