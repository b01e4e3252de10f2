"""How a text file of numbers is written: encoding, separator, decimal mark, where the heading and the numbers are.

Nothing is asked of the writer: spreadsheets of half of Europe write `0,001;2,8`, test stands put comments and a row of units
above the numbers, loggers separate by blanks and end in the middle of a line, Windows writes UTF-16 or its own code page.
What is read as a number is decided by all lines of the beginning together: the separator and decimal mark that make most
cells numbers.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.headings import unit_text
from motorlens_runtime.files.numbered import names_by_number, without_numbers
from motorlens_runtime.files.units import in_heading

# A beginning of this length shows the heading and enough rows.
HEAD_BYTES = 1 << 16
ROWS = 400
# What stands for a missing number, in lower case; Excel's and R's words among them.
MISSING = frozenset(
    ("", "nan", "n/a", "#n/a", "na", "null", "none", "-", "--", "---", "nil", "missing", "-nan", "+nan")
)
COMMENT_MARKS = ("#", "%", "//", "!", ";", "*")
_NUMBER = {
    ".": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE),
    ",": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eEdD][+-]?\d+)?|[+-]?inf(inity)?", re.IGNORECASE),
}
# Digits in groups of three: by blanks of any kind or apostrophes, or, where a decimal mark follows, by the other mark.
_GROUPED = {
    ".": re.compile(r"[+-]?\d{1,3}(([ \u00a0\u202f\u2009'’]\d{3})+(\.\d+)?|(,\d{3})+\.\d+)"),
    ",": re.compile(r"[+-]?\d{1,3}(([ \u00a0\u202f\u2009'’]\d{3})+(,\d+)?|(\.\d{3})+,\d+)"),
}
_GROUPS = {
    mark: str.maketrans("", "", " \u00a0\u202f\u2009'’" + other) for mark, other in ((".", ","), (",", "."))
}
# Separator and decimal mark, the usual first: of two that read equally many numbers, the first is meant.
_WRITINGS = ((",", "."), (";", "."), ("\t", "."), (" ", "."), ("|", "."), (";", ","), ("\t", ","), (" ", ","), ("|", ","),
             (",", ","))  # fmt: skip
# A file without a time and a voltage is no recording.
_FEWEST = 2
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")


@dataclass(frozen=True)
class Layout:
    """How the file is written.

    Attributes:
        encoding: a Python codec that reads it.
        separator: one character; a blank stands for any run of blanks and tabs.
        decimal: "." or ",".
        headings: one a column; with the unit from a row of units; `#1`, `#2` ... where the file has none.
        first_row: the line, from 1, of the first numbers.
        named: whether the file has headings.
    """

    encoding: str
    separator: str
    decimal: str
    headings: tuple[str, ...]
    first_row: int
    named: bool

    def cells(self, line: str) -> list[str]:
        """The cells of a line, without blanks and quotes around them."""
        return split(line, self.separator)

    def plain(self, data: bytes) -> bytes:
        """Whole lines in UTF-8, rewritten with a decimal point and one separator between cells."""
        if self.separator == " ":
            data = re.sub(rb"(?m)^[ \t]+|[ \t\r]+$", b"", data)
            data = re.sub(rb"[ \t]+", b" ", data)
        if self.decimal == "," and self.separator != ",":
            data = data.replace(b",", b".")
        return data


def layout_of(head: bytes, where: str, whole: bool) -> Layout:
    """The layout of a file from its beginning.

    Args:
        head: the first `HEAD_BYTES` of the file.
        where: its name, for messages.
        whole: whether that is all of it, so that the last line counts.

    Raises:
        DataError: it is empty, or not a text.
    """
    encoding = _encoding(head, where)
    text = head.decode(encoding, errors="ignore")
    lines = text.splitlines()
    if not whole and len(lines) > 1:
        lines.pop()
    if not any(line.strip() for line in lines):
        raise DataError(f"{where}: the file is empty; a recording needs a heading line and rows of numbers")
    separator, decimal, first, width = _writing(lines[:ROWS])
    above = lines[:first]
    headings = _headings(above, separator, decimal, width)
    if headings is not None and len(headings) != width:
        mixed = "; decimal commas need semicolons or tabs between the cells" if separator == "," else ""
        raise DataError(
            f"{where}: row {first + 1}: {width} cells where the heading has {len(headings)}: "
            f"{', '.join(headings)[:80]}{mixed}"
        )
    if headings is None:
        return Layout(
            encoding, separator, decimal, tuple(f"#{k + 1}" for k in range(width)), first + 1, False
        )
    return Layout(encoding, separator, decimal, headings, first + 1, True)


def split(line: str, separator: str) -> list[str]:
    """The cells of a line."""
    line = line.strip("\r\n\ufeff")
    if separator == " ":
        return line.split()
    if '"' in line:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
    return [cell.strip() for cell in line.split(separator)]


def number(cell: str, decimal: str = ".") -> float | None:
    """The number in a cell, NaN for a word that says that there is none; None if it is no number."""
    if cell.strip().lower() in MISSING:
        return float("nan")
    cell = cell.strip().replace("\u2212", "-")
    if _NUMBER[decimal].fullmatch(cell) is None:
        if _GROUPED[decimal].fullmatch(cell) is None:
            return None
        cell = cell.translate(_GROUPS[decimal])
    return float(cell.replace(",", ".").replace("d", "e").replace("D", "e"))


def is_comment(line: str) -> bool:
    """Whether a line is a comment, by its first mark."""
    return line.lstrip().startswith(COMMENT_MARKS)


def _encoding(head: bytes, where: str) -> str:
    if head.startswith(b"PK\x03\x04"):
        raise DataError(
            f"{where}: a spreadsheet or an archive, not a text file; save it as CSV, or unpack it"
        )
    if head.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
        return "utf-32"
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if head.startswith(b"\xef\xbb\xbf"):
        return "utf-8-sig"
    nulls = Counter(k % 2 for k, byte in enumerate(head[:1000]) if byte == 0)
    if nulls and 0.4 * len(head[:1000]) < sum(nulls.values()) <= 0.55 * len(head[:1000]):
        wide = "utf-16-le" if nulls[1] > nulls[0] else "utf-16-be"
        if not _CONTROL.search(head.decode(wide, errors="ignore")):
            return wide
    # Control characters are in no text; the last bytes may be half a character.
    if not _CONTROL.search(head.decode("latin-1")):
        for encoding in ("utf-8", "cp1252"):
            try:
                head[: -4 if len(head) > 8 else None].decode(encoding)
            except UnicodeDecodeError as error:
                if encoding == "utf-8" and error.start > len(head) - 8:
                    return encoding
            else:
                return encoding
    raise DataError(f"{where}: not a text file; save a spreadsheet as CSV, with a heading line")


def _writing(lines: Sequence[str]) -> tuple[str, str, int, int]:
    """Separator, decimal mark, the index of the first line of numbers, and the number of cells in it."""
    best: tuple[int, str, str, int, int] | None = None
    for separator, decimal in _WRITINGS:
        # Of each line which cells are words, and how many are numbers.
        counted = []
        for line in lines:
            cells = split(line, separator)
            kinds = [number(cell, decimal) for cell in cells]
            numbers = sum(kind is not None and cell != "" for kind, cell in zip(kinds, cells, strict=True))
            counted.append(([kind is None for kind in kinds], numbers))
        rows = [at for at, (words, numbers) in enumerate(counted) if numbers >= max(_FEWEST, sum(words))]
        if not rows:
            continue
        width = Counter(len(counted[at][0]) for at in rows).most_common(1)[0][0]
        rows = [at for at in rows if len(counted[at][0]) == width]
        score = sum(counted[at][1] - sum(counted[at][0]) for at in rows)
        # A heading may number its columns, but has words where other rows have numbers, and more of the heading below it.
        usual = [2 * sum(column) > len(rows) for column in zip(*(counted[at][0] for at in rows), strict=True)]
        odd = any(word and not often for word, often in zip(counted[rows[0]][0], usual, strict=True))
        if odd and rows[1:] and rows[1] > rows[0] + 1:
            rows.pop(0)
        if best is None or score > best[0]:
            best = score, separator, decimal, rows[0], width
    if best is not None:
        return best[1:]
    # No numbers: the first line that is no comment is a heading, and nothing follows.
    first = next((at for at, line in enumerate(lines) if line.strip() and not is_comment(line)), 0)
    separator = max(",;\t ", key=lines[first].count)
    return separator, ".", first + 1, len(split(lines[first], separator))


def _headings(above: Sequence[str], separator: str, decimal: str, width: int) -> tuple[str, ...] | None:
    """What lines above the numbers say of each column by its number, or a line that has a name for each, with the units
    below it, else the last such line; None if there is neither.

    Where no line of words fits, the last that is no comment is returned as it stands.
    """
    numbered = names_by_number(above, width)
    if numbered is not None:
        return numbered
    rows, numbering = [], list[str]()
    for line in above:
        bare = re.sub(r"^\s*(#|%|//|!|\*)+\s*", "", line.lstrip("\ufeff")) if is_comment(line) else line
        cells = split(bare, separator)
        # A separator at the end of the heading or of each row is a column without a name.
        while len(cells) > width and not cells[-1]:
            cells.pop()
        if len(cells) == width - 1:
            cells.append("")
        if sum(number(cell, decimal) is None for cell in cells) >= 0.5 * len(cells) > 0:
            rows.append((line, cells))
        elif len(cells) == width:
            numbering = cells
    fitting = [cells for line, cells in rows if len(cells) == width and any(cells)]
    if not fitting:
        words = [cells for line, cells in rows if not is_comment(line)]
        return tuple(words[-1]) if words else None
    # Short names or symbols may stand below the units.
    for names, units in reversed(list(pairwise(fitting))):
        if _are_units(units) and not _are_units(names):
            return tuple(_with_unit(*both) for both in zip(names, units, strict=True))
    last = fitting[-1]
    if numbering and _are_units(last) and len(set(last)) < len(last):
        # Units alone do not tell its columns apart: they have numbers.
        return tuple(_with_unit(*both) for both in zip(numbering, last, strict=True))
    return without_numbers(last)


def _are_units(cells: Sequence[str]) -> bool:
    stated = [cell.strip("[]() ") for cell in cells if cell.strip("[]()- ")]
    return bool(stated) and sum(in_heading(cell) is not None for cell in stated) >= 0.5 * len(stated)


def _with_unit(name: str, unit: str) -> str:
    unit = unit.strip("[]() ")
    stated = (
        not unit
        or unit == "-"
        or name.endswith("_" + re.sub(r"[/*·]", "_", unit))
        or unit_text(name) is not None
    )
    return name if stated else f"{name} [{unit}]"
