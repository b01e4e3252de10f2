"""Wire protocol v1: how a drive's samples travel as bytes. docs/wire-protocol.md is the same in words.

A frame is `COBS(header 8 | payload 0..240 | CRC-32)` and one zero byte. COBS (Cheshire and Baker, IEEE/ACM Trans.
Networking 7(2), 1999) leaves no zero inside, so a reader that lost its place is back at the next zero. The header is
kind, version and flags, sequence number and the device's clock; all integers are little-endian. The CRC is the one of
IEEE 802.3, over header and payload.

SAMPLES carries n instants of every channel; what the numbers mean (name, unit, scale, rate) is said by HELLO, which
the device repeats, so that a device that can only transmit is understood too. STATUS carries its counters.

Pure functions on bytes: no device, no clock. `link.Link` turns decoded frames into samples.
"""

import binascii
import json
import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.line.crc32 import crc32_rows
from motorlens_runtime.records import record

VERSION = 1
DELIMITER = b"\0"
HEADER = struct.Struct("<BBHI")
MAX_PAYLOAD = 240
OVERHEAD = HEADER.size + 4
MAX_BODY = MAX_PAYLOAD + OVERHEAD + 1  # as it is on the wire: COBS adds one byte to a frame this short
# Below this many frames of one length, one Python call per frame is faster than the array code.
_VECTOR_FROM = 12

SAMPLE_TYPES: dict[str, np.dtype[Any]] = {"i2": np.dtype("<i2"), "f4": np.dtype("<f4")}


class Kind(IntEnum):
    """What a frame carries."""

    HELLO = 1
    SAMPLES = 2
    STATUS = 3


class Flag(IntFlag):
    """What the device says about the samples of a frame (the low four bits of the second byte)."""

    RESTART = 1
    SATURATED = 2
    OVERRUN = 4


@record(frozen=True)
class Frame:
    """One frame: kind, flags (`Flag` bits), sequence number 0..65535, device clock in microseconds mod 2^32, payload."""

    kind: int
    sequence: int
    t0_us: int
    payload: bytes
    flags: int = 0


@dataclass(frozen=True)
class FrameRun:
    """Consecutive valid frames of one payload length, as arrays: the form in which they are decoded fast.

    `kind`, `flags`, `sequence` and `t0_us` have shape (m,), `payload` is uint8 of shape (m, length).
    """

    kind: NDArray[np.uint8]
    flags: NDArray[np.uint8]
    sequence: NDArray[np.uint16]
    t0_us: NDArray[np.uint32]
    payload: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.kind)

    def frames(self) -> Iterator[Frame]:
        """The same frames one by one."""
        for row in range(len(self)):
            yield Frame(
                int(self.kind[row]),
                int(self.sequence[row]),
                int(self.t0_us[row]),
                self.payload[row].tobytes(),
                int(self.flags[row]),
            )


@dataclass(frozen=True)
class Channel:
    """One channel of SAMPLES: value = scale * code + offset in `unit`; codes at `minimum` or `maximum` are at the rail.

    `name` is a quantity such as "voltage", `unit` any spelling `columns` knows, `type` "i2" or "f4" (all channels of a
    device share one type).
    """

    name: str
    unit: str
    type: str = "i2"
    scale: float = 1.0
    offset: float = 0.0
    minimum: float | None = None
    maximum: float | None = None


@dataclass(frozen=True)
class Hello:
    """What a device says about itself. `rate_Hz` is exact as a fraction; `boot` differs after each restart."""

    device: str
    boot: int
    rate_Hz: tuple[int, int]
    channels: tuple[Channel, ...]
    schema: int = 1
    firmware: str = ""
    simulated: bool = False
    protocol: int = field(default=VERSION)

    def to_json(self) -> bytes:
        """The payload of HELLO before it is cut into pieces."""
        document = {key: value for key, value in asdict(self).items() if key != "channels"}
        document["channels"] = [
            {k: v for k, v in asdict(channel).items() if v is not None} for channel in self.channels
        ]
        return json.dumps(document, separators=(",", ":")).encode()

    @staticmethod
    def from_json(data: bytes) -> "Hello":
        """Read what `to_json` wrote; unknown keys are ignored, so that newer devices are understood.

        Raises:
            DataError: a key is missing or of the wrong kind.
        """
        try:
            document = json.loads(data)
            numerator, denominator = (int(part) for part in document["rate_Hz"])
            if not (0 < numerator <= 1_000_000_000 and 0 < denominator <= 1_000_000_000):
                raise ValueError("rate_Hz")
            channels = tuple(_channel(entry) for entry in document["channels"])
            if not channels or len({channel.type for channel in channels}) != 1:
                raise ValueError("channels of more than one type, or none")
            return Hello(
                device=str(document["device"]), boot=int(document["boot"]), rate_Hz=(numerator, denominator),
                channels=channels, schema=int(document["schema"]), firmware=str(document.get("firmware", "")),
                simulated=bool(document.get("simulated", False)), protocol=int(document["protocol"]),
            )  # fmt: skip
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
            raise DataError(f"HELLO is not understood: {type(error).__name__} {error}") from None


@dataclass(frozen=True)
class Status:
    """Counters of the device since its boot."""

    uptime_us: int
    samples: int
    dropped: int
    saturated: int

    _LAYOUT = struct.Struct("<QIII")

    def to_bytes(self) -> bytes:
        """The payload of STATUS."""
        return self._LAYOUT.pack(
            self.uptime_us, self.samples & 0xFFFFFFFF, self.dropped & 0xFFFFFFFF, self.saturated & 0xFFFFFFFF
        )

    @staticmethod
    def from_bytes(payload: bytes) -> "Status":
        """Read what `to_bytes` wrote. Raises DataError if the length is wrong."""
        if len(payload) != Status._LAYOUT.size:
            raise DataError(f"STATUS has {len(payload)} bytes, not {Status._LAYOUT.size}")
        return Status(*Status._LAYOUT.unpack(payload))


def encode(frame: Frame) -> bytes:
    """The bytes of a frame on the wire, with the zero that ends it.

    Raises:
        ValueError: the payload is longer than `MAX_PAYLOAD`.
    """
    if len(frame.payload) > MAX_PAYLOAD:
        raise ValueError(f"payload of {len(frame.payload)} bytes; a frame holds {MAX_PAYLOAD}")
    head = HEADER.pack(
        frame.kind, VERSION << 4 | frame.flags & 0x0F, frame.sequence & 0xFFFF, frame.t0_us & 0xFFFFFFFF
    )
    body = head + frame.payload
    body += binascii.crc32(body).to_bytes(4, "little")
    # Each piece between zeros is led by its length plus one; no piece reaches 254 in a frame this short.
    return b"".join(bytes((len(piece) + 1,)) + piece for piece in body.split(b"\0")) + DELIMITER


def decode(body: bytes) -> Frame | None:
    """The frame between two zeros, or None if it is damaged, of another version or too long."""
    length = len(body)
    if not OVERHEAD < length <= MAX_BODY:
        return None
    # A code says where the next one stands; there, and that is all, a zero belongs.
    out = bytearray(body)
    at = 0
    while at < length:
        code = out[at]
        if code == 0:
            return None
        out[at] = 0
        at += code
    if at != length or binascii.crc32(out[1:-4]) != int.from_bytes(out[-4:], "little"):
        return None
    kind, second, sequence, t0_us = HEADER.unpack_from(out, 1)
    if second >> 4 != VERSION:
        return None
    return Frame(kind, sequence, t0_us, bytes(out[1 + HEADER.size : -4]), second & 0x0F)


def decode_run(bodies: Sequence[bytes]) -> tuple[FrameRun, int]:
    """Decode frames of one length at once; returns the valid ones in order, and how many were damaged."""
    if len(bodies) < _VECTOR_FROM or not OVERHEAD < len(bodies[0]) <= MAX_BODY:
        frames = [frame for frame in map(decode, bodies) if frame is not None]
        return run_of(frames, max(len(bodies[0]) - OVERHEAD - 1, 0)), len(bodies) - len(frames)
    coded = np.frombuffer(b"".join(bodies), dtype=np.uint8).reshape(len(bodies), -1)
    width = coded.shape[1]
    body = coded[:, 1:].copy()
    # Walk the chain of COBS codes of all rows together: a code says where the next one stands, and there a zero belongs.
    rows = np.arange(len(coded))
    place = np.zeros(len(coded), dtype=np.intp)
    valid = np.ones(len(coded), dtype=bool)
    while rows.size:
        code = coded[rows, place]
        step = place + code
        broken = (code == 0) | (step > width)
        valid[rows[broken]] = False
        on = ~broken & (step < width)
        rows, place = rows[on], step[on]
        body[rows, place - 1] = 0
    valid &= crc32_rows(body[:, :-4]) == np.ascontiguousarray(body[:, -4:]).view("<u4")[:, 0]
    valid &= body[:, 1] >> 4 == VERSION
    good = body if valid.all() else body[valid]
    head = np.ascontiguousarray(good[:, : HEADER.size])
    return FrameRun(
        kind=head[:, 0], flags=head[:, 1] & np.uint8(0x0F), sequence=head.view("<u2")[:, 1], t0_us=head.view("<u4")[:, 1],
        payload=good[:, HEADER.size : -4],
    ), len(bodies) - len(good)  # fmt: skip


class Decoder:
    """Cuts a byte stream into frames. Holds at most one unfinished frame; whatever comes in, it does not raise.

    Attributes:
        bad_frames: pieces between zeros that were not a valid frame of this version.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._overlong = False
        self.bad_frames = 0

    def held(self) -> tuple[bytes, bool, int]:
        """The unfinished frame, whether what comes up to the next zero is thrown away, and the count of bad frames."""
        return self._rest, self._overlong, self.bad_frames

    def hold(self, rest: bytes, overlong: bool, bad_frames: int) -> None:
        """Go on from what another decoder held."""
        self._rest, self._overlong, self.bad_frames = rest, overlong, bad_frames

    def whole(self, data: bytes) -> Frame | None:
        """The frame, where `data` is one sound frame from its first byte to its zero and nothing is unfinished; else None.

        The bytes are not taken in: the caller is done with them, or feeds them.
        """
        if self._rest or self._overlong or data.find(DELIMITER) != len(data) - 1:
            return None
        return decode(data[:-1])

    def feed(self, data: bytes) -> list[FrameRun]:
        """Decode what is complete, in order of arrival; the unfinished tail waits for the next call."""
        pieces = (self._rest + data).split(DELIMITER)
        self._rest = pieces.pop()
        if self._overlong and pieces:
            pieces[0] = b""  # the end of what was thrown away below
            self._overlong = False
        if len(self._rest) > MAX_BODY:
            # A line that sends no zero must not fill the memory.
            self.bad_frames += not self._overlong
            self._rest, self._overlong = b"", True
        runs: list[FrameRun] = []
        start = 0
        bodies = [piece for piece in pieces if piece]
        while start < len(bodies):
            end = start + 1
            while end < len(bodies) and len(bodies[end]) == len(bodies[start]):
                end += 1
            run, bad = decode_run(bodies[start:end])
            self.bad_frames += bad
            if len(run):
                runs.append(run)
            start = end
        return runs


def samples_frame(
    codes: NDArray[np.int16] | NDArray[np.float32], *, schema: int, sequence: int, t0_us: int, flags: int = 0
) -> bytes:
    """SAMPLES on the wire: `codes` of shape (n, channels), int16 or float32; row k was taken at t0 + k / rate.

    Raises:
        ValueError: more than `samples_per_frame` rows.
    """
    layout = "<i2" if codes.dtype.kind == "i" else "<f4"
    payload = bytes((schema, len(codes))) + np.ascontiguousarray(codes, dtype=layout).tobytes()
    return encode(Frame(Kind.SAMPLES, sequence, t0_us, payload, flags))


def samples_per_frame(channels: int, code_type: str = "i2") -> int:
    """How many instants fit in one SAMPLES frame."""
    return (MAX_PAYLOAD - 2) // (channels * int(SAMPLE_TYPES[code_type].itemsize))


def hello_frames(hello: Hello, *, sequence: int, t0_us: int, flags: int = 0) -> list[bytes]:
    """HELLO on the wire: one frame per piece of its JSON, with consecutive sequence numbers from `sequence`."""
    text = hello.to_json()
    size = MAX_PAYLOAD - 2
    pieces = [text[at : at + size] for at in range(0, len(text), size)]
    if len(pieces) > 255:
        raise ValueError("HELLO is longer than 255 frames")
    return [
        encode(Frame(Kind.HELLO, sequence + index, t0_us, bytes((index, len(pieces))) + piece, flags))
        for index, piece in enumerate(pieces)
    ]


def status_frame(status: Status, *, sequence: int, t0_us: int, flags: int = 0) -> bytes:
    """STATUS on the wire."""
    return encode(Frame(Kind.STATUS, sequence, t0_us, status.to_bytes(), flags))


class HelloAssembler:
    """Puts the pieces of HELLO together; pieces of different sendings never mix, a lost one costs that sending only."""

    def __init__(self) -> None:
        self._pieces: list[bytes] = []
        self._count = 0
        self._next_sequence = 0

    def feed(self, frame: Frame) -> Hello | None:
        """The complete HELLO with its last piece, None before. Raises DataError if it is not understood."""
        if len(frame.payload) < 2:
            return None
        index, count = frame.payload[0], frame.payload[1]
        if index == 0:
            self._pieces, self._count = [], count
        elif count != self._count or index != len(self._pieces) or frame.sequence != self._next_sequence:
            self._pieces, self._count = [], 0
            return None
        self._pieces.append(frame.payload[2:])
        self._next_sequence = (frame.sequence + 1) & 0xFFFF
        if len(self._pieces) != self._count:
            return None
        text, self._pieces, self._count = b"".join(self._pieces), [], 0
        return Hello.from_json(text)


def run_of(frames: Sequence[Frame], length: int) -> FrameRun:
    """Frames of one payload length as arrays."""
    return FrameRun(
        kind=np.array([frame.kind for frame in frames], dtype=np.uint8),
        flags=np.array([frame.flags for frame in frames], dtype=np.uint8),
        sequence=np.array([frame.sequence for frame in frames], dtype=np.uint16),
        t0_us=np.array([frame.t0_us for frame in frames], dtype=np.uint32),
        payload=np.frombuffer(b"".join(frame.payload for frame in frames), dtype=np.uint8).reshape(
            len(frames), length
        ),
    )


def _channel(entry: dict[str, object]) -> Channel:
    def number(key: str, default: float | None) -> float | None:
        value = entry.get(key, default)
        if value is None:
            return None
        result = float(value)  # type: ignore[arg-type]
        if not np.isfinite(result):
            raise ValueError(key)
        return result

    kind = str(entry.get("type", "i2"))
    if kind not in SAMPLE_TYPES:
        raise ValueError(f"type {kind!r}")
    scale, offset = number("scale", 1.0), number("offset", 0.0)
    assert scale is not None and offset is not None
    return Channel(
        str(entry["name"]),
        str(entry["unit"]),
        kind,
        scale,
        offset,
        number("minimum", None),
        number("maximum", None),
    )
