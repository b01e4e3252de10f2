"""Headings and units: which physical quantity a column holds, and how it becomes SI.

The canonical heading is `quantity_unit` (`speed_rad_s`). Any other unit of the same dimension is converted
(`speed_rpm`), and the headings that test stands write are understood (`Motor Optical Speed (RPM)`, `v[V]`).
Temperatures stay in degrees Celsius, as every test bench writes them; everything else is SI.
"""

import difflib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from motorlens_runtime.errors import DataError

# quantity -> (canonical unit, the words a heading may use for it, in lower case without blanks)
QUANTITIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "time": ("s", ("time", "t", "timestamp")),
    "voltage": ("V", ("voltage", "v", "armaturevoltage", "terminalvoltage")),
    "current": ("A", ("current", "i", "armaturecurrent", "motorcurrent")),
    "speed": ("rad_s", ("speed", "w", "omega", "motorspeed", "motoropticalspeed", "rotorspeed")),
    "temperature": ("C", ("temperature", "windingtemperature", "motortemp", "coiltemperature")),
    "load_torque": ("Nm", ("loadtorque", "torque", "shafttorque")),
    "ambient": ("C", ("ambient", "ambienttemperature")),
    "angle": ("rad", ("angle", "shaftangle", "position")),
    "resistance": ("ohm", ("resistance", "armatureresistance")),
}

_PI = 3.141592653589793
# canonical unit -> {spelling: (factor, offset)}, canonical = factor * value + offset
_UNITS: dict[str, dict[str, tuple[float, float]]] = {
    "s": {"s": (1, 0), "ms": (1e-3, 0), "us": (1e-6, 0), "µs": (1e-6, 0), "μs": (1e-6, 0), "min": (60, 0), "h": (3600, 0)},
    "V": {"V": (1, 0), "mV": (1e-3, 0), "kV": (1e3, 0)},
    "A": {"A": (1, 0), "mA": (1e-3, 0)},
    "rad_s": {
        "rad/s": (1, 0), "krpm": (1000 * _PI / 30, 0), "rpm": (_PI / 30, 0), "RPM": (_PI / 30, 0),
        "deg/s": (_PI / 180, 0), "°/s": (_PI / 180, 0), "rev/s": (2 * _PI, 0), "Hz": (2 * _PI, 0),
    },
    "C": {
        "C": (1, 0), "degC": (1, 0), "°C": (1, 0), "ºC": (1, 0), "K": (1, -273.15),
        "F": (5 / 9, -160 / 9), "degF": (5 / 9, -160 / 9), "°F": (5 / 9, -160 / 9), "ºF": (5 / 9, -160 / 9),
    },
    "Nm": {
        "Nm": (1, 0), "N*m": (1, 0), "mNm": (1e-3, 0), "lbf*ft": (1.3558179483314004, 0),
        "lbf*in": (0.1129848290276167, 0), "ozf*in": (0.007061551814226043, 0), "kgf*cm": (0.0980665, 0),
    },
    "rad": {"rad": (1, 0), "deg": (_PI / 180, 0), "°": (_PI / 180, 0), "rev": (2 * _PI, 0)},
    "ohm": {"ohm": (1, 0), "Ω": (1, 0), "mohm": (1e-3, 0), "mΩ": (1e-3, 0)},
}  # fmt: skip

# Words that make another quantity of a name, as `sd` and `rise` do in what `infer` writes.
_OTHER_WORDS = frozenset(("ref", "raw", "cmd", "set", "max", "min", "sd", "rise"))


@dataclass(frozen=True)
class Column:
    """One column of a recording: `canonical = factor * value + offset`, in `unit` of `quantity`."""

    index: int
    heading: str
    quantity: str
    factor: float
    offset: float

    @property
    def name(self) -> str:
        """The canonical heading, such as `speed_rad_s`."""
        return canonical_name(self.quantity)


def canonical_name(quantity: str) -> str:
    """`quantity_unit` in SI; temperatures in degrees Celsius."""
    return f"{quantity}_{QUANTITIES[quantity][0]}"


def understand(headings: Sequence[str], mapping: Mapping[str, str], where: str) -> dict[str, Column]:
    """Find the quantities in the headings of a recording.

    Args:
        headings: the first line of the file, one string a column.
        mapping: the user's own choices, `{"speed": "wL_rad_s"}`; a unit may be given on either side
            (`{"speed_deg_s": "y"}`), and without one the canonical unit is assumed.
        where: the file's name, for messages.

    Returns:
        quantity -> column; columns that hold no known quantity are left out.

    Raises:
        DataError: a mapped column is absent, a unit is unknown, or two columns claim one quantity.
    """
    cleaned = [heading.strip().lstrip("﻿").strip('"') for heading in headings]
    found: dict[str, Column] = {}
    for key, heading in mapping.items():
        quantity, unit_left = _mapped_quantity(key)
        if heading not in cleaned:
            near = difflib.get_close_matches(heading, cleaned, n=1)
            hint = (
                f"; did you mean {near[0]!r}?"
                if near
                else f"; it has {', '.join(repr(c) for c in cleaned if c)}"
            )
            raise DataError(f"{where}: no column {heading!r} for {quantity}{hint}")
        unit = unit_left or _unit_in(heading, QUANTITIES[quantity][0]) or QUANTITIES[quantity][0]
        found[quantity] = _column(cleaned.index(heading), heading, quantity, unit, where)
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
            raise DataError(
                f"{where}: no {quantity} column ({canonical_name(quantity)}); it has {', '.join(headings)}; "
                f"map one with --column {quantity}=NAME"
            )


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
    """Quantity and unit of a heading such as `speed_rpm`, `Voltage (V)` or `v[V]`; None if it is neither."""
    bracketed = re.fullmatch(r"(.+?)\s*[(\[]\s*([^)\]]+?)\s*[)\]]", heading)
    if bracketed:
        words = re.sub(r"[\s_]", "", bracketed[1]).lower()
        for quantity, (_, names) in QUANTITIES.items():
            if words in names:
                return quantity, bracketed[2]
        return None
    for quantity, (unit, names) in QUANTITIES.items():
        if re.sub(r"[\s_]", "", heading).lower() in (quantity.replace("_", ""), *names):
            return quantity, unit
        for name in (quantity, *names):
            if heading.lower().startswith(name + "_"):
                suffix = heading[len(name) + 1 :]
                # A longer word (`current_limit_A`) is another quantity, and `speed_reference` no unit.
                if _lookup(unit, suffix) is not None or (
                    heading.lower().startswith(quantity + "_") and _unitlike(suffix)
                ):
                    return quantity, suffix
    return None


def _unitlike(suffix: str) -> bool:
    """Whether a suffix reads as a unit rather than as another word of the name (`speed_ref`, `speed_sd_rad_s`)."""
    pieces = suffix.lower().split("_")
    return all(len(piece) <= 4 for piece in pieces) and pieces[0] not in _OTHER_WORDS


def _unit_in(heading: str, canonical: str) -> str | None:
    """The unit written in a heading that the user mapped by name, if one is there."""
    bracketed = re.fullmatch(r".+?\s*[(\[]\s*([^)\]]+?)\s*[)\]]", heading)
    if bracketed:
        return bracketed[1]
    pieces = heading.split("_")
    for start in range(1, len(pieces)):
        if _lookup(canonical, "_".join(pieces[start:])) is not None:
            return "_".join(pieces[start:])
    return None


def _lookup(canonical: str, unit: str) -> tuple[float, float] | None:
    """Factor and offset of a spelling, with `_`, `·`, `.` and `-` accepted between the parts of a unit."""
    for spelling, conversion in _UNITS[canonical].items():
        pieces = re.split(r"[/*]", spelling)
        if unit == spelling or (
            len(pieces) == 2 and re.fullmatch(rf"{pieces[0]}[/_·*.\- ]?{pieces[1]}", unit)
        ):
            return conversion
    return None


def _column(index: int, heading: str, quantity: str, unit: str, where: str) -> Column:
    canonical = QUANTITIES[quantity][0]
    conversion = _lookup(canonical, unit)
    if conversion is None:
        known = ", ".join(_UNITS[canonical])
        raise DataError(f"{where}: column {heading!r}: unknown unit {unit!r} for {quantity}; known: {known}")
    return Column(index, heading, quantity, *conversion)
