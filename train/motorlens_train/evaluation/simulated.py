"""What the compared methods are fitted to where no recordings are given: simulated duty cycles of the motor file."""

from collections.abc import Sequence

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import chosen_scenario, measure, perform


def simulated_duty(
    file: MotorFile, rng: np.random.Generator, cycles: int = 3, duration_s: float = 600.0, rate_Hz: float = 100.0,
    noise: dict[str, float] | None = None,
) -> list[Recording]:  # fmt: skip
    """Random duty cycles of a motor with measured voltage and current.

    Args:
        file: the motor.
        rng: where cycles and noise come from.
        cycles: how many.
        duration_s: of each.
        rate_Hz: samples per second.
        noise: standard deviation by channel; None: 0.2 % of rated voltage and 0.7 % of rated current.
    """
    sizes = (
        {"voltage": 0.002 * file.rated.voltage_V, "current": 0.007 * file.rated.current_A}
        if noise is None
        else noise
    )
    scenario = chosen_scenario("duty", duration_s, rate_Hz)
    return [measure(perform(file, scenario, rng), file.sensors, sizes, rng) for _ in range(cycles)]


def plate_of(recordings: Sequence[Recording]) -> Rated:
    """A rating plate from recordings, where no motor file is given: the largest values in them."""

    def largest(quantity: str, otherwise: float) -> float:
        values = [np.nanmax(np.abs(r.channels[quantity])) for r in recordings if r.has(quantity)]
        return float(max(values, default=otherwise)) or otherwise

    return Rated(
        largest("voltage", 1.0), largest("current", 1.0), largest("speed", 1.0), largest("load_torque", 1.0)
    )
