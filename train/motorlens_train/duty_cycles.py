"""Duty cycles for training: a motor through random voltage, load, ambient and start temperature, hot restarts
included.

What the sensor sees is voltage and current with Gaussian noise, white or coloured; the targets are true. Cycles start from
ambient temperature; standstills inside a cycle give hot restarts whose history the sensor has seen. A motor
that starts warm, or runs already when the sensor is switched on, is a case of its own (`unknown_history`):
filters of voltage and current alone cannot know what heated it, and a network trained on a mixture would be
wrong about both.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import Phase, Plan, Scenario, grid, perform, steps, time_constants
from motorlens_physics.simulation import Inputs
from motorlens_train.specification import Array

# The noise of a supply, times what is usual.
LEAST, MOST = 0.05, 10.0


@dataclass(frozen=True)
class Noise:
    """Standard deviation of each sample's Gaussian noise, and the time constant of the first-order lag that has coloured
    it; 0: white."""

    voltage_V: float
    current_A: float
    lag_s: float = 0.0

    def of_any_kind(self, rng: np.random.Generator, least: float = LEAST) -> "Noise":
        """From a clean supply to a bad one: times `least` to MOST, evenly in the logarithm, the current's up to twice apart;
        half of them coloured, as by filters before a converter, with 1 to 10 ms."""
        size, apart, lag = np.exp(rng.uniform(np.log([least, 0.5, 1e-3]), np.log([MOST, 2.0, 1e-2])))
        coloured = rng.random() < 0.5
        return Noise(
            float(self.voltage_V * size),
            float(self.current_A * size * apart),
            float(lag) if coloured else 0.0,
        )

    def drawn(self, count: int, period_s: float, rng: np.random.Generator) -> Array:
        """(count,) with deviation 1: an autoregression of first order, stationary from its first sample."""
        white = rng.standard_normal(count)
        if self.lag_s <= 0.0:
            return white
        keep = float(np.exp(-period_s / self.lag_s))
        white[1:] *= np.sqrt(1.0 - keep * keep)
        return np.asarray(lfilter([1.0], [1.0, -keep], white))


@dataclass(frozen=True)
class TrainingDuty(Scenario):
    """Random steps of voltage and load; dwells from a few mechanical time constants to a fifth of the
    recording.

    One dwell in eight is a standstill with the terminals shorted, so every longer cycle holds hot restarts. A
    cycle in five holds its voltage, one in five its load. `warm`: whether it starts at a random temperature.
    """

    warm: bool = False

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        """What to do to this motor."""
        pace, plate = time_constants(file.motor), file.rated
        time = grid(self.duration_s, self.period_s)
        shortest = 5 * pace.mechanical_s
        at = _instants(self.duration_s, shortest, rng)
        levels = plate.voltage_V * rng.uniform(0.15, 1.05, len(at))
        if rng.random() < 0.2:
            levels[:] = levels[-1]
        levels[1:][rng.random(len(at) - 1) < 0.125] = 0.0
        load_at = _instants(self.duration_s, shortest, rng)
        loads = plate.torque_Nm * rng.uniform(0.0, 1.2, len(load_at))
        if rng.random() < 0.2:
            loads[:] = loads[0]
        ambient = rng.uniform(0.0, 40.0)
        warm = rng.uniform(0.0, 1.2 * plate.rise_K) if self.warm else 0.0
        inputs = Inputs(
            time, steps(time, at, levels), steps(time, load_at, loads), np.full_like(time, ambient), held=True
        )
        return Plan((Phase(inputs),), {"theta": warm})


def duty_cycle(
    file: MotorFile,
    noise: Noise,
    rate_Hz: float,
    longest_s: float,
    rng: np.random.Generator,
    unknown_history: bool = False,
) -> Recording:
    """One cycle of random length (to `longest_s`, spread evenly in its logarithm), true but for noisy voltage
    and current.

    Long cycles are sampled more slowly than `rate_Hz`, to at most a million rows and down to a quarter of the
    rate. With `unknown_history` the motor starts at a random temperature, and in one case of two is running
    when the recording begins.
    """
    pace = time_constants(file.motor)
    duration = float(np.exp(rng.uniform(np.log(1000 * pace.mechanical_s), np.log(longest_s))))
    rate = float(np.clip(1e6 / duration, rate_Hz / 4, rate_Hz))
    truth = perform(file, TrainingDuty(duration, 1 / rate, unknown_history), rng)
    if unknown_history and rng.random() < 0.5:
        truth = truth.part(slice(int(rng.uniform(0.1, 0.6) * len(truth)), None))
        truth = replace(truth, time_s=truth.time_s - truth.time_s[0])
    return with_noise(truth, noise, rng)


def with_noise(truth: Recording, noise: Noise, rng: np.random.Generator) -> Recording:
    """Add noise to voltage and current."""
    channels = dict(truth.channels)
    for channel, deviation in (("voltage", noise.voltage_V), ("current", noise.current_A)):
        channels[channel] = channels[channel] + deviation * noise.drawn(len(truth), truth.period_s, rng)
    return replace(truth, channels=channels)


def instants(recording: Recording, count: int, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """Which rows of a cycle to train on: half spread evenly at random, half close behind the start and
    voltage steps.

    Returns:
        At most `count` ascending row numbers.
    """
    rows = len(recording)
    voltage = recording.channels["voltage"]
    jumps = np.flatnonzero(np.abs(np.diff(voltage)) > 12 * noise.voltage_V + 1e-9) + 1
    starts = np.concatenate([[0], jumps])
    behind = (
        np.exp(rng.uniform(0, np.log(max(2.0, min(rows, 5.0 / recording.period_s))), count // 2)).astype(
            np.int64
        )
        - 1
    )
    near = rng.choice(starts, count // 2) + behind
    return np.unique(np.concatenate([rng.integers(0, rows, count - count // 2), near[near < rows]]))


def _instants(duration_s: float, shortest_s: float, rng: np.random.Generator) -> Array:
    longest = max(duration_s / 5, 2 * shortest_s)
    dwell = np.exp(rng.uniform(np.log(shortest_s), np.log(longest), int(2 + 4 * duration_s / shortest_s)))
    at = np.concatenate([[0.0], np.cumsum(dwell)])
    return np.asarray(at[at < duration_s], dtype=np.float64)
