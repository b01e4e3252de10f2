"""Scenarios: the published figures of the paper's run, and closed forms of the standard tests."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.commands.paper import figures_of_merit
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.parameter import Rated
from motorlens_physics.scenario import measure, parse_noise, perform, scenarios
from motorlens_physics.scenarios.coast_down import CoastDown
from motorlens_physics.scenarios.direct_on_line import DirectOnLine
from motorlens_physics.scenarios.duty import Duty
from motorlens_physics.scenarios.load_steps import LoadSteps
from motorlens_physics.scenarios.locked_rotor import LockedRotor
from motorlens_physics.scenarios.no_load_steps import NoLoadSteps
from motorlens_runtime.errors import DataError

PAPER = read_motor_file(Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml")


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_the_papers_run() -> None:
    # Mellah et al. 2016, section III: 60 A, 7.27 A, +31 % (77.5 K at 0.004 1/K), 221 rad/s.
    found = figures_of_merit(perform(PAPER, DirectOnLine(8400.0), rng()))
    assert found["inrush_A"] == pytest.approx(60.0, abs=0.1)
    assert found["steady_current_A"] == pytest.approx(7.27, abs=0.01)
    assert found["rise_K"] == pytest.approx(77.5, abs=0.1)
    assert found["resistance_growth_percent"] == pytest.approx(31.0, abs=0.1)
    assert found["speed_rad_s"] == pytest.approx(221.0, abs=0.3)


def test_a_locked_rotor_shows_resistance_alone() -> None:
    recording = perform(PAPER, LockedRotor(), rng())
    voltage, current = recording.channels["voltage"], recording.channels["current"]
    # Ten dwells of 6 s, over 600 L/R each: at the end of each the current is v / R, and R has hardly warmed.
    ends = np.searchsorted(recording.time_s, 6.0 * np.arange(1, 10)) - 2
    np.testing.assert_allclose(
        current[ends] * recording.channels["resistance"][ends], voltage[ends], atol=1e-5
    )
    assert np.all(recording.channels["speed"] == 0)
    np.testing.assert_allclose(recording.channels["load_torque"], PAPER.motor.ke * current)


def test_a_coast_down_is_friction_alone() -> None:
    motor = PAPER.motor
    recording = perform(PAPER, CoastDown(20.0), rng())
    free = recording.time_s > recording.time_s[-1] - 20.0 + 1e-9
    time, speed = recording.time_s[free], recording.channels["speed"][free]
    # With viscous friction only, J dw/dt = -b w: w decays with J/b.
    np.testing.assert_allclose(speed, speed[0] * np.exp(-(time - time[0]) * motor.b / motor.J), rtol=1e-4)
    np.testing.assert_allclose(recording.channels["voltage"][free], motor.ke * speed, rtol=1e-6)
    assert np.all(recording.channels["current"][free] == 0)


def test_coulomb_friction_stops_a_coast_down_in_finite_time_and_for_good() -> None:
    motor = replace(PAPER.motor, b=0.0).with_effect(CoulombFriction(tau_c=0.5, w_s=0.1))
    recording = perform(replace(PAPER, motor=motor), CoastDown(40.0), rng())
    free = recording.time_s > recording.time_s[-1] - 40.0 + 1e-9
    time, speed = recording.time_s[free], recording.channels["speed"][free]
    # J dw/dt = -tau_c: a straight line, at rest after J w0 / tau_c.
    stop = motor.J * speed[0] / 0.5
    line = np.maximum(speed[0] * (1 - (time - time[0]) / stop), 0)
    np.testing.assert_allclose(speed, line, atol=0.002 * speed[0])
    assert np.all(speed[time > time[0] + 1.01 * stop] == 0)


def test_no_load_current_is_viscous_friction() -> None:
    recording = perform(PAPER, NoLoadSteps(160.0, 0.01), rng())
    # Sixteen dwells of 10 s: ke i = b w at the end of each.
    ends = np.searchsorted(recording.time_s, 10.0 * np.arange(1, 16)) - 2
    current, speed = recording.channels["current"][ends], recording.channels["speed"][ends]
    np.testing.assert_allclose(PAPER.motor.ke * current, PAPER.motor.b * speed, atol=1e-4)
    assert speed.max() > 200 > -200 > speed.min()


def test_load_steps_balance() -> None:
    recording = perform(PAPER, LoadSteps(280.0, 0.01), rng())
    ends = np.searchsorted(recording.time_s, 10.0 * np.arange(1, 28)) - 2
    c = {q: y[ends] for q, y in recording.channels.items()}
    turning = c["speed"] != 0
    torque = PAPER.motor.ke * c["current"] - PAPER.motor.b * c["speed"] - c["load_torque"]
    np.testing.assert_allclose(torque[turning], 0, atol=1e-3)
    volts = c["voltage"] - c["resistance"] * c["current"] - PAPER.motor.ke * c["speed"]
    np.testing.assert_allclose(volts, 0, atol=1e-3)


def test_duty_cycles_differ_by_seed_only() -> None:
    one, same, other = (perform(PAPER, Duty(60.0), rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.channels["current"], same.channels["current"])
    assert not np.array_equal(one.channels["voltage"], other.channels["voltage"])
    assert np.all(one.channels["speed"] >= 0)
    both_ways = perform(PAPER, Duty(60.0, reversing=True), rng(1)).channels["speed"]
    assert both_ways.min() < -20 < 20 < both_ways.max()


@pytest.mark.parametrize("name", sorted(scenarios()))
def test_every_scenario_runs_on_a_small_motor(name: str) -> None:
    # A 12 V gear motor of some 6 W: time constants a hundred times shorter than the paper's.
    small = {
        "R_a0": 2.5,
        "L": 1e-3,
        "ke": 0.02,
        "J": 2e-6,
        "b": 1e-6,
        "k0": 0.1,
        "kT": 1e-4,
        "k_ir": 1e-7,
        "H": 20.0,
    }
    file = MotorFile("small", PAPER.motor, Rated(12.0, 0.5, 500.0, 0.01)).with_values(small)
    recording = perform(file, scenarios()[name](duration_s=2.0), rng())
    assert len(recording) > 100
    assert all(np.isfinite(y).all() for y in recording.channels.values())
    assert np.all(np.diff(recording.time_s) > 0)
    assert np.abs(recording.channels["speed"]).max() < 12.0 / 0.02 * 1.1


def test_measured_noise_has_the_size_asked_for() -> None:
    truth = perform(PAPER, Duty(30.0, 0.001), rng())
    noise = parse_noise(["current=0.05", "speed=1%"], PAPER.rated)
    shown = measure(truth, (), noise, rng(5))
    assert np.std(shown.channels["current"] - truth.channels["current"]) == pytest.approx(0.05, rel=0.03)
    assert np.std(shown.channels["speed"] - truth.channels["speed"]) == pytest.approx(2.21, rel=0.03)
    np.testing.assert_array_equal(shown.channels["voltage"], truth.channels["voltage"])


def test_noise_is_refused_in_words() -> None:
    assert set(parse_noise(["0.5%"], PAPER.rated)) == {
        "voltage",
        "current",
        "speed",
        "temperature",
        "load_torque",
    }
    for argument, said in (
        ("0.5", "say of which channel"),
        ("wind=1", "unknown channel"),
        ("current=x", "write current=0.05"),
    ):
        with pytest.raises(DataError, match=said):
            parse_noise([argument], PAPER.rated)
