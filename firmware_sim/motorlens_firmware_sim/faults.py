"""What a bad line does to bytes: pure functions, so that a test can say exactly what was broken."""

import numpy as np


def flip_bits(data: bytes, rate: float, rng: np.random.Generator) -> bytes:
    """Flip each bit with probability `rate`."""
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
    bits ^= (rng.random(len(bits)) < rate).astype(np.uint8)
    return np.packbits(bits).tobytes()


def drop_bytes(data: bytes, rate: float, rng: np.random.Generator) -> bytes:
    """Lose each byte with probability `rate`."""
    stream = np.frombuffer(data, dtype=np.uint8)
    return stream[rng.random(len(stream)) >= rate].tobytes()


def insert_bytes(data: bytes, rate: float, rng: np.random.Generator) -> bytes:
    """Insert a random byte before each byte with probability `rate`."""
    stream = np.frombuffer(data, dtype=np.uint8)
    at = np.flatnonzero(rng.random(len(stream)) < rate)
    return np.insert(stream, at, rng.integers(0, 256, len(at), dtype=np.uint8)).tobytes()


def repeat_bytes(data: bytes, rate: float, rng: np.random.Generator) -> bytes:
    """Double each byte with probability `rate`."""
    stream = np.frombuffer(data, dtype=np.uint8)
    return np.repeat(stream, 1 + (rng.random(len(stream)) < rate)).tobytes()


def swap_bytes(data: bytes, rate: float, rng: np.random.Generator) -> bytes:
    """Exchange each even-placed byte with its successor with probability `rate`."""
    stream = np.frombuffer(data, dtype=np.uint8).copy()
    pairs = stream[: len(stream) // 2 * 2].reshape(-1, 2)
    chosen = rng.random(len(pairs)) < rate
    pairs[chosen] = pairs[chosen][:, ::-1]
    return stream.tobytes()


def burst(data: bytes, length: int, count: int, rng: np.random.Generator) -> bytes:
    """Overwrite `count` stretches of `length` bytes with noise."""
    stream = np.frombuffer(data, dtype=np.uint8).copy()
    for start in rng.integers(0, max(len(stream) - length, 1), count):
        stream[start : start + length] = rng.integers(
            0, 256, len(stream[start : start + length]), dtype=np.uint8
        )
    return stream.tobytes()
