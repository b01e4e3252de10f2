"""Overhauling load."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class OverhaulingLoad(Scenario):
    """A dynamometer brakes and drives the turning motor in turn, in both directions: torque changes sign against speed.

    Only so are friction under load and a wrong torque scale told apart: a brake always opposes the motion, as friction does.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        voltages = np.array([1.0, 0.6, -0.6, -1.0])
        loads = np.array([0.0, 1.0, -1.0, 0.5, -0.5])
        dwell = 8 * (pace.mechanical_s + pace.electrical_s)
        count = len(voltages) * len(loads)
        duration = self.duration_s or count * dwell
        time = self.times(duration, 0.02 * pace.mechanical_s)
        slots = duration * np.arange(count) / count
        voltage = steps(time, slots, plate.voltage_V * np.repeat(voltages, len(loads)))
        load = steps(time, slots, plate.torque_Nm * np.tile(loads, len(voltages)))
        return Plan((Phase(Inputs(time, voltage, load, np.full_like(time, plate.ambient_C), held=True)),))
