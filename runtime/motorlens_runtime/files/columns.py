"""Headings and units: which physical quantity a column holds, and how it becomes SI.

The canonical heading is `quantity_unit` (`speed_rad_s`). Any other unit of the same dimension is converted
(`speed_rpm`), and the headings that test stands write are understood (`Motor Optical Speed (RPM)`, `Drehzahl [1/min]`).
Temperatures stay in degrees Celsius, as every test bench writes them; everything else is SI.
"""

import difflib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.formula import Cells, Formula, is_formula, parse_formula
from motorlens_runtime.files.units import BASES, Unit, in_heading, name_of
from motorlens_runtime.files.words import WORDS

# quantity -> (canonical unit, the words a heading may use for it, in lower case without blanks)
QUANTITIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "time": ("s", ("time", "t", "timestamp", "zeit", "zeitstempel")),
    "voltage": ("V", ("voltage", "v", "u", "armaturevoltage", "terminalvoltage", "motorvoltage", "spannung",
                      "ankerspannung", "motorspannung", "tension")),
    "current": ("A", ("current", "i", "armaturecurrent", "motorcurrent", "strom", "ankerstrom", "motorstrom", "courant")),
    "speed": ("rad_s", ("speed", "w", "omega", "n", "motorspeed", "motoropticalspeed", "rotorspeed", "velocity",
                        "angularvelocity", "drehzahl", "motordrehzahl", "winkelgeschwindigkeit", "vitesse")),
    "temperature": ("C", ("temperature", "windingtemperature", "motortemp", "coiltemperature", "temperatur",
                          "wicklungstemperatur")),
    "load_torque": ("Nm", ("loadtorque", "torque", "shafttorque", "drehmoment", "lastmoment", "couple")),
    "ambient": ("C", ("ambient", "ambienttemperature", "umgebungstemperatur")),
    "angle": ("rad", ("angle", "shaftangle", "position", "winkel", "drehwinkel")),
    "resistance": ("ohm", ("resistance", "armatureresistance", "widerstand")),
    "terminal": ("", ("terminal", "terminals")),
    "shaft": ("", ("shaft",)),
}  # fmt: skip
# Words that are a quantity only with its unit beside them: alone they are as often something else.
_NEED_A_UNIT = frozenset(("u", "n", "velocity", "tension", "couple"))
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
    ("angle", "counts"): ("{}/1024[counts/rev]", "divide it by the counts of a revolution"),
    ("voltage", "1"): ("{}*SUPPLY_V/100", "multiply it by the supply"),
    ("load_torque", "N"): ("{}*0.1[m]", "multiply it by the lever"),
}
_DUTY = re.compile(r"duty|pwm|tastgrad", re.IGNORECASE)
_SUPPLY = re.compile(r"bat|supply|bus|vdc|dc.?link|versorgung", re.IGNORECASE)

# Words that make another quantity of a name, as `sd` and `rise` do in what `infer` writes.
_BRACKETED = re.compile(r"(.+?)\s*[(\[]\s*([^)\]]+?)\s*[)\]]")
_REVOLUTION = tuple({"rad": 1, "cycle": -1}.get(base, 0) for base in BASES)
_OTHER_WORDS = frozenset(("ref", "raw", "cmd", "set", "max", "min", "sd", "rise"))


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
        return self.formula.uses if self.formula else (self.index,)

    def values(self, cells: Cells) -> Array:
        """(N,) in the canonical unit, from the numbers of each column as they stand in the file."""
        numbers = self.formula.value(cells) if self.formula else cells(self.index)
        if (self.factor, self.offset) == (1, 0):
            return numbers
        return numbers * self.factor + self.offset


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
            (`{"voltage": "duty_pct*vbat_V/100"}`), see `formula`.
        where: the file's name, for messages.

    Returns:
        quantity -> column; columns that hold no known quantity are left out.

    Raises:
        DataError: a mapped column is absent, a unit is unknown or not the quantity's, or two columns claim one quantity.
    """
    cleaned = [heading.strip().lstrip("\ufeff").strip('"') for heading in headings]
    found: dict[str, Column] = {}
    for key, choice in mapping.items():
        quantity, unit = _mapped_quantity(key)
        if choice not in cleaned and is_formula(choice, cleaned):
            found[quantity] = _computed(choice, cleaned, quantity, unit, where)
            continue
        if choice not in cleaned:
            near = difflib.get_close_matches(choice, cleaned, n=1)
            hint = (
                f"; did you mean {near[0]!r}?"
                if near
                else f"; it has {', '.join(repr(c) for c in cleaned if c)}"
            )
            raise DataError(f"{where}: no column {choice!r} for {quantity}{hint}")
        found[quantity] = _chosen(cleaned.index(choice), choice, quantity, unit, where)
    for index, heading in enumerate(cleaned):
        recognised = _recognise(heading)
        if recognised is None or recognised[0] in {_mapped_quantity(key)[0] for key in mapping}:
            continue
        quantity, unit = recognised
        if quantity in found:
            raise DataError(
                f"{where}: columns {found[quantity].heading!r} and {heading!r} both look like {quantity}; "
                f"choose one with --column {quantity}={heading!r}"
            )
        found[quantity] = _column(index, heading, quantity, unit, where)
    return found


def require(
    found: Mapping[str, Column], quantities: Sequence[str], headings: Sequence[str], where: str
) -> None:
    """Refuse a recording that lacks one of `quantities`, saying which columns it has and how to map one."""
    for quantity in quantities:
        if quantity not in found:
            like = candidates(quantity, headings)
            name = headings[0] if headings and headings[0] == "#1" else "NAME"
            cure = f"map one with --column {quantity}={name}"
            if like:
                cure = f"it may be {' or '.join(like)}: --column {shlex.quote(f'{quantity}={like[0]}')}"
            duty = next((h for h in headings if _DUTY.search(h)), None)
            supply = next((h for h in headings if _SUPPLY.search(h)), None)
            if quantity == "voltage" and duty and supply:
                share = f"{duty}*{supply}/100" if unit_in(duty) else f"{duty}/255*{supply}"
                full = "" if unit_in(duty) else ", if 255 is full duty"
                cure = f"duty times supply is --column 'voltage={share}'{full}; add --voltage-commanded, it was not measured"
            raise DataError(
                f"{where}: no {quantity} column ({canonical_name(quantity)}); it has {', '.join(headings)}; {cure}"
            )


def candidates(quantity: str, headings: Sequence[str]) -> list[str]:
    """The headings whose unit is one of the quantity's."""
    unit = QUANTITIES[quantity][0]
    return [h for h in headings if (text := unit_text(h)) and conversion(unit, text) is not None]


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


def _recognise(heading: str) -> tuple[str, str] | None:
    """Quantity and unit of a heading such as `speed_rpm`, `Voltage (V)` or `v[V]`; None if it is neither.

    The unit is empty where the heading is the bare word.
    """
    bracketed = _BRACKETED.fullmatch(heading)
    if bracketed:
        words = re.sub(r"[\s_]", "", bracketed[1]).lower()
        for quantity, (unit, names) in QUANTITIES.items():
            if words in names:
                other = in_heading(bracketed[2])
                return None if other and conversion(unit, bracketed[2]) is None else (quantity, bracketed[2])
        return None
    for quantity, (unit, names) in QUANTITIES.items():
        words = re.sub(r"[\s_]", "", heading).lower()
        if words in (quantity.replace("_", ""), *names) and words not in _NEED_A_UNIT:
            return quantity, ""
        for name in (quantity, *names):
            if heading.lower().startswith(name + "_"):
                suffix = heading[len(name) + 1 :]
                # A longer word (`current_limit_A`) is another quantity, and `speed_reference` no unit; `speed_m_s` is a
                # speed, but none of a shaft.
                if conversion(unit, suffix) is not None or (
                    name == quantity and _unitlike(suffix) and in_heading(suffix) is None
                ):
                    return quantity, suffix
    return None


def _unitlike(suffix: str) -> bool:
    """Whether a suffix reads as a unit rather than as another word of the name (`speed_ref`, `speed_sd_rad_s`)."""
    pieces = suffix.lower().split("_")
    return all(len(piece) <= 4 for piece in pieces) and pieces[0] not in _OTHER_WORDS


def unit_text(heading: str) -> str | None:
    """The unit written in a heading, in brackets or after `_`, if one is there.

    A single small letter is none: `i_m` is the motor's current and `u_s` a supply, not metres and seconds.
    """
    bracketed = _BRACKETED.fullmatch(heading)
    if bracketed:
        return bracketed[2]
    pieces = heading.split("_")
    for start in range(1, len(pieces)):
        suffix = "_".join(pieces[start:])
        if in_heading(suffix) is not None and not re.fullmatch("[a-z1]", suffix):
            return suffix
    return None


def unit_in(heading: str) -> Unit | None:
    """The unit written in a heading; None if there is none, or none that is known."""
    text = unit_text(heading)
    return None if text is None else in_heading(text)


def conversion(canonical: str, text: str) -> tuple[float, float] | None:
    """Factor and offset from a spelling to a canonical unit; None if it is of another dimension. A cycle is a turn."""
    unit, target = in_heading(text), in_heading(canonical) if canonical else None
    if unit is None or target is None:
        return None
    if unit.dimension != target.dimension:
        cycles = unit.dimension[BASES.index("cycle")]
        unit = unit * Unit(2 * np.pi, _REVOLUTION) ** cycles
        if not cycles or unit.dimension != target.dimension:
            return None
    return unit.factor, unit.offset


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


def _tie(quantity: str, heading: str, unit: Unit) -> str:
    formula, meaning = _TIES.get(
        (quantity, name_of(unit.dimension)), ("{}*NUMBER[UNIT]", "tie them by a constant with its unit")
    )
    formula = formula if "=" in formula else f"{quantity}={formula}"
    stated = f"{quantity}_{QUANTITIES[quantity][0]}={heading}"
    return f"{meaning}, as in --column '{formula.format(heading)}', or, if the heading misleads, say so: --column '{stated}'"


def _computed(text: str, headings: Sequence[str], quantity: str, unit: str | None, where: str) -> Column:
    """A formula over columns, whose result has the quantity's dimension; a radian is a number, as in SI."""
    canonical = QUANTITIES[quantity][0]
    formula = parse_formula(text, headings, unit_in, where)
    target = in_heading(canonical)
    assert target is not None
    radian = BASES.index("rad")
    without = [d[:radian] + d[radian + 1 :] for d in (formula.dimension, target.dimension)]
    if formula.plain:
        column = _column(formula.uses[0], text, quantity, unit or "", where)
    elif without[0] == without[1]:
        column = Column(formula.uses[0], text, quantity, 1.0, 0.0)
    else:
        raise DataError(
            f"{where}: --column {quantity}={text}: comes out in {name_of(formula.dimension)}, {quantity} is in "
            f"{_written(canonical)}; give a constant its unit, as in 12[V] or 0.033[m]"
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
        raise DataError(
            f"{where}: column {heading!r}: unknown unit {unit!r} for {quantity}; known: {_OFFERED[canonical]}"
        )
    return Column(index, heading, quantity, *found)
