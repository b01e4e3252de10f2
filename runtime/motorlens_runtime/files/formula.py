"""What `--column voltage=duty_pct*vbat_V/100` says: a formula over columns of a recording, with its units checked.

Columns enter by their heading and are converted to SI by the unit written in it, or behind it where it has none: `y[deg/s]`.
A constant may have a unit, `0.033[m]`; `pi` is one. `row` is the number of the row, from 0: `row*0.001[s]`. `+ - * /` and
brackets; `sin` and `cos` of an angle, `abs`, and `sign`, which is -1, 0 or 1: the load of an arm is
`0.48[N*m]*sin(angle_deg)`, a current sensed without its sign `sense_A*sign(duty_pct)`. A heading that is no plain word is
written as it stands or between quotes. Nothing is evaluated but these.

A constant without a unit that equals the conversion of a column's unit (100 of a percentage, 1000 of millivolts) states that
conversion, and is not applied a second time: `v_mV/1000` and `v_mV` are the same voltage, and `n_rpm*2*pi/60` and `n_rpm`
the same speed.
"""

import difflib
import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.units import PLAIN, Dimension, Unit, name_of, parse

Array = NDArray[np.float64]
Cells = Callable[[int], Array]
UnitOf = Callable[[str], Unit | None]

# The column `row`, that is in no file: the number of each row, from 0.
ROW = -1
_ROW = "row"
# A typed conversion (0.1047 for rpm) is the unit's to the digits that were typed.
_SAME = 1e-3
_DIGITS = re.compile(r"(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NAME = re.compile(r"[^\s*/+\-()\[\]'\"]+")
_FUNCTION = re.compile(r"(sin|cos|abs|sign)\s*\(")
_OF_ANGLE = {"sin": np.sin, "cos": np.cos}
_ANGLE = parse("rad")


@dataclass(frozen=True)
class Formula:
    """A parsed formula.

    Attributes:
        text: as it was written.
        uses: the columns it needs, by index.
        value: from the numbers of a column by its index, as they stand in the file, to SI.
        dimension: of the result.
        plain: whether nothing in it had a unit.
        notes: what was taken for granted, in words.
    """

    text: str
    uses: tuple[int, ...]
    value: Callable[[Cells], Array]
    dimension: Dimension
    plain: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class _Term:
    value: Callable[[Cells], Array]
    dimension: Dimension = PLAIN
    plain: bool = True
    uses: tuple[int, ...] = ()
    # Within a product: the conversions of its columns (factor, heading), and its constants without a unit.
    conversions: tuple[tuple[float, str], ...] = ()
    constants: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def __mul__(self, other: "_Term") -> "_Term":
        mine, others = self.value, other.value
        dimension = tuple(a + b for a, b in zip(self.dimension, other.dimension, strict=True))
        return _Term(
            lambda cells: mine(cells) * others(cells), dimension, self.plain and other.plain, self.uses + other.uses,
            self.conversions + other.conversions, self.constants + other.constants, self.notes + other.notes,
        )  # fmt: skip

    def inverse(self) -> "_Term":
        """One over it."""
        mine = self.value
        return replace(
            self,
            value=lambda cells: 1.0 / mine(cells),
            dimension=tuple(-d for d in self.dimension),
            conversions=tuple((1 / factor, heading) for factor, heading in self.conversions),
            constants=tuple(1 / constant for constant in self.constants),
        )

    def settled(self) -> "_Term":
        """Its product done: constants that state the conversion of a column are taken out again."""
        constants, twice, notes = list(self.constants), 1.0, list(self.notes)
        for factor, heading in self.conversions:
            for constant in (stating := _stating(factor, constants)):
                constants.remove(constant)
            if stating:
                twice *= (stated := math.prod(stating))
                shown = f"{stated:g}" if stated >= 1 else f"1/{1 / stated:g}"
                notes.append(f"the factor {shown} is the unit of {heading!r}, applied once")
        mine = self.value
        value = mine if twice == 1.0 else (lambda cells: mine(cells) / twice)
        return replace(self, value=value, conversions=(), constants=(), notes=tuple(notes))


def _stating(factor: float, constants: Sequence[float]) -> tuple[float, ...]:
    """The fewest constants whose product is a conversion (2, pi and 1/60 of rpm); none if no product is."""
    some = (one for n in range(1, len(constants) + 1) for one in combinations(constants, n))
    return next((one for one in some if math.isclose(math.prod(one), factor, rel_tol=_SAME)), ())


class _Parser:
    def __init__(self, text: str, headings: Sequence[str], unit_of: UnitOf, where: str) -> None:
        self.text, self.at, self.where = text, 0, where
        self.headings, self.unit_of = headings, unit_of
        self.longest_first = sorted({h for h in headings if h}, key=len, reverse=True)

    def fail(self, why: str) -> DataError:
        return DataError(f"{self.where}: --column formula {self.text!r}: {why}")

    def sum(self) -> _Term:
        negative = self.skip("-")
        total = self.product().settled()
        if negative:
            total = total * _constant(-1.0)
        while (sign := self.skip("+") or self.skip("-")) is not None:
            other = self.product().settled()
            if other.dimension != total.dimension:
                raise self.fail(
                    f"{name_of(total.dimension)} and {name_of(other.dimension)} cannot be added; "
                    "give a constant its unit, as in 0.5[V]"
                )
            total = _added(total, other, 1.0 if sign == "+" else -1.0)
        return total

    def product(self) -> _Term:
        total = self.factor()
        while (mark := self.skip("*") or self.skip("/")) is not None:
            other = self.factor()
            total = total * (other if mark == "*" else other.inverse())
        return total

    def factor(self) -> _Term:
        if self.skip("-") is not None:
            return self.factor() * _constant(-1.0)
        rest = self.text[self.at :]
        for heading in self.longest_first:
            if rest.startswith(heading) and not re.match(r"\w", rest[len(heading) : len(heading) + 1]):
                self.at += len(heading)
                return self.column(heading)
        function = _FUNCTION.match(rest)
        if function:
            self.at += function.end() - 1
            return self.applied(function[1], self.bracket())
        if rest[:1] == "(":
            inside = self.bracket()
            if inside.plain and not inside.uses:
                return _number(float(inside.value(_no_cells)))
            return inside
        if rest[:1] in ("'", '"') and rest.find(rest[0], 1) > 0:
            heading = rest[1 : rest.index(rest[0], 1)]
            self.at += len(heading) + 2
            return self.column(heading)
        number = _DIGITS.match(rest)
        if number:
            self.at += number.end()
            return self.constant(float(number[0]))
        name = _NAME.match(rest)
        if name and name[0] == "pi":
            self.at += name.end()
            return self.constant(math.pi)
        if name:
            self.at += name.end()
            return self.column(name[0])
        raise self.fail(
            f"a column or a number is missing before {rest[:10]!r}" if rest else "it ends too early"
        )

    def bracket(self) -> _Term:
        """What stands between the brackets that come next."""
        self.skip("(")
        inside = self.sum()
        if self.skip(")") is None:
            raise self.fail("a closing bracket is missing")
        return inside

    def applied(self, name: str, inside: _Term) -> _Term:
        """A function of a term. What it gives has no unit, but for that of `abs`."""
        mine = inside.value
        if name == "abs":
            return replace(inside, value=lambda cells: np.abs(mine(cells)))
        if name == "sign":
            return replace(inside, value=lambda cells: np.sign(mine(cells)), dimension=PLAIN, plain=True)
        if not inside.plain and _ANGLE and inside.dimension != _ANGLE.dimension:
            raise self.fail(f"{name}() is of an angle, and this is in {name_of(inside.dimension)}")
        of = _OF_ANGLE[name]
        return replace(inside, value=lambda cells: np.asarray(of(mine(cells))), dimension=PLAIN, plain=True)

    def constant(self, value: float) -> _Term:
        unit = self.unit()
        if unit is None:
            return _number(value)
        return replace(_constant(value * unit.factor), dimension=unit.dimension, plain=False)

    def unit(self) -> Unit | None:
        """The unit between square brackets that comes next; None if there is none."""
        bracket = re.match(r"\s*\[([^\]]*)\]", self.text[self.at :])
        if not bracket:
            return None
        unit = parse(bracket[1].strip())
        if unit is None:
            raise self.fail(f"{bracket[1]!r} is no unit; write 0.5[V], 0.033[m] or 0.01[V*s/rad]")
        self.at += bracket.end()
        return unit

    def column(self, heading: str) -> _Term:
        index = index_of(heading, self.headings)
        if index is None:
            near = difflib.get_close_matches(heading, self.longest_first, n=1)
            known = ", ".join(repr(h) for h in self.headings if h)
            raise self.fail(
                f"no column {heading!r}; " + (f"did you mean {near[0]!r}?" if near else f"it has {known}")
            )
        unit, behind = None if index == ROW else self.unit_of(self.headings[index]), self.unit()
        if unit is not None and behind not in (None, unit):
            raise self.fail(f"the heading {heading!r} says another unit than the brackets behind it")
        unit = unit or behind
        if unit is None:
            return _Term(lambda cells: cells(index), uses=(index,))
        factor, offset = unit.factor, unit.offset
        return _Term(
            lambda cells: cells(index) * factor + offset, unit.dimension, False, (index,),
            ((factor, heading),) if factor != 1.0 else (),
        )  # fmt: skip

    def skip(self, mark: str) -> str | None:
        """Past blanks and `mark`; None if something else comes."""
        while self.text[self.at : self.at + 1].isspace():
            self.at += 1
        if not self.text.startswith(mark, self.at):
            return None
        self.at += 1
        while self.text[self.at : self.at + 1].isspace():
            self.at += 1
        return mark


def _constant(value: float) -> _Term:
    return _Term(lambda cells: np.array(value))


def _number(value: float) -> _Term:
    """A constant without a unit, that may state a conversion."""
    return replace(_constant(value), constants=(value,) if value != 0 else ())


def _no_cells(index: int) -> Array:
    raise AssertionError("a number needs no column")


def _added(one: _Term, other: _Term, sign: float) -> _Term:
    first, second = one.value, other.value
    return replace(
        one,
        value=lambda cells: first(cells) + sign * second(cells),
        plain=one.plain and other.plain,
        uses=one.uses + other.uses,
        notes=one.notes + other.notes,
    )


def index_of(name: str, headings: Sequence[str]) -> int | None:
    """The index of a column by its heading, with its unit in brackets or without where only one is named so; by its number
    `#3`, as of a file without headings; `ROW`; None if there is none.

    >>> index_of("u", ["t", "u", "u"]), index_of("#3", ["t", "u", "u"]), index_of("#4", ["t", "u", "u"])
    (1, 2, None)
    >>> index_of("u", ["t [s]", "u [V]"]), index_of("u", ["u (V)", "u [mV]"])
    (1, None)
    """
    if name in headings:
        return list(headings).index(name)
    if name == _ROW:
        return ROW
    named = [index for index, heading in enumerate(headings) if _without_unit(heading) == name]
    if len(named) == 1:
        return named[0]
    number = re.fullmatch(r"#([1-9]\d*)", name)
    return int(number[1]) - 1 if number and int(number[1]) <= len(headings) else None


def _without_unit(heading: str) -> str:
    """A heading without a unit in brackets at its end."""
    return re.sub(r"\s*(\[[^\]]*\]|\([^)]*\))$", "", heading)


def is_formula(text: str, headings: Sequence[str]) -> bool:
    """Whether a text that is no heading is meant as a formula, and not as a heading with a slip in it."""
    if re.search(r"[*/+]|\[.*\]$", text):
        return True
    return any(piece.strip("()'\" ") in headings for piece in text.split("-"))


def parse_formula(text: str, headings: Sequence[str], unit_of: UnitOf, where: str) -> Formula:
    """Parse a formula over the columns of a file.

    Args:
        text: the formula.
        headings: of all columns; they are found in the text as they stand, the longest first.
        unit_of: the unit written in a heading, None if there is none.
        where: the file's name, for messages.

    Raises:
        DataError: a column that is not there, an unknown unit, units that cannot be added, or no formula at all.
    """
    parser = _Parser(text.strip(), headings, unit_of, where)
    term = parser.sum()
    if parser.at < len(parser.text):
        raise parser.fail(f"{parser.text[parser.at :][:20]!r} is not understood")
    if not term.uses and term.plain:
        raise parser.fail("it holds no column of the file; give a constant its unit, as in 8.5[V]")
    return Formula(
        text,
        tuple(dict.fromkeys(term.uses)),
        term.value,
        term.dimension,
        term.plain,
        tuple(dict.fromkeys(term.notes)),
    )
