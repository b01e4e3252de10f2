"""Writing a sensor: one specification becomes a core graph and a step graph, byte for byte the same each
time.

The graphs are written node by node (no tracing, no torch), so that they hold nothing but the sensor.
docs/sensor-file.md is the contract with the runtime.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from motorlens_train.features import wiring
from motorlens_train.observer.nodes import observer_nodes
from motorlens_train.sensor import Learned, Sensor
from motorlens_train.specification import Bank, Cloud

OPSET, IR_VERSION = 17, 8
SEAL = "motorlens.sha256"
# exp() of the noise head is kept within this range of scaled variances, so that no input makes sigma
# overflow.
LOG_VARIANCE_RANGE = (-25.0, 10.0)

Numbers = NDArray[Any]


def core_graph(sensor: Sensor, metadata: Mapping[str, str]) -> bytes:
    """The core graph: `features [N, F] -> estimate [N, K], sigma [N, K]`, all float64."""
    graph = _Graph()
    estimate, sigma = _network(graph, sensor, "features")
    graph.add("Identity", [estimate], "estimate")
    graph.add("Identity", [sigma], "sigma")
    features, outputs = len(sensor.bank.features), len(sensor.specification.outputs)
    return graph.model(
        sensor.name,
        [("features", np.float64, ["N", features])],
        [("estimate", np.float64, ["N", outputs]), ("sigma", np.float64, ["N", outputs])],
        metadata,
    )


def step_graph(sensor: Sensor, metadata: Mapping[str, str]) -> bytes:
    """The step graph: `(voltage, current, [ambient,] dt, state) -> (estimate, sigma, next_state)`, all float64."""
    graph = _Graph()
    bank = sensor.bank
    filters, size = len(bank.filters), bank.observer.size if bank.observer else 0
    filtered = observed = "state"
    if filters and size:
        filtered, observed = graph.split("state", [filters, size])
    parts = [graph.exact([0.0])]
    kept = []
    if bank.signals:
        stack = graph.add("Concat", [_signal(graph, name, bank) for name in bank.signals], axis=0)
        state = _filtered(graph, bank, stack, filtered)
        parts, kept = [stack, state, *parts], [state]
    if bank.observer:
        ambient = "ambient" if bank.ambient else graph.exact([bank.observer.ambient_C])
        outputs_seen, after = observer_nodes(
            graph, bank.observer, "voltage", "current", ambient, "dt", observed
        )
        parts, kept = [*parts, outputs_seen], [*kept, after]
    graph.add("Concat", kept, "next_state", axis=0)
    everything = graph.add("Concat", parts, axis=0)
    plus, minus = (graph.add("Gather", [everything, graph.whole(index)], axis=0) for index in wiring(bank))
    features = graph.add("Sub", [plus, minus])
    estimate, sigma = _network(graph, sensor, graph.add("Unsqueeze", [features, graph.whole([0])]))
    for name, value in (("estimate", estimate), ("sigma", sigma)):
        graph.add("Squeeze", [value, graph.whole([0])], name)
    inputs = ["voltage", "current", *(["ambient"] if bank.ambient else []), "dt"]
    outputs = len(sensor.specification.outputs)
    return graph.model(
        sensor.name + ".step",
        [*((name, np.float64, [1]) for name in inputs), ("state", np.float64, [filters + size])],
        [
            ("estimate", np.float64, [outputs]),
            ("sigma", np.float64, [outputs]),
            ("next_state", np.float64, [filters + size]),
        ],
        metadata,
    )


def _filtered(graph: "_Graph", bank: Bank, signals: str, before: str) -> str:
    """The filters after a sample."""
    drive = graph.add(
        "Gather", [signals, graph.whole([bank.signals.index(f.signal) for f in bank.filters])], axis=0
    )
    decay = graph.add(
        "Exp", [graph.add("Div", [graph.add("Neg", ["dt"]), graph.exact([f.tau_s for f in bank.filters])])]
    )
    return graph.add("Add", [drive, graph.add("Mul", [graph.add("Sub", [before, drive]), decay])])


def write_sensor(
    sensor: Sensor,
    card: Mapping[str, Any],
    golden: Mapping[str, Any],
    path: Path,
    version: str = "1",
    licence: str = "MIT",
) -> None:
    """Write `NAME.onnx` and, beside it, `NAME.step.onnx`; each carries its specification, card, golden values and hash."""
    metadata = {
        "motorlens.schema": "motorlens.sensor/1",
        "motorlens.name": sensor.name,
        "motorlens.version": version,
        "motorlens.licence": licence,
        "motorlens.spec": _json(sensor.specification.document()),
        "motorlens.card": _json(card),
        "motorlens.golden": _json(golden),
        SEAL: "0" * 64,
    }
    path.write_bytes(sealed(core_graph(sensor, metadata)))
    # What describes the sensor stands once, in the core file; the step file refers to it by name and version.
    short = {key: metadata[key] for key in metadata if key not in ("motorlens.card", "motorlens.golden")}
    path.with_suffix(".step.onnx").write_bytes(sealed(step_graph(sensor, short)))


def sealed(model: bytes) -> bytes:
    """Put the SHA-256 of the whole file (with 64 zeros in its place) into a model's metadata."""
    mark = SEAL.encode() + b"\x12\x40"
    if model.count(mark) != 1:
        raise ValueError("a model has exactly one seal")
    at = model.index(mark) + len(mark)
    return model[:at] + hashlib.sha256(model).hexdigest().encode() + model[at + 64 :]


def _signal(graph: "_Graph", name: str, bank: Bank) -> str:
    """Node that computes a signal in float64."""
    v, i = "voltage", "current"
    match name:
        case "one":
            return graph.exact([1.0])
        case "voltage" | "current" | "ambient":
            return name
        case "current_squared":
            return graph.add("Mul", [i, i])
        case "voltage_squared":
            return graph.add("Mul", [v, v])
        case "power":
            return graph.add("Mul", [v, i])
        case _:
            emf = graph.add("Sub", [v, graph.add("Mul", [i, graph.exact([bank.resistance_ohm])])])
            return {
                "emf": lambda: emf,
                "emf_squared": lambda: graph.add("Mul", [emf, emf]),
                "emf_power": lambda: graph.add("Mul", [emf, i]),
            }[name]()


def _network(graph: "_Graph", sensor: Sensor, features: str) -> tuple[str, str]:
    """From `features`, `[N, F]` float64, to estimate and sigma."""
    if sensor.frame is None:
        return _learned(graph, sensor.learned, features)
    base, spread = sensor.frame.selection(len(sensor.bank.features))
    start = graph.add("MatMul", [features, graph.exact(base)])
    deviation = graph.add("Exp", [graph.add("MatMul", [features, graph.exact(spread)])])
    if sensor.learned is None:
        return start, deviation
    mean, sigma = _learned(graph, sensor.learned, features)
    cloud = sensor.envelope.cloud
    if cloud is not None:
        share = _near(graph, cloud, features, len(sensor.promised))
        mean = graph.add("Mul", [share, mean])
        one = graph.exact(np.ones(len(sensor.promised)))
        sigma = graph.add("Add", [graph.add("Mul", [share, graph.add("Sub", [sigma, one])]), one])
    estimate = graph.add("Add", [start, graph.add("Mul", [deviation, mean])])
    return estimate, graph.add("Mul", [deviation, sigma])


def _near(graph: "_Graph", cloud: Cloud, features: str, outputs: int) -> str:
    """`Cloud.near`, once for each output `[N, K]`."""
    centred = graph.add("Sub", [features, graph.exact(cloud.mean)])
    white = graph.add("MatMul", [centred, graph.weights(cloud.precision_cholesky)])
    total = np.full((len(cloud.mean), outputs), -1 / cloud.limit)
    distance = graph.add("MatMul", [graph.add("Mul", [white, white]), graph.exact(total)])
    limits = [graph.exact(np.array(limit)) for limit in (0.0, 1.0)]
    return graph.add("Clip", [graph.add("Add", [distance, graph.exact(np.full(outputs, 2.0))]), *limits])


def _learned(graph: "_Graph", learned: Learned | None, features: str) -> tuple[str, str]:
    """Scaling, layers, output, standard deviation of a network."""
    assert learned is not None
    network, architecture = learned.network, learned.network.architecture
    # Whitening takes small differences of large features, so all is computed in float64; weights are float32
    # numbers.
    centred = graph.add("Sub", [features, graph.exact(learned.inputs.mean)])
    known = [graph.add("MatMul", [centred, graph.weights(learned.inputs.matrix)])]
    first = 0
    for layer, width in enumerate(architecture.hidden):
        reads = len(architecture.reads(layer))
        weight = network.hidden[first : first + width * reads].reshape(width, reads)
        first += width * reads
        net = graph.affine(_read(graph, known, architecture.skips), weight.T)
        known.append(graph.add(architecture.function.onnx, [net]))
    read = _read(graph, known, architecture.skips)
    scaled = graph.affine(read, network.output.T)
    deviation = graph.exact(learned.targets.deviation)
    estimate = graph.add("Add", [graph.add("Mul", [scaled, deviation]), graph.exact(learned.targets.mean)])
    along = graph.affine(read, learned.posterior.basis)
    function = graph.add(
        "MatMul", [graph.add("Mul", [along, along]), graph.weights(learned.posterior.variances.T)]
    )
    limits = [graph.exact(np.array(limit)) for limit in LOG_VARIANCE_RANGE]
    noise = graph.add("Exp", [graph.add("Clip", [graph.affine(read, learned.noise.T), *limits])])
    sigma = graph.add("Mul", [graph.add("Sqrt", [graph.add("Add", [function, noise])]), deviation])
    return estimate, sigma


def _read(graph: "_Graph", known: Sequence[str], skips: bool) -> str:
    """What the next layer reads: everything so far, or the layer before."""
    if not skips or len(known) == 1:
        return known[-1]
    return graph.add("Concat", list(known), axis=-1)


@dataclass
class _Graph:
    """A graph under construction; names are numbers in order of use, so that bytes are stable."""

    nodes: list[Any] = field(default_factory=list)
    constants: list[Any] = field(default_factory=list)
    named: int = 0

    def add(self, operator: str, inputs: Sequence[str], output: str = "", **attributes: Any) -> str:
        name = output or f"t{self.named}"
        self.named += not output
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def split(self, vector: str, sizes: Sequence[int]) -> list[str]:
        """Consecutive pieces of a vector."""
        names = [f"{vector}_{k}" for k in range(len(sizes))]
        self.nodes.append(helper.make_node("Split", [vector, self.whole(list(sizes))], names, axis=0))
        return names

    def affine(self, read: str, weight: Any) -> str:
        """`read @ weight[1:] + weight[0]`: row 0 belongs to the constant."""
        matrix = np.asarray(weight)
        return self.add(
            "Add", [self.add("MatMul", [read, self.weights(matrix[1:])]), self.weights(matrix[0])]
        )

    def weights(self, values: Any) -> str:
        """Numbers that are float32 already, kept as such and computed with as float64."""
        return self.add(
            "Cast",
            [self._constant(np.ascontiguousarray(np.asarray(values, dtype=np.float32)))],
            to=TensorProto.DOUBLE,
        )

    def exact(self, values: Any) -> str:
        return self._constant(np.ascontiguousarray(np.asarray(values, dtype=np.float64)))

    def whole(self, values: Any) -> str:
        return self._constant(np.array(values, dtype=np.int64))

    def _constant(self, values: Numbers) -> str:
        for constant in self.constants:
            if constant.raw_data == values.tobytes() and list(constant.dims) == list(values.shape):
                if constant.data_type == helper.np_dtype_to_tensor_dtype(values.dtype):
                    return str(constant.name)
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(values, name))
        return name

    def model(
        self,
        name: str,
        inputs: Sequence[tuple[str, Any, Sequence[Any]]],
        outputs: Sequence[tuple[str, Any, Sequence[Any]]],
        metadata: Mapping[str, str],
    ) -> bytes:
        def values(entries: Sequence[tuple[str, Any, Sequence[Any]]]) -> list[Any]:
            return [
                helper.make_tensor_value_info(title, helper.np_dtype_to_tensor_dtype(np.dtype(kind)), shape)
                for title, kind, shape in entries
            ]

        graph = helper.make_graph(self.nodes, name, values(inputs), values(outputs), self.constants)
        model = helper.make_model(
            graph,
            producer_name="motorlens",
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=IR_VERSION,
        )
        helper.set_model_props(model, dict(metadata))
        onnx.checker.check_model(model)
        return bytes(model.SerializeToString(deterministic=True))


def _json(document: Mapping[str, Any]) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
