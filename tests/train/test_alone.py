"""A sensor that is an observer alone: all of it is the observer, and it is the same in both directions of rotation."""

import numpy as np
import onnxruntime as ort
import pytest
from helpers.duty import MELLAH

from motorlens_train.alone import alone, observer_alone
from motorlens_train.build import Recipe
from motorlens_train.evaluation.worlds.plant import Constants, run
from motorlens_train.export import core_graph, step_graph
from motorlens_train.features import feature_rows, motor_bank
from motorlens_train.observer.design import ObserverSettings, with_observer
from motorlens_train.specification import Rate

OUTPUTS = ("speed", "temperature", "resistance")


@pytest.fixture(scope="module")
def banks():
    """With filters and all outputs, and alone."""
    settings = ObserverSettings(voltage_sd=0.48, current_sd=0.0509)
    whole = with_observer(motor_bank(3.5, 0.034, 0.0097, 0.131, 4157.0), MELLAH, settings)
    return whole, alone(whole)


@pytest.fixture(scope="module")
def sensor(banks):
    recipe = Recipe("alone", banks[1], OUTPUTS, (), Rate(500.0, 100.0, 10000.0), 0.7, 1)
    return observer_alone(recipe, MELLAH)


@pytest.fixture(scope="module")
def driven():
    """Steps and a load, 500 Hz: time, voltage, current with noise."""
    rng, n = np.random.default_rng(4), 3000
    time = np.arange(n) * 2e-3
    voltage = np.repeat([0.0, 200.0, 90.0, 160.0], n // 4)
    states, _ = run(
        Constants(), time, voltage, True, np.full(n, 4.0), np.zeros(n), np.array([0.0, 0.0, 40.0])
    )
    return time, voltage + 0.3 * rng.standard_normal(n), states[:, 0] + 0.03 * rng.standard_normal(n), states


@pytest.mark.fit
def test_a_part_of_the_outputs_is_what_all_of_them_are(banks, driven):
    whole, part = banks
    assert len(part.observer.read.steps) < len(whole.observer.read.steps)
    time, voltage, current, _ = driven
    _, state = part.observer.run(np.full(len(time), 2e-3), voltage, current, np.full(len(time), 20.0))
    many, few = (np.array(bank.observer.read(20.0, *state)) for bank in banks)
    places = [whole.observer.outputs.index(name) for name in part.observer.outputs]
    np.testing.assert_array_equal(many[places], few)


@pytest.mark.fit
def test_it_finds_a_warm_start_and_says_how_well(sensor, driven):
    time, voltage, current, states = driven
    estimate, sigma = sensor.evaluate(feature_rows(sensor.bank, time, voltage, current))
    off, known = np.abs(estimate[-1, :2] - states[-1, 1:]), sigma[-1, :2]
    assert off[0] < 0.5 and off[1] < 3.0
    assert np.all(off < 3 * known) and 0.2 < known[1] < 20.0


@pytest.mark.fit
def test_a_motor_that_runs_backwards_is_the_same_motor(sensor, driven):
    """As far as the two directions go through the same operations: to rounding."""
    time, voltage, current, _ = driven
    (ahead, sure), (back, unsure) = (
        sensor.evaluate(feature_rows(sensor.bank, time, sign * voltage, sign * current))
        for sign in (1.0, -1.0)
    )
    scale = np.array([output.scale for output in sensor.specification.outputs])
    np.testing.assert_allclose(ahead / scale, back * np.array([-1.0, 1.0, 1.0]) / scale, atol=1e-6)
    np.testing.assert_allclose(sure, unsure, rtol=1e-5)


@pytest.mark.fit
def test_the_step_graph_is_the_observer_and_nothing_else(sensor, driven):
    time, voltage, current, _ = driven
    rows = slice(740, 800)  # a step of the voltage is among them
    x = feature_rows(sensor.bank, time[rows], voltage[rows], current[rows], first_dt_s=2e-3)
    session = ort.InferenceSession(core_graph(sensor, {}), providers=["CPUExecutionProvider"])
    expected = session.run(None, {"features": x})
    session = ort.InferenceSession(step_graph(sensor, {}), providers=["CPUExecutionProvider"])
    state = np.zeros(sensor.bank.observer.size)
    for n, (v, i) in enumerate(zip(voltage[rows], current[rows], strict=True)):
        inputs = {"voltage": np.array([v]), "current": np.array([i]), "dt": np.array([2e-3]), "state": state}
        estimate, sigma, state = session.run(["estimate", "sigma", "next_state"], inputs)
        np.testing.assert_allclose(estimate, expected[0][n], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(sigma, expected[1][n], rtol=1e-9)
