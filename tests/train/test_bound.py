"""The bound against closed forms, an independent solver, and published figures of what voltage and current can show."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.duty import MELLAH, NOISE
from scipy.linalg import expm, solve_discrete_are

from motorlens_physics.motor import Motor
from motorlens_physics.recording import Recording
from motorlens_physics.scenario import chosen_scenario, measure, perform
from motorlens_physics.simulation import Inputs, simulate
from motorlens_train.bound import Bound, Noise, Prior, bound, bound_of_recording, riccati, transition
from motorlens_train.evaluation.scores import counted, plate_prior

pytestmark = pytest.mark.fit

MOTOR = Motor()
# The table was calculated at 2 kHz with 0.5 V and 0.05 A a sample; at 100 Hz the same information needs less noise.
PERIOD_S = 0.01
SAME = float(np.sqrt(5e-4 / PERIOD_S))
UNKNOWN = {"w": 50.0, "theta": 40.0, "i": 1.0, "load": 10.0}


def test_transition_is_the_matrix_exponential():
    rng = np.random.default_rng(0)
    for scale in (0.01, 1.0, 40.0):
        A = scale * rng.standard_normal((4, 4))
        np.testing.assert_allclose(
            transition(A, 0.3), expm(0.3 * A), rtol=1e-9, atol=1e-9 * np.abs(expm(0.3 * A)).max()
        )


def test_a_constant_in_white_noise_is_known_to_sigma_over_root_n():
    n, sd, prior = 500, 0.3, 2.0
    P = riccati(
        np.arange(n) * 0.1, np.zeros((n, 2, 2)), np.diag([prior**2, 0.0]), np.zeros(2), np.zeros(n), 1, np.zeros(2), sd**2,
        np.zeros(n, dtype=bool), 1,
    )  # fmt: skip
    closed = 1 / np.sqrt(1 / prior**2 + np.arange(1, n + 1) / sd**2)
    np.testing.assert_allclose(np.sqrt(P[:, 0, 0]), closed, rtol=1e-10)


def test_a_linear_motor_settles_at_the_riccati_equation_of_another_solver():
    # With the temperature known the motor is linear; scipy solves the stationary equation by a different route.
    noise = Noise(voltage_V=0.5, current_A=0.05, load_walk=0.4)
    n, dt = 4000, 0.002
    motor = replace(MOTOR, alpha=1e-12)
    time = np.arange(n) * dt
    states = {"i": np.full(n, 7.0), "w": np.full(n, 220.0), "theta": np.zeros(n), "load": np.full(n, 6.4)}
    found = bound(
        motor, time, states, np.full(n, 240.0), np.full(n, 20.0), noise, Prior(UNKNOWN | {"theta": 0.0})
    )
    A = np.array(
        [
            [-motor.R_a0 / motor.L, -motor.ke / motor.L, 0],
            [motor.ke / motor.J, -motor.b / motor.J, -1 / motor.J],
            [0, 0, 0],
        ]
    )
    F, g = expm(A * dt), expm(A * dt / 2)[:, 0] * noise.voltage_V * dt / motor.L
    walk = noise.load_walk**2 * dt
    Q = np.outer(g, g) + 0.5 * walk * np.outer(F[:, 2], F[:, 2])
    Q[2, 2] += 0.5 * walk
    H = np.array([[1.0, 0.0, 0.0]])
    before = solve_discrete_are(F.T, H.T, Q, [[noise.current_A**2]])
    after = before - np.outer(before[:, 0], before[0]) / (before[0, 0] + noise.current_A**2)
    sds = [found.sd(name)[-1] for name in ("i", "w", "load")]
    np.testing.assert_allclose(sds, np.sqrt(np.diag(after)), rtol=1e-6)


def _running(case: str, duration_s: float) -> Bound:
    """Cases 1 to 8 of the table: rated voltage, from the steady state at a rise of 40 K."""
    n = round(duration_s / PERIOD_S) + 1
    time = np.arange(n) * PERIOD_S
    R = MOTOR.resistance(40.0)
    i, w = np.linalg.solve([[R, MOTOR.ke], [MOTOR.ke, -MOTOR.b]], [240.0, 6.455])
    voltage, load, noise, prior = (
        np.full(n, 240.0),
        np.full(n, 6.455),
        Noise(0.5 * SAME, 0.05 * SAME, 0.0),
        UNKNOWN,
    )
    if case == "load known":
        prior = UNKNOWN | {"load": 0.0}
    if case in ("load walks", "dither 5 V", "dither 20 V", "dither and voltage bias", "known start"):
        noise = replace(noise, load_walk=0.02, thermal_walk=0.0 if case == "load walks" else 0.1)
    if "dither" in case:
        size = 20.0 if "20" in case else 5.0
        bits = np.random.default_rng(0).choice([-1.0, 1.0], n // 2 + 1)
        voltage = voltage + size * np.repeat(bits, 2)[:n]
    if case == "dither and voltage bias":
        noise = replace(noise, voltage_bias_V=1.0)
    if case == "known start":
        prior = UNKNOWN | {"theta": 1.0}
    ambient = np.full(n, 20.0)
    run = simulate(
        MOTOR, Inputs(time, voltage, load, ambient, held=True), {"theta": 40.0, "i": float(i), "w": float(w)}
    )
    return bound(MOTOR, time, {**run.states, "load": load}, voltage, ambient, noise, Prior(prior))


@pytest.mark.parametrize(
    ("case", "theta_10_s", "theta_10_min"),
    [
        ("load known", 2.1, 0.23),
        ("load unknown", 39.7, 3.7),
        ("load walks", 39.7, 32.0),
        ("dither 5 V", 0.36, 0.32),
        ("dither 20 V", 0.16, 0.16),
        ("known start", 1.05, 2.3),
    ],
)
def test_the_table_of_identifiability_running_motor(case, theta_10_s, theta_10_min):
    theta = _running(case, 600.0).sd("theta")
    # The table gives two digits; a random dither differs from another by a few percent.
    tolerance = 0.12 if "dither" in case else 0.06
    assert theta[round(10 / PERIOD_S)] == pytest.approx(theta_10_s, rel=tolerance)
    assert theta[-1] == pytest.approx(theta_10_min, rel=tolerance)


def test_without_excitation_speed_and_temperature_are_one_number():
    walking = _running("load walks", 60.0)
    assert walking.correlation("w", "theta")[-1] == pytest.approx(-1.0, abs=1e-3)
    # One rad/s looks like nine kelvin.
    assert walking.sd("theta")[-1] / walking.sd("w")[-1] == pytest.approx(9.2, rel=0.02)


def test_a_voltage_bias_goes_into_the_speed_and_not_into_the_temperature():
    biased = _running("dither and voltage bias", 600.0)
    assert biased.sd("w")[-1] == pytest.approx(1.07, rel=0.03)
    assert biased.sd("theta")[-1] == pytest.approx(0.32, rel=0.12)


def _from_rest(
    voltage_V: float, load_Nm: float, duration_s: float, period_s: float, noise: Noise, i: float = 0.0
) -> Bound:
    n = round(duration_s / period_s) + 1
    time = np.arange(n) * period_s
    v, load, ambient = np.full(n, voltage_V), np.full(n, load_Nm), np.full(n, 20.0)
    run = simulate(MOTOR, Inputs(time, v, load, ambient, held=True), {"i": i})
    same = np.sqrt(5e-4 / period_s)
    scaled = replace(noise, voltage_V=0.5 * same, current_A=0.05 * same)
    return bound(
        MOTOR, time, {**run.states, "load": load}, v, ambient, scaled, Prior({"theta": 40.0, "load": 10.0})
    )


def test_an_inrush_from_rest_shows_the_temperature_in_a_fifth_of_a_second():
    start = _from_rest(240.0, 6.455, 0.5, 5e-4, Noise(load_walk=0.02)).sd("theta")
    assert 0.035 < start[400] < 0.08
    biased = _from_rest(240.0, 6.455, 0.5, 5e-4, Noise(load_walk=0.02, voltage_bias_V=1.0)).sd("theta")
    assert biased[400] == pytest.approx(0.34, rel=0.4)
    assert biased[1000] == pytest.approx(0.14, rel=0.4)


def test_a_locked_rotor_is_the_best_thermometer_and_a_dead_one_none():
    locked = _from_rest(20.0, 1000.0, 600.0, PERIOD_S, Noise(load_walk=0.02, thermal_walk=0.1)).sd("theta")
    assert locked[-1] == pytest.approx(0.14, rel=0.2)
    dead = _from_rest(0.0, 1000.0, 1800.0, PERIOD_S, Noise(load_walk=0.02, thermal_walk=0.1)).sd("theta")
    assert dead[round(10 / PERIOD_S)] == pytest.approx(40.0, rel=0.01)
    assert dead[round(600 / PERIOD_S)] == pytest.approx(35.0, rel=0.02)
    assert dead[-1] == pytest.approx(26.0, rel=0.02)


def test_the_noise_of_a_measured_voltage_passes_for_an_excitation():
    """A shorted motor that its load turns at a constant speed tells nothing of its temperature, however long."""
    n, rng = 20_000, np.random.default_rng(0)
    time, load, noise = np.arange(n) * 2e-3, np.full(n, -2.0), Noise(0.5, 0.05, 0.02)
    prior = Prior({"w": 50.0, "theta": 36.0, "load": 10.0, "i": 1.0})
    start = simulate(MOTOR, Inputs(time, np.zeros(n), load, np.full(n, 20.0)), {}).states
    settled = {name: np.full(n, values[-1]) for name, values in start.items()}
    true = bound(MOTOR, time, {**settled, "load": load}, np.zeros(n), np.full(n, 20.0), noise, prior).sd(
        "theta"
    )
    channels = {
        "voltage": 0.5 * rng.standard_normal(n), "load_torque": load, "ambient": np.full(n, 20.0),
        "temperature": np.full(n, 20.0), "speed": settled["w"],
    }  # fmt: skip
    seen = bound_of_recording(MOTOR, Recording("noisy", time, channels), noise, prior).sd("theta")
    assert true[-1] > 0.9 * true[500] > 20.0
    assert seen[-1] < 0.7 * seen[500]


@pytest.mark.parametrize("seed", [0, 1])
def test_where_steps_excite_the_motor_a_measured_voltage_will_do(seed):
    rng = np.random.default_rng(seed)
    run = perform(MELLAH, chosen_scenario("duty", 200.0, 500.0), rng)
    given = Noise(0.5, 0.05, 0.02), plate_prior(MELLAH)
    true, seen = (
        bound_of_recording(MELLAH.motor, one, *given).outputs[counted(run, MELLAH)]
        for one in (run, measure(run, (), NOISE, rng))
    )
    np.testing.assert_allclose((seen**2).mean(0) ** 0.5, (true**2).mean(0) ** 0.5, rtol=0.02)
    assert (seen != true).any()
