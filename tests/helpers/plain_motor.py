"""The textbook motor by classical Runge-Kutta with fixed steps, and recordings of it: shares nothing with `physics/`.

L di/dt = v - R_a0 (1 + alpha theta) i - ke w
J dw/dt = ke i - b w - T_load
H dtheta/dt = R i^2 + k_ir w^2 - k0 (1 + kT |w|) theta
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]

# The motor of mellah2016.toml, and what its plate says.
TYPICAL = {
    "R_a0": 3.5, "L": 0.034, "ke": 0.9346, "J": 0.0328, "b": 0.00154, "alpha": 0.004, "k0": 4.33, "kT": 0.0028,
    "k_ir": 0.00667, "H": 18e3,
}  # fmt: skip
RATED = {"voltage": 240.0, "current": 7.27, "speed": 221.0, "temperature": 80.0, "load_torque": 6.455}
AMBIENT_C = 20.0
# The longest step, as a share of the shortest electrical time constant that occurs: an error of some 1e-9 a step.
STEP = 0.1


@dataclass(frozen=True)
class Test:
    """How a motor is driven and recorded.

    Attributes:
        period_s: between samples.
        samples: how many.
        dwell: samples for which voltage and load stay the same.
        held: whether the inputs truly hold from sample to sample, or run linearly.
        noise: of every channel, inputs too, as a share of its rated value (1 sigma).
        colour: correlation of neighbouring samples of the inputs' noise; 0 is white.
    """

    period_s: float
    samples: int
    dwell: int
    held: bool
    noise: float
    colour: float = 0.0


def scattered(rng: np.random.Generator, share: float = 0.3) -> dict[str, float]:
    """A motor of which every parameter is off by up to this share."""
    return {key: value * rng.uniform(1 - share, 1 + share) for key, value in TYPICAL.items()}


def recorded(motor: dict[str, float], test: Test, rng: np.random.Generator) -> tuple[Array, dict[str, Array]]:
    """Times (N,) and the channels as recorded, (N,) each, in SI and degC, of random steps of voltage and load."""
    time, n = np.arange(test.samples) * test.period_s, test.samples
    levels = n // test.dwell + 1
    voltage = np.repeat(rng.uniform(-RATED["voltage"], RATED["voltage"], levels), test.dwell)[:n]
    load = np.repeat(rng.uniform(0.0, RATED["load_torque"], levels), test.dwell)[:n] * np.sign(voltage)
    states = simulated(motor, voltage, load, test)
    truth = {
        "voltage": voltage, "load_torque": load, "current": states[:, 0], "speed": states[:, 1],
        "temperature": AMBIENT_C + states[:, 2],
    }  # fmt: skip
    noisy = {}
    for q, y in truth.items():
        noise = rng.standard_normal(n)
        if test.colour and q in ("voltage", "load_torque"):
            noise = lfilter([np.sqrt(1 - test.colour**2)], [1.0, -test.colour], noise)
        noisy[q] = y + test.noise * RATED[q] * noise
    return time, noisy


def simulated(motor: dict[str, float], voltage: Array, load: Array, test: Test) -> Array:
    """(N, 3) current, speed and rise of the winding, from rest and cold."""
    steps = max(1, int(np.ceil(test.period_s / (STEP * motor["L"] / motor["R_a0"]))))
    values = np.array([motor[key] for key in TYPICAL])
    return np.asarray(_integrated(values, voltage, load, test.period_s, steps, test.held))


@njit(cache=True)
def _rates(p, x, v, load, out):  # type: ignore[no-untyped-def]
    R_a0, L, ke, J, b, alpha, k0, kT, k_ir, H = p
    i, w, theta = x
    R = R_a0 * (1.0 + alpha * theta)
    out[0] = (v - R * i - ke * w) / L
    out[1] = (ke * i - b * w - load) / J
    out[2] = (R * i * i + k_ir * w * w - k0 * (1.0 + kT * abs(w)) * theta) / H


@njit(cache=True)
def _integrated(p, voltage, load, period, steps, held):  # type: ignore[no-untyped-def]
    n = len(voltage)
    out, x = np.zeros((n, 3)), np.zeros(3)
    k1, k2, k3, k4 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    h = period / steps
    for k in range(n - 1):
        dv = 0.0 if held else voltage[k + 1] - voltage[k]
        dl = 0.0 if held else load[k + 1] - load[k]
        for s in range(steps):
            a, m, z = s / steps, (s + 0.5) / steps, (s + 1.0) / steps
            _rates(p, x, voltage[k] + a * dv, load[k] + a * dl, k1)
            _rates(p, x + 0.5 * h * k1, voltage[k] + m * dv, load[k] + m * dl, k2)
            _rates(p, x + 0.5 * h * k2, voltage[k] + m * dv, load[k] + m * dl, k3)
            _rates(p, x + h * k3, voltage[k] + z * dv, load[k] + z * dl, k4)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        out[k + 1] = x
    return out
