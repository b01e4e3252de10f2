"""Motor files: a motor's parameters with unit, standard deviation and source, in TOML, round-tripped with comments.

schema = "motorlens.motor/1"
name = "mellah2016"

[rated]
voltage_V = 240.0

[parameters]
R_a0 = { value = 3.5, unit = "ohm", sd = 0.035, source = "published: arXiv 2104.04348" }

[effects.coulomb_friction]
tau_c = { value = 0.3, unit = "N*m", sd = 0.01, source = "fitted to bench.csv" }

A fitted value keeps what was stated of it before, or taken where nothing was, to which the next fit to the same recordings
holds:

R_a0 = { value = 3.61, unit = "ohm", sd = 0.02, source = "fitted to bench.csv", prior = { value = 3.5, sd = 0.035 } }

[sensors.speed_sensor_gain]
gain = { value = 1.02, unit = "1" }
"""

import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeGuard

from motorlens_physics.effect import Effect, catalogue
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Parameter, Rated, parameters
from motorlens_physics.sensor_model import SensorModel, in_chain, sensor_models
from motorlens_runtime.errors import DataError, ModelError
from motorlens_runtime.files.shipped import motor_path

SCHEMA = "motorlens.motor/1"
_TOP = ("schema", "name", "description", "source", "brief_s", "rated", "parameters", "effects", "sensors")
# Faults that a sensor can have and a command cannot.
_NO_SENSOR = ("gain", "offset", "lag")
_ENTRY = ("value", "unit", "sd", "brief_sd", "source", "prior")
_PRIOR = ("value", "sd", "source")


@dataclass(frozen=True)
class Stated:
    """A value with its standard deviation and where it comes from."""

    value: float
    sd: float
    source: str = ""


@dataclass(frozen=True)
class Knowledge:
    """What is known of one value: its standard deviation (None: not stated) and where it comes from.

    `brief_sd` is by how much a recording of `MotorFile.brief_s` leads away from its motor, see `make`. `prior` is what was
    stated, or taken, before the value was fitted to recordings from which more may still be learnt.
    """

    sd: float | None = None
    source: str = ""
    brief_sd: float = 0.0
    prior: Stated | None = None


@dataclass(frozen=True)
class MotorFile:
    """A motor, its rating plate, its sensors, and what is known of each parameter.

    `knowledge` is keyed like the parameters of a fit: "R_a0", "coulomb_friction.tau_c", "speed_sensor_gain.gain".
    `brief_s` is how long recordings are of which it says by how much they lead away from their motor. `sensors` are in
    the order in which they act, see `in_chain`.
    """

    name: str
    motor: Motor
    rated: Rated
    sensors: tuple[SensorModel, ...] = ()
    knowledge: Mapping[str, Knowledge] = field(default_factory=dict)
    description: str = ""
    text: str = ""  # the TOML it was read from, so that writing keeps comments and order
    brief_s: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensors", in_chain(self.sensors))

    @property
    def parts(self) -> tuple[Effect | SensorModel, ...]:
        """Everything beside the textbook motor that has parameters: its effects, then its sensors."""
        return (*self.motor.effects, *self.sensors)

    def values(self) -> dict[str, float]:
        """All parameter values by key, effects and sensors included."""
        own = {name: getattr(self.motor, name) for name in parameters(self.motor)}
        for part in self.parts:
            own |= {f"{part.name()}.{name}": getattr(part, name) for name in parameters(part)}
        return own

    def meaning(self, key: str) -> Parameter:
        """The declaration of a parameter by key."""
        owner, _, name = key.rpartition(".")
        if not owner:
            return parameters(self.motor)[name]
        return next(part for part in self.parts if part.name() == owner).parameters()[name]

    def with_values(
        self, values: Mapping[str, float], knowledge: Mapping[str, Knowledge] | None = None
    ) -> "MotorFile":
        """A copy with some parameters changed; `knowledge` replaces what was known of them."""
        of_owner: dict[str, dict[str, Any]] = {}
        for key, value in values.items():
            owner, _, name = key.rpartition(".")
            of_owner.setdefault(owner, {})[name] = value
        effects = tuple(replace(effect, **of_owner.get(effect.name(), {})) for effect in self.motor.effects)
        sensors = tuple(replace(sensor, **of_owner.get(sensor.name(), {})) for sensor in self.sensors)
        motor = replace(self.motor, effects=effects, **of_owner.get("", {}))
        return replace(self, motor=motor, sensors=sensors, knowledge={**self.knowledge, **(knowledge or {})})


def read_motor_file(path: Path | str, effects_from: Iterable[type[Effect]] = ()) -> MotorFile:
    """Read a motor file, or the shipped one of that name; `effects_from` are effect classes from outside the catalogue.

    Raises:
        ModelError: not TOML, an unknown key (with the nearest known one), a wrong unit, a value out of bounds.
        OSError: the file cannot be read.
    """
    where, path = str(path), motor_path(path)
    try:
        text = path.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except ValueError as error:  # no text, or no TOML
        hint = "" if path.suffix.lower() == ".toml" else "; it is TOML, *.toml, or the name of a shipped one"
        raise ModelError(f"{where}: not a motor file{hint}: {error}") from None
    _known(document, _TOP, where, "")
    if document.get("schema") != SCHEMA:
        raise ModelError(f"{where}: schema is {document.get('schema')!r}, expected {SCHEMA!r}")
    known: dict[str, Knowledge] = {}
    values = _values(_table(document, "parameters", where), parameters(Motor), where, "", known)
    absent = [name for name in parameters(Motor) if name not in values]
    if absent:
        raise ModelError(f"{where}: [parameters] lacks {', '.join(absent)}")
    motor = Motor(**values)
    plate = _plate(_table(document, "rated", where), where)
    available = catalogue() | {effect.name(): effect for effect in effects_from}
    parts = _table(document, "effects", where)
    _known(parts, tuple(available), where, "effects")
    for name in parts:
        effect = available[name]
        entries = _table(parts, name, where)
        given = _values(entries, effect.parameters(), where, name, known)
        # What the file leaves open has the shape that fits the plate.
        motor = motor.with_effect(replace(effect.at_null(plate), **given))
    models = sensor_models()
    faults = _table(document, "sensors", where)
    _known(faults, tuple(models), where, "sensors")
    sensors = tuple(
        replace(
            models[name],
            **_values(_table(faults, name, where), models[name].parameters(), where, name, known),
        )
        for name in faults
    )
    name = str(document.get("name", Path(path).stem))
    brief_s = _not_negative(document, "brief_s", where, "s")
    return MotorFile(name, motor, plate, sensors, known, str(document.get("description", "")), text, brief_s)


def voltage_commanded(file: MotorFile) -> MotorFile:
    """The same motor with a voltage that is a command, duty times supply: its gain, offset and lag are known to be none.

    A command may act late; its delay stays open.
    """
    models = sensor_models()
    ideal = tuple(models[f"voltage_sensor_{kind}"].at_null(file.rated) for kind in _NO_SENSOR)
    names = {model.name() for model in ideal}
    sensors = (*(s for s in file.sensors if s.name() not in names), *ideal)
    known = {
        f"{model.name()}.{name}": Knowledge(0.0, "measured: a command, no sensor")
        for model in ideal
        for name in model.parameters()
    }
    return replace(file, sensors=sensors, knowledge={**file.knowledge, **known})


def write_motor_file(file: MotorFile, path: Path | str) -> None:
    """Write a motor file; comments and order of the text it was read from are kept, what is gone is removed."""
    Path(path).write_text(to_toml(file), encoding="utf-8")


def to_toml(file: MotorFile) -> str:
    """The TOML of a motor file, comments and order of the text it was read from kept."""
    import tomlkit

    document = tomlkit.parse(file.text)
    document["schema"] = SCHEMA
    document["name"] = file.name
    if file.description:
        document["description"] = file.description
    if file.brief_s:
        _update(document, "brief_s", file.brief_s)
    else:
        document.pop("brief_s", None)
    rated = document.setdefault("rated", tomlkit.table())
    for name in Rated.__dataclass_fields__:
        _update(rated, name, getattr(file.rated, name))
    values = file.values()
    sections = {"parameters": [key for key in values if "." not in key]}
    for owner in file.parts:
        section = "effects" if isinstance(owner, Effect) else "sensors"
        sections[f"{section}.{owner.name()}"] = [f"{owner.name()}.{name}" for name in owner.parameters()]
    for section in ("effects", "sensors"):
        for name in [name for name in document.get(section, {}) if f"{section}.{name}" not in sections]:
            del document[section][name]
    for section, keys in sections.items():
        group, _, name = section.partition(".")
        table = document.setdefault(group, tomlkit.table(is_super_table=bool(name)))
        if name:
            table = table.setdefault(name, tomlkit.table())
        for key in keys:
            entry = table.setdefault(key.rpartition(".")[2], tomlkit.inline_table())
            known = file.knowledge.get(key, Knowledge())
            _update(entry, "value", float(values[key]))
            _update(entry, "unit", file.meaning(key).unit)
            if known.sd is not None:
                _update(entry, "sd", float(known.sd))
            if known.brief_sd:
                _update(entry, "brief_sd", float(known.brief_sd))
            else:
                entry.pop("brief_sd", None)
            if known.source:
                _update(entry, "source", known.source)
            if known.prior is None:
                entry.pop("prior", None)
            else:
                before = entry.setdefault("prior", tomlkit.inline_table())
                for part, value in asdict(known.prior).items():
                    _update(before, part, value)
    return tomlkit.dumps(document)


def _update(table: Any, key: str, value: Any) -> None:
    # Writing an unchanged value would drop the way it was spelled (18e3).
    if key not in table or table[key] != value:
        table[key] = value


def _table(parent: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    table = parent.get(key, {})
    if not isinstance(table, Mapping):
        raise ModelError(
            f"{where}: {key} is not a table but {table!r}; parameters are written NAME = {{ value = ... }}"
        )
    return table


def _plate(table: Mapping[str, Any], where: str) -> Rated:
    _known(table, tuple(Rated.__dataclass_fields__), where, "rated")
    absent = [f.name for f in fields(Rated) if f.default is MISSING and f.name not in table]
    if absent:
        raise ModelError(f"{where}: [rated] lacks {', '.join(absent)}")
    for name, value in table.items():
        # Only a temperature in degC may be zero or below.
        if not _number(value) or (value <= 0 and name != "ambient_C"):
            raise ModelError(f"{where}: [rated] {name} = {value!r} is not a positive number")
    return Rated(**{name: float(value) for name, value in table.items()})


def _number(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _known(table: Mapping[str, Any], known: tuple[str, ...], where: str, section: str) -> None:
    for key in table:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
            raise ModelError(f"{where}: {f'[{section}] ' if section else ''}unknown key {key!r}; {hint}")


def _values(
    table: Mapping[str, Any],
    declared: Mapping[str, Parameter],
    where: str,
    owner: str,
    known: dict[str, Knowledge],
) -> dict[str, Any]:
    section = owner or "parameters"
    _known(table, tuple(declared), where, section)
    values: dict[str, Any] = {}
    for name, entry in table.items():
        what = declared[name]
        entry = entry if isinstance(entry, Mapping) else {"value": entry}
        _known(entry, _ENTRY, where, f"{section}.{name}")
        if entry.get("unit", what.unit) != what.unit:
            raise ModelError(f"{where}: [{section}] {name} is in {entry['unit']!r}, expected {what.unit!r}")
        here = f"{where}: [{section}]"
        values[name] = _value(entry, what, here, name)
        sd = _not_negative(entry, "sd", here, what.unit, f" of {name}") if "sd" in entry else None
        brief_sd = _not_negative(entry, "brief_sd", here, what.unit, f" of {name}")
        prior = _prior(entry, what, where, section, name) if "prior" in entry else None
        key = f"{owner}.{name}" if owner else name
        known[key] = Knowledge(sd, str(entry.get("source", "")), brief_sd, prior)
    return values


def _prior(entry: Mapping[str, Any], what: Parameter, where: str, section: str, name: str) -> Stated:
    before = _table(entry, "prior", f"{where}: [{section}] {name}")
    _known(before, _PRIOR, where, f"{section}.{name}.prior")
    here, of = f"{where}: [{section}]", f"the prior of {name}"
    if "sd" not in before:
        raise ModelError(f"{here} {of} has no sd")
    sd = _not_negative(before, "sd", here, what.unit, f" of {of}")
    return Stated(_value(before, what, here, of), sd, str(before.get("source", "")))


def _value(entry: Mapping[str, Any], what: Parameter, here: str, name: str) -> float:
    value, (low, high) = entry.get("value"), what.bounds
    if not _number(value):
        raise ModelError(f"{here} {name} has no number as its value but {value!r}")
    if not low <= value <= high:
        raise ModelError(f"{here} {name} = {value:g} is outside {low:g} to {high:g} {what.unit}")
    return float(value)


def _not_negative(table: Mapping[str, Any], key: str, where: str, unit: str, of: str = "") -> float:
    value = table.get(key, 0.0)
    if not _number(value) or value < 0:
        raise ModelError(f"{where}: {key}{of} is {value!r}, expected a number in {unit}, 0 or more")
    return float(value)


def parse_override(argument: str) -> tuple[str, float]:
    """Turn `coulomb_friction.tau_c=0.3` (or `R_a0=3.6`) into a key and a value.

    Raises:
        DataError: no `=`, or no number behind it.
    """
    key, _, value = argument.partition("=")
    try:
        return key, float(value)
    except ValueError:
        raise DataError(f"{argument!r}: write NAME=NUMBER, for example coulomb_friction.tau_c=0.3") from None


def with_overrides(
    file: MotorFile, overrides: Mapping[str, float], own: Mapping[str, type[Effect]] | None = None
) -> MotorFile:
    """A copy with parameters set by key; effects and sensor models named for the first time are added.

    Args:
        file: the motor file.
        overrides: such as {"R_a0": 3.6, "coulomb_friction.tau_c": 0.3, "speed_sensor_gain.gain": 1.02}.
        own: effects from outside the catalogue, by name.

    Raises:
        DataError: an unknown effect, sensor model or parameter (with the nearest known one), or a value out of bounds.
    """
    effects, models = catalogue() | dict(own or {}), sensor_models()
    for key, value in overrides.items():
        owner = key.rpartition(".")[0]
        if owner and owner not in {part.name() for part in file.parts}:
            if owner in effects:
                file = replace(file, motor=file.motor.with_effect(effects[owner].at_null(file.rated)))
            elif owner in models:
                file = replace(file, sensors=(*file.sensors, models[owner].at_null(file.rated)))
            else:
                raise DataError(
                    f"{key}: unknown effect or sensor model {owner!r}; {_near(owner, (*effects, *models))}"
                )
        declared = [known for known in file.values() if known.rpartition(".")[0] == owner]
        if key not in declared:
            raise DataError(f"{key}: unknown parameter; {_near(key, declared)}")
        low, high = file.meaning(key).bounds
        if not low <= value <= high:
            raise DataError(f"{key}={value:g} is outside {low:g} to {high:g} {file.meaning(key).unit}")
        file = file.with_values({key: value})
    return file


def _near(word: str, known: Iterable[str]) -> str:
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}"
