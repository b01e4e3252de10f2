"""No-load steps."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class NoLoadSteps(Scenario):
    """Voltage steps in both directions with nothing on the shaft: the no-load current is the friction."""

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        shares = np.array(
            [0.0, 0.1, 0.3, 0.6, 1.0, 0.4, 0.0, -0.2, -0.5, -1.0, -0.7, -0.3, 0.15, 0.8, -0.1, 0.0]
        )
        duration = self.duration_s or len(shares) * 8 * (pace.mechanical_s + pace.electrical_s)
        time = self.times(duration, 0.02 * pace.mechanical_s)
        voltage = steps(time, duration * np.arange(len(shares)) / len(shares), plate.voltage_V * shares)
        still = np.zeros_like(time)
        return Plan((Phase(Inputs(time, voltage, still, still + plate.ambient_C, held=True)),))
