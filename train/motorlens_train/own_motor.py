"""The observer of somebody's own motor, from recordings alone: what they reach is its rating plate, what they show its
parameters; and whether it foretells a recording it has not seen better than a network does.

A motor that the textbook describes is followed by its observer wherever it is driven, and the observer says when it is
not. Where friction, backlash or a gear rule, a network that was shown them comes nearer. Recordings left out tell which.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from motorlens_physics.datasheet import from_datasheet
from motorlens_physics.estimate.calibrate import calibrate
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import time_constants
from motorlens_runtime.errors import DataError, ModelError
from motorlens_train.alone import alone
from motorlens_train.baselines.extended_kalman import noise_of
from motorlens_train.data import arrays, cycle
from motorlens_train.material import Material, observed_rate
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.observer.frame import Frame
from motorlens_train.specification import Bank
from motorlens_train.trainer import train

# Of the current, what a motor without load takes: nobody has stated it, and the fit finds the friction.
NO_LOAD = 0.1
# So many recordings are left out in turn.
FOLDS = 4
# What a card calls the recordings of a motor that was fitted to them.
FITTED = "the recordings its motor was fitted to"


def motor_of(name: str, recordings: Sequence[Recording]) -> MotorFile:
    """The motor of recordings with speed and current.

    The rating plate is what they reach; resistance and back-EMF constant are those of least squares, and all that is not
    exact is then fitted as `motorlens calibrate` fits it.

    Raises:
        DataError, ModelError: they show no motor.
    """
    v, i, w = (
        np.concatenate([np.nan_to_num(r.channels[channel]) for r in recordings])
        for channel in ("voltage", "current", "speed")
    )
    slope = np.concatenate([np.gradient(np.nan_to_num(r.channels["current"]), r.time_s) for r in recordings])
    (resistance, inductance, ke), *_ = np.linalg.lstsq(np.column_stack([i, slope, w]), v)
    voltage, speed = float(np.abs(v).max()), float(np.abs(w).max())
    if min(resistance, ke) <= 0 or ke * speed >= voltage:
        raise DataError(
            f"{recordings[0].name}: voltage, current and speed are not those of a motor: check signs and units"
        )
    current = (voltage - float(ke) * speed) / float(resistance)
    ambient = [np.mean(r.channels["ambient"]) for r in recordings if r.has("ambient")]
    start = from_datasheet(
        name, voltage_V=voltage, current_A=current, speed_rad_s=speed, resistance_ohm=float(resistance),
        no_load_current_A=NO_LOAD * current, inductance_H=float(inductance) if inductance > 0 else None,
        ambient_C=float(np.mean(ambient)) if ambient else 20.0,
    )  # fmt: skip
    return calibrate(start, recordings).file


def observing(file: MotorFile, recordings: Sequence[Recording], bank: Bank) -> Bank:
    """A bank with the observer of a motor, its noise read off recordings; its temperature is the rise above ambient."""
    voltage_sd, current_sd = noise_of(recordings, file.rated)
    return with_observer(
        replace(bank, ambient=False), file, ObserverSettings(voltage_sd=voltage_sd, current_sd=current_sd)
    )


def nearer_observer(name: str, recordings: Sequence[Recording], material: Material) -> MotorFile | None:
    """The motor of the recordings, if its observer comes nearer to those left out in turn than the network of `material`.

    None with fewer than two recordings, where no motor is shown, or where the network comes nearer.
    """
    outputs, recipe = material.recipe.outputs, material.recipe
    if len(recordings) < 2 or "speed" not in outputs:
        return None
    ratios = []
    try:
        for out in range(min(len(recordings), FOLDS)):
            others = [r for k, r in enumerate(recordings) if k != out]
            bank = observing(motor_of(name, others), others, replace(recipe.bank, filters=(), features=()))
            seen = cycle(recordings[out], bank, outputs)
            estimate, _ = Frame.of(bank, outputs).start(seen.x)
            found = train(
                arrays([cycle(r, recipe.bank, outputs) for r in others]),
                recipe.architecture,
                recipe.seed,
                recipe.settings,
            )
            guess = found.predict(torch.from_numpy(cycle(recordings[out], recipe.bank, outputs).x)).numpy()
            ratios.append(_rms(estimate - seen.y) / _rms(guess - seen.y))
        return motor_of(name, recordings) if float(np.mean(np.log(ratios))) < 0.0 else None
    except (DataError, ModelError):
        return None


def alone_on(file: MotorFile, recordings: Sequence[Recording], material: Material) -> Material:
    """What is to be made of the motor of some recordings: its observer, alone; it promises what `material` does."""
    recipe, rate = material.recipe, material.recipe.rate.nominal
    bank = alone(observing(file, recordings, recipe.bank), recipe.outputs)
    recipe = replace(
        recipe, bank=bank, rate=observed_rate(rate), warm_up_s=5 * time_constants(file.motor).mechanical_s
    )
    names = ", ".join(r.name for r in recordings)
    origin = f"the {len(recordings)} recordings that its motor was fitted to: {names}"
    cycles = tuple(cycle(r, bank, recipe.outputs) for r in recordings)
    return Material(recipe, (), (), (), origin, {FITTED: cycles})


def _rms(errors: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt((errors**2).mean(0)) + 1e-12)
