"""A speed that is counted: the mean since the sample before, by an integrator that is not the package's."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL, simulated
from scipy.integrate import quad

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.mean_speed import bend_of, mean_since_last
from motorlens_physics.estimate.model import predict, sensitivities_of
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
SAMPLES, NOISE = 1800, 0.003
# Of each sample, so many shorter ones, of which the mean is taken.
FINE = 20
DECAY_S = TYPICAL["L"] / TYPICAL["R_a0"]


@pytest.mark.parametrize("decay", [0.01, 0.2, 1.0, 9.0, 11.0, 300.0])
def test_the_mean_beside_a_current_that_settles(decay: float) -> None:
    """A current of 0 goes to 1 A by an exponential, and the speed, rad/s, is its integral over a sample of 1 s."""

    def speed(t: float) -> float:
        return t + decay * float(np.expm1(-t / decay))

    settled = -float(np.expm1(-1 / decay))
    bend, slope = bend_of(np.array([0.0, 1.0]), np.array([decay * settled]), decay, held=True)
    found = mean_since_last(np.array([0.0, speed(1.0)]), np.array([0.0, settled]), bend)
    assert found[1] == pytest.approx(quad(speed, 0.0, 1.0)[0], rel=1e-6)
    # A plain mean of both ends is off by more.
    assert abs(0.5 * speed(1.0) - found[1]) > 1e-3 * speed(1.0)
    # In proportion to what a current does in a sample if it stays: 1 rad/s here.
    more, less = (
        bend_of(np.array([0.0, 1.0]), np.array([-other * np.expm1(-1 / other)]), other, held=True)[0][0]
        for other in (decay * 1.001, decay / 1.001)
    )
    assert slope[0] == pytest.approx((more - less) / (2 * np.log(1.001)), rel=1e-4, abs=1e-9)


def test_the_mean_beside_a_current_that_runs_linearly() -> None:
    """From 0 to 1 A in a sample of 1 s: the speed is a parabola, whose mean is a third of its end."""
    spun = np.array([0.01 * (1 - np.exp(-100.0))])
    bend, _ = bend_of(np.array([0.0, 1.0]), spun, 0.01, held=False)
    found = mean_since_last(np.array([0.0, 0.5]), np.array([0.0, 1.0]), bend)
    assert found[1] == pytest.approx(1 / 6, rel=1e-9)


def test_a_rotor_that_is_held_has_no_speed_however_the_current_jumps() -> None:
    still, jump = np.zeros((3, 2)), np.cumsum(np.ones((3, 2)), axis=0)
    bend, _ = bend_of(np.arange(3.0), np.zeros(2), 0.3, held=True)
    assert not mean_since_last(still, jump, bend).any()


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
        # How far the current falls within a sample is taken as of the winding alone, without what it induces.
        share = 0.025 if key == "L" else 0.005
        assert columns[:, 1, k] == pytest.approx(told, abs=share * np.abs(told).max()), key
