"""What every sensor model keeps, on every channel, and each against a closed form."""

import doctest
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pint
import pytest
import sympy
from helpers.effect_contract import PLATES

from motorlens_physics.describe import CITATION
from motorlens_physics.estimate.calibrate import calibrate
from motorlens_physics.estimate.model import Model, with_sensor
from motorlens_physics.motor_file import read_motor_file, with_overrides, write_motor_file
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_physics.sensor_model import CHANNELS, UNIT_OF_CHANNEL, sensor_catalogue, sensor_models
from motorlens_physics.sensors.clipping import SensorClipping
from motorlens_physics.sensors.dead import SensorDead
from motorlens_physics.sensors.gain import SensorGain
from motorlens_physics.sensors.lag import SensorLag
from motorlens_physics.sensors.noise import SensorNoise
from motorlens_physics.sensors.offset import SensorOffset
from motorlens_physics.sensors.quantisation import SensorQuantisation

MODELS = sensor_models()
FAULTS = sensor_catalogue()
TIME = np.cumsum(np.random.default_rng(1).uniform(0.002, 0.02, 500))
TRUE = 3.0 * np.sin(4 * TIME) + 2.0


def rng():
    return np.random.default_rng(5)


def test_every_fault_of_the_design_is_there_on_every_channel():
    assert set(FAULTS) == {f"{c}_sensor_{kind}" for c in CHANNELS for kind in ("gain", "offset", "lag")}
    kinds = ("gain", "offset", "lag", "noise", "quantisation", "clipping", "dead")
    assert set(MODELS) == {f"{c}_sensor_{kind}" for c in CHANNELS for kind in kinds}


@pytest.mark.parametrize("name", MODELS)
def test_shape(name):
    model = MODELS[name]
    assert model.name() == name
    assert sum(p.null is not None for p in model.parameters().values()) == (1 if name in FAULTS else 0)
    for p in model.parameters().values():
        assert len(p.description) > 3 and p.bounds[0] <= p.default <= p.bounds[1] and p.prior > 0
        assert p.fixed == (name not in FAULTS)
        for rated in PLATES:
            assert p.bounds[0] <= p.typical(rated) <= p.bounds[1]
    assert CITATION.search(type(model).__doc__ or "")
    assert bool(model.excited_by) == (name in FAULTS) and set(model.excited_by) <= set(scenarios())


@pytest.mark.parametrize(
    "kind", [SensorGain, SensorOffset, SensorLag, SensorNoise, SensorQuantisation, SensorClipping, SensorDead]
)
def test_the_number_worked_by_hand(kind):
    (example,) = doctest.DocTestFinder(recurse=False).find(
        kind, globs=dict(vars(sys.modules[kind.__module__])) | {"np": np}
    )
    result = doctest.DocTestRunner(verbose=False).run(example, out=lambda text: None)
    assert result.failed == 0 and result.attempted > 0


@pytest.mark.parametrize("name", MODELS)
def test_units_are_those_of_the_channel(name):
    model, registry = MODELS[name], pint.get_application_registry()
    unit = UNIT_OF_CHANNEL[model.channel]
    for p in model.parameters().values():
        registry.Unit(p.unit)
        assert p.unit != "channel" and p.of != "channel"
    if name in FAULTS:
        typical = model.typical(PLATES[0])
        with_units: dict[str, Any] = {
            n: registry.Quantity(getattr(typical, n), p.unit) for n, p in model.parameters().items()
        }
        y, rate = registry.Quantity(3.0, unit), registry.Quantity(7.0, f"({unit})/s")
        shown = replace(model, **with_units).read(y, rate)
        assert shown.to(unit).magnitude == pytest.approx(typical.read(3.0, 7.0), rel=1e-12)


@pytest.mark.parametrize("name", FAULTS)
def test_at_null_it_shows_the_truth_to_the_last_bit(name):
    for rated in PLATES:
        null = FAULTS[name].at_null(rated)
        for shown in (
            null.read(TRUE, np.cos(TIME)),
            null.unrecord(TIME, TRUE),
            null.record(TIME, TRUE, rng()),
        ):
            np.testing.assert_array_equal(shown, TRUE)


@pytest.mark.fit
@pytest.mark.parametrize("name", FAULTS)
def test_typical_faults_show_and_do_not_drown(name):
    for rated in PLATES:
        fault = FAULTS[name].typical(rated)
        scale = rated.scale(fault.parameters().get("offset", fault.switch()).of) if "offset" in name else 1.0
        # Slow against the channel's lag: some 50 time constants a radian.
        time = 50 * TIME * (fault.tau if "lag" in name else 1.0)
        y = scale * (1 + 0.5 * np.sin(time / (50 * fault.tau) if "lag" in name else time))
        error = np.max(np.abs(fault.record(time, y, rng()) - y)) / scale
        assert 1e-3 < error < 0.2


@pytest.mark.parametrize("name", FAULTS)
def test_what_was_recorded_is_found_again(name):
    fault = FAULTS[name].typical(PLATES[0])
    # A lag of a thirtieth of a sample tells the corners too, but not what came before the first.
    time = TIME / np.mean(np.diff(TIME)) * (30 * fault.tau if "lag" in name else 1.0)
    again = fault.unrecord(time, fault.record(time, TRUE, rng()))
    np.testing.assert_allclose(again[1:], TRUE[1:], atol=5e-3 if "lag" in name else 1e-13)


@pytest.mark.parametrize("samples", [0.05, 0.3, 1.0, 3.0, 30.0])
def test_a_lag_is_undone_by_least_squares(samples):
    """Against dense ones, at uneven steps."""
    time = np.cumsum(rng().uniform(0.6, 1.4, 80))
    shown = np.cumsum(rng().standard_normal(80))
    lag = SensorLag("voltage", tau=samples)
    dt = np.diff(time)
    keep = np.exp(-dt / samples)
    late = 1 / (1 - keep) - samples / dt
    turn = np.zeros((78, 80))
    mean = np.eye(79, 80) * (1 - late)[:, None] + np.eye(79, 80, 1) * late[:, None]
    for row in range(78):
        turn[row, row : row + 3] = np.sqrt(0.1 * ((1 - late) / late)[row + 1] ** 3) * np.array([1, -2, 1])
    first = np.eye(1, 80)
    right = [
        [shown[0] + samples * (shown[1] - shown[0]) / dt[0]],
        (shown[1:] - keep * shown[:-1]) / (1 - keep),
        np.zeros(78),
    ]
    expected = np.linalg.lstsq(np.vstack([first, mean, turn]), np.concatenate(right), rcond=None)[0]
    np.testing.assert_allclose(lag.unrecord(time, shown), expected, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(("samples", "corner"), [(0.2, 0.13), (0.5, 0.7), (2.0, 0.92), (20.0, 0.97)])
def test_undone_a_lag_leaves_corners_and_noise_grows_little_more_than_by_a_difference_over_two_steps(
    samples, corner
):
    """The errors of both beside each other, and what becomes of noise."""
    time = np.arange(4000.0)
    steps = np.repeat(rng().standard_normal(40), 100)
    white = rng().standard_normal(4000)
    lag = SensorLag("voltage", tau=samples)

    def by_differences(y):
        return y + samples * np.gradient(y, time)

    def left(undone):
        return np.std((undone(lag.record(time, steps, rng())) - steps)[2:-2])

    def grown(undone):
        return np.std(undone(white)[2:-2])

    def by_lag(y):
        return lag.unrecord(time, y)

    assert 0.8 * corner < left(by_lag) / left(by_differences) < corner
    assert 1.0 < grown(by_lag) / grown(by_differences) < 1.45


@pytest.mark.parametrize("name", FAULTS)
def test_symbols_give_smooth_reading(name):
    fault = FAULTS[name]
    on_symbols: dict[str, Any] = {n: sympy.Symbol(n) for n in fault.parameters()}
    y, rate = sympy.symbols("y rate", real=True)
    switch = fault.switch()
    slope = sympy.diff(replace(fault, **on_symbols).read(y, rate), on_symbols[switch.name])
    assert slope.subs({y: 3, rate: 7}) == {"gain": 3, "offset": 1, "lag": -7}[fault.kind]


def test_a_lag_follows_a_ramp_and_a_step_as_the_closed_form_says():
    lag = SensorLag("speed", tau=0.3)
    start = TIME[0]
    ramp = 5.0 * (TIME - start)
    expected = ramp - 5.0 * 0.3 * (1 - np.exp(-(TIME - start) / 0.3))
    np.testing.assert_allclose(lag.record(TIME, ramp, rng()), expected, atol=1e-12)
    # A step between two samples is a ramp between them.
    step = np.where(np.arange(500) < 100, 0.0, 1.0)
    dt = TIME[100] - TIME[99]
    ramped = 1 - 0.3 / dt * (1 - np.exp(-dt / 0.3))
    after = TIME[100:] - TIME[100]
    np.testing.assert_allclose(
        lag.record(TIME, step, rng())[100:], 1 - (1 - ramped) * np.exp(-after / 0.3), atol=1e-12
    )


def test_a_lag_takes_any_step_over_its_time_constant():
    for tau in (1e-9, 1e-4, 1.0, 1e4):
        shown = SensorLag("speed", tau=tau).record(TIME, TRUE, rng())
        assert np.isfinite(shown).all() and np.max(np.abs(shown - TRUE)) < np.ptp(TRUE) + 1e-9
    np.testing.assert_allclose(SensorLag("speed", tau=1e-9).record(TIME, TRUE, rng()), TRUE, atol=1e-6)


def test_a_lag_is_the_same_on_even_and_uneven_times():
    lag = SensorLag("speed", tau=0.05)
    even = np.linspace(0.0, 2.0, 401)
    uneven = even.copy()
    uneven[-1] += 1e-4  # one step differs, so that the general recursion runs
    np.testing.assert_allclose(
        lag.record(even, np.sin(9 * even), rng())[:-1],
        lag.record(uneven, np.sin(9 * even), rng())[:-1],
        rtol=1e-12,
    )


SIZES = {
    "speed_sensor_lag.tau": 0.02,
    "current_sensor_lag.tau": 0.002,
    "speed_sensor_gain.gain": 1.04,
    "current_sensor_offset.offset": 0.2,
    "voltage_sensor_gain.gain": 1.03,
    "temperature_sensor_offset.offset": 2.0,
}


@pytest.mark.parametrize("key", SIZES)
def test_simulate_and_recover(key):
    """Faults are found again by calibration, lags by their true filter, not to first order."""
    file = read_motor_file(Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml")
    truth = with_overrides(file, {key: SIZES[key]})
    random = np.random.default_rng(4)
    noise = {"current": 0.015, "speed": 0.4, "temperature": 0.2}
    data = measure(perform(truth, scenarios()["no_load_steps"](), random), truth.sensors, noise, random)
    fault = truth.sensors[0]
    found = calibrate(replace(file, sensors=(fault.at_null(file.rated),)), [data], [key], held=True)
    assert found.converged
    assert abs(found.value[key] - SIZES[key]) < max(
        4 * found.sd[key], 1e-2 * abs(SIZES[key] - fault.switch().null)
    )
    assert found.sd[key] < 0.1 * abs(SIZES[key] - fault.switch().null)


def test_first_order_of_a_small_lag_is_the_pointwise_reading():
    """`read` is the derivative at null that a diagnosis uses: the error falls with tau squared."""

    def error(tau):
        lag = SensorLag("speed", tau=tau)
        fine = np.linspace(0, 3, 60_001)
        exact = lag.record(fine, np.sin(4 * fine), rng())
        return np.max(np.abs(exact - lag.read(np.sin(4 * fine), 4 * np.cos(4 * fine)))[fine > 1])

    assert 3.9 < error(0.02) / error(0.01) < 4.1


def test_noise_has_its_standard_deviation_and_no_memory():
    shown = SensorNoise("current", sd=0.25).record(np.arange(40_000.0), np.zeros(40_000), rng())
    assert 0.245 < np.std(shown) < 0.255
    assert abs(np.corrcoef(shown[1:], shown[:-1])[0, 1]) < 0.02


def test_quantisation_error_is_uniform_within_half_a_step():
    y = np.random.default_rng(2).normal(0, 10, 20_000)
    shown = SensorQuantisation("voltage", step=0.5).record(np.arange(20_000.0), y, rng())
    np.testing.assert_allclose(shown / 0.5, np.round(shown / 0.5))
    assert np.max(np.abs(shown - y)) <= 0.25
    assert np.std(shown - y) == pytest.approx(0.5 / np.sqrt(12), rel=0.02)


def test_clipping_and_death_leave_the_rest_alone():
    y = np.linspace(-3, 3, 61)
    time = np.arange(61.0)
    clipped = SensorClipping("current", limit=2.0).record(time, y, rng())
    np.testing.assert_array_equal(clipped[np.abs(y) <= 2], y[np.abs(y) <= 2])
    assert set(clipped[np.abs(y) > 2]) == {-2.0, 2.0}
    dead = SensorDead("current", after=30.0, shows=0.7).record(time, y, rng())
    np.testing.assert_array_equal(dead[:30], y[:30])
    assert set(dead[30:]) == {0.7}


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_a_gain_and_an_offset_show_the_same_whichever_was_found_first(order, tmp_path):
    """gain y + offset, and not gain (y + offset); also where a contest or a file adds one after the other."""
    faults = SensorGain("speed", 1.25), SensorOffset("speed", -3.0)
    file = replace(read_motor_file("mellah2016"), sensors=tuple(faults[k] for k in order))
    run = perform(file, scenarios()["no_load_steps"](2.0, 0.01), rng())
    clean = measure(run, (), {}, rng()).channels["speed"]
    shown = measure(run, file.sensors, {}, rng()).channels["speed"]
    np.testing.assert_allclose(shown, 1.25 * clean - 3.0, rtol=1e-12)
    model = Model(file, (), ())
    for fault in (replace(faults[k], channel="voltage") for k in order):
        model = with_sensor(model, fault)
    assert [sensor.kind for sensor in model.file.sensors if sensor.channel == "voltage"] == ["gain", "offset"]
    write_motor_file(model.file, tmp_path / "motor.toml")
    assert read_motor_file(tmp_path / "motor.toml").sensors == model.file.sensors
