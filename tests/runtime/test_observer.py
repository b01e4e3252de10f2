"""A sensor with a physics observer: the runtime's interpreter of its programs against the trainer's compiled one."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from helpers.sensor_files import features_by_loop, make_spec, write_sensor

from motorlens_physics.motor_file import read_motor_file
from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.observer import Observer
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import load_sensor

MOTOR = Path(__file__).resolve().parents[2] / "models" / "motors" / "mellah2016.toml"


@pytest.fixture(scope="module")
def trained():
    """The trainer's observer of the paper's motor."""
    pytest.importorskip("sympy")
    observer = pytest.importorskip("motorlens_train.observer.design")
    return observer.observer(read_motor_file(MOTOR))


def spec_with(trained):
    spec = make_spec()
    spec["observer"] = json.loads(json.dumps(trained.document()))
    spec["features"] += [{"kind": "observer", "output": k} for k in range(len(trained.outputs))]
    n = len(spec["features"])
    spec["envelope"]["features"] = {
        "mean": [0.0] * n,
        "precision_cholesky": np.eye(n).tolist(),
        "limit": 1e12,
    }
    return spec


def features_with(trained):
    def features(spec, time_s, voltage, current, ambient=None):
        plain = {**spec, "features": [f for f in spec["features"] if f["kind"] != "observer"]}
        dt = np.diff(time_s, prepend=time_s[0] - 1 / spec["sample_rate_Hz"]["nominal"])
        outputs, _ = trained.run(dt, voltage, current, np.full(len(dt), trained.ambient_C))
        return np.hstack((features_by_loop(plain, time_s, voltage, current), outputs))

    return features


def start_up(n, seed=0):
    """Direct on line, roughly: 240 V, an inrush that decays, noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(n)
    voltage = 240 + 0.3 * rng.normal(size=n)
    return Samples(
        t * 1_000_000, voltage, 7 + 50 * np.exp(-t / 120) * (1 - np.exp(-t / 10)) + 0.1 * rng.normal(size=n)
    )


def run(sensor, samples, edges=()):
    estimator = open_estimator(sensor, 1e-3)
    parts = [
        estimator.push(Samples(samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows]))
        for rows in np.split(np.arange(len(samples)), np.sort(edges).astype(int))
    ]
    return Estimates(
        *(np.concatenate([getattr(p, f) for p in parts]) for f in Estimates.__dataclass_fields__)
    )


@pytest.mark.fit
def test_outputs_are_those_of_the_trainer(trained):
    samples, n = start_up(3000), 3000
    ours = Observer(json.loads(json.dumps(trained.document())))
    dt = np.full(n, 1e-3)
    dt[[500, 900]] = [0.7, 0.1]
    _, outputs = ours.advance(
        ours.start(), samples.voltage_V, samples.current_A, None, dt, np.ones(n, dtype=bool), None
    )
    expected, _ = trained.run(dt, samples.voltage_V, samples.current_A, np.full(n, trained.ambient_C))
    scale = 1 + np.abs(expected).max(axis=0)
    assert np.abs((outputs - expected) / scale).max() < 1e-9
    assert np.ptp(expected[:, 0]) > 10  # it estimates a speed that moves


@pytest.mark.fit
@pytest.mark.parametrize("pause_s", [1.0, 60.0, 3600.0, 86400.0])
def test_a_pause_of_any_length_leaves_an_observer_that_works(trained, pause_s):
    """Off for a while: the winding cools towards the surroundings, and the next start is followed again."""
    n = 3000
    samples, ones = start_up(n), np.ones(n, dtype=bool)
    observer, dt = Observer(json.loads(json.dumps(trained.document()))), np.full(n, 1e-3)
    columns = (samples.voltage_V, samples.current_A, None, dt, ones, None)
    state, first = observer.advance(observer.start(), *columns)
    state, zero = observer.rest(state, pause_s, None), np.zeros(1)
    _, off = observer.advance(state, zero, zero, None, zero, ones[:1], None)
    _, second = observer.advance(state, *columns)
    assert np.isfinite(off).all() and np.isfinite(second).all()
    speed, rise = trained.outputs.index("speed"), trained.outputs.index("temperature")
    assert second[-1, speed] == pytest.approx(first[-1, speed], rel=0.05)
    # The fall to 0 V lies within one step of the rest, 0.4 s long: what it moves is below 1 K.
    assert off[0, rise] < first[-1, rise] + 1.0
    if pause_s > 3 * 3600:  # about 4 H/k0 = 70 min each
        assert abs(off[0, rise]) < 0.2 * first[-1, rise]


@pytest.mark.fit
@pytest.mark.usefixtures("engine")
def test_estimates_and_their_bits(trained, tmp_path):
    path = tmp_path / "s.onnx"
    spec, network = write_sensor(path, spec=spec_with(trained), features=features_with(trained))
    samples = start_up(700)
    sensor = load_sensor(path)
    whole = run(sensor, samples)
    features = features_with(trained)(spec, samples.time_ns * 1e-9, samples.voltage_V, samples.current_A)
    scale = [output["scale"] for output in spec["outputs"]]
    assert np.abs((whole.values - network(features)[0]) / scale).max() < 2e-5
    rng = np.random.default_rng(0)
    for _ in range(10):
        cut = run(sensor, samples, rng.integers(0, 700, 20))
        assert all(np.array_equal(getattr(cut, f), getattr(whole, f)) for f in Estimates.__dataclass_fields__)
    rows = np.flatnonzero(rng.random(700) < 0.1)
    some = open_estimator(sensor, 1e-3).push(samples, rows)
    assert np.array_equal(some.values, whole.values[rows]) and np.array_equal(
        some.quality, whole.quality[rows]
    )


@pytest.mark.fit
@pytest.mark.usefixtures("engine")
def test_rubbish_is_passed_over(trained, tmp_path):
    path = tmp_path / "s.onnx"
    write_sensor(path, spec=spec_with(trained), features=features_with(trained))
    sensor, samples = load_sensor(path), start_up(400)
    bad = Samples(samples.time_ns, samples.voltage_V.copy(), samples.current_A.copy())
    bad.voltage_V[200:203], bad.current_A[300] = np.nan, np.inf
    result = run(sensor, bad)
    assert np.isfinite(result.values).all() and np.isfinite(result.sigma).all()
    assert np.flatnonzero(result.quality & Quality.NOT_FINITE).tolist() == [200, 201, 202, 300]


def program(inputs, constants, steps, outputs):
    return {"inputs": ["x"] * inputs, "constants": constants, "steps": steps, "outputs": outputs}


def tiny(**changes):
    """State (last, time): `accumulate` keeps the voltage and adds dt, `correct` clears the time, `read` is log(last)."""
    return {
        "period_s": 0.0099, "ambient_C": 20.0, "size": 2, "window": 2, "time": 1, "outputs": ["log"],
        "accumulate": program(6, [], [["add", 5, 3]], [0, 6]),
        "correct": program(3, [0.0], [], [1, 3]),
        "read": program(3, [], [["log", 1]], [3]),
        **changes,
    }  # fmt: skip


def test_arithmetic_that_fails_starts_the_observer_afresh():
    observer = Observer(tiny())
    voltage = np.array([math.e, -1.0, math.e, math.e])
    ones, dt = np.ones(4, dtype=bool), np.full(4, 1e-3)
    _, read = observer.advance(observer.start(), voltage, voltage, None, dt, ones, None)
    assert read[[0, 2, 3], 0] == pytest.approx([1, 1, 1], abs=1e-15) and np.isnan(read[1, 0])
    state, _ = observer.advance(
        observer.start(), voltage[[0, 2, 3]], voltage[:3], None, dt[:3], ones[:3], None
    )
    assert state == pytest.approx((math.e, 0.003))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"read": program(3, [], [["system", 1]], [3])}, "unknown operation 'system'"),
        ({"read": program(3, [], [["log", 9]], [3])}, "log of"),
        ({"read": program(3, [], [["log", 1, 2]], [3])}, "log of"),
        ({"read": program(3, [], [["log", 1]], [9])}, "unknown register"),
        ({"read": program(4, [], [["log", 1]], [3])}, "program of 4 inputs"),
        ({"read": program(3, ["__import__('os')"], [["log", 1]], [3])}, "could not convert"),
        ({"read": program(3, [float("nan")], [["log", 1]], [3])}, "not a number"),
        ({"time": 7}, "layout"),
        ({"period_s": 0}, "layout"),
    ],
)
def test_a_document_that_is_no_observer_is_refused(change, words, tmp_path):
    with pytest.raises((ValueError, KeyError), match=words):
        Observer(tiny(**change))


@pytest.mark.usefixtures("engine")
def test_a_feature_of_an_output_that_is_not_there_is_refused(tmp_path):
    spec = make_spec()
    spec["observer"] = tiny()
    spec["features"].append({"kind": "observer", "output": 1})
    n = len(spec["features"])
    spec["envelope"]["features"] = {
        "mean": [0.0] * n,
        "precision_cholesky": np.eye(n).tolist(),
        "limit": 1e12,
    }
    write_sensor(tmp_path / "s.onnx", spec=spec, features=lambda spec, t, *rest: np.zeros((len(t), n)))
    with pytest.raises(ModelError, match="output of the observer that is not there"):
        load_sensor(tmp_path / "s.onnx")


@pytest.mark.usefixtures("engine")
def test_an_observer_alone_without_filters(tmp_path):
    spec = make_spec(outputs=1)
    spec["observer"] = tiny(read=program(3, [], [["abs", 1]], [3]))
    spec["filters"], spec["features"] = [], [{"kind": "observer", "output": 0}]
    spec["envelope"].pop("features")
    features = lambda spec, t, v, *rest: np.abs(v)[:, None]  # noqa: E731
    _, network = write_sensor(tmp_path / "s.onnx", spec=spec, features=features)
    samples = start_up(200)
    result = run(load_sensor(tmp_path / "s.onnx"), samples)
    assert np.abs(result.values - network(features(spec, None, samples.voltage_V))[0]).max() < 2e-5 * 120


@pytest.mark.fit
@pytest.mark.usefixtures("engine")
def test_heat_in_an_observer_is_remembered(trained, tmp_path):
    """Warm, off for an hour, restored from the file: the observer stands where a rest of an hour would have brought it."""
    snapshot = pytest.importorskip("motorlens_runtime.service.snapshot")
    write_sensor(tmp_path / "s.onnx", spec=spec_with(trained), features=features_with(trained))
    sensor = load_sensor(tmp_path / "s.onnx")
    estimator = open_estimator(sensor, 1e-3)
    estimator.push(start_up(3000))
    snapshot.save(tmp_path / "heat", snapshot.take(sensor, "d", estimator.state, 10**18))
    restored = snapshot.restore(snapshot.load(tmp_path / "heat"), sensor, "d", 10**18 + 3600 * 10**9)
    observer, zero, one = sensor.extractor.observer, np.zeros(1), np.ones(1, dtype=bool)
    assert restored.state.observer == observer.rest(estimator.state.observer, 3600.0, None)
    assert observer.noise and all(
        restored.state.observer[k] == estimator.state.observer[k] != 0.0 for k in observer.noise
    )  # nobody measured the zeros of a rest
    rise = trained.outputs.index("temperature")
    rises = [
        observer.advance(state, zero, zero, None, zero, one, None)[1][0, rise]
        for state in (estimator.state.observer, restored.state.observer)
    ]
    motor = read_motor_file(MOTOR).motor
    # k0 theta leaves a body of H; the speed at the start, for some seconds, only adds to it
    assert rises[1] / rises[0] == pytest.approx(np.exp(-3600 * motor.k0 / motor.H), rel=0.05)
