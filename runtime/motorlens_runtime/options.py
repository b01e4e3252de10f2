"""Options of a dialect, publisher or alarm, as they stand in a URL: read once, each by name, and nothing left over."""

import difflib
import math
from collections.abc import Iterable, Mapping

from motorlens_runtime.errors import DataError


class Options:
    """Named texts. Each read takes one out; `finish` refuses what nobody read."""

    def __init__(self, values: Mapping[str, str], where: str) -> None:
        self._values = dict(values)
        self._known: list[str] = []
        self.where = where

    def text(self, name: str, default: str | None = None) -> str:
        """The text of an option. Raises DataError if it is absent and there is no default."""
        self._known.append(name)
        value = self._values.pop(name, default)
        if value is None:
            raise DataError(f"{self.where}: needs {name}=...")
        return value

    def choice(self, name: str, choices: tuple[str, ...]) -> str:
        """One of `choices`, the first if it is not given."""
        value = self.text(name, choices[0])
        if value not in choices:
            raise DataError(f"{self.where}: {name}={value}; choose one of {', '.join(choices)}")
        return value

    def number(self, name: str, default: float | None, low: float, high: float) -> float:
        """A number between `low` and `high`."""
        text = self.text(name, None if default is None else repr(default))
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not low <= value <= high:
            raise DataError(f"{self.where}: {name}={text}; it is a number from {low:g} to {high:g}")
        return value

    def integer(self, name: str, default: int, low: int, high: int) -> int:
        """A whole number between `low` and `high`; 0x80 is understood."""
        text = self.text(name, str(default))
        try:
            value = int(text, 0)
        except ValueError:
            value = low - 1
        if not low <= value <= high:
            raise DataError(f"{self.where}: {name}={text}; it is a whole number from {low} to {high}")
        return value

    def finish(self) -> None:
        """Raise DataError if an option was given that nobody knows."""
        for name in self._values:
            raise DataError(f"{self.where}: no option {name!r}{nearest(name, self._known)}")


def nearest(word: str, known: Iterable[str]) -> str:
    """The end of a message about an unknown word: the one that was meant, or all there are."""
    names = sorted(set(known))
    near = difflib.get_close_matches(word, names, n=1)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; there are {', '.join(names)}" if names else "; there are none"
