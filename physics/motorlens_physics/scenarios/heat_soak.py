"""Heating and cooling."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class HeatSoak(Scenario):
    """Rated load until warm, a pause, a run at half speed, a pause, over some four thermal time constants.

    What cools a motor and where its heat is stored (IEC 60034-1:2022, 8.3): the pauses show a second thermal node, the
    two speeds the fan.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        duration = self.duration_s or 4.0 * pace.thermal_s
        time = self.times(duration, duration / 20_000)
        at = duration * np.array([0.0, 0.4, 0.55, 0.8])
        voltage = steps(time, at, plate.voltage_V * np.array([1.0, 0.0, 0.5, 0.0]))
        load = steps(time, at, plate.torque_Nm * np.array([1.0, 0.0, 1.0, 0.0]))
        return Plan((Phase(Inputs(time, voltage, load, np.full_like(time, plate.ambient_C), held=True)),))
