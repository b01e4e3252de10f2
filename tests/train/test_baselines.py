"""The methods a sensor must beat: each is right where its assumptions hold, and wrong as the textbook says where not."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.duty import MELLAH, NOISE, measured_duty

from motorlens_physics.scenario import chosen_scenario, measure, perform
from motorlens_train.baselines import (
    ExtendedKalman,
    Perceptron,
    ResistanceThermometer,
    SteadyStateVoltage,
    ThermalObserver,
    TwoStepKalman,
)
from motorlens_train.baselines.calibration import calibrated
from motorlens_train.baselines.extended_kalman import noise_of
from motorlens_train.baselines.method import low_pass, truth
from motorlens_train.bound import Noise, Prior, bound_of_recording
from motorlens_train.evaluation.scores import counted

pytestmark = pytest.mark.fit


@pytest.fixture(scope="module")
def duty():
    return [measured_duty(seed, 200.0) for seed in (3, 4, 5)]


@pytest.fixture(scope="module")
def kalman(duty):
    return ExtendedKalman(refit=False).fit(duty[:1], MELLAH)


def rms(method, recording):
    error = (method.estimate(recording).values - truth(recording, MELLAH))[counted(recording, MELLAH)]
    return np.sqrt(np.mean(error**2, axis=0))


def test_low_pass_of_a_step_is_the_exponential():
    time = np.cumsum(np.r_[0.0, np.tile([0.01, 0.03, 0.2], 40)])
    u = np.ones(len(time))
    u[0] = 0.0
    np.testing.assert_allclose(low_pass(time, u, 0.5), 1 - np.exp(-time / 0.5), atol=1e-12)


def test_calibration_finds_parameters_that_were_changed(duty):
    wrong = MELLAH.with_values({"R_a0": 3.8, "ke": 0.90, "J": 0.036, "H": 20e3})
    found = calibrated(wrong, duty).values()
    for key, tolerance in (("R_a0", 0.01), ("ke", 0.003), ("J", 0.01), ("H", 0.1)):
        assert found[key] == pytest.approx(MELLAH.values()[key], rel=tolerance), key


def test_noise_is_read_off_the_recordings(duty):
    v, i = noise_of(duty, MELLAH.rated)
    assert v == pytest.approx(NOISE["voltage"], rel=0.05)
    assert i == pytest.approx(NOISE["current"], rel=0.05)


def test_steady_state_voltage_is_exact_for_a_cold_motor_at_rest_with_its_load_and_wrong_by_the_winding_when_hot():
    method = SteadyStateVoltage(R=MELLAH.motor.R_a0, ke=MELLAH.motor.ke)
    scenario = chosen_scenario("direct_on_line", 8400.0, 0.2)
    run = perform(MELLAH, scenario, np.random.default_rng(0))
    error = method.estimate(run).speed - run.channels["speed"]
    # R alpha theta i / ke: 3.5 0.004 77.5 7.27 / 0.9346 = 8.4 rad/s too much after 140 minutes.
    assert error[20] == pytest.approx(0.0, abs=0.3)
    assert error[-1] == pytest.approx(8.44, abs=0.15)


def test_the_thermal_observer_is_exact_for_an_exact_motor_from_ambient_and_never_finds_an_unknown_start():
    cold = perform(MELLAH, chosen_scenario("direct_on_line", 1200.0, 100.0), np.random.default_rng(0))
    method = ThermalObserver(motor=MELLAH.motor)
    rise = truth(cold, MELLAH)[:, 1]
    assert np.max(np.abs(method.estimate(cold).temperature - rise)) < 0.1
    cooled = replace(MELLAH, motor=replace(MELLAH.motor, k0=0.9 * MELLAH.motor.k0))
    warm = measured_duty(3, 100.0)
    start = truth(warm, MELLAH)[0, 1]
    assert start > 20
    assert method.estimate(warm).temperature[5] - start == pytest.approx(-start, rel=0.01)
    # Ten percent less cooling than the model believes is a rise ten percent too low in the end.
    hot = perform(cooled, chosen_scenario("direct_on_line", 14400.0, 0.5), np.random.default_rng(0))
    rise = truth(hot, MELLAH)[-1, 1]
    assert -13 < method.estimate(hot).temperature[-1] - rise < -5


def test_the_extended_kalman_filter_reaches_the_bound_when_the_load_is_constant():
    # Nothing jumps: the filter's assumptions hold, so its errors and its deviations must be those of the bound.
    file = MELLAH
    quiet = ExtendedKalman(
        motor=file.motor, rated=file.rated, load_walk=0.02, thermal_walk=0.0, rise=30.0, rise_sd=20.0
    )
    ratios, sds = [], []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        run = perform(file, chosen_scenario("direct_on_line", 20.0, 200.0), rng)
        run = run.part(slice(400, None))
        recording = measure(run, (), NOISE, rng)
        estimate = quiet.estimate(recording)
        prior = Prior({"i": 0.05, "w": 55.25, "theta": 20.0, "load": 6.455})
        limit = bound_of_recording(file.motor, run, Noise(0.5, 0.05, 0.02), prior).outputs
        late = slice(len(run) // 2, None)
        ratios.append((estimate.speed - run.channels["speed"])[late] / limit[late, 0])
        sds.append(estimate.speed_sd[late] / limit[late, 0])
    assert np.mean(sds) == pytest.approx(1.0, abs=0.1)
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 1.8


def test_the_extended_kalman_filter_on_duty_cycles(kalman, duty):
    errors = np.sqrt(np.mean([rms(kalman, recording) ** 2 for recording in duty], axis=0))
    assert 0.05 < errors[0] < 1.5
    assert errors[1] < 12
    assert errors[2] == pytest.approx(MELLAH.motor.R_a0 * MELLAH.motor.alpha * errors[1], rel=1e-6)


def test_the_extended_kalman_filter_does_not_mind_irregular_steps(kalman):
    recording = measured_duty(3, 60.0, rate_Hz=200.0)
    keep = np.sort(np.random.default_rng(0).choice(len(recording), 2 * len(recording) // 3, replace=False))
    thinned = replace(
        recording, time_s=recording.time_s[keep], channels={q: y[keep] for q, y in recording.channels.items()}
    )
    whole, part = kalman.estimate(recording), kalman.estimate(thinned)
    counts = counted(thinned, MELLAH)
    difference = (part.speed - whole.speed[keep])[counts]
    assert np.sqrt(np.mean(difference**2)) < 0.5
    assert np.all(np.isfinite(part.sds)) and np.all(part.sds > 0)


def test_a_later_ladder(duty, kalman):
    # What decades of papers found, on one cycle: a filter with a disturbance beats a static equation beats nothing.
    static = SteadyStateVoltage().fit(duty[:2], MELLAH)
    step = TwoStepKalman().fit(duty[:2], MELLAH)
    thermometer = ResistanceThermometer().fit(duty[:2], MELLAH)
    spread = np.std(duty[2].channels["speed"])
    assert rms(kalman, duty[2])[0] < 0.6 * rms(static, duty[2])[0] < 0.1 * spread
    assert rms(step, duty[2])[0] < 0.1 * spread
    assert rms(thermometer, duty[2])[0] < 0.1 * spread
    # Deviations are positive and errors have their size.
    for method in (static, step):
        estimate = method.estimate(duty[2])
        assert 0.2 < rms(method, duty[2])[0] / estimate.speed_sd.mean() < 5


def test_the_perceptron_knows_no_history(duty):
    method = Perceptron(hidden=(6,), rows=4000).fit(duty[:2], MELLAH)
    recording = duty[2]
    order = np.random.default_rng(0).permutation(len(recording))
    shuffled = replace(recording, channels={q: y[order] for q, y in recording.channels.items()})
    np.testing.assert_allclose(
        method.estimate(shuffled).values, method.estimate(recording).values[order], rtol=1e-9
    )
    assert rms(method, recording)[0] < 0.1 * np.std(recording.channels["speed"])
