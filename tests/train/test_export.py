"""The exported graphs: equal to torch, byte-stable, sealed, and the same sensor as a stateful step."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest
import torch
from helpers.sensors import small_sensor

from motorlens_runtime.errors import ModelError
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.build import Built, Recipe, build, golden
from motorlens_train.data import Cycle
from motorlens_train.export import core_graph, sealed, step_graph, write_sensor
from motorlens_train.features import feature_rows, motor_bank
from motorlens_train.specification import Bank, Rate, bank_from
from motorlens_train.trainer import Settings

BANK = motor_bank(3.5, 0.034, 0.0097, 0.131, 4157.0)


def samples(rows: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Irregular times, voltage and current that wander like a drive's."""
    generator = np.random.default_rng(seed)
    time = np.cumsum(generator.choice([0.001, 0.002, 0.5], rows, p=[0.9, 0.09, 0.01]))
    voltage = (
        120 + 60 * np.sin(0.7 * time) + 30 * np.sin(0.11 * time + 1) + 0.5 * generator.standard_normal(rows)
    )
    return time, voltage, 5 + 3 * np.sin(time) + 0.1 * generator.standard_normal(rows)


def made_cycle(bank: Bank, rows: int, seed: int) -> Cycle:
    time, voltage, current = samples(rows, seed)
    x = feature_rows(bank, time, voltage, current)
    speed = (voltage - 3.6 * current) / 0.93 + np.random.default_rng(seed).standard_normal(rows)
    y = np.stack([speed, 0.01 * x[:, 8] + 3, 3.5 + 0.001 * x[:, 8]], axis=1)
    ends = (float(voltage.min()), float(voltage.max())), (float(current.min()), float(current.max()))
    return Cycle("made", time, x, y, *ends, rows)


@pytest.fixture(scope="module", params=[True, False], ids=["cascade", "feed-forward"])
def built(request: pytest.FixtureRequest) -> Built:
    recipe = Recipe(
        "test", BANK, ("speed", "temperature", "resistance"), (6, 4), Rate(1000.0, 200.0, 2000.0), 1.0, 1,
        Settings(iterations=25), skips=request.param,
    )  # fmt: skip
    cycles = [made_cycle(BANK, 400, seed) for seed in range(10)]
    return build(recipe, cycles[:3], cycles[3:9], cycles[9:])


def run(model: bytes, inputs: dict[str, np.ndarray]) -> list[np.ndarray]:
    session = ort.InferenceSession(model, providers=["CPUExecutionProvider"])
    return [np.asarray(value) for value in session.run(None, inputs)]


@pytest.mark.fit
def test_core_graph_equals_torch_to_1e_10_of_scale_on_10000_samples(built: Built) -> None:
    sensor = built.sensor
    x = feature_rows(sensor.bank, *samples(10_000, 77))
    scale = np.array([o.scale for o in sensor.specification.outputs])
    estimate, sigma = run(core_graph(sensor, {}), {"features": x})
    predicted = built.trained.predict(torch.from_numpy(x)).numpy()
    # Of its scale, or of itself where the network extrapolates to many times that.
    assert np.abs((estimate - predicted) / np.maximum(scale, np.abs(predicted))).max() < 1e-10
    assert np.abs((sigma - sensor.evaluate(x)[1]) / scale).max() < 1e-9
    assert np.abs(estimate / scale).max() > 0.1


@pytest.mark.fit
def test_step_graph_is_the_bank_and_the_core_graph(built: Built) -> None:
    sensor = built.sensor
    time, voltage, current = samples(300, 5)
    x = feature_rows(sensor.bank, time, voltage, current, first_dt_s=0.001)
    expected = run(core_graph(sensor, {}), {"features": x})
    session = ort.InferenceSession(step_graph(sensor, {}), providers=["CPUExecutionProvider"])
    state = np.zeros(len(sensor.bank.filters))
    for n, dt in enumerate(np.diff(time, prepend=time[0] - 0.001)):
        inputs = {"voltage": voltage[[n]], "current": current[[n]], "dt": np.array([dt]), "state": state}
        estimate, sigma, state = session.run(["estimate", "sigma", "next_state"], inputs)
        assert estimate == pytest.approx(expected[0][n], rel=1e-9, abs=1e-9)
        assert sigma == pytest.approx(expected[1][n], rel=1e-9, abs=1e-9)
    assert state.dtype == np.float64


def test_file_is_byte_stable_sealed_and_accepted_by_the_runtime(built: Built, tmp_path: Path) -> None:
    sensor, first, second = built.sensor, tmp_path / "a.onnx", tmp_path / "b.onnx"
    for path in (first, second):
        write_sensor(sensor, built.card, golden(sensor), path)
    data = first.read_bytes()
    assert data == second.read_bytes()
    assert first.with_suffix(".step.onnx").read_bytes() == second.with_suffix(".step.onnx").read_bytes()
    at = data.index(b"motorlens.sha256\x12\x40") + 18
    assert hashlib.sha256(data[:at] + b"0" * 64 + data[at + 64 :]).hexdigest().encode() == data[at : at + 64]
    assert load_sensor(first).specification.rate_Hz == 1000.0
    first.write_bytes(data[:-200] + bytes([data[-200] ^ 1]) + data[-199:])
    with pytest.raises(ModelError, match="altered"):
        load_sensor(first)


def test_metadata_hold_the_whole_specification(built: Built, tmp_path: Path) -> None:
    path = tmp_path / "a.onnx"
    write_sensor(built.sensor, built.card, golden(built.sensor), path)
    model = onnx.load(path)
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    spec = json.loads(metadata["motorlens.spec"])
    assert bank_from(spec) == built.sensor.bank
    assert [o["name"] for o in spec["outputs"]] == ["speed", "temperature", "resistance"]
    assert (
        json.loads(metadata["motorlens.card"])["training_data_sha256"] == built.card["training_data_sha256"]
    )
    assert model.opset_import[0].version == 17 and model.ir_version == 8


def test_only_one_seal() -> None:
    with pytest.raises(ValueError, match="one seal"):
        sealed(b"nothing")


@pytest.mark.fit
def test_away_from_where_it_was_trained_a_network_leaves_the_observer_alone() -> None:
    """Inside its cloud as before, from once to twice the limit less and less, beyond that nothing; in graph and torch."""
    built = small_sensor(observed=True).sensor
    cloud, frame = built.envelope.cloud, built.frame
    assert cloud is not None and built.learned is not None and frame is not None
    # On so few cycles nothing is borne out: a constant correction, so that something fades.
    shifted = replace(built.learned.targets, mean=torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64))
    learned = replace(built.learned, targets=shifted)
    sensor = replace(built, learned=learned)
    # Steps along one whitened direction, so that the squared distance is what it is meant to be.
    away = np.linalg.solve(cloud.precision_cholesky.T, np.eye(len(cloud.mean))[0])
    squared = cloud.limit * np.array([0.0, 0.5, 1.0, 1.25, 1.5, 2.0, 9.0])
    x = cloud.mean + np.sqrt(squared)[:, None] * away
    share = np.array([1.0, 1.0, 1.0, 0.75, 0.5, 0.0, 0.0])[:, None]
    start, deviation = frame.start(x)
    mean, sigma = learned.evaluate(x)
    expected = start + deviation * share * mean, deviation * (share * sigma + 1 - share)
    assert np.abs(mean).max() > 0.1
    for found in (sensor.evaluate(x), run(core_graph(sensor, {}), {"features": x})):
        for one, other in zip(found, expected, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9 * np.abs(other).max())
