"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.specification import Specification, signals_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Channels:
    """What was measured at n instants: volts, amperes, degrees Celsius, each (n,)."""

    voltage_V: Array
    current_A: Array
    ambient_C: Array | None


class FeatureMap:
    """How features are made of signals and filters, as index arrays: each is a column, or the difference of two.

    The columns are the U signals that are used, then the S filters, then the outputs of the observer. All arrays have time
    along their last axis.
    """

    def __init__(self, specification: Specification) -> None:
        filters, features = specification.filters, specification.features
        self._signals = signals_of(specification)
        self._factors = [_FACTORS[name] for name in self._signals]
        self._uses_emf = any("emf" in factors for factors in self._factors)
        self._resistance_ohm = specification.resistance_ohm
        place = {name: index for index, name in enumerate(self._signals)}
        first = len(place)
        observed = first + len(filters)
        pairs: list[tuple[int, ...]] = []
        for feature in features:
            of_filters = tuple(first + index for index in feature.filters)
            if feature.kind == "observer":
                pairs.append((observed + feature.output,))
            elif feature.signal:
                pairs.append((place[feature.signal], *of_filters))
            else:
                pairs.append(of_filters)
        self._plus = np.array([pair[0] for pair in pairs], dtype=np.intp)
        self._differences = np.array([k for k, pair in enumerate(pairs) if len(pair) > 1], dtype=np.intp)
        self._minus = np.array([pair[1] for pair in pairs if len(pair) > 1], dtype=np.intp)

    def signals(self, channels: Channels) -> Array:
        """The signals (U, n) of n samples."""
        known = {"voltage": channels.voltage_V, "current": channels.current_A}
        if channels.ambient_C is not None:
            known["ambient"] = channels.ambient_C
        if self._uses_emf:
            # Back-EMF with the winding taken as cold.
            known["emf"] = channels.voltage_V - self._resistance_ohm * channels.current_A
        table = np.empty((len(self._signals), len(channels.voltage_V)))
        for row, factors in zip(table, self._factors, strict=True):
            if len(factors) == 2:
                np.multiply(known[factors[0]], known[factors[1]], out=row)
            else:
                row[:] = known[factors[0]] if factors else 1.0
        return table

    def features(self, signals: Array, filtered: Array, observed: Array | None) -> Array:
        """Features (F, m) in SI, of signals (U, m), filters (S, m) and observer outputs (M, m) after the same samples."""
        columns = np.concatenate((signals, filtered) if observed is None else (signals, filtered, observed))
        features = columns.take(self._plus, axis=0)
        if len(self._minus):
            features[self._differences] -= columns[self._minus]
        return features


# Each signal as a product of at most two of what is measured.
_FACTORS: Mapping[str, tuple[str, ...]] = {
    "one": (), "voltage": ("voltage",), "current": ("current",), "ambient": ("ambient",), "emf": ("emf",),
    "current_squared": ("current", "current"), "voltage_squared": ("voltage", "voltage"), "power": ("voltage", "current"),
    "emf_squared": ("emf", "emf"), "emf_power": ("emf", "current"),
}  # fmt: skip
