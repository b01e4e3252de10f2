"""How a motor is connected: what its terminals and its shaft are tied to, sample by sample.

A terminal is driven by a voltage, open (no current flows, the terminals show the back-EMF), shorted (the armature brakes),
or current-controlled (the current is given, the voltage is what it takes). A shaft is free, locked, or turned: another
machine gives its speed. Each holds from its sample to the next, and a sample shows what is so from then on.
"""

from collections.abc import Iterable
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError


class Terminal(IntEnum):
    """What the terminals are tied to; the numbers are those of a recording's column `terminal`."""

    DRIVEN = 0
    OPEN = 1
    SHORTED = 2
    CURRENT = 3


class Shaft(IntEnum):
    """What the shaft is tied to; the numbers are those of a recording's column `shaft`."""

    FREE = 0
    LOCKED = 1
    TURNED = 2


def code(kind: type[Terminal] | type[Shaft], word: str, where: str) -> int:
    """The number of a word such as "open", or of the number itself.

    Raises:
        DataError: neither; `where` begins the message.
    """
    words = {member.name.lower(): int(member) for member in kind}
    numbers = {str(number): number for number in words.values()}
    at = word.strip().lower().removesuffix(".0")
    if at not in words | numbers:
        known = ", ".join(f"{name} ({number})" for name, number in words.items())
        raise DataError(f"{where}: {word!r}; known: {known}")
    return (words | numbers)[at]


def codes(kind: type[Terminal] | type[Shaft], values: Iterable[Any], where: str) -> NDArray[np.int64]:
    """Numbers of a column, checked.

    Raises:
        DataError: a number that means nothing.
    """
    given = np.asarray(values, dtype=np.float64)
    wrong = ~np.isin(given, [int(member) for member in kind])
    if wrong.any():
        code(kind, f"{given[int(np.argmax(wrong))]:g}", f"{where}, sample {int(np.argmax(wrong))}")
    return given.astype(np.int64)
