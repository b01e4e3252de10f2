"""Small sensors, built in seconds: with filters alone, and with an observer beside them."""

from functools import cache

import numpy as np
from helpers.duty import MELLAH

from motorlens_physics.scenario import time_constants
from motorlens_train.build import Built, Recipe, build
from motorlens_train.data import cycle
from motorlens_train.duty_cycles import Noise, duty_cycle, instants
from motorlens_train.features import motor_bank
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.specification import Bank, Rate
from motorlens_train.trainer import Settings

NOISE = Noise(0.5, 0.05)
OUTPUTS = ("speed", "temperature", "resistance")


def small_bank(observed: bool) -> Bank:
    """The default filters of the shipped motor, with or without its observer."""
    m, pace = MELLAH.motor, time_constants(MELLAH.motor)
    bank = motor_bank(m.R_a0, m.L, pace.electrical_s, pace.mechanical_s, pace.thermal_s)
    return (
        with_observer(bank, MELLAH, ObserverSettings(voltage_sd=0.5, current_sd=0.05)) if observed else bank
    )


@cache
def small_sensor(observed: bool, skips: bool = True) -> Built:
    """A sensor trained on a few cycles: right in form, not in figures."""
    bank = small_bank(observed)
    cycles = []
    for k in range(9):
        recording = duty_cycle(MELLAH, NOISE, 200.0, 200.0, np.random.default_rng([5, k]), k % 2 == 1)
        cycles.append(
            cycle(recording, bank, OUTPUTS, instants(recording, 200, NOISE, np.random.default_rng(k)))
        )
    rate = Rate(200.0, 100.0, 10000.0)
    recipe = Recipe(
        "small", bank, OUTPUTS, (4, 3), rate, 1.0, 0, Settings(iterations=12, time_series=True), skips=skips
    )
    return build(recipe, cycles[:3], cycles[3:], [])
