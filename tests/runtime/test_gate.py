"""Few samples are judged one by one, many as arrays, by the C core each alone: to the same end, field by field."""

import numpy as np
import pytest
from helpers.sensor_files import write_sensor
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.estimate.gate import Gate, Gated, GateState, Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.sensor.sensor import load_sensor


@pytest.fixture(scope="module")
def specification(tmp_path_factory):
    path = tmp_path_factory.mktemp("sensor") / "s.onnx"
    write_sensor(path)
    return load_sensor(path).specification


def troubled(rng, n, period_ns):
    """Currents that repeat and jump, voltages that move, stand still, vanish and leave the range, stamps that miss some."""
    held = np.repeat(rng.normal(8, 2, n), rng.integers(1, 150, n))[:n]
    current = np.where(rng.random(n) < rng.choice([0.0, 0.5, 1.0]), held, rng.normal(8, 0.3, n))
    current[rng.integers(0, n, 3)] += rng.choice([-90.0, 90.0, 1e3])
    voltage = 100 + np.repeat(rng.normal(0, 20, n), rng.integers(1, 40, n))[:n]
    start = int(rng.integers(0, n))
    voltage[start : start + 100] = rng.choice([0.0, 100.0, 270.0])
    if rng.random() < 0.5:
        voltage[rng.integers(0, n, 2)] = [np.nan, 1e9]
    steps = rng.choice([1.0, 1.0, 1.0, 1.0, 1.4, 0.01, 7.0], n) if rng.random() < 0.5 else np.ones(n)
    time_ns = 5_000_000_000 + (np.cumsum(steps) * period_ns).astype(np.int64)
    flags = rng.choice(np.array([0, Quality.SATURATED], dtype=np.uint32), n)
    return Samples(time_ns, voltage, current, None, flags if rng.random() < 0.5 else None)


@pytest.mark.fit
@settings(max_examples=100, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1 / 3000, 0.04]))
def test_one_by_one_and_as_arrays(parts, specification, seed, period_s):
    rng = np.random.default_rng(seed)
    samples = troubled(rng, 600, period_s * 1e9)
    whole_state, whole = Gate(specification, period_s).inspect(GateState(), samples)
    gate, state, pieces = parts.Gate(specification, period_s), GateState(), []
    for rows in np.split(np.arange(600), np.sort(rng.integers(0, 600, 200))):
        flags = None if samples.flags is None else samples.flags[rows]
        part = Samples(samples.time_ns[rows], samples.voltage_V[rows], samples.current_A[rows], None, flags)
        state, gated = gate.inspect(state, part)
        pieces.append(gated)
    assert state == whole_state
    for name in Gated.__dataclass_fields__:
        if name != "ambient_C":
            joined = np.concatenate([getattr(part, name) for part in pieces])
            assert np.array_equal(joined, getattr(whole, name)), name
