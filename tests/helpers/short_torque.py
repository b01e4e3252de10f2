"""A recording at a sample a second in which a torque that nobody measured is over within a sample."""

import numpy as np
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL
from scipy.signal import lfilter

from motorlens_physics.recording import Recording

# An hour and a half near standstill; a share of the torque remains at the next sample.
SAMPLES, REMAINS = 5400, float(np.exp(-1.0))
VOLTAGE_SD, CURRENT_SD, TORQUE_SD = 0.16, 0.02, 0.013
# The sensor of the load is better than the torque that it does not see is large.
LOAD_SD = 0.003
MOTOR = {**TYPICAL, "J": 0.9 * TYPICAL["J"], "ke": 0.9 * TYPICAL["ke"]}


def recorded(*, loaded: bool) -> Recording:
    """Voltage and current; `loaded`, also a load that steps and is measured."""
    rng = np.random.default_rng(11)
    corners = np.sort(rng.uniform(0, SAMPLES, 60))
    volts = np.interp(np.arange(SAMPLES), corners, 0.08 * RATED["voltage"] * rng.uniform(-1, 1, 60))
    torque = TORQUE_SD * lfilter([np.sqrt(1 - REMAINS**2)], [1.0, -REMAINS], rng.standard_normal(SAMPLES))
    voltage_noise, current_noise = rng.standard_normal((2, SAMPLES))
    load = np.zeros(SAMPLES)
    if loaded:
        load = np.repeat(0.05 * RATED["load_torque"] * rng.uniform(-1, 1, SAMPLES // 300), 300)
    states = plain_motor.simulated(MOTOR, volts, load + torque, plain_motor.Test(1.0, SAMPLES, 1, False, 0.0))
    channels = {
        "voltage": volts + VOLTAGE_SD * voltage_noise,
        "current": states[:, 0] + CURRENT_SD * current_noise,
    }
    if loaded:
        channels["load_torque"] = load + LOAD_SD * rng.standard_normal(SAMPLES)
    return Recording("slow.csv", np.arange(float(SAMPLES)), channels)
