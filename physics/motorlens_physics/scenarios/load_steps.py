"""Load steps."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class LoadSteps(Scenario):
    """Brake-load steps at several voltages in both directions: current and speed vary independently of each other."""

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        voltages = np.array([0.0, 1.0, 0.6, 0.3, 0.0, -0.6, -1.0])
        loads = np.array([0.0, 0.5, 1.0, 0.2])
        dwell = 8 * (pace.mechanical_s + pace.electrical_s)
        duration = self.duration_s or len(voltages) * len(loads) * dwell
        time = self.times(duration, 0.02 * pace.mechanical_s)
        slots = duration * np.arange(len(voltages) * len(loads)) / (len(voltages) * len(loads))
        voltage = steps(time, slots, plate.voltage_V * np.repeat(voltages, len(loads)))
        load = steps(time, slots, plate.torque_Nm * np.tile(loads, len(voltages))) * np.sign(voltage)
        return Plan((Phase(Inputs(time, voltage, load, np.full_like(time, plate.ambient_C), held=True)),))
