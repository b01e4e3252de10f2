"""The CRC-32 of IEEE 802.3 of many rows at once."""

import binascii
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


def crc32_rows(rows: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """CRC-32 of each row of shape (m, length), shape (m,).

    The CRC is affine over GF(2): the exclusive or of one table entry per byte position, and of the CRC of zeros.
    """
    length = rows.shape[1]
    tables = _position_tables(length)
    crc = np.full(len(rows), binascii.crc32(bytes(length)), dtype=np.uint32)
    for position in range(length):
        crc ^= tables[position][rows[:, position]]
    return crc


@lru_cache(maxsize=32)
def _position_tables(length: int) -> NDArray[np.uint32]:
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, table >> 1 ^ np.uint32(0xEDB88320), table >> 1)
    tables = np.empty((length, 256), dtype=np.uint32)
    entry = table
    for position in reversed(range(length)):
        tables[position] = entry
        entry = table[entry & 0xFF] ^ entry >> 8  # the same byte with one more zero byte after it
    return tables
