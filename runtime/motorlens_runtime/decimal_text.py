"""Numbers from and to decimal text, a whole block at a time, with the results of `float` and of `%.9g` to the last bit.

Both do exactly what is simple and hand back what is not: reading numbers of up to 15 digits without an exponent, whose
mantissa and power of ten are exact, so that one division rounds correctly (Clinger, PLDI 1990); writing nine digits
where the tenth does not stand on the edge of rounding.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]

_ZERO, _NINE_PLUS, _POINT, _MINUS = 48, 10, 46, 45
_TENS = 10 ** np.arange(16, dtype=np.int64)
_TENS_FLOAT: Array = 10.0 ** np.arange(23, dtype=np.float64)
_TRIPLES = np.frombuffer("".join(f"{k:03d}" for k in range(1000)).encode(), dtype=np.uint8).reshape(1000, 3)
# Columns that a number of nine digits takes at most, as in -0.000123456789 or -1.23456789e-300.
WIDTH = 16


def read(raw: Bytes, ends: NDArray[np.intp]) -> Array | None:
    """The numbers of cells that end before `ends`, or None if any of them is not plain enough.

    Args:
        raw: text as bytes; a separator stands at each of `ends`, the last byte is one.
    """
    digit = raw - np.uint8(_ZERO)
    is_digit = digit < _NINE_PLUS
    points, signs = np.flatnonzero(raw == _POINT), np.flatnonzero(raw == _MINUS)
    so_far = np.cumsum(is_digit, dtype=np.int32)
    if not len(so_far) or so_far[-1] + len(points) + len(signs) + len(ends) != len(raw):
        return None
    last = so_far[ends]
    first = np.concatenate((last[:1] * 0, last[:-1]))
    count = last - first
    cell = np.searchsorted(ends, points)
    owner = np.searchsorted(ends, signs)
    starts = np.concatenate((ends[:1] * 0, ends[:-1] + 1))
    if count.min() < 1 or count.max() > 15 or (cell[1:] == cell[:-1]).any() or (signs != starts[owner]).any():
        return None
    power = np.repeat(last, count)
    power -= np.arange(1, len(power) + 1)
    weighted = _TENS[power]
    weighted *= digit[is_digit]
    mantissa = np.add.reduceat(weighted, first)
    decimals = np.zeros(len(ends), dtype=np.intp)
    decimals[cell] = last[cell] - so_far[points]
    values: Array = mantissa / _TENS_FLOAT[decimals]
    values[owner] = -values[owner]
    return values


def nine_digits(values: Array) -> Bytes:
    """`%.9g` of each value, (n, WIDTH) bytes with zeros where there is nothing."""
    out = np.zeros((len(values), WIDTH), dtype=np.uint8)
    size = np.abs(values)
    plain = (size >= 1e-4) & (size < 999_999_999.0)
    safe = np.where(plain, size, 1.0)
    exponent = np.floor(np.log10(safe)).astype(np.intp)
    # The logarithm may be off by one next to a power of ten.
    exponent += (safe >= _power(exponent + 1)).astype(np.intp) - (safe < _power(exponent))
    scaled = safe * _power(8 - exponent)
    whole = np.floor(scaled)
    part = scaled - whole
    plain &= np.abs(part - 0.5) > 1e-6
    mantissa = (whole + (part > 0.5)).astype(np.int64)
    plain &= mantissa < 1_000_000_000
    digits = _digits_of(np.where(plain, mantissa, 0))
    significant = 9 - (digits[:, ::-1] != _ZERO).argmax(axis=1)
    place = np.arange(9)
    digits[place >= np.maximum(significant, exponent + 1)[:, None]] = 0
    for e in np.unique(exponent[plain]).tolist():
        rows = np.flatnonzero(plain & (exponent == e))
        if e >= 0:
            out[rows, 1 : e + 2] = digits[rows, : e + 1]
            out[rows, e + 2] = np.where(significant[rows] > e + 1, _POINT, 0)
            out[rows, e + 3 : 11] = digits[rows, e + 1 :]
        else:
            out[rows, 1], out[rows, 2] = _ZERO, _POINT
            out[rows, 3 : 2 - e] = _ZERO
            out[rows, 2 - e : 11 - e] = digits[rows]
    out[plain & (values < 0), 0] = _MINUS
    for row in np.flatnonzero(~plain).tolist():
        text = b"%.9g" % float(values[row])
        out[row, : len(text)] = np.frombuffer(text, dtype=np.uint8)
    return out


def seconds(time_ns: NDArray[np.int64]) -> Bytes:
    """Nanoseconds, not negative, as seconds with one to nine decimals, (n, 20) bytes with zeros where there is nothing."""
    whole, part = np.divmod(time_ns, 1_000_000_000)
    out = np.empty((len(time_ns), 20), dtype=np.uint8)
    out[:, 0] = whole // 1_000_000_000 + _ZERO
    out[:, 1:10] = _digits_of(whole % 1_000_000_000)
    leading = np.maximum.accumulate(out[:, :9] != _ZERO, axis=1)
    out[:, :9][~leading] = 0
    out[:, 10] = _POINT
    decimals = _digits_of(part)
    used = np.maximum(9 - (decimals[:, ::-1] != _ZERO).argmax(axis=1), 1)
    used[part == 0] = 1
    decimals[np.arange(9) >= used[:, None]] = 0
    out[:, 11:] = decimals
    return out


def seconds_text(time_ns: int) -> str:
    """The same for one instant, of either sign."""
    whole, part = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{whole}.{f'{part:09d}'.rstrip('0') or '0'}"


def table(time_ns: NDArray[np.int64], values: Array, words: NDArray[np.uint32]) -> bytes:
    """CSV lines of times (n,), values (n, k) in nine digits, and integers (n,)."""
    n, columns = values.shape
    comma = np.full((n, 1), ord(","), dtype=np.uint8)
    parts = [seconds(time_ns)]
    for column in range(columns):
        parts += [comma, nine_digits(values[:, column])]
    number = np.zeros((n, 10), dtype=np.uint8)
    for word in np.unique(words).tolist():
        text = np.frombuffer(b"%d" % word, dtype=np.uint8)
        number[words == word, : len(text)] = text
    flat = np.concatenate(
        [*parts, comma, number, np.full((n, 1), ord("\n"), dtype=np.uint8)], axis=1
    ).reshape(-1)
    lines: bytes = flat[flat != 0].tobytes()
    return lines


def _power(exponent: NDArray[np.intp]) -> Array:
    """10 to the exponent, correctly rounded; -22 to 22."""
    ten = _TENS_FLOAT[np.abs(exponent)]
    result: Array = np.where(exponent >= 0, ten, 1 / ten)
    return result


def _digits_of(values: NDArray[np.int64]) -> Bytes:
    """Nine digits, (n, 9), of values below 10^9."""
    high, rest = np.divmod(values, 1_000_000)
    middle, low = np.divmod(rest, 1_000)
    return np.concatenate((_TRIPLES[high], _TRIPLES[middle], _TRIPLES[low]), axis=1)
