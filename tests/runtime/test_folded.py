"""The folded graph against ONNX Runtime on the graph as it is, operation by operation and in random mixtures."""

import tracemalloc
from dataclasses import replace

import numpy as np
import onnx
import onnxruntime as ort
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from onnx import helper, numpy_helper

from motorlens_runtime.errors import ModelError
from motorlens_runtime.sensor.backend import TILE, NumpyBackend
from motorlens_runtime.sensor.folded import Linear, centred, fold
from motorlens_runtime.sensor.onnx_file import parse

FEATURES = 6
RNG = np.random.default_rng(5)
CONSTANTS = {
    "square": RNG.normal(size=(6, 6)), "row": RNG.normal(size=6), "positive": RNG.uniform(0.5, 2.0, 6), "two": np.array(2.0),
    "low": np.array(-0.5), "high": np.array(0.7), "wide": RNG.normal(size=(18, 6)), "three": RNG.normal(size=(3, 6)),
    "starts": np.array([4]), "ends": np.array([0]), "axes": np.array([1]), "steps": np.array([-1]),
    "order": np.array([5, 0, 3, 3, 1, 2]), "sizes": np.array([2, 4]), "last": RNG.normal(size=(6, 3)),
}  # fmt: skip
# Each takes x (N, 6) and gives y (N, 6).
OPERATIONS = {
    "Add": [("Add", ["x", "row"], {})],
    "Add of scalar": [("Add", ["two", "x"], {})],
    "Sub": [("Sub", ["row", "x"], {})],
    "Mul": [("Mul", ["x", "row"], {})],
    "Mul from the left": [("Mul", ["two", "x"], {})],
    "Div": [("Div", ["x", "positive"], {})],
    "Div by variable": [("Exp", ["x"], {}, "t"), ("Div", ["row", "t"], {})],
    "Neg": [("Neg", ["x"], {})],
    "MatMul": [("MatMul", ["x", "square"], {})],
    "Gemm": [("Gemm", ["x", "square", "row"], {"transB": 1, "alpha": 0.5, "beta": 2.0})],
    "Gemm without bias": [("Gemm", ["x", "square"], {})],
    "Product of two": [("MatMul", ["x", "square"], {}, "t"), ("Mul", ["x", "t"], {})],
    "Square": [("Mul", ["x", "x"], {})],
    "Concat": [("Tanh", ["x"], {}, "t"), ("Concat", ["x", "t", "x"], {"axis": 1}, "c"), ("MatMul", ["c", "wide"], {})],
    "Slice": [("Slice", ["x", "starts", "ends", "axes", "steps"], {}, "s"), ("Concat", ["s", "x"], {"axis": -1}, "c"),
              ("Gather", ["c", "order"], {"axis": 1})],
    "Split": [("Split", ["x", "sizes"], {"axis": 1}, "a", "b"), ("Concat", ["b", "a"], {"axis": 1})],
    "Gather": [("Gather", ["x", "order"], {"axis": 1})],
    "Cast of a constant": [("Cast", ["row"], {"to": 11}, "r"), ("Add", ["x", "r"], {})],
    "Sum of constants": [("Add", ["row", "two"], {}, "r"), ("Mul", ["x", "r"], {})],
    "Clip": [("Clip", ["x", "low", "high"], {})],
    "Clip above": [("Clip", ["x", "", "high"], {})],
    "Clip below": [("Clip", ["x", "low"], {})],
    "Max": [("Max", ["x", "row"], {})],
    "Min": [("Min", ["row", "x"], {})],
    "Sqrt": [("Abs", ["x"], {}, "t"), ("Sqrt", ["t"], {})],
    "Log": [("Exp", ["x"], {}, "t"), ("Log", ["t"], {})],
    "Pow": [("Pow", ["x", "two"], {})],
    "Reciprocal": [("Exp", ["x"], {}, "t"), ("Reciprocal", ["t"], {})],
    **{name: [(name, ["x"], {})] for name in ("Identity", "Tanh", "Exp", "Abs", "Relu", "Sigmoid", "Sin", "Cos")},
}  # fmt: skip


def graph(names):
    """The operations one after another, then three columns of the result, and their exponentials."""
    nodes, x = [], "features"
    for number, name in enumerate(names):
        for operation, inputs, attributes, *outputs in OPERATIONS[name]:
            mine = [x if i == "x" else f"{i}{number}" if i and i not in CONSTANTS else i for i in inputs]
            results = [f"{o}{number}" for o in outputs] or [f"y{number}"]
            nodes.append(helper.make_node(operation, mine, results, **attributes))
        x = f"y{number}"
    nodes.append(helper.make_node("MatMul", [x, "last"], ["estimate"]))
    nodes.append(helper.make_node("Tanh", ["estimate"], ["bounded"]))
    nodes.append(helper.make_node("Exp", ["bounded"], ["sigma"]))

    def port(name, width):
        return helper.make_tensor_value_info(name, onnx.TensorProto.DOUBLE, ["N", width])

    tensors = [numpy_helper.from_array(value, name) for name, value in CONSTANTS.items()]
    body = helper.make_graph(
        nodes, "g", [port("features", FEATURES)], [port("estimate", 3), port("sigma", 3)], tensors
    )
    model = helper.make_model(body, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    return model.SerializeToString()


def compare(names, rows=4 * TILE, always_finite=True):
    data = graph(names)
    x = np.random.default_rng(len(names)).normal(size=(rows, FEATURES))
    options = ort.SessionOptions()
    options.log_severity_level = 3
    # Its optimiser cannot fuse Relu and Clip of float64 and refuses the graph.
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    session = ort.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    tiles = x.reshape(-1, TILE, FEATURES).transpose(0, 2, 1)
    backend = NumpyBackend(fold(parse(data, "g"), FEATURES, "g"))
    ours = backend.evaluate(tiles)
    ports = ["estimate", "sigma"]
    # A cosine of 1e12 is as good as any other number: what sixteen units in the last place of a feature change by more than
    # the tolerance has no answer to agree on.
    nudged = session.run(ports, {"features": x * (1 + 2.0**-48)})
    for mine, theirs, near in zip(ours, session.run(ports, {"features": x}), nudged, strict=True):
        mine = mine.transpose(0, 2, 1).reshape(rows, 3)
        good = np.isfinite(mine)
        assert np.isfinite(theirs[good]).all() and (good.all() or not always_finite)
        tolerance = 1e-9 * np.abs(theirs[good]).max(initial=1.0)
        told = np.isclose(near[good], theirs[good], rtol=1e-9, atol=tolerance)
        assert told.all() or not always_finite
        np.testing.assert_allclose(mine[good][told], theirs[good][told], rtol=1e-9, atol=tolerance)
    for tile in range(len(tiles)):
        for alone, together in zip(backend.evaluate(tiles[tile : tile + 1]), ours, strict=True):
            assert np.array_equal(alone[0], together[tile], equal_nan=True)


@pytest.mark.parametrize("name", OPERATIONS)
def test_each_operation(name):
    compare([name])
    compare(["Tanh", name])


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.sampled_from(sorted(set(OPERATIONS) - {"Exp", "Pow", "Square", "Product of two"})), max_size=6
    )
)
@example(["Div by variable", "Div by variable", "Cos"])
def test_mixtures(names):
    compare(names, always_finite=False)


def test_softplus():
    """ONNX Runtime has it in float32 only."""
    OPERATIONS["Softplus"] = [("Softplus", ["x"], {})]
    try:
        backend = NumpyBackend(fold(parse(graph(["Softplus"]), "g"), FEATURES, "g"))
    finally:
        del OPERATIONS["Softplus"]
    x = np.random.default_rng(0).normal(scale=5.0, size=(1, FEATURES, TILE))
    expected = CONSTANTS["last"].T @ np.log1p(np.exp(x))
    np.testing.assert_allclose(backend.evaluate(x)[0], expected, rtol=1e-12)


def test_features_that_hardly_move_lose_nothing():
    """With weights of 1e6 on features that vary by 1e-6, sums of products are 1e-10 off; once the mean is taken away they
    are not. The oracle is the same sums in numpy's extended precision."""
    rng = np.random.default_rng(8)
    folded = fold(parse(graph(["Gemm", "Tanh", "Gemm"]), "g"), FEATURES, "g")
    mean = rng.uniform(1.0, 2.0, FEATURES)
    weights = folded.steps[0].arguments[0].weights * np.append(np.full(FEATURES, 1e6), 1.0)
    weights[:, FEATURES] -= weights[:, :FEATURES] @ mean
    folded = replace(folded, steps=(replace(folded.steps[0], arguments=(Linear(weights),)),))
    x = mean[:, None] + 1e-6 * rng.normal(size=(FEATURES, TILE))

    def error(around):
        form = centred(folded, around)
        columns = np.vstack([x if around is None else x - around[:, None], np.ones(TILE)])
        columns = columns.astype(np.longdouble)
        columns = np.vstack(
            [columns, np.tanh(form.steps[0].arguments[0].weights.astype(np.longdouble) @ columns)]
        )
        exact = form.estimate.weights.astype(np.longdouble) @ columns
        return np.max(np.abs(NumpyBackend(folded, around).evaluate(x[None])[0][0] - exact))

    assert error(None) > 1e-11 > 1e-14 > error(mean)


def test_many_tiles_are_the_bits_of_few():
    compare(["Gemm", "Tanh", "Concat", "Sigmoid"], rows=200 * TILE)


def test_memory_is_what_the_largest_call_needs():
    """Several sensors may be loaded at a time, and a live line gives them a tile at a time."""
    model = parse(graph(["Gemm", "Tanh", "Concat", "Sigmoid"]), "g")
    tiles = np.random.default_rng(0).normal(size=(64, FEATURES, TILE))
    tracemalloc.start()
    try:
        backend = NumpyBackend(fold(model, FEATURES, "g"))
        first = backend.evaluate(tiles[:1])[0]
        of_one = tracemalloc.get_traced_memory()[0]
        backend.evaluate(tiles)
        of_many = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    # A tile has 31 columns and 15 rows of products of 16 float64 each; the plan and what Python needs for it are 70 kB.
    assert 46 * TILE * 8 < of_one < 120_000
    assert 64 * 46 * TILE * 8 < of_many - of_one + 46 * TILE * 8 < 1.1 * 64 * 46 * TILE * 8
    assert np.array_equal(backend.evaluate(tiles[:1])[0], first)


@pytest.mark.parametrize(
    ("node", "message"),
    [
        (("MatMul", ["features", "features"], {}), "of two variables"),
        (("Concat", ["features", "features"], {"axis": 0}), "Concat of rows"),
        (("Gather", ["features", "order"], {"axis": 0}), "does not follow its graph"),
        (("HardSwish", ["features"], {}), "has no HardSwish"),
    ],
)
def test_what_is_not_followed_is_said(node, message):
    operation, inputs, attributes = node
    model = onnx.load_from_string(graph([]))
    model.graph.node.insert(0, helper.make_node(operation, inputs, ["odd"], **attributes))
    with pytest.raises(ModelError, match=message) as caught:
        NumpyBackend(fold(parse(model.SerializeToString(), "g"), FEATURES, "g"))
    assert "install onnxruntime" in str(caught.value)
