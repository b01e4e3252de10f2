"""Signals and features against what docs/sensor-file.md says of them, and their bits alone and in company."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_runtime.estimate.features import Channels
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.sensor.specification import Feature, Filter

SHIPPED = Path(__file__).resolve().parents[2] / "models/sensors/mellah2016.onnx"
RESISTANCE_OHM = 3.7
SIGNALS = {
    "voltage": lambda v, i, a: v, "current": lambda v, i, a: i, "one": lambda v, i, a: v * 0 + 1,
    "ambient": lambda v, i, a: a, "current_squared": lambda v, i, a: i * i,
    "voltage_squared": lambda v, i, a: v * v, "power": lambda v, i, a: v * i,
    "emf": lambda v, i, a: v - RESISTANCE_OHM * i, "emf_squared": lambda v, i, a: (v - RESISTANCE_OHM * i) ** 2,
    "emf_power": lambda v, i, a: (v - RESISTANCE_OHM * i) * i,
}  # fmt: skip


def map_of(parts, features):
    filters = tuple(Filter(signal, 0.1) for signal in SIGNALS)
    specification = load_sensor(SHIPPED).specification
    return parts.FeatureMap(
        replace(specification, filters=filters, features=tuple(features), resistance_ohm=RESISTANCE_OHM)
    )


@pytest.mark.parametrize("with_ambient", [True, False])
def test_each_signal_alone_and_in_company(parts, with_ambient):
    rng = np.random.default_rng(0)
    voltage, current, ambient = rng.normal(size=(3, 50)) * [[100.0], [8.0], [20.0]]
    voltage[3:5], current[5:7] = [-0.0, 1e100], [0.0, -1e-200]
    channels = Channels(voltage, current, ambient if with_ambient else None)
    features = map_of(parts, [Feature("lowpass", "", (0,))])
    together = features.signals(channels)
    for row, signal in zip(together, SIGNALS.values(), strict=True):
        expected = signal(voltage, current, ambient if with_ambient else ambient * 0)
        np.testing.assert_allclose(row, expected, rtol=1e-15)
    for k in range(50):
        at = slice(k, k + 1)
        alone = features.signals(Channels(voltage[at], current[at], ambient[at] if with_ambient else None))
        assert alone.tobytes() == np.ascontiguousarray(together[:, at]).tobytes()


def test_features_are_filters_signals_and_differences(parts):
    """Differences in rows that follow one another, as most do, and in rows that do not."""
    pairs = [(0, 1), (2, 3), (3, 4), (4, 5), (9, 0), (8, 1)]
    chosen = [Feature("between", "", pair) for pair in pairs]
    chosen[4:4] = [
        Feature("lowpass", "", (7,)),
        Feature("raw", "current", ()),
        Feature("difference", "current", (1,)),
    ]
    rng = np.random.default_rng(1)
    filtered, signals = rng.normal(size=(2, len(SIGNALS), 5))
    expected = [filtered[a] - filtered[b] for a, b in pairs]
    expected[4:4] = [filtered[7], signals[1], signals[1] - filtered[1]]
    features = map_of(parts, chosen)
    assert features.uses_signals
    assert np.array_equal(features.features(filtered, signals, None), np.array(expected))
