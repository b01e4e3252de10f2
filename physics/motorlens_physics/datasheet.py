"""A starting motor file from a datasheet: five numbers, physics, and deviations that say how little that is."""

import math
from collections.abc import Sequence
from typing import Any

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated, parameters
from motorlens_runtime.errors import DataError, ModelError
from motorlens_runtime.files.columns import understand

REQUIRED = ("voltage_V", "current_A", "speed_rad_s", "resistance_ohm", "no_load_current_A")
OPTIONAL = ("inductance_H", "inertia_kg_m2", "rise_K", "ambient_C")
# Relative deviations: tolerances of datasheets (IEC 60034-1:2022, 12.2, and makers' +-10 %), and factors for guesses.
_STATED, _DERIVED, _GUESSED = 0.1, 0.15, 1.0


def parse_datasheet(arguments: Sequence[str]) -> dict[str, float]:
    """Turn `voltage_V=24 speed_rpm=3000 no_load_current_mA=90` into the names of `from_datasheet`.

    Raises:
        DataError: not NAME=NUMBER, an unknown name or unit, one that is missing.
    """
    found: dict[str, float] = {}
    for argument in arguments:
        heading, _, text = argument.partition("=")
        try:
            value = float(text)
        except ValueError:
            raise DataError(f"--datasheet {argument!r}: write NAME=NUMBER, such as voltage_V=24") from None
        name = heading
        if heading not in (*REQUIRED, *OPTIONAL):
            prefix = "no_load_" if heading.startswith("no_load_") else ""
            columns = understand([heading.removeprefix(prefix)], {}, "--datasheet")
            for column in columns.values():
                value = column.factor * value + column.offset
                name = prefix + column.name
        if name not in (*REQUIRED, *OPTIONAL):
            known = ", ".join((*REQUIRED, *OPTIONAL))
            raise DataError(f"--datasheet {heading}: unknown; known: {known}")
        found[name] = value
    missing = [name for name in REQUIRED if name not in found]
    if missing:
        raise DataError(f"--datasheet lacks {', '.join(missing)}")
    return found


def from_datasheet(
    name: str,
    *,
    voltage_V: float,
    current_A: float,
    speed_rad_s: float,
    resistance_ohm: float,
    no_load_current_A: float,
    inductance_H: float | None = None,
    inertia_kg_m2: float | None = None,
    rise_K: float = 60.0,
    ambient_C: float = 20.0,
) -> MotorFile:
    """The motor that a rating plate describes.

    The back-EMF constant follows from the rated point, friction from the no-load current (all of it taken as viscous),
    and the cooling from the rise that the rated losses bring about; inductance, inertia and heat capacity are typical of
    motors of this rating, to a factor of e.

    Raises:
        ModelError: numbers that no motor can have.
    """
    positive = {
        "voltage_V": voltage_V, "current_A": current_A, "speed_rad_s": speed_rad_s, "resistance_ohm": resistance_ohm,
        "no_load_current_A": no_load_current_A, "rise_K": rise_K,
    }  # fmt: skip
    for what, value in positive.items():
        if not (math.isfinite(value) and value > 0):
            raise ModelError(f"datasheet: {what} = {value:g} must be positive")
    emf = voltage_V - resistance_ohm * current_A
    if emf <= 0:
        raise ModelError(
            f"datasheet: {resistance_ohm:g} ohm times {current_A:g} A is {resistance_ohm * current_A:.4g} V, not less than "
            f"the rated {voltage_V:g} V; check the units"
        )
    if no_load_current_A >= current_A:
        raise ModelError(
            f"datasheet: the no-load current, {no_load_current_A:g} A, is not less than the rated one"
        )
    ke = emf / speed_rad_s
    no_load_speed = (voltage_V - resistance_ohm * no_load_current_A) / ke
    b = ke * no_load_current_A / no_load_speed
    torque = ke * current_A - b * speed_rad_s
    rated = Rated(voltage_V, current_A, speed_rad_s, torque, rise_K, ambient_C)
    typical = {key: meaning.typical(rated) for key, meaning in parameters(Motor).items()}
    losses = (
        resistance_ohm * (1 + typical["alpha"] * rise_K) * current_A**2 + typical["k_ir"] * speed_rad_s**2
    )
    values: dict[str, Any] = {
        "R_a0": resistance_ohm,
        "L": typical["L"] if inductance_H is None else inductance_H,
        "ke": ke,
        "J": typical["J"] if inertia_kg_m2 is None else inertia_kg_m2,
        "b": b,
        "alpha": typical["alpha"],
        "k0": losses / (rise_K * (1 + typical["kT"] * speed_rad_s)),
        "kT": typical["kT"],
        "k_ir": typical["k_ir"],
        "H": typical["H"],
    }
    stated = "datasheet"
    sources = {
        "R_a0": (_STATED, stated),
        "L": (_GUESSED, "typical of the rating") if inductance_H is None else (_STATED, stated),
        "ke": (_DERIVED, "datasheet: rated point"),
        "J": (_GUESSED, "typical of the rating") if inertia_kg_m2 is None else (_STATED, stated),
        "b": (_GUESSED, "datasheet: no-load current, taken as viscous"),
        "alpha": (0.03, "copper"),
        "k0": (0.5, "rated losses over the rated rise"),
    }
    known = {
        key: Knowledge(
            abs(value) * sources.get(key, (_GUESSED, ""))[0],
            sources.get(key, (0.0, "typical of the rating"))[1],
        )
        for key, value in values.items()
    }
    return MotorFile(name, Motor(**values), rated, knowledge=known)
