"""The thermal equation alone, driven by the current and the speed as they were measured.

Behind a speed controller, a commutator of transistors or a gear train, the voltage on record is not the voltage at the
motor, and nothing can be said of two of the three equations. The third can be tested all the same. The motor is fed by a
current source, a voltage behind a resistance that dwarfs its own (Norton), and turned by a speed source, a torque against a
damping that dwarfs its load; both follow the recording at once. All else is as ever: fit, screen, verdict.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from motorlens_physics.effects.supply_resistance import SupplyResistance
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError

# How much stronger a source is than what it works against.
DWARFS = 1e4
# Time constant of either source over the sampling period.
FOLLOWS = 1e-3
NEEDED = ("current", "speed", "temperature")
_SOURCE = "supply_resistance"


def driven(file: MotorFile, recordings: Sequence[Recording]) -> tuple[MotorFile, list[Recording]]:
    """The motor between its sources, and recordings whose inputs make them follow what was measured.

    Raises:
        DataError: a recording without current, speed or temperature.
    """
    for recording in recordings:
        missing = [channel for channel in NEEDED if not recording.has(channel)]
        if missing:
            raise DataError(
                f"{recording.name}: {' and '.join(missing)} not recorded; --driven needs {', '.join(NEEDED)}"
            )
    rated = file.rated
    resistance = DWARFS * rated.voltage_V / rated.current_A
    resistance = min(resistance, SupplyResistance.parameters()["R_s"].bounds[1])
    damping = DWARFS * rated.torque_Nm / rated.speed_rad_s
    quick = FOLLOWS * min(float(np.median(np.diff(recording.time_s))) for recording in recordings)
    imposed = {
        "L": resistance * quick,
        "ke": 1e-6 * rated.voltage_V / rated.speed_rad_s,
        "J": damping * quick,
        "b": damping,
        f"{_SOURCE}.R_s": resistance,
    }
    motor = file.motor.without_effect(_SOURCE) if _has_source(file) else file.motor
    with_source = replace(file, motor=motor.with_effect(SupplyResistance(R_s=resistance)))
    known = {key: Knowledge(0.0, "imposed") for key in imposed}
    fed = [_fed(recording, resistance, damping) for recording in recordings]
    return with_source.with_values(imposed, known), fed


def freed(found: MotorFile, file: MotorFile) -> MotorFile:
    """A motor file found between the sources, with what belongs to them as it is in `file`."""
    motor = found.motor.without_effect(_SOURCE)
    if _has_source(file):
        motor = motor.with_effect(next(e for e in file.motor.effects if e.name() == _SOURCE))
    values = {key: file.values()[key] for key in ("L", "ke", "J", "b")}
    known = {key: file.knowledge.get(key, Knowledge()) for key in values}
    kept = {key: value for key, value in found.knowledge.items() if not key.startswith(f"{_SOURCE}.")}
    return replace(found, motor=motor, knowledge=kept).with_values(values, known)


def _has_source(file: MotorFile) -> bool:
    return any(effect.name() == _SOURCE for effect in file.motor.effects)


def _fed(recording: Recording, resistance: float, damping: float) -> Recording:
    measured = recording.channels
    kept = {quantity: measured[quantity] for quantity in ("temperature", "ambient") if quantity in measured}
    sources = {"voltage": resistance * measured["current"], "load_torque": -damping * measured["speed"]}
    return replace(recording, channels={**sources, **kept})
