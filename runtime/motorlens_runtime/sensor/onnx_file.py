"""The little of the ONNX file format that the runtime needs, read without a protobuf library.

Field numbers are those of onnx.proto3 (https://github.com/onnx/onnx/blob/main/onnx/onnx.proto3). Reading the file a second
time, by other code than ONNX Runtime's, is what lets the numpy backend check it.
"""

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError

# StringStringEntryProto {key: "motorlens.sha256", value: 64 digits}, up to the digits.
_SEAL = re.compile(rb"motorlens\.sha256\x12\x40([0-9a-f]{64})", re.DOTALL)
_TYPES: dict[int, type[np.generic]] = {1: np.float32, 6: np.int32, 7: np.int64, 9: np.bool_, 11: np.float64}


@dataclass(frozen=True)
class Node:
    """One operation of the graph; attributes are numbers, tuples of numbers, bytes or arrays."""

    op: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: dict[str, Any]


@dataclass(frozen=True)
class OnnxFile:
    """Graph and metadata. `inputs` and `outputs` are names, `constants` the initializers by name."""

    metadata: dict[str, str]
    nodes: tuple[Node, ...]
    constants: dict[str, NDArray[Any]]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    input_types: tuple[type[np.generic], ...]


def check_seal(data: bytes, where: str) -> str:
    """Verify the SHA-256 that the file carries of itself and return it.

    Raises:
        ModelError: there is none, more than one, or it is of another file.
    """
    seals = list(_SEAL.finditer(data))
    if len(seals) != 1:
        raise ModelError(
            f"{where}: not a motorlens sensor, or cut short: no motorlens.sha256 in it; export it again"
        )
    start, end = seals[0].span(1)
    digest = sha256(data[:start] + b"0" * 64 + data[end:]).hexdigest()
    if digest.encode() != data[start:end]:
        raise ModelError(
            f"{where}: altered or cut short: its SHA-256 is {digest[:12]}..., not {seals[0][1].decode()[:12]}...; "
            "copy it again"
        )
    return digest


def parse(data: bytes, where: str) -> OnnxFile:
    """Read a model.

    Raises:
        ModelError: the bytes are not an ONNX model of the kinds of tensors that are known here.
    """
    try:
        metadata: dict[str, str] = {}
        graph = b""
        for number, value in _fields(data):
            if number == 14:
                entry = dict(_fields(value))
                metadata[entry[1].decode()] = entry.get(2, b"").decode()
            elif number == 7:
                graph = value
        nodes: list[Node] = []
        types: dict[str, type[np.generic]] = {}
        constants: dict[str, NDArray[Any]] = {}
        inputs: list[str] = []
        outputs: list[str] = []
        for number, value in _fields(graph):
            if number == 1:
                nodes.append(_node(value))
            elif number == 5:
                name, array = _tensor(value)
                constants[name] = array
            elif number in (11, 12):
                entry = dict(_fields(value))
                name = entry[1].decode()
                types[name] = _TYPES[dict(_fields(dict(_fields(entry[2]))[1]))[1]]
                (inputs if number == 11 else outputs).append(name)
        inputs = [name for name in inputs if name not in constants]
        input_types = tuple(types[name] for name in inputs)
        return OnnxFile(metadata, tuple(nodes), constants, tuple(inputs), tuple(outputs), input_types)
    except (ValueError, KeyError, IndexError, struct.error, AttributeError, TypeError) as error:
        raise ModelError(f"{where}: not a readable ONNX model ({type(error).__name__}: {error})") from None


def _node(data: bytes) -> Node:
    inputs, outputs, op, attributes = [], [], "", {}
    for number, value in _fields(data):
        if number == 1:
            inputs.append(value.decode())
        elif number == 2:
            outputs.append(value.decode())
        elif number == 4:
            op = value.decode()
        elif number == 5:
            name, attribute = _attribute(value)
            attributes[name] = attribute
    return Node(op, tuple(inputs), tuple(outputs), attributes)


def _attribute(data: bytes) -> tuple[str, Any]:
    name, value = "", None
    many: list[Any] = []
    for number, raw in _fields(data):
        if number == 1:
            name = raw.decode()
        elif number == 2:
            value = struct.unpack("<f", raw)[0]
        elif number == 3:
            value = _signed(raw)
        elif number == 4:
            value = raw
        elif number == 5:
            value = _tensor(raw)[1]
        elif number == 7:
            many += [x for (x,) in struct.iter_unpack("<f", raw)]
        elif number == 8:
            many += [_signed(raw)] if isinstance(raw, int) else [_signed(x) for x in _varints(raw)]
    return name, tuple(many) if many else value


def _tensor(data: bytes) -> tuple[str, NDArray[Any]]:
    dims: list[int] = []
    name, kind, raw = "", 0, None
    values: list[Any] = []
    for number, value in _fields(data):
        if number == 1:
            dims += [value] if isinstance(value, int) else list(_varints(value))
        elif number == 2:
            kind = value
        elif number == 4:
            values += [x for (x,) in struct.iter_unpack("<f", value)]
        elif number in (5, 7):
            values += [_signed(value)] if isinstance(value, int) else [_signed(x) for x in _varints(value)]
        elif number == 8:
            name = value.decode()
        elif number == 9:
            raw = value
        elif number == 10:
            values += [x for (x,) in struct.iter_unpack("<d", value)]
    dtype = _TYPES[kind]
    flat: NDArray[Any] = np.frombuffer(raw, dtype=dtype) if raw is not None else np.array(values, dtype=dtype)
    return name, flat.reshape(dims)


def _fields(data: bytes) -> Iterator[tuple[int, Any]]:
    """Field number and value: an int for a varint, bytes for anything else."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        wire = key & 7
        if wire == 0:
            value, at = _varint(data, at)
            yield key >> 3, value
            continue
        if wire == 2:
            size, at = _varint(data, at)
        elif wire in (1, 5):
            size = 8 if wire == 1 else 4
        else:
            raise ValueError(f"wire type {wire}")
        if at + size > len(data):
            raise ValueError("cut short")
        yield key >> 3, data[at : at + size]
        at += size


def _varint(data: bytes, at: int) -> tuple[int, int]:
    result = shift = 0
    while True:
        byte = data[at]
        at += 1
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result, at
        shift += 7
        if shift > 63:
            raise ValueError("varint")


def _varints(data: bytes) -> Iterator[int]:
    at = 0
    while at < len(data):
        value, at = _varint(data, at)
        yield value


def _signed(value: int) -> int:
    return value - (1 << 64) if value >> 63 else value
