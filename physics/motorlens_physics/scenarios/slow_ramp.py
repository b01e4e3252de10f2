"""Slow ramp through zero."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class SlowRamp(Scenario):
    """The voltage runs slowly from full reverse to full forward and back, twice, without load.

    Near standstill it shows breakaway, Stribeck and cogging torque and dead bands; at speed, the friction curve.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        duration = self.duration_s or 400 * (pace.mechanical_s + pace.electrical_s)
        time = self.times(duration, 0.02 * pace.mechanical_s)
        corners = duration * np.array([0.0, 0.125, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0])
        # Forward and reverse at full scale, then once more within a fifth of it, where friction is found.
        shares = np.array([0.0, 1.0, -1.0, 0.0, 0.2, 0.0, -0.2, 0.0])
        voltage = plate.voltage_V * np.interp(time, corners, shares)
        still = np.zeros_like(time)
        return Plan((Phase(Inputs(time, voltage, still, still + plate.ambient_C)),))
