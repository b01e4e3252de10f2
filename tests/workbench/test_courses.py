"""What a parameter adds to the balances, against the balances written out by hand; travel against geometry."""

from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.hypotheses.courses import Course, courses, of_parameter, travel

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.fixture(scope="module")
def trajectory():
    file = read_motor_file(MOTOR)
    coulomb = catalogue()["coulomb_friction"].typical(file.rated)
    time = np.arange(3000) * 0.002
    voltage = 100 * np.sin(2 * np.pi * time / 3)
    inputs = Inputs(time, voltage, np.full(3000, 0.5), np.full(3000, 20.0))
    return simulate(file.motor.with_effect(coulomb), inputs, {"theta": 30.0}, smooth=True)


@pytest.mark.fit
def test_a_unit_of_each_parameter_adds_what_the_textbook_says(trajectory):
    motor, i, w, theta = trajectory.motor, trajectory.current_A, trajectory.speed_rad_s, trajectory.rise_K
    warm = 1 + motor.alpha * theta
    for parameter, voltage, torque, heat in (
        ("R_a0", -warm * i, 0 * i, warm * i**2),
        ("ke", -w, i, 0 * i),
        ("b", 0 * i, -w, 0 * i),
        ("k_ir", 0 * i, 0 * i, w**2),
        ("k0", 0 * i, 0 * i, -(1 + motor.kT * np.abs(w)) * theta),
    ):
        added = of_parameter(trajectory, parameter)
        assert added.voltage == pytest.approx(voltage, rel=1e-5, abs=1e-6), parameter
        assert added.torque == pytest.approx(torque, rel=1e-5, abs=1e-6), parameter
        assert added.heat == pytest.approx(heat, rel=1e-5, abs=1e-4), parameter


def test_stores_add_what_their_content_changes_by(trajectory):
    """L di/dt, J dw/dt, H dtheta/dt: derivatives of the simulated states themselves."""
    time = trajectory.inputs.time_s
    inside = slice(20, -20)
    for parameter, state, balance in (("L", "i", "voltage"), ("J", "w", "torque"), ("H", "theta", "heat")):
        slope = np.gradient(trajectory.states[state], time)[inside]
        added = getattr(of_parameter(trajectory, parameter), balance)[inside]
        scale = np.abs(slope).max()
        assert np.sqrt(np.mean((added + slope) ** 2)) < 0.02 * scale
        assert np.corrcoef(added, -slope)[0, 1] > 0.999


def test_an_effect_counts_with_its_size(trajectory):
    added = of_parameter(trajectory, "coulomb_friction.tau_c")
    fast = np.abs(trajectory.speed_rad_s) > 20
    assert added.torque[fast] == pytest.approx(-np.sign(trajectory.speed_rad_s[fast]), abs=1e-3)
    assert not added.voltage.any()


def test_the_hats_of_a_course_add_up_to_its_parameter(trajectory):
    whole = of_parameter(trajectory, "R_a0")
    parts = Course("R_a0", "electrical", "ohm", "speed", np.array([0.0, 20.0, 60.0])).forcing(trajectory)
    assert parts.voltage.shape == (3000, 3)
    assert parts.voltage.sum(axis=1) == pytest.approx(whole.voltage)
    assert parts.heat.sum(axis=1) == pytest.approx(whole.heat)


def test_travel_is_the_angle_since_the_last_reversal():
    time = np.arange(4001) * 1e-3
    speed = 10 * np.cos(2 * np.pi * time / 2)
    since = travel(speed, time)
    # From rest at 0.5 s to rest at 1.5 s: the area of half a wave, 2 * 10 / pi rad.
    assert since[1490] == pytest.approx(20 / np.pi, rel=0.01)
    assert since.max() == pytest.approx(20 / np.pi, rel=0.01)
    assert since[1000] == pytest.approx(10 / np.pi, rel=0.02)
    assert travel(np.full(5, 2.0), np.arange(5.0)).tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]


def test_samples_too_far_apart_tell_no_travel():
    time = np.arange(2000.0)
    speed = 200 * np.cos(2 * np.pi * time / 400)
    assert (travel(speed, time) == 20.0).all()
    assert travel(speed / 100, time).min() == 0.0


def test_heat_is_left_out_where_the_temperature_is_not_measured(trajectory):
    file = read_motor_file(MOTOR)
    named = {
        one.shapes[0].parameter for one in courses(file, [trajectory], ("current", "speed"), loaded=True)
    }
    assert {"R_a0", "L", "ke", "J", "b"} == named
    named |= {
        one.shapes[0].parameter
        for one in courses(file, [trajectory], ("current", "temperature"), loaded=True)
    }
    assert {"k0", "k_ir", "H"} <= named
