"""Names that a preamble gives to columns by their numbers, a line for one or a few of them.

Loggers of robots and of measurement programs describe their columns above the numbers:

    # column 2: voltage [V]
    % 11 12 Motor voltage [V] left, right: 2.7 2.7
    # 1:time_s 2:voltage_V

Such lines are believed where their numbers together are those of all columns, each once, from 0 or from 1.
"""

import re
from collections.abc import Sequence

from motorlens_runtime.files.units import in_heading

_LINE = re.compile(
    r"\W*(?:(?:column|col|channel|field|spalte|kanal)s?\b\W*)?(\d+(?:[\s,&]+\d+)*)\s*[\])}.:=-]*\s+(.*\S)",
    re.IGNORECASE,
)
_VALUE = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# The values of the moment at which the preamble was written, and perhaps their unit: `time 0.000 sec`.
_VALUES = re.compile(rf"\s*[:=]?\s+{_VALUE}(?:[\s,]+{_VALUE})*(?:\s+(\S+))?$")
_BRACKETED = re.compile(r"\s*[\[(]([^\])]*)[\])]")
_COUNTED = re.compile(r"(\d+)\s*[.:)=]\s*(?=\D)")


def names_by_number(preamble: Sequence[str], width: int) -> tuple[str, ...] | None:
    """The names of `width` columns, the unit in brackets; None where the lines do not number them all.

    >>> names_by_number(["% log", "% 1 time 0.001 sec", "% 2 3 Voltage [V] left, right: 2.7 2.8"], 3)
    ('time [sec]', 'Voltage left [V]', 'Voltage right [V]')
    """
    found: dict[int, str] = {}
    for line in preamble:
        matched = _LINE.fullmatch(line)
        if matched is None:
            continue
        numbers = [int(text) for text in re.findall(r"\d+", matched[1])]
        if max(numbers) > width:
            continue  # a date, a serial number
        for number, name in zip(numbers, _names(matched[2], len(numbers)), strict=True):
            # Said twice, it is no list of columns.
            if number in found:
                return None
            found[number] = name
    begin = min(found, default=1)
    if begin not in (0, 1) or sorted(found) != list(range(begin, begin + width)):
        return None
    return tuple(found[number] for number in sorted(found))


def without_numbers(cells: Sequence[str]) -> tuple[str, ...]:
    """Headings that begin with the number of their column, without it; others as they are.

    >>> without_numbers(["1:time_s", "2:voltage_V"]), without_numbers(["1:time_s", "voltage_V"])
    (('time_s', 'voltage_V'), ('1:time_s', 'voltage_V'))
    """
    counted = [_COUNTED.match(cell) for cell in cells]
    numbers = [int(one[1]) for one in counted if one is not None]
    if len(numbers) < len(cells) or numbers[:1] not in ([0], [1]):
        return tuple(cells)
    if numbers != list(range(numbers[0], numbers[0] + len(cells))):
        return tuple(cells)
    return tuple(cell[one.end() :] for cell, one in zip(cells, counted, strict=True) if one is not None)


def _names(text: str, count: int) -> list[str]:
    """The names that a line has for `count` columns: `Motor voltage [V] left, right` are two."""
    units: list[str] = []
    values = _VALUES.search(text)
    if values is not None and (values[1] is None or in_heading(values[1]) is not None):
        units = [values[1]] if values[1] else []
        text = text[: values.start()]
    text = text.rstrip(" :=")
    bracketed = [one for one in _BRACKETED.finditer(text) if _are_units(one[1], count)]
    if bracketed:
        units = _parts(bracketed[-1][1])
        text = text[: bracketed[-1].start()] + text[bracketed[-1].end() :]
    names = [text.strip()]
    if count > 1:
        parts = _parts(text)
        common, _, first = parts[0].rpartition(" ")
        own = [first, *parts[1:]] if len(parts) == count else [str(k + 1) for k in range(count)]
        common = common if len(parts) == count else text.strip()
        names = [f"{common} {word}".strip() for word in own]
    units = units * count if len(units) == 1 else units
    return [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)] if units else names


def _parts(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]


def _are_units(text: str, count: int) -> bool:
    """Whether one unit, or one for each column, stands in brackets; a unit that is not known counts: it is asked for."""
    return len(_parts(text)) in (1, count) and not text.strip().isdigit()
