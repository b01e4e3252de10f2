"""The sensor of a motor that is known: its observer, alone.

Where the motor is the file's, its observer errs by chance, and a network could learn nothing but the accidents of some
cycles. So there is none, nor filters to feed it, and the sensor is right wherever the observer's equations are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from motorlens_physics.motor_file import MotorFile
from motorlens_train.build import Recipe, measured
from motorlens_train.data import Cycle
from motorlens_train.observer.frame import Frame
from motorlens_train.sensor import Sensor
from motorlens_train.specification import Bank, Envelope, Feature, Output, Specification

OUTPUTS = ("speed", "temperature", "resistance")
# What a supply gives beyond the rating plate, its noise included; the largest current is that of a locked rotor.
SUPPLY = 1.25


def alone(bank: Bank, given: Sequence[str] = OUTPUTS) -> Bank:
    """A bank with an observer, without filters; of the observer's outputs those that a sensor gives."""
    observer = bank.observer
    assert observer is not None
    names = (*given, *(f"log_{name}" for name in given), "distrust")
    read = observer.read.giving([observer.outputs.index(name) for name in names])
    features = tuple(Feature("observer", filters=(k,)) for k in range(len(names)))
    return replace(bank, filters=(), features=features, observer=replace(observer, outputs=names, read=read))


def observer_alone(recipe: Recipe, file: MotorFile) -> Sensor:
    """The sensor of a motor, from a recipe with a bank of `alone`."""
    rated, motor = file.rated, file.motor
    rise_K = 0.45 * rated.rise_K
    sizes = {
        "speed": ("rad/s", rated.speed_rad_s / 4), "temperature": ("K", rise_K),
        "resistance": ("ohm", motor.R_a0 * motor.alpha * rise_K),
    }  # fmt: skip
    promised = tuple(Output(each, sizes[each][0], float(f"{sizes[each][1]:.2g}")) for each in recipe.outputs)
    most_V = SUPPLY * rated.voltage_V
    most_A = most_V / motor.R_a0
    fence = Envelope((-most_V, most_V), (-most_A, most_A))
    specification = Specification(promised, recipe.bank, recipe.rate, recipe.warm_up_s, fence)
    return Sensor(recipe.name, specification, None, Frame.of(recipe.bank, recipe.outputs))


def card_of(
    sensor: Sensor, unseen: Sequence[Cycle], cases: Mapping[str, Sequence[Cycle]], seed: int
) -> dict[str, Any]:
    """What is said of it: its errors on simulated cycles, if there are any, and on how many samples it is judged: of those
    and of further `cases`."""
    judged = [one for cycles in (unseen, *cases.values()) for one in cycles]
    return {
        "network": "observer alone", "parameters": 0, "seed": seed, "unseen_cycles": len(unseen),
        "samples_seen": sum(c.rows for c in judged), "unseen": measured(sensor, unseen) if unseen else {},
        "operations": {
            key: len(getattr(sensor.bank.observer, key).steps) for key in ("accumulate", "correct", "read")
        },
    }  # fmt: skip
