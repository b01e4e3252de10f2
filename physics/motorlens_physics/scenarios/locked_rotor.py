"""Locked-rotor test."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.conditions import Shaft
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, tied, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class LockedRotor(Scenario):
    """The shaft is held while the voltage steps through both polarities at up to rated current.

    With w = 0 the terminals show R and the brush drop alone (IEEE Std 113-1985, 5.4). `load_torque` is what the lock bears.
    """

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate, motor = time_constants(file.motor), file.rated, file.motor
        duration = self.duration_s or 60.0
        time = self.times(duration, min(0.5 * pace.electrical_s, duration / 1000))
        rated_drop = motor.R_a0 * plate.current_A
        shares = np.array([0.0, 0.25, 0.5, 1.0, 0.5, -0.5, -1.0, -0.5, -0.25, 0.0])
        at = duration * np.arange(len(shares)) / len(shares)
        voltage = steps(time, at, rated_drop * shares)
        still = np.zeros_like(time)
        inputs = Inputs(time, voltage, still, still + plate.ambient_C, held=True)
        return Plan((Phase(tied(inputs, file, shaft=Shaft.LOCKED)),))
