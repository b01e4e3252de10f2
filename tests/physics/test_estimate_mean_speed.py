"""A speed that is counted: the mean since the sample before, by an integrator that is not the package's."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL, simulated

from motorlens_physics.conditions import Shaft
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.mean_speed import mean_of
from motorlens_physics.estimate.model import predict, sensitivities_of
from motorlens_physics.estimate.prepare import prepare, prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_physics.sensitivity import Linearisation

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
SAMPLES, NOISE = 1800, 0.003
# Of each sample, so many shorter ones, of which the mean is taken.
FINE = 20
DECAY_S = TYPICAL["L"] / TYPICAL["R_a0"]


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("share", [0.05, 0.5, 5.0, 20.0])
@pytest.mark.parametrize("inertia", [1.0, 0.1])
def test_the_mean_over_a_sample_is_that_of_two_hundred_shorter_ones(
    share: float, inertia: float, held: bool
) -> None:
    """Samples from a twentieth of the winding's time constant to a few of the rotor's, with the voltage of a drive."""
    fine, samples, period_s = 200, 400, share * DECAY_S
    motor = TYPICAL | {"J": inertia * TYPICAL["J"]}
    steps = np.repeat(np.random.default_rng(1).uniform(-240, 240, samples // 40), 40)
    # What runs linearly is smooth over a sample.
    voltage = steps if held else np.convolve(steps, np.ones(30) / 30, "same")
    between = np.arange(samples * fine) / fine
    driven = np.repeat(voltage, fine) if held else np.interp(between, np.arange(samples), voltage)
    test = plain_motor.Test(period_s / fine, samples * fine, 1, held, 0.0)
    current, speed, _ = simulated(motor, driven, np.zeros(samples * fine), test).T
    turned = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1])))[::fine] / fine
    file, time = MotorFile("plate", Motor(**motor), PLATE), np.arange(samples) * period_s
    channels = {"voltage": voltage, "current": current[::fine], "speed": speed[::fine]}
    (run,) = prepare_all(
        [Recording("counted.csv", time, {**channels, "ambient": np.full(samples, AMBIENT_C)})], file
    )
    run = run.holding((held, held, True)).showing(True)
    model = replace(start_model(file, [run]), held=(run.inputs.hold,))
    shown = predict(model.with_values({f"initial.{state}@0": 0.0 for state in ("i", "w", "theta")}), run, 0)[
        1
    ]
    off = np.abs(shown[1:, 1] - np.diff(turned))
    both = np.abs(0.5 * (speed[::fine][1:] + speed[::fine][:-1]) - np.diff(turned))
    size = np.abs(speed).max()
    assert off.max() < 1e-4 * size
    # The mean of both ends is off by more.
    assert off.max() < 0.01 * both.max()


def answering(torque: float, voltage: float) -> Linearisation:
    """Of two samples, in which current and speed answer so much to what holds, half of it if it rises; else by nothing."""
    matrices = np.zeros((1, 3, 9))
    matrices[0, 0, [3, 6]], matrices[0, 1, [4, 7]] = 0.5 * voltage, 0.5 * torque
    return Linearisation(("i", "w", "theta"), matrices)


@pytest.mark.parametrize(("torque", "voltage"), [(0.0, 1.0), (1.0, 0.0), (0.0, 0.0)])
def test_what_is_held_does_not_bend_the_speed_however_the_current_jumps(
    torque: float, voltage: float
) -> None:
    """A rotor that is held, a current that something imposes, and both."""
    mean = mean_of(answering(torque, voltage))
    assert mean.since_last(np.array([0.0, 2.0]), np.array([0.0, 5.0])) == pytest.approx([0.0, 1.0])


def fitted(period_s: float, counted: bool, held: bool, seed: int) -> Estimate:
    """The estimate from random steps, a tenth of what the winding's time constant is long or more, with noise on all."""
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(-240, 240, SAMPLES // 40), 40)
    fine = np.arange(SAMPLES * FINE) / FINE
    driven = np.repeat(voltage, FINE) if held else np.interp(fine, np.arange(SAMPLES), voltage)
    test = plain_motor.Test(period_s / FINE, SAMPLES * FINE, 1, held, NOISE)
    states = simulated(TYPICAL, driven, np.zeros(SAMPLES * FINE), test)
    speed = states[::FINE, 1].copy()
    if counted:
        angle = np.concatenate([[0.0], np.cumsum(0.5 * (states[1:, 1] + states[:-1, 1]))])[::FINE] / FINE
        speed[1:] = np.diff(angle)
    shown = {"voltage": voltage, "current": states[::FINE, 0], "speed": speed}
    channels = {q: y + NOISE * RATED[q] * rng.standard_normal(SAMPLES) for q, y in shown.items()}
    file, time = MotorFile("plate", Motor(), PLATE), np.arange(SAMPLES) * period_s
    recording = Recording("counted.csv", time, {**channels, "ambient": np.full(SAMPLES, AMBIENT_C)})
    return estimate(file, prepare_all([recording], file))


def test_a_run_without_the_speed_of_its_angle_shows_no_mean() -> None:
    """Of the current alone; where something turns the shaft; and without a dead encoder's speed."""
    time, turns = np.arange(200) * 0.01, np.ones(200)
    channels = {
        "voltage": turns,
        "current": np.sin(time),
        "angle": time,
        "speed": np.append(np.nan, turns[1:]),
    }
    counted = Recording("counted.csv", time, channels, speed_from_angle=True)
    turned = replace(counted, channels=channels | {"shaft": turns * Shaft.TURNED})
    file = MotorFile("plate", Motor(), PLATE)
    whole = prepare(counted, file)
    assert whole.mean_speed and whole.from_angle and "speed" in whole.channels
    for run in (prepare(counted, file, ("current",)), prepare(turned, file), whole.without_channel("speed")):
        assert run.channels == ("current",) and not run.mean_speed and not run.from_angle
        predict(start_model(file, [run]), run, 0)


@pytest.mark.fit
@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("share", [0.5, 5.0])
def test_a_counted_speed_is_taken_as_a_mean_and_another_is_not(share: float, held: bool) -> None:
    """Samples of half the winding's time constant, and of five times as much."""
    period_s = share * DECAY_S
    for counted in (True, False):
        found = fitted(period_s, counted, held, 1)
        values, sd = found.fit.model.values(), found.fit.sd()
        assert found.runs[0].mean_speed == counted
        assert not found.runs[0].late and found.fit.model.held[0][0] == held
        for key in ("L", "R_a0", "J", "ke"):
            assert abs(values[key] - TYPICAL[key]) < 4 * sd[key], (key, values[key], sd[key])
        assert abs(values["skew.speed@0"]) < max(4 * sd["skew.speed@0"], 0.03 * period_s)


@pytest.mark.fit
@pytest.mark.parametrize("held", [True, False])
def test_how_a_mean_answers_to_every_parameter_is_told(held: bool) -> None:
    """Central differences of what is shown, in samples of three time constants of the winding."""
    time = np.arange(400) * 3 * DECAY_S
    voltage = np.repeat(np.random.default_rng(2).uniform(-240, 240, 10), 40)
    file = MotorFile("plate", Motor(), PLATE)
    channels = {"voltage": voltage, "current": 0.01 * voltage, "speed": 0.5 * voltage}
    (run,) = prepare_all([Recording("counted.csv", time, channels)], file)
    run = run.holding((held, held, True)).showing(True)
    model = replace(start_model(file, [run]), held=(run.inputs.hold,), tolerance=1e-9)
    keys = ("R_a0", "L", "ke", "J", "b", "skew.speed@0")
    _, _, columns, _ = sensitivities_of(model, run, 0, keys)
    for k, key in enumerate(keys):
        value = model.values()[key]
        step = 1e-4 * value or 1e-6
        up, down = (predict(model.with_values({key: value + sign * step}), run, 0)[1] for sign in (1, -1))
        told = (up - down)[:, 1] / (2 * step)
        assert columns[:, 1, k] == pytest.approx(told, abs=0.002 * np.abs(told).max()), key
