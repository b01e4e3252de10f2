"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.specification import Specification, signals_of

Array = NDArray[np.float64]
Columns = dict[str, Array]


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
        known: Columns = {"voltage": channels.voltage_V, "current": channels.current_A}
        if channels.ambient_C is not None:
            known["ambient"] = channels.ambient_C
        table = np.empty((len(self._signals), len(channels.voltage_V)))
        for row, name in enumerate(self._signals):
            table[row] = _signal(name, known, self._resistance_ohm)
        return table

    def features(self, signals: Array, filtered: Array, observed: Array | None) -> Array:
        """Features (F, m) in SI, of signals (U, m), filters (S, m) and observer outputs (M, m) after the same samples."""
        columns = np.concatenate((signals, filtered) if observed is None else (signals, filtered, observed))
        features = columns.take(self._plus, axis=0)
        if len(self._minus):
            features[self._differences] -= columns[self._minus]
        return features


def _signal(name: str, known: Columns, resistance_ohm: float) -> Array:
    if name not in known:
        if name in ("emf", "emf_squared", "emf_power") and "emf" not in known:
            # Back-EMF with the winding taken as cold.
            known["emf"] = known["voltage"] - resistance_ohm * known["current"]
        if name != "emf":
            known[name] = _PRODUCTS[name](known)
    return known[name]


_PRODUCTS: Mapping[str, Callable[[Columns], Array]] = {
    "one": lambda s: np.ones_like(s["voltage"]),
    "current_squared": lambda s: s["current"] * s["current"],
    "voltage_squared": lambda s: s["voltage"] * s["voltage"],
    "power": lambda s: s["voltage"] * s["current"],
    "emf_squared": lambda s: s["emf"] * s["emf"],
    "emf_power": lambda s: s["emf"] * s["current"],
}
