"""Direct-on-line start under load."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, constant, grid, time_constants


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
        # Without inductance the current follows at once; what is left to see is the run-up.
        fine = self.period_s / 100 or min(0.1 * pace.electrical_s or np.inf, 0.01 * pace.mechanical_s)
        inrush = self.times(start, fine) if not self.period_s else grid(start, fine)
        warming = self.times(duration - start, 1.0, start_s=start)
        time = np.concatenate([inrush[inrush < start], warming[warming < duration], [duration]])
        plate = file.rated
        return Plan((Phase(constant(time, plate.voltage_V, plate.torque_Nm, plate.ambient_C)),))
