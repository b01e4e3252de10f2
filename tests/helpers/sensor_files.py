"""A random but valid sensor file, and a slow reading of docs/sensor-file.md to compare the runtime with.

Written with the onnx package and plain loops: it shares no code with the runtime or with training.
"""

import hashlib
import json
import math
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OUTPUTS = (
    {"name": "speed", "unit": "rad/s", "scale": 120.0},
    {"name": "temperature", "unit": "K", "scale": 40.0},
    {"name": "resistance", "unit": "ohm", "scale": 0.5},
)


def make_spec(outputs=3, ambient=False, limit=1e9, rate_Hz=1000.0, warm_up_s=0.05):
    filters = [
        {"signal": "current", "tau_s": 0.01},
        {"signal": "current_squared", "tau_s": 900.0},
        {"signal": "emf", "tau_s": 0.3},
        {"signal": "one", "tau_s": 20.0},
        {"signal": "emf_power", "tau_s": 5.0},
        {"signal": "voltage_squared", "tau_s": 0.1},
    ]
    features = [
        {"kind": "raw", "signal": "voltage"},
        {"kind": "lowpass", "filter": 0},
        {"kind": "difference", "signal": "current", "filter": 0},
        {"kind": "lowpass", "filter": 1},
        {"kind": "lowpass", "filter": 2},
        {"kind": "lowpass", "filter": 3},
        {"kind": "between", "filters": [4, 1]},
        {"kind": "lowpass", "filter": 5},
    ]
    if ambient:
        filters.append({"signal": "ambient", "tau_s": 60.0})
        features.append({"kind": "lowpass", "filter": 6})
    n = len(features)
    listed = [dict(output) for output in OUTPUTS[:outputs]]
    if ambient and outputs > 1:
        listed[1]["unit"] = "degC"
    return {
        "schema": "motorlens.spec/1",
        "outputs": listed,
        "inputs": ["voltage", "current", *(["ambient"] if ambient else [])],
        "resistance_ohm": 3.5,
        "inductance_H": 0.034,
        "filters": filters,
        "features": features,
        "sample_rate_Hz": {"nominal": rate_Hz, "minimum": rate_Hz / 20, "maximum": rate_Hz * 20},
        "warm_up_s": warm_up_s,
        "envelope": {
            "voltage_V": [-264.0, 264.0],
            "current_A": [-75.0, 75.0],
            "features": {"mean": [0.0] * n, "precision_cholesky": np.eye(n).tolist(), "limit": limit},
        },
    }


def signal(name, v, i, ambient, resistance):
    e = v - resistance * i
    return {
        "one": 1.0, "voltage": v, "current": i, "current_squared": i * i, "voltage_squared": v * v, "power": v * i,
        "emf": e, "emf_squared": e * e, "emf_power": e * i, "ambient": ambient,
    }[name]  # fmt: skip


def features_by_loop(spec, time_s, voltage, current, ambient=None):
    """The features of docs/sensor-file.md, one sample, one filter at a time."""
    state = [0.0] * len(spec["filters"])
    rows, previous = [], None
    for k, t in enumerate(time_s):
        dt = 1 / spec["sample_rate_Hz"]["nominal"] if previous is None else t - previous
        previous = t
        read = lambda name, k=k: signal(  # noqa: E731
            name, voltage[k], current[k], None if ambient is None else ambient[k], spec["resistance_ohm"]
        )
        for f, entry in enumerate(spec["filters"]):
            u = read(entry["signal"])
            state[f] = u + (state[f] - u) * math.exp(-dt / entry["tau_s"])
        row = []
        for entry in spec["features"]:
            kind = entry["kind"]
            if kind == "raw":
                row.append(read(entry["signal"]))
            elif kind == "lowpass":
                row.append(state[entry["filter"]])
            elif kind == "difference":
                row.append(read(entry["signal"]) - state[entry["filter"]])
            else:
                row.append(state[entry["filters"][0]] - state[entry["filters"][1]])
        rows.append(row)
    return np.array(rows)


def source(spec, feature):
    """The signal that a feature is made of, "observer" for one of an observer's outputs."""
    if feature["kind"] in ("raw", "difference", "observer"):
        return feature.get("signal", "observer")
    return spec["filters"][feature.get("filters", [feature.get("filter")])[0]]["signal"]


class Network:
    """A cascade network with random weights: two hidden layers, each sees the inputs too."""

    def __init__(self, spec, rng, dtype=np.float32, hidden=6):
        n, k = len(spec["features"]), len(spec["outputs"])
        self.dtype = dtype
        typical = {
            "voltage": 200,
            "current": 40,
            "current_squared": 1000,
            "emf": 300,
            "one": 1,
            "emf_power": 8000,
        }
        typical |= {"voltage_squared": 40000, "ambient": 40, "observer": 100}
        self.scale = np.array([typical[source(spec, feature)] for feature in spec["features"]], dtype=dtype)
        self.w1 = rng.normal(size=(n, hidden)).astype(dtype) / 3
        self.b1 = rng.normal(size=hidden).astype(dtype)
        self.w2 = rng.normal(size=(n + hidden, hidden)).astype(dtype) / 3
        self.b2 = rng.normal(size=hidden).astype(dtype)
        self.w3 = rng.normal(size=(2 * hidden, k)).astype(dtype)
        self.w4 = rng.normal(size=(hidden, k)).astype(dtype) / 4
        self.size = np.array([output["scale"] for output in spec["outputs"]], dtype=dtype)

    def __call__(self, features):
        x = np.asarray(features, dtype=np.float64) / self.scale
        a = np.tanh(x @ self.w1.astype(float) + self.b1)
        b = np.tanh(np.hstack((x, a)) @ self.w2.astype(float) + self.b2)
        return np.hstack((a, b)) @ self.w3.astype(float) * self.size, np.exp(
            b @ self.w4.astype(float)
        ) * self.size

    def graph(self):
        constants = {
            name: getattr(self, name) for name in ("scale", "w1", "b1", "w2", "b2", "w3", "w4", "size")
        }
        nodes = [
            helper.make_node("Div", ["features", "scale"], ["x"]),
            helper.make_node("Gemm", ["x", "w1", "b1"], ["p1"]),
            helper.make_node("Tanh", ["p1"], ["a"]),
            helper.make_node("Concat", ["x", "a"], ["xa"], axis=1),
            helper.make_node("Gemm", ["xa", "w2", "b2"], ["p2"]),
            helper.make_node("Tanh", ["p2"], ["b"]),
            helper.make_node("Concat", ["a", "b"], ["ab"], axis=1),
            helper.make_node("MatMul", ["ab", "w3"], ["y"]),
            helper.make_node("Mul", ["y", "size"], ["estimate"]),
            helper.make_node("MatMul", ["b", "w4"], ["s"]),
            helper.make_node("Exp", ["s"], ["es"]),
            helper.make_node("Mul", ["es", "size"], ["sigma"]),
        ]
        kind = TensorProto.FLOAT if self.dtype == np.float32 else TensorProto.DOUBLE
        value = helper.make_tensor_value_info
        return helper.make_graph(
            nodes, "core", [value("features", kind, ["N", len(self.scale)])],
            [value("estimate", kind, ["N", len(self.size)]), value("sigma", kind, ["N", len(self.size)])],
            [numpy_helper.from_array(array, name) for name, array in constants.items()],
        )  # fmt: skip


def seal(data):
    """Put the SHA-256 into the place that the file keeps for it."""
    marker = b"motorlens.sha256\x12\x40"
    at = data.index(marker) + len(marker)
    empty = data[:at] + b"0" * 64 + data[at + 64 :]
    return empty[:at] + hashlib.sha256(empty).hexdigest().encode() + empty[at + 64 :]


def write_sensor(
    path, *, seed=0, dtype=np.float32, spec=None, golden=None, features=features_by_loop, **options
):
    """Write a random sensor to `path`; `features` computes its golden rows. Returns (spec, network)."""
    rng = np.random.default_rng(seed)
    spec = spec or make_spec(**options)
    network = Network(spec, rng, dtype)
    n = 30
    time_s = np.cumsum(rng.choice([0.001, 0.002, 0.5], size=n))
    voltage, current, ambient = rng.uniform(-200, 200, n), rng.uniform(-40, 40, n), rng.uniform(10, 40, n)
    estimate, sigma = network(features(spec, time_s, voltage, current, ambient))
    document = {
        "time_s": time_s.tolist(), "voltage_V": voltage.tolist(), "current_A": current.tolist(),
        "ambient_C": ambient.tolist(),
        "estimate": estimate.tolist(), "sigma": sigma.tolist(), "tolerance": 1e-4,
    }  # fmt: skip
    model = helper.make_model(network.graph(), opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    entries = {
        "motorlens.schema": "motorlens.sensor/1",
        "motorlens.name": "random",
        "motorlens.version": "1",
        "motorlens.licence": "MIT",
        "motorlens.spec": json.dumps(spec),
        "motorlens.card": "{}",
        "motorlens.golden": json.dumps({**document, **(golden or {})}),
        "motorlens.sha256": "0" * 64,
    }
    helper.set_model_props(model, entries)
    onnx.checker.check_model(model)
    Path(path).write_bytes(seal(model.SerializeToString()))
    return spec, network
