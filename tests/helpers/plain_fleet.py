"""Motors of one make whose population is known, and recordings of them: shares nothing with `physics/`.

The motor is that of `plain_motor`, with a drop at the brushes and Coulomb friction besides, by classical Runge-Kutta:

L di/dt = v - R_a0 (1 + alpha theta) i - ke w - V_b tanh(i / 0.1 A)
J dw/dt = ke i - b w - T_load - tau_c tanh(w / 0.5 rad/s)
H dtheta/dt = R i^2 + k_ir w^2 - k0 (1 + kT |w|) theta

Parameters of a motor are lognormal around those of the make, and those of a recording around those of its motor.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path

import numpy as np
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

EFFECTS = {"V_b": 0.0, "tau_c": 0.0}
# Relative standard deviations between motors of the make, and between recordings of one motor.
SPREAD = {
    "R_a0": 0.05, "L": 0.06, "ke": 0.03, "J": 0.05, "b": 0.12, "alpha": 0.01, "k0": 0.05, "kT": 0.05,
    "k_ir": 0.05, "H": 0.05,
}  # fmt: skip
WANDERS = {"R_a0": 0.01, "b": 0.05}
# A channel's noise as a share of its rated value: of good recordings, and of poor ones.
GOOD, POOR = 0.005, 0.02
# Days between recordings.
EVERY_DAYS = 30
FIRST = date(2025, 1, 6)


@dataclass(frozen=True)
class World:
    """A make, its motors and how they are recorded.

    Attributes:
        motors, recordings: how many motors, and recordings of each.
        make: what all motors have; parameters not named are those of `plain_motor`.
        broken: motor -> factors on its parameters, and sizes of its effects.
        since: motor -> the first recording (0, 1, ...) at which it is broken.
        poor: every so manieth motor has poor recordings only; 0 is none.
        period_s, samples, dwell: of a recording, see `plain_motor.Test`.
        heated_s, heated_samples: of the last recording of each motor, which is longer and warms it up; 0 s: as the others.
    """

    motors: int
    recordings: int
    make: Mapping[str, float] = field(default_factory=dict)
    broken: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    since: Mapping[int, int] = field(default_factory=dict)
    poor: int = 5
    period_s: float = 5e-3
    samples: int = 1200
    dwell: int = 100
    heated_s: float = 0.0
    heated_samples: int = 3000

    def typical(self) -> dict[str, float]:
        """The medians of the make."""
        return {**TYPICAL, **EFFECTS, **self.make}

    def motor(self, number: int, seed: int) -> dict[str, float]:
        """A motor's own parameters, before it broke."""
        rng = np.random.default_rng([seed, number])
        return {
            key: value * float(np.exp(SPREAD.get(key, 0.0) * rng.standard_normal()))
            for key, value in self.typical().items()
        }

    def recorded(self, number: int, recording: int, seed: int) -> dict[str, Array]:
        """Columns of one recording."""
        rng = np.random.default_rng([seed, number, recording])
        motor = self.motor(number, seed)
        if recording >= self.since.get(number, 0):
            for key, change in self.broken.get(number, {}).items():
                motor[key] = motor[key] + change if key in EFFECTS else motor[key] * change
        for key, sd in WANDERS.items():
            motor[key] *= float(np.exp(sd * rng.standard_normal()))
        heated = self.heated_s and recording == self.recordings - 1
        period_s, n = (self.heated_s, self.heated_samples) if heated else (self.period_s, self.samples)
        levels = n // self.dwell + 1
        voltage = np.repeat(rng.uniform(-RATED["voltage"], RATED["voltage"], levels), self.dwell)[:n]
        load = np.repeat(rng.uniform(0.0, RATED["load_torque"], levels), self.dwell)[:n] * np.sign(voltage)
        states = simulated(motor, voltage, load, period_s)
        truth = {
            "voltage": voltage, "load_torque": load, "current": states[:, 0], "speed": states[:, 1],
            "temperature": AMBIENT_C + states[:, 2],
        }  # fmt: skip
        noise = POOR if self.poor and number % self.poor == self.poor - 1 else GOOD
        columns = {q: y + noise * RATED[q] * rng.standard_normal(n) for q, y in truth.items()}
        return {"time": np.arange(n) * period_s, **columns, "ambient": np.full(n, AMBIENT_C)}

    def write(self, folder: Path, seed: int) -> None:
        """All recordings, as FOLDER/motor_017/2025-03-07.csv."""
        for number in range(self.motors):
            place = folder / f"motor_{number:03d}"
            place.mkdir(parents=True, exist_ok=True)
            for recording in range(self.recordings):
                path = place / f"{FIRST + timedelta(days=EVERY_DAYS * recording)}.csv"
                if not path.exists():
                    write(self.recorded(number, recording, seed), path)


UNITS = {
    "time": "s",
    "voltage": "V",
    "load_torque": "Nm",
    "current": "A",
    "speed": "rad_s",
    "temperature": "C",
    "ambient": "C",
}


def write(columns: Mapping[str, Array], path: Path) -> None:
    heading = ",".join(f"{q}_{UNITS[q]}" for q in columns)
    np.savetxt(
        path, np.column_stack(list(columns.values())), fmt="%.7g", delimiter=",", header=heading, comments=""
    )


def simulated(motor: Mapping[str, float], voltage: Array, load: Array, period_s: float) -> Array:
    """(N, 3) current, speed and rise of the winding, from rest and cold; inputs hold between samples."""
    # Where nothing of the current's own course is seen between samples, steps need only be stable.
    share = 0.1 if period_s < 10 * motor["L"] / motor["R_a0"] else 0.5
    steps = max(1, int(np.ceil(period_s / (share * motor["L"] / motor["R_a0"]))))
    values = np.array([motor[key] for key in (*TYPICAL, *EFFECTS)])
    return np.asarray(_integrated(values, voltage, load, period_s, steps))


@njit(cache=True)
def _rates(p, x, v, load, out):  # type: ignore[no-untyped-def]
    R_a0, L, ke, J, b, alpha, k0, kT, k_ir, H, V_b, tau_c = p
    i, w, theta = x
    R = R_a0 * (1.0 + alpha * theta)
    out[0] = (v - R * i - ke * w - V_b * np.tanh(i / 0.1)) / L
    out[1] = (ke * i - b * w - load - tau_c * np.tanh(w / 0.5)) / J
    out[2] = (R * i * i + k_ir * w * w - k0 * (1.0 + kT * abs(w)) * theta) / H


@njit(cache=True)
def _integrated(p, voltage, load, period, steps):  # type: ignore[no-untyped-def]
    n = len(voltage)
    out, x, y = np.zeros((n, 3)), np.zeros(3), np.zeros(3)
    k1, k2, k3, k4 = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    h = period / steps
    for k in range(n - 1):
        for _ in range(steps):
            _rates(p, x, voltage[k], load[k], k1)
            for j in range(3):
                y[j] = x[j] + 0.5 * h * k1[j]
            _rates(p, y, voltage[k], load[k], k2)
            for j in range(3):
                y[j] = x[j] + 0.5 * h * k2[j]
            _rates(p, y, voltage[k], load[k], k3)
            for j in range(3):
                y[j] = x[j] + h * k3[j]
            _rates(p, y, voltage[k], load[k], k4)
            for j in range(3):
                x[j] += h / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j])
        out[k + 1] = x
    return out
