"""Units by their spelling: the factor to SI and the dimension, for headings of recordings and for `--column`.

Products and quotients are understood (`V*s/rad`, `m/s/(rad/s)`), and in headings also what a name can hold (`rad_s`,
`lbf_ft`, `lbf·ft`). Temperatures are in degrees Celsius, everything else is SI. Besides the base units of SI a dimension
counts radians, counts of a converter or encoder, and cycles (Hz), so that none is taken for another.
"""

import re
from dataclasses import dataclass, replace
from functools import lru_cache

_PI = 3.141592653589793
BASES = ("m", "kg", "s", "A", "K", "rad", "count", "cycle")
Dimension = tuple[int, ...]
PLAIN: Dimension = (0,) * len(BASES)


@dataclass(frozen=True)
class Unit:
    """`SI = factor * number + offset`; `dimension` holds the exponents of `BASES`."""

    factor: float
    dimension: Dimension = PLAIN
    offset: float = 0.0

    def __mul__(self, other: "Unit") -> "Unit":
        dimension = tuple(a + b for a, b in zip(self.dimension, other.dimension, strict=True))
        return Unit(self.factor * other.factor, dimension)

    def __truediv__(self, other: "Unit") -> "Unit":
        return self * other**-1

    def __pow__(self, exponent: int) -> "Unit":
        return Unit(self.factor**exponent, tuple(exponent * d for d in self.dimension))


def _base(name: str) -> Unit:
    return Unit(1.0, tuple(int(name == base) for base in BASES))


def _atoms() -> dict[str, Unit]:
    m, kg, s, a, k, rad, count, cycle = map(_base, BASES)
    newton, volt = kg * m / s**2, kg * m**2 / s**3 / a
    found = {
        "s": s, "min": replace(s, factor=60.0), "h": replace(s, factor=3600.0),
        "V": volt, "A": a, "ohm": volt / a, "Ω": volt / a, "Ohm": volt / a, "H": volt * s / a, "W": volt * a,
        "N": newton, "Nm": newton * m, "lbf": replace(newton, factor=4.4482216152605),
        "ozf": replace(newton, factor=0.27801385095378125), "kgf": replace(newton, factor=9.80665), "kg": kg,
        "g": replace(kg, factor=1e-3), "m": m, "cm": replace(m, factor=1e-2), "ft": replace(m, factor=0.3048),
        "in": replace(m, factor=0.0254), "rad": rad, "rev": replace(rad, factor=2 * _PI),
        "turn": replace(rad, factor=2 * _PI), "Hz": cycle / s, "cycle": cycle, "1": Unit(1.0),
        "K": replace(k, offset=-273.15), "%": Unit(0.01), "pct": Unit(0.01), "percent": Unit(0.01),
    }  # fmt: skip
    found |= dict.fromkeys(("deg", "°"), replace(rad, factor=_PI / 180))
    found |= dict.fromkeys(("C", "degC", "°C", "ºC"), k)
    found |= dict.fromkeys(("F", "degF", "°F", "ºF"), replace(k, factor=5 / 9, offset=-160 / 9))
    found |= dict.fromkeys(
        ("count", "counts", "cts", "tick", "ticks", "pulse", "pulses", "step", "steps", "LSB", "lsb"), count
    )
    rpm = replace(rad / s, factor=_PI / 30)
    found |= dict.fromkeys(("rpm", "RPM", "Rpm", "1/min", "min-1", "min^-1", "U/min", "tr/min", "r/min"), rpm)
    found |= dict.fromkeys(("rad/sec", "rads/s", "rads", "radps", "rad_per_s", "рад/с"), rad / s)
    found |= dict.fromkeys(("giri/min", "об/мин", "tours/min", "omw/min", "upm", "Upm"), rpm)
    found |= dict.fromkeys(("dps", "deg/sec"), found["deg"] / s) | dict.fromkeys(
        ("rps", "rev/sec"), found["rev"] / s
    )
    found["krpm"] = replace(rpm, factor=1000 * _PI / 30)
    prefixes = {"m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9, "k": 1e3}
    for name, letters in (("s", "muµμn"), ("V", "mukµμ"), ("A", "muµμk"), ("ohm", "mk"), ("Ω", "mk"), ("m", "mk"),
                          ("H", "muµ"), ("W", "mk"), ("N", "mk"), ("Nm", "mk"), ("rad", "m"), ("Hz", "k")):  # fmt: skip
        for letter in letters:
            found[letter + name] = replace(found[name], factor=prefixes[letter] * found[name].factor)
    found |= {"d": replace(s, factor=86400.0), "с": s, "мс": found["ms"], "В": volt, "мВ": found["mV"], "А": a,
              "мА": found["mA"], "Н·м": found["Nm"], "Nmm": found["mNm"],
              "Ncm": replace(newton * m, factor=1e-2)}  # fmt: skip
    return found


def _words(atoms: dict[str, Unit]) -> dict[str, Unit]:
    """Units written out, in lower case."""
    written = {
        "s": "sec secs second seconds sekunde sekunden",
        "ms": "msec msecs millis millisec millisecs millisecond milliseconds",
        "us": "usec microsecond microseconds", "min": "mins minute minutes minuten", "h": "hr hrs hour hours",
        "d": "day days", "V": "volt volts", "mV": "millivolt millivolts", "A": "amp amps ampere amperes",
        "mA": "milliamp milliamps milliampere milliamperes", "ohm": "ohms", "degC": "celsius", "degF": "fahrenheit",
        "K": "kelvin", "rad": "radian radians", "deg": "degree degrees grad", "rev": "revs revolution revolutions",
    }  # fmt: skip
    return {word: atoms[unit] for unit, words in written.items() for word in words.split()}


_ATOMS = _atoms()
_WORDS = _words(_ATOMS)
# Units of two parts whose parts may be joined by another mark in a heading.
_PAIRS = (
    "rad/s", "mrad/s", "deg/s", "°/s", "rev/s", "rev/min", "rad/s2", "m/s", "mm/s", "cm/s", "km/h", "m/s2", "counts/s",
    "ticks/s", "N*m", "mN*m", "lbf*ft", "lbf*in", "ozf*in", "kgf*cm", "V*s", "V*A",
)  # fmt: skip
_TOKEN = re.compile(r"\s*(?:(?P<mark>[*/·()])|\^?(?P<power>-?\d+)|(?P<name>[A-Za-z%°ºΩµμ]+))")


def parse(text: str) -> Unit | None:
    """The unit of a spelling such as `mV`, `V*s/rad` or `m/s^2`; None if it is none."""
    if text in _ATOMS:
        return _ATOMS[text]
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    tokens: list[tuple[str, str]] = []
    at = 0
    while at < len(text.rstrip()):
        token = _TOKEN.match(text, at)
        if token is None:
            return None
        tokens.append((token.lastgroup or "", token[token.lastgroup or 0]))
        at = token.end()
    try:
        unit, rest = _product(tokens)
    except (IndexError, KeyError):
        return None
    return None if rest else unit


def _product(tokens: list[tuple[str, str]]) -> tuple[Unit, list[tuple[str, str]]]:
    unit, rest = _factor(tokens)
    while rest and rest[0][1] != ")":
        mark = rest[0][1] if rest[0][0] == "mark" and rest[0][1] != "(" else ""
        other, rest = _factor(rest[1:] if mark else rest)
        unit = unit / other if mark == "/" else unit * other
    return unit, rest


def _factor(tokens: list[tuple[str, str]]) -> tuple[Unit, list[tuple[str, str]]]:
    kind, text = tokens[0]
    if text == "(":
        unit, rest = _product(tokens[1:])
        if rest[0][1] != ")":
            raise KeyError(text)
        rest = rest[1:]
    else:
        unit, rest = replace(_ATOMS[text], offset=0.0), tokens[1:]
    if kind != "power" and rest and rest[0][0] == "power":
        unit, rest = unit ** int(rest[0][1]), rest[1:]
    return unit, rest


@lru_cache(maxsize=4096)
def in_heading(text: str) -> Unit | None:
    """Like `parse`, with `_`, `·`, `.`, `-`, a blank or nothing between the two parts of a unit (`rad_s`, `lbf·ft`)."""
    for pair in _PAIRS:
        first, mark, second = re.split(r"([/*])", pair)
        between = r"[_·*.\- ]?" if mark == "*" else r"[/_.\- ]"
        if re.fullmatch(f"{re.escape(first)}{between}{re.escape(second)}", text):
            return parse(pair)
    return parse(text) if not re.search(r"[_\s]", text) else None


def name_of(dimension: Dimension) -> str:
    """How a dimension is written: `V`, `rad/s`, or in base units."""
    for name in (
        "V",
        "A",
        "ohm",
        "s",
        "W",
        "N*m",
        "N",
        "m/s",
        "rad/s",
        "rad",
        "V*s",
        "V*s/rad",
        "counts",
        "counts/s",
    ):
        unit = parse(name)
        if unit is not None and unit.dimension == dimension:
            return name
    above = [f"{b}^{d}" if d > 1 else b for b, d in zip(BASES, dimension, strict=True) if d > 0]
    below = [f"{b}^{-d}" if d < -1 else b for b, d in zip(BASES, dimension, strict=True) if d < 0]
    if not above and not below:
        return "1"
    return "/".join(["*".join(above) or "1", *below])
