"""The observer: its programs run alike everywhere, its physics is the motor's, and it is as sure as it should be."""

import json
from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
import sympy as sp
from helpers.duty import MELLAH, NOISE, measured_duty
from helpers.sensors import small_sensor
from numba import njit

from motorlens_physics.effect import catalogue
from motorlens_physics.motor_file import Knowledge, with_overrides
from motorlens_physics.scenario import chosen_scenario, measure, perform
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.estimate.estimator import Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.baselines.method import steps_of, truth
from motorlens_train.bound import Noise, Prior, bound_of_recording
from motorlens_train.build import golden
from motorlens_train.evaluation.scores import counted
from motorlens_train.export import write_sensor
from motorlens_train.features import feature_rows
from motorlens_train.observer.design import ObserverSettings, observer
from motorlens_train.observer.file import Observer
from motorlens_train.observer.model import equations, linearised
from motorlens_train.observer.program import OPERATIONS, Program, Recorder, record

SETTINGS = ObserverSettings(voltage_sd=NOISE["voltage"], current_sd=NOISE["current"])


@pytest.fixture(scope="module")
def watching():
    return observer(MELLAH, SETTINGS)


def follow(watching, recording):
    c = recording.channels
    values, _ = watching.run(steps_of(recording.time_s), c["voltage"], c["current"], c["ambient"])
    return dict(zip(watching.outputs, values.T, strict=True))


# ---- straight-line programs


@pytest.mark.fit
def test_a_recorded_expression_is_the_expression():
    x, y = sp.symbols("x y", real=True)
    e = (
        sp.tanh(x / 3) * sp.sqrt(x**2 + y**2)
        - sp.exp(-(y**2)) / x
        + sp.Abs(y) ** 3
        + sp.Max(x, y) * sp.cos(x)
        - 2.5
    )
    r = Recorder()
    values = dict(zip((x, y), r.inputs(["x", "y"]), strict=True))
    program = r.program([record(e, values, r), record(sp.diff(e, x), values, r)])
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0.2, 2.0, (2, 50))
    for k, expression in enumerate((e, sp.diff(e, x))):
        expected = [float(expression.subs({x: p, y: q})) for p, q in zip(a, b, strict=True)]
        np.testing.assert_allclose(program(a, b)[k], expected, rtol=1e-12)


def test_equal_operations_are_recorded_once_and_constants_are_folded():
    r = Recorder()
    x = r.input("x")
    program = r.program([(x + 1.0) * (1.0 + x), x * 0.0 + 2.0 * 3.0, x * 1.0 - 0.0])
    assert [name for name, _ in program.steps] == ["add", "mul"]
    assert program(2.0) == [9.0, 6.0, 2.0]


@njit
def called(function, x, y):
    function(x, y)


def test_compiled_and_interpreted_programs_agree_on_every_operation():
    r = Recorder()
    a, b, c = r.inputs(["a", "b", "c"])
    outputs = []
    for name, (count, _) in OPERATIONS.items():
        outputs.append(r.apply(name, *(a, b, c)[:count]))
    program = r.program(outputs)
    compiled, out = program.compiled(), np.empty(len(outputs))
    for sample in ((0.3, 1.2, -2.0), (1.2, 0.3, 0.0), (2.0, 2.0, 5.0), (2.0, 1.0, np.nan)):
        called(compiled, np.array(sample), out)
        np.testing.assert_allclose(out, [float(v) for v in program(*sample)], rtol=1e-14)


def test_a_document_says_all_of_a_program_and_a_damaged_one_is_refused(watching):
    text = json.dumps(watching.document())
    again = Observer.from_document(json.loads(text))
    assert again == watching
    damaged = json.loads(text)["read"]
    damaged["steps"][0][1] = 10_000
    with pytest.raises(ValueError, match="step 0"):
        Program.from_document(damaged)


# ---- the motor's equations


@pytest.mark.fit
def test_rates_and_jacobian_are_those_of_the_motor_with_every_effect():
    for name, effect in catalogue().items():
        motor = replace(MELLAH.motor, effects=(effect.typical(MELLAH.rated),))
        names, program = linearised(motor)
        if "phi" in effect.states:
            assert names == ("i", "w", "theta", "load")
            continue
        at = {"i": 6.0, "w": 180.0, "theta": 45.0, "load": 5.0}
        x = np.array([at.get(state, 3.0) for state in names])
        found = np.array([float(v) for v in program(*x, 210.0, 25.0)])
        n = len(names)
        jacobian = found[n:].reshape(n, n)
        for k in range(n):
            step = 1e-5 * max(abs(x[k]), 1.0)
            ends = [program(*(x + sign * step * (np.arange(n) == k)), 210.0, 25.0)[:n] for sign in (1, -1)]
            slope = (np.array(ends[0], dtype=float) - np.array(ends[1], dtype=float)) / (2 * step)
            np.testing.assert_allclose(jacobian[:, k], slope, rtol=2e-4, atol=1e-6, err_msg=name)
        if name == "brush_voltage_drop":
            # 210 - R i - ke w - V_b i / sqrt(i^2 + i_s^2), over L, by hand.
            m = MELLAH.motor
            e = motor.effects[0]
            by_hand = (
                210 - m.R_a0 * (1 + m.alpha * 45) * 6 - m.ke * 180 - e.V_b * 6 / np.hypot(6, e.i_s)
            ) / m.L
            assert found[0] == pytest.approx(by_hand, rel=1e-9)


def test_free_parameters_stay_symbols():
    system = equations(MELLAH.motor, ["R_a0", "ke"])
    assert set(system.free) == {"R_a0", "ke"}
    assert system.voltage.has(system.free["R_a0"]) and system.voltage.has(system.free["ke"])


# ---- what it sees


@pytest.mark.parametrize("rise", [0.0, 20.0, 50.0, 80.0])
def test_inrush_shows_an_unknown_temperature_within_a_second(watching, rise):
    rng = np.random.default_rng(int(rise))
    time = np.arange(2001) * 1e-3
    voltage = np.where(time < 0.2, 0.0, 120.0)
    inputs = Inputs(time, voltage, np.full(2001, 4.0), np.full(2001, 20.0), held=True)
    run = simulate(MELLAH.motor, inputs, {"theta": rise})
    values, _ = watching.run(
        np.full(2001, 1e-3), voltage + 0.5 * rng.standard_normal(2001), run.current_A + 0.05 * rng.standard_normal(2001),
        np.full(2001, 20.0),
    )  # fmt: skip
    assert values[1200, watching.outputs.index("temperature")] == pytest.approx(run.rise_K[1200], abs=3.0)


@pytest.mark.fit
def test_it_comes_near_the_bound_on_duty_cycles(watching):
    ratios, coverage = [], []
    for seed in range(3, 9):
        recording = measured_duty(seed, 200.0, 1000.0)
        seen, actual, rows = follow(watching, recording), truth(recording, MELLAH), counted(recording, MELLAH)
        prior = Prior({"i": 0.05, "w": 55.0, "theta": 36.0, "load": 6.455})
        limit = bound_of_recording(MELLAH.motor, recording, Noise(0.5, 0.05, 0.02), prior).outputs
        pair = np.column_stack([seen["speed"], seen["temperature"]])[rows] - actual[rows, :2]
        ratios.append(np.sqrt(np.mean(pair**2, 0) / np.mean(limit[rows, :2] ** 2, 0)))
        coverage.append(np.mean(np.abs(pair[:, 0]) < 1.96 * np.exp(0.5 * seen["log_speed"][rows])))
    # A genie tells the bound when the load jumps, and the noise; the observer must find out.
    assert 0.9 < np.median(ratios, axis=0)[0] < 2.5
    assert 0.1 < np.median(ratios, axis=0)[1] < 3.0
    assert 0.9 < np.mean(coverage) <= 1.0


def test_a_load_that_jumps_is_believed_at_once_and_then_sure_again(watching):
    n, at = 8000, 5000
    rng = np.random.default_rng(4)
    time = np.arange(n) * 1e-3
    voltage, load = np.where(time < 0.2, 0.0, 200.0), np.where(np.arange(n) < at, 2.0, 5.0)
    run = simulate(MELLAH.motor, Inputs(time, voltage, load, np.full(n, 20.0), held=True))
    values, _ = watching.run(
        np.full(n, 1e-3), voltage + 0.5 * rng.standard_normal(n), run.current_A + 0.05 * rng.standard_normal(n),
        np.full(n, 20.0),
    )  # fmt: skip
    seen = dict(zip(watching.outputs, values.T, strict=True))
    assert seen["changing"][at - 1] < 0.05
    assert seen["changing"][at : at + 100].max() > 0.9
    assert seen["changing"][-1] < 0.2
    assert seen["load"][at - 1] == pytest.approx(2.0, abs=0.3)
    assert seen["load"][at + 500] == pytest.approx(5.0, abs=0.5)


@pytest.mark.fit
def test_a_motor_of_another_ke_is_found_out():
    true = MELLAH.with_values({"ke": 1.06 * MELLAH.values()["ke"]})
    rng = np.random.default_rng(5)
    recording = measure(perform(true, chosen_scenario("duty", 150.0, 200.0), rng), (), NOISE, rng)
    # With J known; ke^2/J is all that voltage and current show.
    tolerances = (("ke", 0.06), ("R_a0", 0.06))
    errors, deviation = {}, {}
    for name, settings in (("fixed", SETTINGS), ("open", replace(SETTINGS, tolerances=tolerances))):
        seen, rows = follow(observer(MELLAH, settings), recording), counted(recording, MELLAH)
        errors[name] = np.sqrt(np.mean((seen["speed"] - recording.channels["speed"])[rows] ** 2))
        deviation[name] = np.exp(0.5 * seen["log_temperature"][-1])
    assert errors["open"] < 0.5 * errors["fixed"]
    # 6 % of R_a0 are 15 K and more, whatever the resistance is known to. The fixed one sees that the motor is another.
    assert 10.0 < deviation["open"] < 40.0
    assert 10.0 < deviation["fixed"] < 40.0


@pytest.mark.fit
def test_housing_and_magnets_start_as_warm_as_the_winding():
    cold = observer(with_overrides(MELLAH, {"magnet_temperature.beta": 0.002}), SETTINGS)
    rng = np.random.default_rng(6)
    time = np.arange(2001) * 1e-3
    voltage = np.where(time < 0.2, 0.0, 120.0)
    inputs = Inputs(time, voltage, np.full(2001, 4.0), np.full(2001, 20.0), held=True)
    run = simulate(MELLAH.motor, inputs, {"theta": 0.0})
    values, _ = cold.run(
        np.full(2001, 1e-3), voltage + 0.5 * rng.standard_normal(2001), run.current_A + 0.05 * rng.standard_normal(2001),
        np.full(2001, 20.0),
    )  # fmt: skip
    magnets = values[:, cold.outputs.index("theta_m")]
    assert magnets[0] > 10.0
    assert abs(magnets[-1]) < 6.0


def test_nothing_is_learned_at_rest_without_current(watching):
    n = 20_000
    rng = np.random.default_rng(0)
    values, _ = watching.run(
        np.full(n, 0.01), 0.5 * rng.standard_normal(n), 0.05 * rng.standard_normal(n), np.full(n, 20.0)
    )
    seen = dict(zip(watching.outputs, values.T, strict=True))
    # From white noise alone: it stays where the cooling law puts its first guess (half cold, half 24 K), and as unsure as it
    # began: the interval holds any warm start.
    cooling = np.exp(-200.0 * MELLAH.motor.k0 / MELLAH.motor.H)
    assert seen["temperature"][-1] == pytest.approx(12.0 * cooling, rel=0.05)
    sd = np.exp(0.5 * seen["log_temperature"])
    assert sd[-1] == pytest.approx(sd[0] * cooling, rel=0.05)
    assert 1.25 * 36.0 < sd[0] < 1.45 * 36.0
    assert np.abs(seen["speed"][1000:]).max() < 3.0


@pytest.mark.fit
def test_deviation_widens_without_excitation_and_narrows_at_a_step():
    # Of the filter's own deviation: that the motor is the file's, and its resistance with it, is beyond doubt, and no cold
    # start knows better.
    file = replace(MELLAH, knowledge={**MELLAH.knowledge, "R_a0": Knowledge(0.0)})
    doubting = observer(file, replace(SETTINGS, thermal_walk=0.1, others=1e-6))
    n, at = 60_000, 40_000
    rng = np.random.default_rng(1)
    time = np.arange(n) * 0.01
    voltage = np.where(time < 1.0, 0.0, np.where(np.arange(n) < at, 200.0, 120.0))
    inputs = Inputs(time, voltage, np.full(n, 5.0), np.full(n, 20.0), held=True)
    run = simulate(MELLAH.motor, inputs, {"theta": 40.0})
    values, _ = doubting.run(
        np.full(n, 0.01),
        voltage + 0.5 * rng.standard_normal(n),
        run.current_A + 0.05 * rng.standard_normal(n),
        np.full(n, 20.0),
    )
    sd = np.exp(0.5 * dict(zip(doubting.outputs, values.T, strict=True))["log_temperature"])
    assert sd[300] < 3.0
    assert sd[at - 1] > 1.5 * sd[1000]
    assert sd[at + 300] < 0.7 * sd[at - 1]


@pytest.mark.fit
def test_an_effect_in_the_motor_file_reaches_the_observer():
    # 1.5 V at the brushes look like 1.6 rad/s to an observer that does not know of them.
    true = with_overrides(MELLAH, {"brush_voltage_drop.V_b": 1.5})
    rng = np.random.default_rng(2)
    recording = measure(perform(true, chosen_scenario("duty", 150.0, 500.0), rng), (), NOISE, rng)
    errors = {}
    for name, file in (("knows", true), ("ignores", MELLAH)):
        seen = follow(observer(file, SETTINGS), recording)
        rows = counted(recording, MELLAH)
        errors[name] = np.sqrt(np.mean((seen["speed"] - recording.channels["speed"])[rows] ** 2))
    assert errors["knows"] < 0.5 * errors["ignores"]


def test_a_gap_is_forgotten_within_a_second(watching):
    recording = measured_duty(5, 120.0, 500.0)
    kept = (recording.time_s < 40) | (recording.time_s > 70)
    cut = replace(
        recording, time_s=recording.time_s[kept], channels={q: y[kept] for q, y in recording.channels.items()}
    )
    seen = follow(watching, cut)
    assert all(np.isfinite(y).all() for y in seen.values())
    after = cut.time_s > 72
    error = (seen["speed"] - cut.channels["speed"])[after]
    assert np.sqrt(np.mean(error**2)) < 2.0


# ---- one sensor, everywhere


@pytest.mark.fit
def test_file_step_graph_and_runtime_agree_with_training(tmp_path):
    built = small_sensor(True)
    write_sensor(built.sensor, built.card, golden(built.sensor), tmp_path / "small.onnx")
    recording = measured_duty(3, 20.0, 200.0)
    time, v, i = recording.time_s, recording.channels["voltage"], recording.channels["current"]
    estimate, sigma = built.sensor.evaluate(feature_rows(built.sensor.bank, time, v, i, first_dt_s=0.005))
    scale = np.array([output.scale for output in built.sensor.specification.outputs])

    session = onnxruntime.InferenceSession(
        (tmp_path / "small.step.onnx").read_bytes(), providers=["CPUExecutionProvider"]
    )
    state, dt = np.zeros(session.get_inputs()[-1].shape[0]), np.diff(time, prepend=time[0] - 0.005)
    stepped = []
    for k in range(1500):
        value, deviation, state = session.run(
            None, {"voltage": v[k : k + 1], "current": i[k : k + 1], "dt": dt[k : k + 1], "state": state}
        )
        stepped.append((value, deviation))
    found = np.array(stepped)
    assert np.max(np.abs(found[:, 0] - estimate[:1500]) / scale) < 1e-9
    assert np.max(np.abs(found[:, 1] - sigma[:1500]) / scale) < 1e-9

    runtime = Estimator(load_sensor(tmp_path / "small.onnx"), 0.005)
    whole = runtime.push(Samples(np.round(time * 1e9).astype(np.int64), v, i))
    assert np.max(np.abs(whole.values - estimate) / scale) < 1e-4
    assert np.max(np.abs(whole.sigma - sigma) / scale) < 1e-4
