"""Columns: which one holds a physical quantity, by its heading or by the user's choice, and how it becomes SI.

Any unit of the quantity's dimension is converted; how headings are understood says `headings`.
Temperatures stay in degrees Celsius, as every test bench writes them; everything else is SI.
"""

import difflib
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.formula import ROW, Cells, Formula, index_of, is_formula, parse_formula
from motorlens_runtime.files.headings import (
    QUANTITIES,
    candidates,
    conversion,
    is_canonical,
    recognise,
    unit_in,
    unit_text,
)
from motorlens_runtime.files.units import BASES, Unit, in_heading, name_of
from motorlens_runtime.files.words import WORDS

# The first spellings to offer for a canonical unit.
_OFFERED = {
    "s": "s, ms, us, min, h", "V": "V, mV, kV", "A": "A, mA", "rad_s": "rad/s, rpm, deg/s, rev/s, Hz",
    "C": "degC, K, degF", "Nm": "Nm, mNm, lbf*ft, lbf*in, ozf*in, kgf*cm", "rad": "rad, deg, rev", "ohm": "ohm, mohm",
}  # fmt: skip
# What ties a column of another dimension to a quantity: (quantity, the column's unit) -> a formula and its meaning.
_TIES = {
    ("speed", "m/s"): ("{}/0.03[m]", "divide it by the radius"),
    ("speed", "V"): ("{}/0.01[V*s/rad]", "divide it by the tachometer's constant"),
    ("speed", "counts"): (
        "angle={}/1024[counts/rev]",
        "counts are an angle, and the speed follows from that",
    ),
    ("speed", "counts/s"): ("{}/1024[counts/rev]", "divide it by the counts of a revolution"),
    ("angle", "counts"): ("{}/1024[counts/rev]", "divide it by the counts of a revolution"),
    ("voltage", "1"): ("{}*SUPPLY_V/100", "multiply it by the supply"),
    ("load_torque", "N"): ("{}*0.1[m]", "multiply it by the lever"),
}
# Of a file without a heading line, for an example.
_USUAL_ORDER = ("time", "voltage", "current", "speed", "temperature")
# As the choice of a column: none of the file's.
_NOTHING = "none"
_DUTY = re.compile(r"duty|pwm|tastgrad", re.IGNORECASE)
_SUPPLY = re.compile(r"bat|supply|bus|vdc|dc.?link|versorgung", re.IGNORECASE)


Array = NDArray[np.float64]


@dataclass(frozen=True)
class Column:
    """What holds a quantity: one column, `canonical = factor * value + offset`, or a formula over several.

    `heading` is the column's, or the formula's text; `index` is the (first) column's. `assumed` says that no unit was given.
    """

    index: int
    heading: str
    quantity: str
    factor: float
    offset: float
    formula: Formula | None = None
    assumed: bool = False

    @property
    def name(self) -> str:
        """The canonical heading, such as `speed_rad_s`."""
        return canonical_name(self.quantity)

    @property
    def uses(self) -> tuple[int, ...]:
        """The columns it needs."""
        return (self.formula.uses if self.formula else ()) or (self.index,)

    def values(self, cells: Cells) -> Array:
        """(N,) in the canonical unit, from the numbers of each column as they stand in the file."""
        numbers = self.formula.value(cells) if self.formula else cells(self.index)
        if numbers.ndim == 0:
            numbers = np.full(len(cells(self.index)), float(numbers))
        if (self.factor, self.offset) == (1, 0):
            return numbers
        return numbers * self.factor + self.offset


def in_seconds(time: Column) -> Column:
    """A column of time whose cells are dates, given as seconds: its heading's unit says nothing."""
    return replace(time, factor=1.0, offset=0.0, assumed=False)


def units_offered(quantity: str) -> tuple[str, ...]:
    """Spellings of units that a quantity is often recorded in, the canonical one first; none for a word.

    >>> units_offered("speed")
    ('rad/s', 'rpm', 'deg/s', 'rev/s', 'Hz')
    """
    unit = QUANTITIES[quantity][0]
    return tuple(_OFFERED[unit].split(", ")) if unit in _OFFERED else ()


def canonical_name(quantity: str) -> str:
    """`quantity_unit` in SI; temperatures in degrees Celsius; a quantity in words is its name alone."""
    return f"{quantity}_{QUANTITIES[quantity][0]}".removesuffix("_")


def understand(headings: Sequence[str], mapping: Mapping[str, str], where: str) -> dict[str, Column]:
    """Find the quantities in the headings of a recording.

    Args:
        headings: the first line of the file, one string a column.
        mapping: the user's own choices, `{"speed": "wL_rad_s"}`; a unit may be given on either side
            (`{"speed_deg_s": "y"}`), and without one the canonical unit is assumed. A formula over columns will do
            (`{"voltage": "duty_pct*vbat_V/100"}`), see `formula`. "none": nothing is taken for the quantity.
        where: the file's name, for messages.

    Returns:
        quantity -> column; columns that hold no known quantity are left out.

    Raises:
        DataError: a mapped column is absent, a unit is unknown or not the quantity's, or two columns claim one quantity.
    """
    cleaned = [heading.strip().lstrip("\ufeff").strip("\"'") for heading in headings]
    found: dict[str, Column] = {}
    for key, choice in mapping.items():
        quantity, unit = _mapped_quantity(key)
        index = index_of(choice, cleaned)
        if index is None and choice == _NOTHING:
            continue
        if index is None and is_formula(choice, cleaned):
            found[quantity] = _computed(choice, cleaned, quantity, unit, where)
            continue
        if index is None:
            near = difflib.get_close_matches(choice, cleaned, n=1)
            hint = (
                f"; did you mean {near[0]!r}?"
                if near
                else f"; it has {', '.join(repr(c) for c in cleaned if c)}"
            )
            raise DataError(f"{where}: no column {choice!r} for {quantity}{hint}")
        heading = choice if index == ROW else cleaned[index]
        found[quantity] = _chosen(index, heading, quantity, unit, where)
    for index, heading in enumerate(cleaned):
        recognised = recognise(heading)
        if recognised is None or recognised[0] in {_mapped_quantity(key)[0] for key in mapping}:
            continue
        quantity, unit = recognised
        if quantity in found and is_canonical(found[quantity].heading) != is_canonical(heading):
            # Of two the one that is named as usual.
            if is_canonical(heading):
                found[quantity] = _column(index, heading, quantity, unit, where)
            continue
        if quantity in found:
            raise DataError(
                f"{where}: columns {found[quantity].heading!r} and {heading!r} both look like {quantity}; "
                f"choose one with --column {quantity}={heading!r}"
            )
        found[quantity] = _column(index, heading, quantity, unit, where)
    # A constant is as long as the time.
    constant = {q: c for q, c in found.items() if c.formula and not c.formula.uses}
    return found | {q: replace(c, index=found["time"].index) for q, c in constant.items() if "time" in found}


def require(
    found: Mapping[str, Column],
    quantities: Sequence[str],
    headings: Sequence[str],
    where: str,
    rising: Callable[[], Sequence[str]] | None = None,
) -> None:
    """Refuse a recording that lacks any of `quantities`, saying which columns it has and how to map all that it lacks.

    Args:
        found: the columns by quantity.
        quantities: that are needed.
        headings: of all columns.
        where: the file.
        rising: finds the headings of columns that rise from row to row, as a time does; None: that cannot be known.

    Raises:
        DataError: a quantity is lacking.
    """
    lacking = [quantity for quantity in quantities if quantity not in found]
    if not lacking:
        return
    lacks = " and ".join(f"no {quantity} column ({canonical_name(quantity)})" for quantity in lacking)
    if list(headings[:1]) == ["#1"]:
        # Nothing says what the others hold: one order that occurs, to be changed.
        chosen = {quantity: column.heading for quantity, column in found.items()}
        if "time" in lacking and rising is not None:
            chosen["time"] = next(iter(rising()), "row*0.001[s]")
        open_ = [quantity for quantity in _USUAL_ORDER if quantity not in chosen]
        free = [heading for heading in headings if heading not in chosen.values()]
        example = [f"{q}={name}" for q, name in (*chosen.items(), *zip(open_, free, strict=False))]
        command = shlex.join(["motorlens", "look", where, *(w for one in example for w in ("--column", one))])
        raise DataError(
            f"{where}: it has no heading line, so {lacks}; it has {', '.join(headings)}; say which column holds what, for "
            f"example: {command}"
        )
    cures = "; ".join(_cure(quantity, headings) for quantity in lacking)
    raise DataError(f"{where}: {lacks}; it has {', '.join(headings)}; {cures}")


def _cure(quantity: str, headings: Sequence[str]) -> str:
    """How a quantity that no heading names may be mapped."""
    if quantity == "time" and not candidates(quantity, headings):
        return "rows that follow each other in the same time, say 1 ms, are --column 'time=row*0.001[s]'"
    duty = next((h for h in headings if _DUTY.search(h)), None) if quantity == "voltage" else None
    supply = next((h for h in headings if _SUPPLY.search(h)), None)
    percent = duty is not None and unit_in(duty) is not None
    if duty and supply:
        volts = supply if unit_in(supply) is not None else f"{supply}[V]"
        share = f"{duty}*{volts}/100" if percent else f"{duty}/255*{volts}"
        full = "" if percent else ", if 255 is full duty"
        return f"duty times supply is --column 'voltage={share}'{full}; add --voltage-commanded, it was not measured"
    if like := candidates(quantity, headings):
        return f"it may be {' or '.join(like)}: --column {shlex.quote(f'{quantity}={like[0]}')}"
    if duty:
        share = f"{duty}*24[V]" if percent else f"{duty}/255*24[V]"
        return f"duty times supply, if that is 24 V, is --column 'voltage={share}'; add --voltage-commanded"
    return f"map one with --column {quantity}=NAME"


def parse_mapping(arguments: Sequence[str]) -> dict[str, str]:
    """Turn `--column QUANTITY=NAME` arguments into a mapping.

    Raises:
        DataError: an argument has no `=` or names an unknown quantity.
    """
    mapping = {}
    for argument in arguments:
        key, equals, heading = argument.partition("=")
        if not equals or not heading:
            raise DataError(f"--column {argument}: write QUANTITY=COLUMN, for example speed=wL_rad_s")
        _mapped_quantity(key)
        mapping[key] = heading
    return mapping


def _mapped_quantity(key: str) -> tuple[str, str | None]:
    for quantity in sorted(QUANTITIES, key=len, reverse=True):
        if key == quantity:
            return quantity, None
        if key.startswith(quantity + "_"):
            return quantity, key[len(quantity) + 1 :]
    near = difflib.get_close_matches(key, QUANTITIES, n=1)
    raise DataError(
        f"unknown quantity {key!r}; {f'did you mean {near[0]!r}?' if near else 'known: ' + ', '.join(QUANTITIES)}"
    )


def _chosen(index: int, heading: str, quantity: str, unit: str | None, where: str) -> Column:
    """The column that the user chose for a quantity; a unit of another dimension in its heading is refused."""
    canonical = QUANTITIES[quantity][0]
    if unit is None:
        pieces = heading.split("_")
        suffixes = ["_".join(pieces[start:]) for start in range(1, len(pieces))]
        unit = (
            next((text for text in suffixes if conversion(canonical, text)), None) or unit_text(heading) or ""
        )
        other = in_heading(unit) if unit else None
        if other is not None and conversion(canonical, unit) is None:
            raise DataError(f"{where}: column {heading!r} is in {unit}, {quantity} is in {_written(canonical)}; "
                            + _tie(quantity, heading, other))  # fmt: skip
    return _column(index, heading, quantity, unit, where)


def speed_of(headings: Sequence[str]) -> list[str]:
    """What a speed may be computed from where none is named: counts of an encoder, or a path: formulas for `--column`."""
    found = []
    for heading in headings:
        unit = unit_in(heading)
        of = "" if unit is None else name_of(unit.dimension)
        if of in ("counts", "counts/s", "m/s"):
            formula = _TIES["speed", of][0].format(_in_formula(heading))
            found.append(formula if "=" in formula else f"speed={formula}")
    return found


def _in_formula(heading: str) -> str:
    """A heading as formulas have it: in quotes unless it is one word."""
    return heading if re.fullmatch(r"\w+", heading) else f'"{heading}"'


def _tie(quantity: str, heading: str, unit: Unit) -> str:
    formula, meaning = _TIES.get(
        (quantity, name_of(unit.dimension)), ("{}*NUMBER[UNIT]", "tie them by a constant with its unit")
    )
    formula = formula if "=" in formula else f"{quantity}={formula}"
    stated = f"{quantity}_{QUANTITIES[quantity][0]}={heading}"
    example = formula.format(_in_formula(heading))
    return f"{meaning}, as in --column '{example}', or, if the heading misleads, say so: --column '{stated}'"


def _computed(text: str, headings: Sequence[str], quantity: str, unit: str | None, where: str) -> Column:
    """A formula over columns, whose result has the quantity's dimension; a radian is a number, but no angle is 1/rad."""
    canonical = QUANTITIES[quantity][0]
    target = in_heading(canonical)
    if target is None:
        raise DataError(
            f"{where}: --column {quantity}={text}: {quantity} has no unit, and no formula; name a column that holds it"
        )
    formula = parse_formula(text, headings, unit_in, where)
    first = next(iter(formula.uses), 0)
    radian = BASES.index("rad")
    without = [d[:radian] + d[radian + 1 :] for d in (formula.dimension, target.dimension)]
    if formula.plain:
        column = _column(first, text, quantity, unit or "", where)
    elif without[0] == without[1] and formula.dimension[radian] * target.dimension[radian] >= 0:
        column = Column(first, text, quantity, 1.0, 0.0)
    else:
        example = "encoder[counts]/512[counts/rev]" if quantity == "angle" else "supply[V] or 0.033[m]"
        raise DataError(
            f"{where}: --column {quantity}={text}: comes out in {name_of(formula.dimension)}, {quantity} is in "
            f"{_written(canonical)}; give a column or a constant its unit, as in {example}"
        )
    return replace(column, formula=formula)


def _written(canonical: str) -> str:
    return {"rad_s": "rad/s", "C": "degC", "Nm": "N m"}.get(canonical, canonical)


def _column(index: int, heading: str, quantity: str, unit: str, where: str) -> Column:
    canonical = QUANTITIES[quantity][0]
    if not unit:
        return Column(index, heading, quantity, 1.0, 0.0, assumed=quantity not in WORDS)
    found = conversion(canonical, unit)
    if found is None:
        example = f'{quantity}="{heading}" [UNIT]'
        raise DataError(
            f"{where}: column {heading!r}: unknown unit {unit!r} for {quantity}; known: {_OFFERED[canonical]}; say which it "
            f"is in the place of UNIT: --column {shlex.quote(example)}"
        )
    return Column(index, heading, quantity, *found)
