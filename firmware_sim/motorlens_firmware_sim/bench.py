"""The simulated test bench: a motor runs through a scenario, and a drive digitises what its sensors show."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motorlens_firmware_sim.adc import Codes
from motorlens_firmware_sim.telemetry import Drive, drive_for
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import chosen_scenario, measure, parse_noise, perform
from motorlens_runtime.errors import DataError


@dataclass(frozen=True)
class Setup:
    """What is on the bench. `noise` as in `motorlens simulate`; `rows_per_frame` instants travel together."""

    motor: str = "mellah2016"
    scenario: str = "duty"
    duration_s: float = 60.0
    rate_Hz: int = 1000
    rows_per_frame: int = 10
    bits: int = 12
    noise: Sequence[str] = ("0.1%",)
    seed: int = 0


@dataclass(frozen=True)
class Bench:
    """The drive, the codes (N, 2) that it will send, and the truth behind them, row by row."""

    drive: Drive
    codes: Codes
    truth: Recording


def prepare(setup: Setup) -> Bench:
    """Run the motor through its scenario and digitise what the sensors show.

    Raises:
        DataError: a setting out of range, or an unknown scenario.
        ModelError: the motor file.
    """
    if not 1 <= setup.rate_Hz <= 100_000:
        raise DataError(f"rate {setup.rate_Hz}: between 1 and 100000 samples per second")
    if setup.rows_per_frame < 1 or not 8 <= setup.bits <= 16 or setup.duration_s <= 0:
        raise DataError(
            "a frame holds at least 1 row, a converter has 8 to 16 bits, and the duration is above 0"
        )
    file = read_motor_file(setup.motor)
    rng = np.random.default_rng(setup.seed)
    truth = perform(file, chosen_scenario(setup.scenario, setup.duration_s, setup.rate_Hz), rng)
    shown = measure(truth, file.sensors, parse_noise(setup.noise, file.rated), rng)
    drive = drive_for(file, setup.rate_Hz, setup.bits, setup.rows_per_frame, boot=1 + setup.seed)
    return Bench(drive, drive.digitise(shown), truth)
