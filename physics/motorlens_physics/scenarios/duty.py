"""Random duty cycle."""

from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Array
from motorlens_physics.scenario import Phase, Plan, Scenario, steps, time_constants
from motorlens_physics.simulation import Inputs


@dataclass(frozen=True)
class Duty(Scenario):
    """Random voltage, load, ambient and start temperature: what a motor sees that nobody planned for.

    Voltage and load change at random instants, dwelling from a few mechanical time constants to a tenth of the
    recording; between steps the voltage sometimes ramps. One dwell in eight is a standstill. The load brakes: it follows
    the direction of the voltage. Motors start at rest, one in two warm from an earlier run.
    """

    reversing: bool = False

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        pace, plate = time_constants(file.motor), file.rated
        duration = self.duration_s or 600.0
        time = self.times(duration, 0.01)
        # No dwell is shorter than a sample.
        shortest = max(5 * pace.mechanical_s, float(time[1] - time[0]) if len(time) > 1 else duration)
        at = self._instants(duration, shortest, rng)
        levels = plate.voltage_V * rng.uniform(0.15, 1.05, len(at))
        if self.reversing:
            levels *= rng.choice([-1.0, 1.0], len(at))
        levels[rng.random(len(at)) < 0.125] = 0.0
        levels[0] = 0.0
        voltage = steps(time, at, levels)
        if rng.random() < 0.5:
            # A ramp generator between the steps: at most rated voltage in five mechanical time constants.
            voltage = _slew(time, voltage, plate.voltage_V / (5 * pace.mechanical_s))
        load_at = self._instants(duration, shortest, rng)
        load = steps(time, load_at, plate.torque_Nm * rng.uniform(0.0, 1.2, len(load_at)))
        load = load * np.sign(voltage)
        ambient = np.full_like(time, rng.uniform(0.0, 40.0))
        warm = rng.uniform(0.0, 1.2 * plate.rise_K) if rng.random() < 0.5 else 0.0
        return Plan((Phase(Inputs(time, voltage, load, ambient)),), {"theta": warm})

    @staticmethod
    def _instants(duration: float, shortest: float, rng: np.random.Generator) -> Array:
        longest = max(duration / 10, 2 * shortest)
        dwell = np.exp(rng.uniform(np.log(shortest), np.log(longest), int(2 + 4 * duration / shortest)))
        at = np.concatenate([[0.0], np.cumsum(dwell)])
        return np.asarray(at[at < duration])


def _slew(time: Array, wanted: Array, rate: float) -> Array:
    """Follow a staircase no faster than `rate` per second."""
    limited = wanted.copy()
    allowed = rate * np.diff(time)
    for k in range(1, len(time)):
        limited[k] = limited[k - 1] + min(max(wanted[k] - limited[k - 1], -allowed[k - 1]), allowed[k - 1])
    return limited
