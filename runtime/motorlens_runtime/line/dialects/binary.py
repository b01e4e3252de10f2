"""Binary records of a drive of one's own: sync bytes, numbers in a fixed order, a checksum. Described by a TOML file.

```toml
[record]
sync = "AA 55"                 # in hexadecimal; at least one byte
byte_order = "little"          # or "big"
checksum = "crc16_modbus"      # none, sum8, xor8, crc16_modbus, crc16_xmodem, crc16_ccitt, crc32; after the fields
checksum_covers_sync = false
rate_Hz = 1000                 # only if no field is the time; without it, time of arrival is used

[[field]]
type = "u32"                   # u8 i8 u16 i16 u32 i32 u64 i64 f32 f64; skip (with count = N) passes over bytes
quantity = "time"              # time, voltage, current, ambient, duty, supply_voltage; without one, a field is ignored
unit = "us"

[[field]]
type = "i16"
quantity = "voltage"
unit = "mV"
scale = 10.0                   # value = scale * number + offset, in the unit
offset = 0.0
```

Option: `file`, the path of the TOML file.
"""

import binascii
import functools
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.dialects import Dialect
from motorlens_runtime.line.dialects.quantities import Assembler, conversion, empty_samples, require_channels
from motorlens_runtime.options import Options, nearest

_TYPES = {
    f"{kind}{8 * size}": f"{code}{size}" for kind, code in (("u", "u"), ("i", "i")) for size in (1, 2, 4, 8)
}
_TYPES |= {"f32": "f4", "f64": "f8"}
_MAX_BYTES = 4096


def crc16_modbus(data: bytes) -> int:
    """CRC-16/MODBUS: polynomial 0x8005 reflected, from 0xFFFF.

    >>> hex(crc16_modbus(b"123456789"))
    '0x4b37'
    """
    crc = 0xFFFF
    table = _modbus_table()
    for byte in data:
        crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
    return crc


@functools.cache
def _modbus_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ 0xA001 if value & 1 else value >> 1
        table.append(value)
    return tuple(table)


# Name -> bytes of the checksum, and the function.
CHECKSUMS: dict[str, tuple[int, Callable[[bytes], int]]] = {
    "none": (0, lambda data: 0),
    "sum8": (1, lambda data: sum(data) & 0xFF),
    "xor8": (1, lambda data: functools.reduce(int.__xor__, data, 0)),
    "crc16_modbus": (2, crc16_modbus),
    "crc16_xmodem": (2, lambda data: binascii.crc_hqx(data, 0)),
    "crc16_ccitt": (2, lambda data: binascii.crc_hqx(data, 0xFFFF)),
    "crc32": (4, binascii.crc32),
}


@dataclass(frozen=True)
class Field:
    """One number of a record: numpy type without byte order, and value = factor * number + offset in SI."""

    quantity: str
    type: str
    factor: float
    offset: float


@dataclass(frozen=True)
class Record:
    """How a record is laid out: `sync`, then `layout` (a numpy dtype), then the checksum."""

    sync: bytes
    layout: np.dtype[Any]
    fields: tuple[Field, ...]
    checksum: str
    byte_order: Literal["little", "big"]
    covers_sync: bool
    rate_Hz: float | None

    @property
    def size(self) -> int:
        """Bytes of a record, all told."""
        return len(self.sync) + self.layout.itemsize + CHECKSUMS[self.checksum][0]

    @property
    def time_modulus_ns(self) -> int | None:
        """Where the time field wraps, if it is an integer that does within this century."""
        for field in self.fields:
            if field.quantity == "time" and field.type[0] in "ui":
                modulus = 2.0 ** (8 * int(field.type[1:])) * field.factor * 1e9
                return round(modulus) if modulus < 2.0**61 else None
        return None


def make(options: Options) -> "Binary":
    """The dialect with its options."""
    path = options.text("file")
    try:
        document = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: {error}") from None
    return Binary(parse_record(document, path))


def parse_record(document: Mapping[str, Any], where: str) -> Record:
    """The layout that a TOML document describes.

    Raises:
        DataError: a key is missing, unknown or not usable; the message says which.
    """
    try:
        _refuse_unknown(document, ("record", "field"), where)
        head = document["record"]
        known = ("sync", "byte_order", "checksum", "checksum_covers_sync", "rate_Hz")
        _refuse_unknown(head, known, f"{where}: [record]")
        sync = bytes.fromhex(head["sync"])
        if not sync:
            raise DataError(f"{where}: sync is empty; a record without a mark at its start cannot be found")
        byte_order, checksum = head.get("byte_order", "little"), head.get("checksum", "none")
        for name, value, choices in (
            ("byte_order", byte_order, ("little", "big")),
            ("checksum", checksum, tuple(CHECKSUMS)),
        ):
            if value not in choices:
                raise DataError(f"{where}: {name} = {value!r}{nearest(str(value), choices)}")
        rate = head.get("rate_Hz")
        if rate is not None and not 0 < float(rate) <= 1e6:
            raise DataError(f"{where}: rate_Hz = {rate}")
        columns, fields = [], []
        for index, entry in enumerate(document["field"]):
            column, field = _field(entry, f"{where}: field {index + 1}")
            order = ">" if byte_order == "big" else "<"
            columns.append((f"f{index}", column if column.startswith("V") else order + column))
            fields.append(field)
        layout = np.dtype(columns)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise DataError(f"{where}: is not understood ({type(error).__name__}: {error})") from None
    record = Record(
        sync, layout, tuple(fields), checksum, byte_order, bool(head.get("checksum_covers_sync", False)),
        None if rate is None else float(rate),
    )  # fmt: skip
    if record.size > _MAX_BYTES:
        raise DataError(f"{where}: a record of {record.size} bytes; at most {_MAX_BYTES}")
    quantities = [field.quantity for field in fields if field.quantity]
    for quantity in quantities:
        if quantities.count(quantity) > 1:
            raise DataError(f"{where}: more than one field is {quantity}")
    require_channels(quantities, where)
    return record


def _field(entry: Mapping[str, Any], where: str) -> tuple[str, Field]:
    _refuse_unknown(entry, ("type", "quantity", "unit", "scale", "offset", "count"), where)
    kind = entry["type"]
    if kind == "skip":
        return f"V{max(int(entry.get('count', 1)), 1)}", Field("", "", 0.0, 0.0)
    if kind not in _TYPES:
        raise DataError(f"{where}: type {kind!r}{nearest(str(kind), (*_TYPES, 'skip'))}")
    quantity = entry.get("quantity", "")
    if not quantity:
        return _TYPES[kind], Field("", _TYPES[kind], 0.0, 0.0)
    unit = str(entry.get("unit", "1" if quantity == "duty" else ""))
    factor, offset = conversion(str(quantity), unit, where)
    scale, shift = float(entry.get("scale", 1.0)), float(entry.get("offset", 0.0))
    return _TYPES[kind], Field(quantity, _TYPES[kind], factor * scale, factor * shift + offset)


def _refuse_unknown(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known:
            raise DataError(f"{where}: unknown key {key!r}{nearest(key, known)}")


class Binary(Dialect):
    """Decoder of one record layout.

    With a checksum, a record is one whose checksum is right. Without, the mark alone decides: a record counts where the
    mark stands again right after it, or where the one before ended.
    """

    def __init__(self, record: Record) -> None:
        super().__init__()
        self.record = record
        self._rest = b""
        self._locked = False
        self._assembler = Assembler(record.time_modulus_ns, record.rate_Hz)

    def feed(self, data: bytes, now_ns: int) -> Samples:
        """Samples from the records that `data` completes."""
        self.bytes_seen += len(data)
        data = self._rest + data
        size, sync = self.record.size, self.record.sync
        found: list[bytes] = []
        at = 0
        while True:
            start = data.find(sync, at)
            if start != at:
                self._locked = False
            if start < 0:
                at = max(at, len(data) - len(sync) + 1)
                break
            at = start
            if len(data) - at < size:
                break
            if self.record.checksum == "none" and not self._locked:
                after = data[at + size : at + size + len(sync)]
                if len(after) < len(sync):
                    break
                good = after == sync
            else:
                good = self._check(data[at : at + size])
            if good:
                found.append(data[at + len(sync) : at + len(sync) + self.record.layout.itemsize])
            self.bad_frames += not good
            self._locked = good
            at += size if good else 1
        self._rest = data[at:]
        if not found:
            return empty_samples()
        rows = np.frombuffer(b"".join(found), dtype=self.record.layout)
        with np.errstate(invalid="ignore", over="ignore"):  # a float32 from the line may be a signalling NaN
            columns = {
                field.quantity: rows[f"f{index}"].astype(np.float64) * field.factor + field.offset
                for index, field in enumerate(self.record.fields)
                if field.quantity
            }
            return self._assembler.samples(columns, now_ns)

    def _check(self, record: bytes) -> bool:
        length, function = CHECKSUMS[self.record.checksum]
        if not length:
            return True
        body = record[0 if self.record.covers_sync else len(self.record.sync) : -length]
        return function(body) == int.from_bytes(record[-length:], self.record.byte_order)
