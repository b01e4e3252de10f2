"""Direct-on-line start under load."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, constant, time_constants


@dataclass(frozen=True)
class DirectOnLine(Scenario):
    """Rated voltage and load applied at once to a cold motor at rest, then left running until it is warm.

    The run of the paper: inrush, run-up, and 140 minutes of heating (Mellah et al. 2016, figures 2 to 4). The start is
    sampled a hundred times finer than the rest.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace = time_constants(file.motor)
        duration = self.duration_s or 2.0 * pace.thermal_s
        start = min(15 * (pace.mechanical_s + pace.electrical_s), duration)
        fine = (
            min(0.1 * pace.electrical_s, 0.01 * pace.mechanical_s)
            if not self.period_s
            else self.period_s / 100
        )
        coarse = self.period_s or 1.0
        time = np.concatenate([np.arange(0, start, fine), np.arange(start, duration, coarse), [duration]])
        plate = file.rated
        return Plan((Phase(constant(time, plate.voltage_V, plate.torque_Nm, plate.ambient_C)),))
