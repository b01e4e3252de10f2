"""Coast-down test."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.conditions import Terminal
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, constant, tied, time_constants


@dataclass(frozen=True)
class CoastDown(Scenario):
    """Run up without load, open the terminals, and let friction alone stop the motor.

    The slope of the speed over the speed is the friction curve (IEEE Std 113-1985, 5.6). `voltage` is the back-EMF.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate, motor = time_constants(file.motor), file.rated, file.motor
        run_up = 8 * (pace.mechanical_s + pace.electrical_s)
        # Friction of a few per cent of rated torque stops the rotor in this time.
        coast = self.duration_s or 1.5 * motor.J * plate.speed_rad_s / (0.05 * plate.torque_Nm)
        period = 0.02 * pace.mechanical_s
        ambient = plate.ambient_C
        driven = Phase(constant(self.times(run_up, period), plate.voltage_V, 0.0, ambient))
        free = constant(self.times(coast, period, start_s=driven.inputs.time_s[-1]), 0.0, 0.0, ambient)
        return Plan((driven, Phase(tied(free, file, Terminal.OPEN))))
