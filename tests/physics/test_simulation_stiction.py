"""Real friction: a rotor that stops, rests and breaks away when mechanics by hand says so."""

from dataclasses import replace

import numpy as np
import pytest

from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.directional_friction import DirectionalFriction
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.motor import Motor
from motorlens_physics.simulation import Inputs, simulate

FRICTION = Motor(effects=(CoulombFriction(tau_c=0.4, w_s=0.5),))
# Hardly any current flows, so the rotor is alone with its friction.
COASTING = replace(FRICTION, R_a0=1e12, b=0.002)


def inputs(
    time: np.ndarray, volts: np.ndarray | float, load: np.ndarray | float = 0.0, *, held: bool = False
) -> Inputs:
    ones = np.ones_like(time)
    return Inputs(time, volts * ones, load * ones, 20.0 * ones, held)


def test_a_coasting_rotor_stops_when_mechanics_says_and_stays() -> None:
    # J dw/dt = -tau_c - b w from 100 rad/s.
    tau, b, inertia, w0 = 0.4, COASTING.b, COASTING.J, 100.0
    time = np.linspace(0.0, 12.0, 2401)
    run = simulate(COASTING, inputs(time, 0.0), {"w": w0}, tolerance=1e-9)
    stops = inertia / b * np.log(1 + b * w0 / tau)
    by_hand = np.where(time < stops, (w0 + tau / b) * np.exp(-b * time / inertia) - tau / b, 0.0)
    np.testing.assert_allclose(run.speed_rad_s, by_hand, atol=1e-6)
    assert (run.speed_rad_s[time > stops] == 0.0).all()
    assert (run.speed_rad_s[time < stops] > 0.0).all()


def test_a_resting_rotor_breaks_away_when_the_torque_exceeds_stiction() -> None:
    # Without inductance the torque of a ramp of 2 V/s is ke v / R.
    motor = replace(FRICTION, L=0.0)
    time = np.linspace(0.0, 2.0, 2001)
    run = simulate(motor, inputs(time, 2.0 * time), tolerance=1e-9)
    breaks = 0.4 * motor.R_a0 / motor.ke / 2.0
    assert (run.speed_rad_s[time <= breaks] == 0.0).all()
    assert (run.speed_rad_s[time > breaks + 1e-3] > 0.0).all()
    # Just after: J dw/dt = ke 2 (t - t0) / R, while there is hardly any back-EMF.
    soon = (time > breaks) & (time < breaks + 0.02)
    by_hand = motor.ke * (time[soon] - breaks) ** 2 / motor.R_a0 / motor.J
    np.testing.assert_allclose(run.speed_rad_s[soon], by_hand, rtol=0.15, atol=1e-6)


@pytest.mark.parametrize("side", [1, -1])
def test_friction_that_differs_with_the_direction_holds_as_it_brakes(side: int) -> None:
    # 0.4 N m either way and 0.3 N m more forwards: it breaks away at 0.7 N m forwards, at 0.4 N m backwards.
    motor = replace(FRICTION, L=0.0, effects=(*FRICTION.effects, DirectionalFriction(tau_d=0.3)))
    time = np.linspace(0.0, 4.0, 4001)
    run = simulate(motor, inputs(time, side * 2.0 * time), tolerance=1e-9)
    breaks = (0.7 if side > 0 else 0.4) * motor.R_a0 / motor.ke / 2.0
    assert (run.speed_rad_s[time <= breaks] == 0.0).all()
    assert (side * run.speed_rad_s[time > breaks + 1e-3] > 0.0).all()


def test_a_resting_rotor_does_not_drift() -> None:
    time = np.linspace(0.0, 600.0, 60001)
    amplitude = 0.99 * 0.4 * FRICTION.R_a0 / FRICTION.ke
    run = simulate(FRICTION, inputs(time, amplitude * np.sin(3 * time)))
    assert (run.speed_rad_s == 0.0).all()
    # The smooth form creeps.
    creeping = simulate(FRICTION, inputs(time, amplitude * np.sin(3 * time)), smooth=True)
    assert np.abs(creeping.speed_rad_s).max() > 1e-3


@pytest.mark.parametrize("motor", [Motor(), FRICTION], ids=["frictionless", "friction"])
@pytest.mark.parametrize("load", [6.0, -6.0])
def test_a_load_never_drives_a_resting_rotor(motor: Motor, load: float) -> None:
    time = np.linspace(0.0, 1.0, 101)
    assert (simulate(motor, inputs(time, 0.0, load)).speed_rad_s == 0.0).all()
    # Nor does it when the motor pushes a little, either way.
    assert (simulate(motor, inputs(time, 5.0 * np.sin(9 * time), load)).speed_rad_s == 0.0).all()
    # Once the motor overcomes it, it goes, and where the motor wants.
    assert simulate(motor, inputs(time, 60.0, load)).speed_rad_s[-1] > 0.0
    assert simulate(motor, inputs(time, -60.0, load)).speed_rad_s[-1] < 0.0


def test_a_start_against_a_load_waits_for_the_current() -> None:
    # With a locked rotor i = V/R (1 - exp(-R t/L)); it turns when ke i exceeds the load.
    motor, load = Motor(alpha=0.0), 6.455
    turns = -motor.L / motor.R_a0 * np.log(1 - load / motor.ke * motor.R_a0 / 240.0)
    time = np.linspace(0.0, 0.01, 10001)
    run = simulate(motor, inputs(time, 240.0, load, held=True), tolerance=1e-9)
    assert run.speed_rad_s.min() == 0.0
    first = time[np.argmax(run.speed_rad_s > 0)]
    assert turns < first <= turns + 2e-6


def test_forwards_and_backwards_are_mirror_images() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(3000) * 1e-3
    volts = np.repeat(rng.uniform(-30.0, 30.0, 30), 100)
    motor = Motor(effects=(CoulombFriction(tau_c=0.4), StribeckFriction(tau_s=0.3)))
    there = simulate(motor, inputs(time, volts, held=True))
    back = simulate(motor, inputs(time, -volts, held=True))
    np.testing.assert_array_equal(there.speed_rad_s, -back.speed_rad_s)
    np.testing.assert_array_equal(there.current_A, -back.current_A)
    assert (there.speed_rad_s == 0).any() and (there.speed_rad_s > 0).any() and (there.speed_rad_s < 0).any()


def test_the_smooth_form_approaches_real_friction_as_it_narrows() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    volts = 60.0 * np.sin(15.0 * time)
    real = simulate(FRICTION, inputs(time, volts), tolerance=1e-8).speed_rad_s
    distance = []
    for width in (1.0, 0.1, 0.01):
        narrow = Motor(effects=(CoulombFriction(tau_c=0.4, w_s=width),))
        smooth = simulate(narrow, inputs(time, volts), tolerance=1e-8, smooth=True)
        distance.append(np.abs(smooth.speed_rad_s - real).max())
    assert distance[0] > 2 * distance[1] > 8 * distance[2]
    # Real friction does not depend on the width.
    wide = Motor(effects=(CoulombFriction(tau_c=0.4, w_s=2.0),))
    np.testing.assert_allclose(
        simulate(wide, inputs(time, volts), tolerance=1e-8).speed_rad_s, real, atol=1e-5
    )


def test_a_torque_that_turns_within_a_sample_turns_the_rotor() -> None:
    # At first the load of a light push backwards, then the voltage: the rotor must not sleep through the sample.
    motor = Motor(effects=())
    time = np.array([0.0, 0.5, 1.0])
    pushed = simulate(motor, Inputs(time, np.array([-1e-3, 240.0, 240.0]), 0 * time, 20 + 0 * time))
    fine = np.linspace(0.0, 1.0, 10001)
    truth = simulate(
        motor, Inputs(fine, np.interp(fine, time, [-1e-3, 240.0, 240.0]), 0 * fine, 20 + 0 * fine)
    )
    assert pushed.speed_rad_s[1] == pytest.approx(truth.speed_rad_s[5000], rel=1e-5)
