"""RoboClaw packet serial: supply voltage, PWM and motor current, asked for in turn.

Commands 24 (main battery voltage, 0.1 V), 48 (PWM of both motors, +-32767 is full) and 49 (current of both motors, 10 mA),
each `address, command`; the reply is the big-endian values and a CRC-16/XMODEM over address, command and values, so that a
reply can be told apart although it names neither. Source: RoboClaw Series User Manual (Basicmicro), Packet Serial and
Advanced Packet Serial, commands 24, 48 and 49.

The terminal voltage is PWM times supply. The manual calls the current the draw of the motor: its sign is taken to say
drawing or generating, and the PWM gives it its direction; `current=signed` takes it as it comes.

Options: `motor` 1 or 2, `address` (default 0x80), `poll_Hz` (samples a second, default 50; 0 only listens),
`current` = `draw` or `signed`.
"""

import binascii
import math
import struct

import numpy as np

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.dialects.quantities import Assembler, empty_samples
from motorlens_runtime.options import Options

READ_SUPPLY, READ_PWM, READ_CURRENT = 24, 48, 49
# In the order of asking: what changes fastest is asked last and next to each other.
_LENGTHS = {READ_SUPPLY: 2, READ_PWM: 4, READ_CURRENT: 4}
# The manual lets the drive 10 ms to answer; USB adds a few.
_PATIENCE_NS = 30_000_000


def make(options: Options) -> "RoboClaw":
    """The dialect with its options."""
    return RoboClaw(
        motor=options.integer("motor", 1, 1, 2),
        address=options.integer("address", 0x80, 0x80, 0x87),
        poll_Hz=options.number("poll_Hz", 50.0, 0.0, 300.0),
        signed=options.choice("current", ("draw", "signed")) == "signed",
    )


class RoboClaw(Dialect):
    """Decoder of the three replies, and the host that asks for them one at a time."""

    asks = True

    def __init__(
        self, motor: int = 1, address: int = 0x80, poll_Hz: float = 50.0, signed: bool = False
    ) -> None:
        super().__init__()
        self._motor = motor
        self._address = address
        self._signed = signed
        self._period_ns = round(1e9 / poll_Hz) if poll_Hz else 0
        self._started_ns: int | None = None  # when the round of questions began
        self._asked: int | None = None  # the question that is open
        self._asked_ns = 0
        self._values: dict[int, float] = {}
        self._rest = b""
        self._assembler = Assembler()

    def request(self, now_ns: int) -> bytes:
        """The next of the three questions, as soon as the one before is answered or given up."""
        if not self._period_ns:
            return b""
        if self._asked is not None:
            if now_ns - self._asked_ns < _PATIENCE_NS:
                return b""
            # The answer that did not come may still trickle in; it must not be taken for the next one.
            self.bad_frames += 1
            self._rest, self._values = b"", {}
        missing = [command for command in _LENGTHS if command not in self._values]
        if len(missing) == len(_LENGTHS):
            if self._started_ns is None or now_ns - self._started_ns >= 2 * self._period_ns:
                self._started_ns = now_ns
            elif now_ns - self._started_ns < self._period_ns:
                return b""
            else:
                self._started_ns += (
                    self._period_ns
                )  # rounds keep to their grid, unless the drive has been silent
        self._asked, self._asked_ns = missing[0], now_ns
        return bytes((self._address, self._asked))

    def patience_s(self, now_ns: int) -> float:
        """Until the open answer is given up, or the next round begins."""
        if not self._period_ns:
            return math.inf
        if self._asked is not None:
            return max(self._asked_ns + _PATIENCE_NS - now_ns, 0) * 1e-9
        if self._values or self._started_ns is None:
            return 0.0
        return max(self._started_ns + self._period_ns - now_ns, 0) * 1e-9

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """A sample each time all three replies have come."""
        self.bytes_seen += len(data)
        rest = self._rest + data
        rows: list[tuple[float, float, float]] = []
        at, lost = 0, False
        while at < len(rest):
            command = self._reply_at(rest, at)
            if command is None:
                if len(rest) - at < self._awaited_length():
                    break
                self.bad_frames += not lost
                at, lost = at + 1, True
                continue
            lost = False
            self._take(command, rest[at : at + _LENGTHS[command]])
            at += _LENGTHS[command] + 2
            if len(self._values) == len(_LENGTHS):
                rows.append((self._values[READ_CURRENT], self._values[READ_PWM], self._values[READ_SUPPLY]))
                self._values = {}
        self._rest = rest[at:]
        if not rows:
            return empty_samples()
        current, duty, supply = np.array(rows, dtype=np.float64).T
        if not self._signed:
            current = np.where(duty < 0, -current, current)
        return self._assembler.samples({"current": current, "duty": duty, "supply_voltage": supply}, now_ns)

    def _awaited_length(self) -> int:
        """Bytes of the open reply with its CRC, or of the longest there is."""
        return 2 + (_LENGTHS[self._asked] if self._asked is not None else max(_LENGTHS.values()))

    def _reply_at(self, data: bytes, at: int) -> int | None:
        """The command that a reply starting here answers; only the open one, if there is one."""
        for command in (self._asked,) if self._asked is not None else tuple(_LENGTHS):
            end = at + _LENGTHS[command]
            if end + 2 <= len(data):
                crc = binascii.crc_hqx(bytes((self._address, command)) + data[at:end], 0)
                if crc == int.from_bytes(data[end : end + 2], "big"):
                    return command
        return None

    def _take(self, command: int, values: bytes) -> None:
        self._asked = None
        if command == READ_SUPPLY:
            self._values[command] = int.from_bytes(values, "big") / 10.0
            return
        value = struct.unpack(">hh", values)[self._motor - 1]
        self._values[command] = value / 32767.0 if command == READ_PWM else value / 100.0
