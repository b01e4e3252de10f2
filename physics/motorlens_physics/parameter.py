"""Parameters: a number in a frozen dataclass that carries its unit, meaning, bounds and prior.

`param(...)` is a thin `dataclasses.field`; the values are the fields, what they mean is the field's metadata.
"""

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

_KEY = "motorlens"


@dataclass(frozen=True)
class Parameter:
    """What is known of a parameter before any measurement.

    Attributes:
        name: the field's name, the symbol of its equation.
        unit: as pint reads it, in SI without prefixes, such as "N*m" or "V*s/rad".
        description: one phrase.
        default: the value of a motor or an effect made without arguments.
        bounds: the physically possible values, both ends included.
        prior: typical size as a multiple of `of`; also the standard deviation of the prior around `null`
            (or around the default where there is no null).
        of: what `prior` is a multiple of, a product of powers of the rated quantities of a motor such as
            "torque/speed^2"; "1" for an absolute figure in `unit`.
        null: the value at which the effect vanishes; None for a parameter that only shapes it.
        fixed: stated by choice, never calibrated (the width of a smoothing, a number of slots).
        role: "phase" of the shaft's angle, "count" of periods a revolution, "width" of a transition that may be sharper than
            any recording tells, "onset" where one has built up, "knee" of how sharply it bends, which hardly shows until all
            else is right, "share" of an effect that may be left undone; "" for anything else.
        largest: the largest size that is no wonder of nature, as a multiple of `of`; None: not known.
    """

    name: str
    unit: str
    description: str
    default: float
    bounds: tuple[float, float]
    prior: float
    of: str
    null: float | None
    fixed: bool
    role: str = ""
    largest: float | None = None

    def typical(self, rated: "Rated") -> float:
        """The typical value in `unit` for a motor of this rating plate, within the bounds.

        A switch is typically one prior away from its null; a shape is what the plate makes it, or its default where
        its prior is an absolute figure.
        """
        size = self.sd(rated)
        value = size + self.null if self.null is not None else self.default if self.of == "1" else size
        return min(max(value, self.bounds[0]), self.bounds[1])

    def sd(self, rated: "Rated") -> float:
        """The standard deviation of what is known before any measurement, in `unit`, for a motor of this plate."""
        return self.prior * rated.scale(self.of)


@dataclass(frozen=True)
class Rated:
    """The rating plate: what the motor is made for. Sizes of effects are stated as shares of it."""

    voltage_V: float
    current_A: float
    speed_rad_s: float
    torque_Nm: float
    rise_K: float = 60.0
    ambient_C: float = 20.0

    def scale(self, of: str) -> float:
        """Evaluate a product of powers of rated quantities.

        >>> Rated(voltage_V=24.0, current_A=2.0, speed_rad_s=40.0, torque_Nm=0.5).scale("torque/speed^2")  # 0.5 / 1600
        0.0003125
        """
        powers = {
            "1": 1.0,
            "voltage": self.voltage_V,
            "current": self.current_A,
            "speed": self.speed_rad_s,
            "torque": self.torque_Nm,
            "rise": self.rise_K,
            "power": self.voltage_V * self.current_A,
        }
        value = 1.0
        for operator, word, exponent in re.findall(r"([*/]?)([a-z1]+)(?:\^([0-9.]+))?", of):
            factor = powers[word] ** float(exponent or 1)
            value = value / factor if operator == "/" else value * factor
        return value


def param(
    default: float,
    unit: str,
    description: str,
    *,
    bounds: tuple[float, float],
    prior: float,
    of: str = "1",
    null: float | None = None,
    fixed: bool = False,
    role: str = "",
    largest: float | None = None,
) -> Any:
    """Declare a parameter of a motor, an effect or a sensor model; see `Parameter` for the arguments."""
    meaning = {
        "default": default,
        "unit": unit,
        "description": description,
        "bounds": bounds,
        "prior": prior,
        "of": of,
        "null": null,
    }
    meaning |= {"fixed": fixed, "role": role, "largest": largest}
    return dataclasses.field(default=default, metadata={_KEY: meaning})


def phase(description: str) -> Any:
    """Declare the phase of what goes with the shaft's angle, in rad: any is as likely as any other, and it has no end.

    Its standard deviation is that of a uniform distribution over a turn. A fit begins within half a turn of nought, and its
    bounds are half a turn farther.
    """
    turn = 2 * math.pi
    return param(0.0, "rad", description, bounds=(-turn, turn), prior=turn / math.sqrt(12), role="phase")


def parameters(owner: Any) -> dict[str, Parameter]:
    """The parameters of a dataclass or an instance of one, by name, in the order of their declaration."""
    return dict(_declared(owner if isinstance(owner, type) else type(owner)))


@cache
def _declared(owner: type) -> Mapping[str, Parameter]:
    return {
        field.name: Parameter(name=field.name, **field.metadata[_KEY])
        for field in dataclasses.fields(owner)
        if _KEY in field.metadata
    }
