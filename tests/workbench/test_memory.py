"""Terms with a memory: the resonators against scipy, and a sprung flywheel that no curve of speed can show."""

from pathlib import Path

import numpy as np
import pytest
from helpers.nameless import nameless
from scipy.linalg import expm
from scipy.signal import lsim

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_workbench.contest.contest import contest
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.hypotheses.memory import DAMPING, Memory, resonances

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
PERIOD_S = 0.002


@pytest.mark.fit
def test_resonators_answer_as_scipy_does_also_to_uneven_samples():
    """x'' + 2 d W x' + W^2 x = y'', integrated by scipy on a grid twenty times finer."""
    rng = np.random.default_rng(0)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5e-3, 1.5e-3, 2000))])
    y = np.sin(30 * time) + 3.0
    found = resonances(y, time, np.array([3.0, 10.0]))
    fine = np.linspace(0, time[-1], 40_001)
    for k, hertz in enumerate((3.0, 10.0)):
        omega = 2 * np.pi * hertz
        below = [1, 2 * DAMPING * omega, omega**2]
        for j, above in enumerate(([1, 0, 0], [omega, 0])):
            _, expected, _ = lsim((above, below), np.interp(fine, time, y) - y[0], fine)
            assert np.abs(np.interp(time, fine, expected) - found[:, 2 * k + j]).max() < 2e-5


@pytest.mark.fit
def test_the_amplitude_is_that_of_the_response_of_the_resonators():
    """A sine at one of the frequencies through fitted resonators swings as far as is said, and 0 coefficients say 0."""
    term = Memory("torque", np.array([2.0, 4.0, 8.0]))
    coefficient = np.array([0.3, -0.2, 0.1, 0.4, -0.5, 0.2])
    _, size, sd = term.values(coefficient, 1e-4 * np.eye(6))
    time = np.arange(20_000) * 1e-3
    for hertz, expected in zip(term.frequencies_Hz, size, strict=True):
        swing = resonances(np.sin(2 * np.pi * hertz * time), time, term.frequencies_Hz) @ coefficient
        assert np.abs(swing[10_000:]).max() == pytest.approx(expected, rel=1e-3)
    assert np.all((sd > 1e-3) & (sd < 3e-2))


@pytest.mark.fit
@pytest.mark.parametrize("twisting", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_flywheel_on_a_spring_shows_as_a_torque_with_a_memory(twisting):
    """Half of the inertia behind a soft shaft that resonates at 40 Hz; on a stiff shaft nothing of the kind is found."""
    file, recording = with_flywheel(twisting)
    if not twisting:
        outcome = contest(fitted_of(estimate(file, prepare_all([recording], file))))
        assert outcome.unnamed is None and not outcome.accepted
        return
    term = nameless(file, recording)
    assert term is not None
    assert isinstance(term.entry.shape, Memory) and term.entry.shape.balance == "torque"
    hertz, size, _ = term.entry.shape.values(term.coefficient, term.covariance)
    assert 20.0 < hertz[np.argmax(size)] < 80.0


def with_flywheel(twisting):
    """A motor file, and 20 s at 500 Hz of that motor, part of whose inertia sits behind a spring if it is twisting.

    Random steps of the voltage, exact from sample to sample (scipy's matrix exponential); noise of 0.2 % of rated on speed
    and current. The winding is so heavy that it stays cold.
    """
    file = read_motor_file(MOTOR)
    motor, rated = file.motor, file.rated
    near = motor.J / 2
    spring = (2 * np.pi * 40.0) ** 2 * near / 2
    damper = 0.1 * np.sqrt(spring * near / 2)
    electrical = [-motor.R_a0 / motor.L, -motor.ke / motor.L]
    # States: current, speed, twist of the shaft, speed of the far end; the voltage behind them.
    rates = np.zeros((5, 5))
    rates[0, [0, 1, 4]] = [*electrical, 1 / motor.L]
    if twisting:
        rates[1, :4] = np.array([motor.ke, -motor.b - damper, -spring, damper]) / near
        rates[2, [1, 3]] = [1, -1]
        rates[3, 1:4] = np.array([damper, spring, -damper]) / near
    else:
        rates[1, :2] = np.array([motor.ke, -motor.b]) / motor.J
    onward = expm(rates * PERIOD_S)
    rng = np.random.default_rng(3)
    voltage = np.repeat(rng.uniform(0.2, 1.0, 40), 250) * rated.voltage_V
    states = np.zeros((len(voltage), 5))
    for k in range(len(voltage) - 1):
        states[k, 4] = voltage[k]
        states[k + 1] = onward @ states[k]
    noise = 0.002 * rng.standard_normal((2, len(voltage)))
    channels = {
        "voltage": voltage, "load_torque": np.zeros(len(voltage)),
        "current": states[:, 0] + rated.current_A * noise[0], "speed": states[:, 1] + rated.speed_rad_s * noise[1],
    }  # fmt: skip
    return file, Recording("flywheel", np.arange(len(voltage)) * PERIOD_S, channels)
