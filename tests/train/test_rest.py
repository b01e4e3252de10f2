"""A rotor at rest: what it takes is its resistance's alone, as far as a brake lets it creep; one that creeps or comes loose
slowly is not taken for it."""

import numpy as np
import pytest
from helpers.duty import MELLAH

from motorlens_train.evaluation.worlds.plant import Constants, run
from motorlens_train.observer import correction
from motorlens_train.observer.design import ObserverSettings, observer

pytestmark = pytest.mark.fit

SETTINGS = ObserverSettings(voltage_sd=0.48, current_sd=0.0509)
MOTOR = Constants()
PERIOD_S = 2e-3


@pytest.fixture(scope="module")
def watching():
    return observer(MELLAH, SETTINGS)


def seen_by(watching, voltage, current, seed=0):
    """What an observer says of a voltage and a current with noise, at 500 Hz."""
    rng, n = np.random.default_rng(seed), len(voltage)
    found, _ = watching.run(
        np.full(n, PERIOD_S), voltage + 0.48 * rng.standard_normal(n), current + 0.0509 * rng.standard_normal(n),
        np.full(n, 20.0),
    )  # fmt: skip
    return dict(zip(watching.outputs, found.T, strict=True))


def locked(watching, rise_K, volts=30.0, seconds=10.0):
    """A locked rotor under a slow ramp of the voltage: Ohm's law."""
    voltage = np.linspace(0.0, volts, int(seconds / PERIOD_S))
    return seen_by(watching, voltage, voltage / (MOTOR.R * (1 + MOTOR.alpha * rise_K)))


def loose(watching, rise_K, brake_Nm=2.3, volts_a_second=3.0, seconds=12.0):
    """A rotor that a slow ramp of the voltage tears loose from its brake: what is said of it, and its states."""
    n = int(seconds / PERIOD_S)
    time = np.arange(n) * PERIOD_S
    start = np.array([0.0, 0.0, rise_K])
    states, voltage = run(
        MOTOR,
        time,
        np.maximum(time - 1.0, 0.0) * volts_a_second,
        True,
        np.full(n, brake_Nm),
        np.zeros(n),
        start,
    )
    return seen_by(watching, voltage, states[:, 0], 3), states


@pytest.mark.parametrize("rise_K", [0.0, 35.0, 70.0])
def test_a_locked_rotor_shows_how_warm_it_is(watching, rise_K):
    seen = locked(watching, rise_K)
    # Nothing but the resistance: a tenth of an ohm is 7 K.
    assert abs(seen["temperature"][-1] - rise_K) < 6.0
    assert abs(seen["speed"][-1]) < 0.5
    assert seen["changing"][-1] > 0.7


def test_what_a_brake_lets_it_creep_by_is_a_resistance_and_the_interval_holds_it(watching):
    # In proportion to the current, as friction that turns round smoothly gives way: ke w / i more of resistance.
    n, warm, creep = 20_000, MOTOR.R * (1 + MOTOR.alpha * 40.0), 0.5
    current = np.linspace(0.0, 6.0, n)
    seen = seen_by(watching, warm * current + MOTOR.ke * creep * current / 6.0, current)
    passes_for = MOTOR.ke * creep / 6.0 / (MOTOR.R * MOTOR.alpha)
    error = seen["temperature"][-1] - 40.0
    assert 0.6 * passes_for < error < 1.2 * passes_for
    assert error < 1.96 * np.exp(0.5 * seen["log_temperature"][-1])


@pytest.mark.parametrize("speed", [-1.5, 0.7, 2.0])
def test_who_is_found_creeping_is_not_taken_for_resting(watching, speed):
    # At a steady current a speed passes for a resistance, and nobody can tell: the interval holds both.
    n, current = 10_000, 1.5
    voltage = np.full(n, MOTOR.R * (1 + MOTOR.alpha * 30.0) * current + MOTOR.ke * speed)
    seen = seen_by(watching, voltage, np.full(n, current))
    for name, true in (("temperature", 30.0), ("speed", speed)):
        assert abs(seen[name][-1] - true) < 1.96 * np.exp(0.5 * seen[f"log_{name}"][-1])


@pytest.mark.parametrize("rise_K", [0.0, 60.0])
def test_a_rotor_that_comes_loose_slowly_is_followed(watching, rise_K):
    seen, states = loose(watching, rise_K)
    turning = states[:, 1] > 5.0
    assert np.abs(seen["temperature"] - states[:, 2])[turning].max() < 30.0
    assert np.abs(seen["speed"] - states[:, 1])[turning].max() < 1.5
    assert seen["changing"][-1] < 0.05


def test_a_brake_that_is_taken_to_give_way_anyhow_makes_it_a_winding_that_warms(monkeypatch, watching):
    monkeypatch.setattr(correction, "HOLDS", 1.0)
    others = [loose(each, 0.0) for each in (watching, observer(MELLAH, SETTINGS))]
    about, anyhow = (np.abs(seen["temperature"] - states[:, 2]).max() for seen, states in others)
    assert anyhow > 1.5 * about


def test_a_load_that_jumps_at_rest_leaves_what_is_known_of_the_winding(watching):
    # Warm and known from a step; at rest; then thrown on at once by a load that drives.
    n = 20_000
    time = np.arange(n) * PERIOD_S
    voltage = np.where(time < 2.0, 0.0, np.where(time < 12.0, 120.0, np.where(time < 25.0, 0.0, 6.0)))
    torque = np.where(time < 25.0, 0.0, 2.5)
    states, _ = run(MOTOR, time, voltage, True, np.full(n, 2.0), torque, np.array([0.0, 0.0, 50.0]))
    seen = seen_by(watching, voltage, states[:, 0], 5)
    known = time > 5.0
    assert np.abs(seen["temperature"] - states[:, 2])[known].max() < 3.0
    assert np.exp(0.5 * seen["log_temperature"])[known].max() < 45.0
