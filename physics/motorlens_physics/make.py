"""What is known of a make, put into the motor file of one of its motors; and what a brief recording says of it.

No model is the motor. What it lacks leaves errors of one sign for long, which bend the parameters that a brief recording
asks for, and no such recording can tell by how much: it is of one piece. The make's own recordings can: each has a beginning
as brief, and a whole. A brief recording is one that found, in the place of the motor's parameters, its own, which scatter
about them; so much of its estimate is believed as is the motor's share of all that scatter (inter-occasion variability;
Karlsson and Sheiner 1993, doi:10.1007/BF01113502).
"""

from collections.abc import Mapping
from dataclasses import replace

from motorlens_physics.motor_file import Knowledge, MotorFile


def of_make(file: MotorFile, make: MotorFile) -> MotorFile:
    """A motor's file with what its make's says better: values and deviations, and effects that the motor's lacks.

    A parameter is the motor's own where its file states a smaller deviation than the make's, 0 included.

    Args:
        file: of the motor.
        make: of the make, as `motorlens fleet` writes it: values and deviations of a motor that was not recorded yet.
    """
    motor = file.motor
    for effect in make.motor.effects:
        if motor.effect(effect.name()) is None:
            motor = motor.with_effect(effect)
    names = {sensor.name() for sensor in file.sensors}
    sensors = (*file.sensors, *(sensor for sensor in make.sensors if sensor.name() not in names))
    wider = replace(file, motor=motor, sensors=sensors)
    values, known = make.values(), {}
    for key, of_the_make in make.knowledge.items():
        own = file.knowledge.get(key, Knowledge()).sd
        if of_the_make.sd is not None and (own is None or own > of_the_make.sd):
            known[key] = of_the_make
    found = wider.with_values({key: values[key] for key in known}, known)
    return replace(found, brief_s=make.brief_s) if make.brief_s else found


def led_away(file: MotorFile, seconds: float) -> dict[str, float]:
    """By how much recordings of so many seconds in all lead away from their motor: standard deviations by key.

    As means of so many pieces of `brief_s`, each of which leads elsewhere.
    """
    share = min(file.brief_s / seconds, 1.0) if seconds > 0 else 1.0
    return {
        key: known.brief_sd * share**0.5
        for key, known in file.knowledge.items()
        if known.sd and known.brief_sd
    }


def of_recordings(file: MotorFile, away: Mapping[str, float]) -> MotorFile:
    """The file with what may be expected of the parameters that recordings find, in the place of the motor's own."""
    known = {key: replace(file.knowledge[key], sd=_all_of(file, key, sd)) for key, sd in away.items()}
    return file.with_values({}, known)


def believed(
    file: MotorFile, away: Mapping[str, float], value: Mapping[str, float], sd: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, float]]:
    """Values and deviations of the motor's parameters, by those that recordings found.

    Args:
        file: of the motor, before.
        away: see `led_away`.
        value, sd: as they were found, from what `of_recordings` expects.
    """
    values, sds, before = dict(value), dict(sd), file.values()
    for key in away.keys() & value.keys():
        known = file.knowledge[key].sd or 0.0
        share = (known / _all_of(file, key, away[key])) ** 2
        values[key] = before[key] + share * (value[key] - before[key])
        sds[key] = float(((1 - share) * known**2 + (share * sd[key]) ** 2) ** 0.5)
    return values, sds


def _all_of(file: MotorFile, key: str, away: float) -> float:
    known = file.knowledge[key].sd or 0.0
    return float((known**2 + away**2) ** 0.5)
