"""VESC over UART, USB or TCP: the reply to COMM_GET_VALUES, asked for or overheard.

Packet: start byte 2 (one length byte), 3 (two) or 4 (three), payload, CRC-16/XMODEM of the payload, stop byte 3; integers
are big-endian. Source: the VESC firmware (github.com/vedderb/bldc), comm/packet.c and COMM_GET_VALUES in comm/commands.c.

The terminal voltage of a motor in DC mode is duty cycle times input voltage. The motor current the firmware reports is
positive while the motor draws, negative while it generates, whichever way it turns (`mcpwm_get_tot_current_filtered` in
motor/mcpwm.c), so the duty cycle gives it its sign. It is the mean since the last reply, which is what an estimator
wants, and why only one host should ask.

Options: `poll_Hz` (default 100; 0 only listens), `values` = `selective` (three numbers, firmware from 2018 on) or `all`.
"""

import binascii
import math
import struct

import numpy as np

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.dialects.quantities import Assembler, empty_samples
from motorlens_runtime.options import Options

COMM_GET_VALUES = 4
COMM_GET_VALUES_SELECTIVE = 50
# The values in the order of their mask bits, as far as they are needed here: type, and divisor of the number.
_FIELDS = (
    ("h", 10.0),  # transistor temperature
    ("h", 10.0),  # motor temperature
    ("i", 100.0),  # motor current
    ("i", 100.0),  # input current
    ("i", 100.0),  # id
    ("i", 100.0),  # iq
    ("h", 1000.0),  # duty cycle
    ("i", 1.0),  # electrical speed
    ("h", 10.0),  # input voltage
)
_CURRENT, _DUTY, _VOLTAGE = 2, 6, 8
_MASK = 1 << _CURRENT | 1 << _DUTY | 1 << _VOLTAGE
# The longest packet the firmware sends over UART is 512 bytes of payload.
_MAX_PAYLOAD = 512
# A reply that has not come by then is not waited for any more.
_PATIENCE_NS = 100_000_000


def make(options: Options) -> "Vesc":
    """The dialect with its options."""
    return Vesc(
        poll_Hz=options.number("poll_Hz", 100.0, 0.0, 1000.0),
        selective=options.choice("values", ("selective", "all")) == "selective",
    )


class Vesc(Dialect):
    """Decoder of VESC packets, and the host that asks for them."""

    asks = True

    def __init__(self, poll_Hz: float = 100.0, selective: bool = True) -> None:
        super().__init__()
        self._period_ns = round(1e9 / poll_Hz) if poll_Hz else 0
        payload = (
            struct.pack(">BI", COMM_GET_VALUES_SELECTIVE, _MASK) if selective else bytes((COMM_GET_VALUES,))
        )
        self._question = packet(payload)
        self._asked_ns: int | None = None
        self._waiting = False
        self._rest = b""
        self._assembler = Assembler()

    def request(self, now_ns: int) -> bytes:
        """The next question, when it is due and the last one has been answered or given up."""
        if not self._period_ns:
            return b""
        if now_ns < self._due_ns(now_ns):
            return b""
        # Questions keep to their grid, unless the drive has been silent.
        on_grid = self._asked_ns is not None and now_ns - self._asked_ns < 2 * self._period_ns
        self._asked_ns = (
            self._asked_ns + self._period_ns if on_grid and self._asked_ns is not None else now_ns
        )
        self._waiting = True
        return self._question

    def patience_s(self, now_ns: int) -> float:
        """Until the next question is due."""
        return max(self._due_ns(now_ns) - now_ns, 0) * 1e-9 if self._period_ns else math.inf

    def _due_ns(self, now_ns: int) -> int:
        if self._asked_ns is None:
            return now_ns
        return self._asked_ns + (max(self._period_ns, _PATIENCE_NS) if self._waiting else self._period_ns)

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """Samples from the replies that `data` completes."""
        self.bytes_seen += len(data)
        payloads, self._rest, bad = payloads_in(self._rest + data)
        self.bad_frames += bad
        rows = [row for row in map(values_in, payloads) if row is not None]
        if not rows:
            return empty_samples()
        self._waiting = False
        current, duty, supply = np.array(rows, dtype=np.float64).T
        columns = {"current": np.where(duty < 0, -current, current), "duty": duty, "supply_voltage": supply}
        return self._assembler.samples(columns, now_ns)


def packet(payload: bytes) -> bytes:
    """A payload of up to 65535 bytes as it stands on the wire."""
    short = len(payload) < 256
    head = bytes((2, len(payload))) if short else struct.pack(">BH", 3, len(payload))
    return head + payload + struct.pack(">HB", binascii.crc_hqx(payload, 0), 3)


def payloads_in(data: bytes) -> tuple[list[bytes], bytes, int]:
    """Payloads of the complete packets, the unfinished rest, and how many starts led to no packet.

    As in the firmware, whatever is no packet is left one byte at a time, so a packet inside rubbish is found.
    """
    payloads: list[bytes] = []
    at = bad = 0
    while at < len(data):
        start = data[at]
        if start not in (2, 3):
            at += 1
            continue
        if len(data) - at < start:
            break
        length = data[at + 1] if start == 2 else data[at + 1] << 8 | data[at + 2]
        if not (1 if start == 2 else 255) <= length <= _MAX_PAYLOAD:
            at += 1
            continue
        end = at + start + length
        if end + 3 > len(data):
            break
        payload = data[at + start : end]
        if data[end + 2] == 3 and binascii.crc_hqx(payload, 0) == int.from_bytes(data[end : end + 2], "big"):
            payloads.append(payload)
            at = end + 3
        else:
            bad += 1
            at += 1
    return payloads, data[at:], bad


def values_in(payload: bytes) -> tuple[float, float, float] | None:
    """Motor current in A, duty cycle, input voltage in V of a reply; None if it is another message or lacks one."""
    if payload[0] == COMM_GET_VALUES:
        mask, at = 0xFFFFFFFF, 1
    elif payload[0] == COMM_GET_VALUES_SELECTIVE and len(payload) >= 5:
        mask, at = int.from_bytes(payload[1:5], "big"), 5
    else:
        return None
    if mask & _MASK != _MASK:
        return None
    found = []
    for bit, (layout, divisor) in enumerate(_FIELDS):
        if not mask >> bit & 1:
            continue
        size = struct.calcsize(layout)
        if at + size > len(payload):
            return None
        if _MASK >> bit & 1:
            found.append(struct.unpack_from(">" + layout, payload, at)[0] / divisor)
        at += size
    current, duty, supply = found
    return current, duty, supply
