"""Loading a sensor: it comes out as a slow reading of its document says, and damage is refused in one line."""

import json
import re

import numpy as np
import onnx
import pytest
from helpers.sensor_files import features_by_loop, make_spec, seal, write_sensor

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.estimator import Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor.onnx_file import parse
from motorlens_runtime.sensor.sensor import load_sensor


def recording(n, rng, irregular=False):
    time_ns = np.cumsum(rng.integers(200_000, 3_000_000, n) if irregular else np.full(n, 1_000_000))
    return Samples(
        time_ns,
        rng.uniform(-200, 200, n),
        20 * np.sin(np.arange(n) / 50) + rng.normal(size=n),
        rng.uniform(10, 30, n),
    )


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("backend", ["onnxruntime", "numpy"])
@pytest.mark.parametrize("ambient", [False, True])
def test_estimates_are_those_of_a_loop_over_the_document(tmp_path, dtype, irregular, backend, ambient):
    spec, network = write_sensor(tmp_path / "s.onnx", dtype=dtype, ambient=ambient)
    samples = recording(500, np.random.default_rng(1), irregular)
    result = Estimator(load_sensor(tmp_path / "s.onnx", backend), 1e-3).push(samples)
    features = features_by_loop(
        spec, samples.time_ns * 1e-9, samples.voltage_V, samples.current_A, samples.ambient_C
    )
    scale = [output["scale"] for output in spec["outputs"]]
    tolerance = 2e-5 if dtype == np.float32 else 1e-11
    for value, expected in zip((result.values, result.sigma), network(features), strict=True):
        assert np.abs((value - expected) / scale).max() < tolerance
        assert (np.ptp(expected, axis=0) / scale).min() > 0.05  # the test sees something move


def test_fewer_outputs(engine, tmp_path):
    write_sensor(tmp_path / "s.onnx", outputs=1)
    sensor = load_sensor(tmp_path / "s.onnx")
    assert [output.heading for output in sensor.specification.outputs] == ["speed_rad_s"]
    assert Estimator(sensor, 1e-3).push(recording(5, np.random.default_rng(0))).values.shape == (5, 1)


def test_the_two_readers_of_the_file_agree(tmp_path):
    write_sensor(tmp_path / "s.onnx")
    data = (tmp_path / "s.onnx").read_bytes()
    ours, theirs = parse(data, "s"), onnx.load_from_string(data)
    assert ours.metadata == {entry.key: entry.value for entry in theirs.metadata_props}
    assert [node.op for node in ours.nodes] == [node.op_type for node in theirs.graph.node]
    for tensor in theirs.graph.initializer:
        assert np.array_equal(ours.constants[tensor.name], onnx.numpy_helper.to_array(tensor))


def test_every_flipped_bit_and_every_truncation_is_refused(tmp_path):
    path = tmp_path / "s.onnx"
    write_sensor(path)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for at in rng.integers(0, len(data), 150):
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        with pytest.raises(ModelError):
            load_sensor(path)
    for length in [0, 1, 100, len(data) // 2, len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(ModelError, match=r"empty|cut short"):
            load_sensor(path)
    path.write_bytes(data + b"\0")
    with pytest.raises(ModelError, match="altered or cut short"):
        load_sensor(path)


def resealed(path, change):
    model = onnx.load(path)
    change(model)
    path.write_bytes(seal(model.SerializeToString()))


def entry(model, key):
    return next(prop for prop in model.metadata_props if prop.key == key)


def set_spec(**changes):
    def change(model):
        prop = entry(model, "motorlens.spec")
        prop.value = json.dumps({**json.loads(prop.value), **changes})

    return change


def wrong_weight(model):
    tensor = next(t for t in model.graph.initializer if t.name == "w3")
    array = onnx.numpy_helper.to_array(tensor).copy()
    array[0, 0] += 0.1
    tensor.CopyFrom(onnx.numpy_helper.from_array(array, "w3"))


def set_entry(key, value):
    return lambda model: setattr(entry(model, key), "value", value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (wrong_weight, "golden values do not come out"),
        (set_entry("motorlens.schema", "motorlens.sensor/2"), "schema 'motorlens.sensor/2'"),
        (set_entry("motorlens.golden", "[]"), "not a JSON object"),
        (set_entry("motorlens.golden", "{}"), "golden sequence is damaged"),
        (set_entry("motorlens.golden", "{nan"), "not a JSON object"),
        (set_entry("motorlens.spec", "{"), "specification is damaged"),
        (set_spec(outputs=[{"name": "torque", "unit": "N*m", "scale": 1.0}]), "unknown output 'torque'"),
        (
            set_spec(outputs=[{"name": "speed", "unit": "rpm", "scale": 1.0}]),
            "unknown output 'speed' in 'rpm'",
        ),
        (set_spec(filters=[{"signal": "flux", "tau_s": 1.0}]), "unknown signal 'flux'"),
        (set_spec(filters=[{"signal": "current", "tau_s": 0.0}]), "not positive"),
        (set_spec(filters=[]), "filter that is not there"),
        (set_spec(features=[{"kind": "cubed", "signal": "current"}]), "unknown feature 'cubed'"),
        (set_spec(observer={"kind": "ekf"}), "specification is damaged .KeyError: 'outputs'"),
        (set_spec(inputs=["voltage"]), "inputs"),
        (set_spec(schema="motorlens.spec/9"), "motorlens.spec/9"),
        (set_spec(envelope={"voltage_V": [0, float("nan")], "current_A": [0, 1]}), "not finite"),
        (lambda model: model.graph.node.pop(), "ONNX Runtime does not run it|graph of"),
    ],
)
def test_what_cannot_be_believed_is_refused_in_one_line(engine, tmp_path, change, message):
    path = tmp_path / "s.onnx"
    write_sensor(path)
    resealed(path, change)
    with pytest.raises(ModelError, match=message) as caught:
        load_sensor(path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < 400


def test_absent_file_and_other_files(tmp_path):
    with pytest.raises(ModelError, match="No such file"):
        load_sensor(tmp_path / "none.onnx")
    (tmp_path / "text.onnx").write_text("time_s,voltage_V\n")
    with pytest.raises(ModelError, match="not a motorlens sensor"):
        load_sensor(tmp_path / "text.onnx")


def test_an_operation_unknown_to_numpy_leaves_onnx_runtime(tmp_path):
    path = tmp_path / "s.onnx"
    write_sensor(path)

    def to_elu(model):
        node = next(n for n in model.graph.node if n.output[0] == "estimate")
        node.output[0] = "inner"
        model.graph.node.insert(
            len(model.graph.node), onnx.helper.make_node("HardSwish", ["inner"], ["estimate"])
        )

    resealed(path, to_elu)
    with pytest.raises(ModelError, match=r"numpy backend has no HardSwish"):
        load_sensor(path, "numpy")
    with pytest.raises(ModelError, match="golden values do not come out: onnxruntime"):
        load_sensor(path)


def test_no_input_of_a_parser_escapes_as_another_error(tmp_path):
    write_sensor(tmp_path / "s.onnx")
    data = (tmp_path / "s.onnx").read_bytes()
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(300):
        damaged = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 20)):
            damaged[at] = rng.integers(256)
        try:
            parse(bytes(damaged), "s")
        except ModelError as error:
            assert re.match("s: ", str(error))
            refused += 1
    assert refused > 0


def test_spec_of_the_helper_is_the_documented_one():
    assert make_spec()["schema"] == "motorlens.spec/1"
