"""Numbers from and to decimal text, a whole block at a time, with the results of `float` and of `%.9g` to the last bit.

Both do exactly what is simple and hand back what is not: reading numbers of up to 15 digits without an exponent, whose
mantissa and power of ten are exact, so that one division rounds correctly (Clinger, PLDI 1990); writing nine digits
where the tenth does not stand on the edge of rounding. Digits are looked up three at a time, four bytes with zeros where
there is nothing; in the end the zeros are taken out.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Words = NDArray[np.uint32]

_ZERO, _NINE_PLUS, _POINT, _MINUS = 48, 10, 46, 45
_TENS = 10 ** np.arange(16, dtype=np.int64)
_TENS_FLOAT: Array = 10.0 ** np.arange(23, dtype=np.float64)
_POWERS: Array = np.array([float(f"1e{k}") for k in range(-14, 23)])
# Bytes that a number of nine digits takes with zeros between; the last is always free.
WIDTH = 32
# As many lines at a time as keep the work in the cache.
_ROWS_AT_ONCE = 1024


def _words(texts: list[str]) -> Words:
    """Up to four characters each."""
    return np.frombuffer("".join(text.ljust(4, "\0") for text in texts).encode("ascii"), dtype=np.uint32)


_ALL = [f"{k:03d}" for k in range(1000)]
# Three digits without the zeros they begin with, and from 1000 on with them: other digits stand before.
_LEADING = _words([text.lstrip("0") for text in _ALL] + _ALL)
# The same for the last three, of which one is always there.
_UNITS = _words([str(k) for k in range(1000)] + _ALL)
# The first three of a number, and from 1000 on of a negative one.
_SIGNED = _words([sign + text.lstrip("0") for sign in ("", "-") for text in _ALL])
# Three decimals without the zeros they end with, and from 1000 on with them: others follow.
_TRAILING = _words([text.rstrip("0") for text in _ALL] + _ALL)
_POINTS = _words(["", ".", ".0", ".00", ".000"])
# What follows the digits of a number below 1e-4: an e in the free byte of the last word of digits, and from 1e-13 on this.
_EXPONENT = _words(["\0\0\0e"])[0]
_EXPONENTS = _words([f"{e:03d}" for e in range(-13, -4)] + [""])


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
    """`%.9g` of each value (...), (..., WIDTH) bytes with zeros where there is nothing."""
    words = np.empty((*values.shape, WIDTH // 4), dtype=np.uint32)
    size = np.abs(values)
    plain = (size >= 1e-13) & (size < 999_999_999.0)
    np.copyto(size, 1.0, where=~plain)
    exponent = np.floor(np.log10(size)).astype(np.intp)
    # The logarithm may be off by one next to a power of ten.
    exponent += size >= _power(exponent + 1)
    exponent -= size < _power(exponent)
    scaled = size * _power(8 - exponent)
    mantissa = np.floor(scaled)
    scaled -= mantissa
    plain &= np.abs(scaled - 0.5) > 1e-6
    mantissa += scaled > 0.5
    plain &= mantissa < 1e9
    # What stands before the point, and the nine digits from the first behind it, or behind zeros that follow it; all are
    # whole numbers of less than 2^53, and a quotient that is not whole lies far from one that is.
    small = exponent < -4
    shown = np.maximum(exponent, -1)
    shown[small] = 0
    unit = _power(8 - shown)
    whole = np.floor(mantissa / unit)
    mantissa -= whole * unit
    mantissa *= _power(shown + 1)
    _put_whole(words, whole.astype(np.int32), _SIGNED, values < 0)
    behind = mantissa.astype(np.int32)
    _put_decimals(words, behind)
    words[..., 3] = _POINTS.take(np.where(small, 1, shown - exponent + 1) * (behind > 0))
    words[..., 6] |= _EXPONENT * small
    words[..., 7] = _EXPONENTS.take(np.minimum(exponent, -4) + 13)
    out = words.view(np.uint8)
    for at in () if plain.all() else np.argwhere(~plain).tolist():
        text = b"%.9g" % float(values[tuple(at)])
        out[tuple(at)] = np.frombuffer(text.ljust(WIDTH, b"\0"), dtype=np.uint8)
    return out


def seconds(time_ns: NDArray[np.int64]) -> Bytes:
    """Nanoseconds, not negative, as seconds with one to nine decimals, (n, 32) bytes with zeros where there is nothing."""
    words = np.empty((len(time_ns), 8), dtype=np.uint32)
    whole = time_ns // 1_000_000_000
    behind = (time_ns - whole * 1_000_000_000).astype(np.int32)
    first = whole // 1_000_000_000
    words[:, 0] = _LEADING.take(first)
    _put_whole(words[:, 1:], (whole - first * 1_000_000_000).astype(np.int32), _LEADING, first > 0)
    words[:, 4] = _POINTS[1]
    _put_decimals(words[:, 1:], behind)
    words[:, 5][behind == 0] = _UNITS[0]
    return words.view(np.uint8)


def seconds_text(time_ns: int) -> str:
    """The same for one instant, of either sign."""
    whole, part = divmod(abs(time_ns), 1_000_000_000)
    return f"{'-' if time_ns < 0 else ''}{whole}.{f'{part:09d}'.rstrip('0') or '0'}"


def table(time_ns: NDArray[np.int64], values: Array, words: NDArray[np.uint32]) -> bytes:
    """CSV lines of times (n,), values (n, k) in nine digits, and integers (n,)."""
    parts = [slice(k, k + _ROWS_AT_ONCE) for k in range(0, len(time_ns), _ROWS_AT_ONCE)]
    return b"".join([_lines(time_ns[part], values[part], words[part]) for part in parts])


def _lines(time_ns: NDArray[np.int64], values: Array, words: NDArray[np.uint32]) -> bytes:
    n, columns = values.shape
    out = np.empty((n, 32 + columns * WIDTH + 12), dtype=np.uint8)
    out[:, :32] = seconds(time_ns)
    out[:, 32:-12] = nine_digits(values).reshape(n, -1)
    # The last byte of each number is free.
    out[:, 31:-12:WIDTH] = ord(",")
    for word in words[:1].tolist() if (words == words[:1]).all() else np.unique(words).tolist():
        text = b"%d\n" % word
        out[words == word, -12:] = np.frombuffer(text.ljust(12, b"\0"), dtype=np.uint8)
    return out.tobytes().translate(None, b"\0")


def _put_whole(words: Words, number: NDArray[np.int32], first: Words, other: NDArray[np.bool_]) -> None:
    """A whole number below 10^9 into words 0 to 2, its first three digits as in `first`, or in its other half."""
    thousands = number // 1000
    millions = thousands // 1000
    words[..., 0] = first.take(millions + 1000 * other)
    # Digits stand before where the number is that large, or other digits stand before the number.
    earlier = other if first is _LEADING else False
    words[..., 1] = _LEADING.take(thousands - 1000 * millions + 1000 * ((millions > 0) | earlier))
    words[..., 2] = _UNITS.take(number - 1000 * thousands + 1000 * ((thousands > 0) | earlier))


def _put_decimals(words: Words, number: NDArray[np.int32]) -> None:
    """Nine decimals, given as a whole number, into words 4 to 6, without zeros at their end."""
    millionths = number // 1000
    low = number - 1000 * millionths
    high = millionths // 1000
    middle = millionths - 1000 * high
    words[..., 4] = _TRAILING.take(high + 1000 * (number > 1_000_000 * high))
    words[..., 5] = _TRAILING.take(middle + 1000 * (low > 0))
    words[..., 6] = _TRAILING.take(low)


def _power(exponent: NDArray[np.intp]) -> Array:
    """10 to the exponent, correctly rounded; -14 to 22."""
    result: Array = _POWERS.take(exponent + 14)
    return result
