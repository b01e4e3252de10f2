"""Hum is found, of the size and frequency that were added, and taken out; what a drive of its frequency stirs up is none."""

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.notes import notes_of
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"], ambient_C=AMBIENT_C,
)  # fmt: skip
SAMPLES, NOISE = 6000, 0.002
TRUTH = TYPICAL | {"R_a0": 1.1 * TYPICAL["R_a0"], "J": 0.9 * TYPICAL["J"]}


def driven(voltage: np.ndarray, period_s: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    test = plain_motor.Test(period_s, SAMPLES, 1, True, NOISE)
    states = plain_motor.simulated(TRUTH, voltage, np.zeros(SAMPLES), test)
    shown = {"voltage": voltage, "current": states[:, 0], "speed": states[:, 1]}
    return {q: y + NOISE * RATED[q] * rng.standard_normal(SAMPLES) for q, y in shown.items()}


def fitted(channels: dict[str, np.ndarray], period_s: float, **wrong: float) -> Estimate:
    file = MotorFile("plate", Motor(**(TYPICAL | wrong)), PLATE)
    runs = prepare_all([Recording("hum.csv", np.arange(SAMPLES) * period_s, channels)], file)
    prior = base_prior(file, runs)
    return estimate(file, runs, prior.only([key for key in prior.keys if key not in wrong]))


@pytest.mark.fit
@pytest.mark.parametrize(
    ("rate_Hz", "lines"),
    [
        (500.0, {("current", 50.03): 0.01, ("speed", 119.9): 0.01}),
        pytest.param(200.0, {("current", 149.95): 0.01}, marks=pytest.mark.long),  # folded to 50 Hz
        (40.0, {("speed", 50.02): 0.01}),  # folded to 10 Hz
        (500.0, {}),
    ],
)  # fmt: skip
def test_hum_is_found_and_taken_out(rate_Hz: float, lines: dict[tuple[str, float], float]) -> None:
    rng, time = np.random.default_rng(7), np.arange(SAMPLES) / rate_Hz
    voltage = np.repeat(rng.uniform(-RATED["voltage"], RATED["voltage"], SAMPLES // 100), 100)
    channels = driven(voltage, 1 / rate_Hz, rng)
    clean = {q: y.copy() for q, y in channels.items()}
    for (name, frequency), share in lines.items():
        channels[name] += share * RATED[name] * np.sin(2 * np.pi * frequency * time + 1.0)

    (run,) = fitted(channels, 1 / rate_Hz).runs

    assert len(run.hum) == len(lines)
    for (name, frequency), share in lines.items():
        ((found, amplitude),) = [(f, a) for (c, f), a in run.hum.items() if c == name]
        # As sampled: a line and the one that it is folded to are one.
        apart = abs(found - frequency) % rate_Hz
        folded = abs(found + frequency) % rate_Hz
        assert min(apart, rate_Hz - apart, folded, rate_Hz - folded) < 0.15
        assert amplitude == pytest.approx(share * RATED[name], rel=0.05)
        left = run.measured[:, run.channels.index(name)] - clean[name]
        assert np.std(left) < 0.2 * NOISE * RATED[name]
        assert any(f"Hz out of the {name}" in note for note in notes_of([run]))


@pytest.mark.long
@pytest.mark.fit
def test_what_the_drive_stirs_up_at_the_frequency_of_the_mains_is_no_hum() -> None:
    """A square wave of 16.7 Hz has lines at 50 and 150 Hz, and so has what half the inductance leaves."""
    rate_Hz, rng = 500.0, np.random.default_rng(8)
    time = np.arange(SAMPLES) / rate_Hz
    voltage = 0.3 * RATED["voltage"] * np.sign(np.sin(2 * np.pi * 50 / 3 * (time + 1e-4)))
    channels = driven(voltage, 1 / rate_Hz, rng)
    found = fitted(channels, 1 / rate_Hz, L=0.5 * TYPICAL["L"])
    error = found.fit.residuals[0][:, 0]
    power = np.abs(np.fft.rfft(error)) ** 2 / np.sum(error**2)
    assert power[round(50 / rate_Hz * SAMPLES)] > 20.0
    assert not found.runs[0].hum
