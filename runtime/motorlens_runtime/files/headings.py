"""Headings: which quantity the name of a column says it holds, and in which unit.

The canonical heading is `quantity_unit` (`speed_rad_s`). What test stands and spreadsheets write is understood beside it:
`Motor Optical Speed (RPM)`, `v[V]`, `U/V`, `Spannung U in mV`, `Time, ms`, `motor_current_mA`, `MotorSpeed_rpm`, `Ia`,
`TIME_MS`, `motorSpeedRpm`, `currentmA`, `rpm`. Beside a word for the quantity may stand where and how it was measured;
with any other word (`current_limit_A`, `field_voltage_V`) it is another quantity.
"""

import re
from collections.abc import Iterator, Sequence
from functools import lru_cache

import numpy as np

from motorlens_runtime.files.units import BASES, Unit, in_heading

# quantity -> (canonical unit, the words a heading may use for it, in lower case without blanks)
QUANTITIES: dict[str, tuple[str, tuple[str, ...]]] = {
    "time": ("s", ("time", "t", "timestamp", "elapsed", "zeit", "zeitstempel", "temps", "tiempo", "tempo", "tid",
                   "время", "时间", "時間")),
    "voltage": ("V", ("voltage", "volt", "v", "u", "spannung", "ankerspannung", "motorspannung", "tension",
                      "tensión", "tensione", "voltaje", "voltagem", "spanning", "напряжение", "电压", "電圧")),
    "current": ("A", ("current", "curr", "i", "strom", "ankerstrom", "motorstrom", "courant", "corriente",
                      "corrente", "stroom", "ток", "电流", "電流")),
    "speed": ("rad_s", ("speed", "w", "omega", "ω", "n", "velocity", "drehzahl", "motordrehzahl",
                        "winkelgeschwindigkeit", "vitesse", "velocidad", "velocidade", "velocità", "snelheid",
                        "скорость", "转速", "回転数")),
    "temperature": ("C", ("temperature", "temp", "t", "winding", "coil", "motortemp", "motortemperature",
                          "temperatur", "wicklungstemperatur", "température", "temperatura", "temperatuur",
                          "температура", "温度")),
    "load_torque": ("Nm", ("torque", "load", "tau", "tload", "tl", "ml", "drehmoment", "lastmoment", "couple",
                           "par", "coppia", "момент", "转矩", "トルク")),
    "ambient": ("C", ("ambient", "amb", "tamb", "room", "umgebungstemperatur", "raumtemperatur")),
    "angle": ("rad", ("angle", "position", "pos", "theta", "phi", "winkel", "drehwinkel")),
    "resistance": ("ohm", ("resistance", "widerstand")),
    "terminal": ("", ("terminal", "terminals")),
    "shaft": ("", ("shaft",)),
}  # fmt: skip
# Words that are a quantity only with its unit beside them: alone they are as often something else.
_NEED_A_UNIT = frozenset(("u", "n", "velocity", "tension", "couple", "par", "tempo", "temp", "winding", "coil", "load",
                          "tau", "tload", "tl", "ml", "amb", "room", "pos", "theta", "phi"))  # fmt: skip
# What may stand beside a word for the quantity and leaves it what it is: how it was measured, and where.
_HOW = frozenset(("measured", "meas", "actual", "act", "gemessen", "ist"))
_WHERE = {
    "time": ("test", "sample", "sampling", "relative", "rel"),
    "voltage": ("motor", "mot", "m", "armature", "arm", "a", "terminal", "terminals", "term"),
    "current": ("motor", "mot", "m", "armature", "arm", "a"),
    "speed": ("motor", "mot", "m", "shaft", "rotor", "angular", "rotational", "optical", "encoder", "enc", "tacho"),
    "temperature": ("armature",),
    "load_torque": ("shaft", "brake"),
    "ambient": ("temperature", "temp", "t", "air"),
    "angle": ("motor", "shaft", "rotor", "encoder", "enc"),
    "resistance": ("armature",),
}  # fmt: skip
_BRACKETED = re.compile(r"(.+?)\s*/?\s*[(\[]\s*([^)\]]+?)\s*[)\]]")
# What stands between a name and its unit where there are no brackets.
_BETWEEN = re.compile(r"\s+in\s+|\s*[/,;]\s*|[\s.\-:_]+")
# Where a name ends and its unit begins with nothing between: at a capital, or after a word for a quantity.
_CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_AFTER_WORD = re.compile(
    "|".join(f"(?<={word})" for _, words in QUANTITIES.values() for word in words if len(word) > 3),
    re.IGNORECASE,
)
_REVOLUTION = tuple({"rad": 1, "cycle": -1}.get(base, 0) for base in BASES)
# Words that make another quantity of a name, as `sd` and `rise` do in what `infer` writes.
_OTHER_WORDS = frozenset(("ref", "raw", "cmd", "set", "max", "min", "sd", "rise"))
# Units that stand for their quantity where a heading is nothing else.
_SPEAKING = re.compile(
    "rpm|secs?|volts?|amps?|amperes?|seconds?|millisec(?:ond)?s?|ms|us|rad/s|celsius|degc", re.IGNORECASE
)


def recognise(heading: str) -> tuple[str, str] | None:
    """Quantity and unit of a heading such as `speed_rpm`, `Voltage (V)` or `U/V`; None if it is neither.

    The unit is empty where the heading is the bare word.
    """
    return _canonically(heading) or _freely(heading) or _of_unknown_unit(heading)


def is_canonical(heading: str) -> bool:
    """Whether a heading is `quantity_unit`, a bare word or has its unit in brackets."""
    return _canonically(heading) is not None


def unit_text(heading: str) -> str | None:
    """The unit written in a heading, in brackets or after `_`, `/`, `,` or "in", if one is there.

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
    if in_heading(heading) is None:
        for between, suffix in _split(heading):
            # After a blank or a dash a letter is rather a number of its own: `Phase A`, `Motor-A`.
            if len(suffix) > 1 or between not in (" ", "-", ".", ":", "_", ""):
                known = [text for text in _spellings(between, suffix) if in_heading(text) is not None]
                if known:
                    return known[0]
    return None


def unit_in(heading: str) -> Unit | None:
    """The unit written in a heading; None if there is none, or none that is known."""
    text = unit_text(heading)
    return None if text is None else in_heading(text)


def candidates(quantity: str, headings: Sequence[str]) -> list[str]:
    """The headings whose unit is one of the quantity's; without any, those that hold a word for it, or its symbol."""
    unit, words = QUANTITIES[quantity]
    by_unit = [h for h in headings if (text := unit_text(h)) and conversion(unit, text) is not None]
    if by_unit:
        return by_unit
    long = [word for word in words if len(word) > 3]
    named = [h for h in headings if unit_text(h) is None and any(word in h.lower() for word in long)]
    return named or [h for h in headings if _is_named(quantity, h)]


@lru_cache(maxsize=4096)
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


def _canonically(heading: str) -> tuple[str, str] | None:
    bracketed = _BRACKETED.fullmatch(heading)
    if bracketed:
        named = [quantity for quantity in QUANTITIES if _is_named(quantity, bracketed[1])]
        for quantity in named:
            if conversion(QUANTITIES[quantity][0], bracketed[2]) is not None:
                return quantity, bracketed[2]
        return (named[0], bracketed[2]) if named and in_heading(bracketed[2]) is None else None
    words = re.sub(r"[\s_]", "", heading).lower()
    for quantity, (unit, names) in QUANTITIES.items():
        if words in (quantity.replace("_", ""), *names) and words not in _NEED_A_UNIT:
            return quantity, ""
        for name in (quantity, *names):
            if heading.lower().startswith(name + "_"):
                suffix = _as_written(quantity, heading, heading[len(name) + 1 :])
                if conversion(unit, suffix) is not None:
                    return quantity, suffix
    return None


def _of_unknown_unit(heading: str) -> tuple[str, str] | None:
    """A quantity's own name before what reads as a unit and is none: to be refused in words."""
    for quantity in QUANTITIES:
        if heading.lower().startswith(quantity + "_"):
            suffix = heading[len(quantity) + 1 :]
            # `speed_reference` is another quantity, and `speed_m_s` a speed, but none of a shaft.
            if _unitlike(suffix) and in_heading(suffix) is None:
                return quantity, suffix
    return None


def _freely(heading: str) -> tuple[str, str] | None:
    """Name and unit without brackets, both known and of one quantity; or a name alone."""
    if _SPEAKING.fullmatch(heading):
        return _speaking(heading)
    for between, after in _split(heading):
        name = heading[: len(heading) - len(after)]
        name = re.sub(r"(\s+in\s+|[\s_/,;.\-:(]+)$", "", name)
        for unit_there in _spellings(between, after):
            for quantity, (unit, _words) in QUANTITIES.items():
                suffix = _as_written(quantity, heading, unit_there)
                if unit and _is_named(quantity, name) and conversion(unit, suffix) is not None:
                    return quantity, suffix
            # `motor_rpm`
            if _SPEAKING.fullmatch(unit_there) and (spoken := _speaking(unit_there)):
                if all(piece in (*_WHERE[spoken[0]], *_HOW) for piece in _pieces(name)):
                    return spoken
    named = (
        quantity
        for quantity, (unit, _words) in QUANTITIES.items()
        if unit and _is_named(quantity, heading, with_unit=False)
    )
    return next(((quantity, "") for quantity in named), None)


def _speaking(unit_there: str) -> tuple[str, str] | None:
    return next(
        ((q, unit_there) for q, (unit, _) in QUANTITIES.items() if conversion(unit, unit_there) is not None),
        None,
    )


def _split(heading: str) -> Iterator[tuple[str, str]]:
    """What may stand between name and unit, and the unit, for each place where a heading may be parted; "" is nothing."""
    for between in _BETWEEN.finditer(heading):
        if between.start() > 0 and between.end() < len(heading):
            yield between[0].strip() or " ", heading[between.end() :]
    for mark in (_AFTER_WORD, _CAPITAL):
        for between in mark.finditer(heading):
            if between.end() < len(heading) and heading[between.end()].isalpha():
                yield "", heading[between.end() :]


def _spellings(between: str, unit_there: str) -> tuple[str, ...]:
    """The units that may be meant: a capital that parts one from its name is mostly none of its own (`speedRpm`)."""
    if between or len(unit_there) == 1:
        return (unit_there,)
    in_words = _CAPITAL.sub("_", unit_there).lower().replace("_per_", "/")
    return (unit_there[0].lower() + unit_there[1:], in_words, unit_there)


def _is_named(quantity: str, name: str, *, with_unit: bool = True) -> bool:
    """Whether a name is words for a quantity (`Spannung U`), and for where or how it was measured (`motor_voltage`)."""
    nouns = (quantity.replace("_", ""), *QUANTITIES[quantity][1])
    if not with_unit:
        nouns = tuple(noun for noun in nouns if noun not in _NEED_A_UNIT)
    beside = {*_WHERE.get(quantity, ()), *_HOW}
    pieces = _pieces(name)
    if "".join(pieces) in nouns:
        return True
    # With where it was measured as its index: `ia`, `wm`, `vmot`.
    indexed = {noun + index for noun in nouns for index in beside}
    of_it = [piece in nouns or piece in indexed for piece in pieces]
    return any(of_it) and all(
        is_noun or piece in beside or piece in QUANTITIES[quantity][1]
        for piece, is_noun in zip(pieces, of_it, strict=True)
    )


def _pieces(name: str) -> list[str]:
    """The words of a name in lower case: parted by blanks, signs and capitals (`MotorSpeed`)."""
    return [piece.lower() for piece in re.split(r"[\s_./\-]+|(?<=[a-z]{2})(?=[A-Z])", name.strip()) if piece]


def _as_written(quantity: str, heading: str, suffix: str) -> str:
    """The unit that a suffix means: in a heading all in capitals it is written so too."""
    return _in_small_letters(quantity, suffix) if heading.isupper() else suffix


def _in_small_letters(quantity: str, suffix: str) -> str:
    """The unit that a heading in capitals means: `TIME_MS` is in milliseconds, `SPEED_RAD_S` in radians per second."""
    usual = {"time": ("s", "ms", "us"), "speed": ("rad_s", "rpm", "deg_s"), "voltage": ("V", "mV"), "current": ("A", "mA"),
             "load_torque": ("Nm", "mNm"), "angle": ("rad", "deg")}.get(quantity, ())  # fmt: skip
    return next((unit for unit in usual if unit.upper() == suffix), suffix)


def _unitlike(suffix: str) -> bool:
    """Whether a suffix reads as a unit rather than as another word of the name (`speed_ref`, `speed_sd_rad_s`)."""
    pieces = suffix.lower().split("_")
    return all(len(piece) <= 4 for piece in pieces) and pieces[0] not in _OTHER_WORDS
