"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.specification import Specification

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

    The columns are the signals that are used, then the S filters, then one of zeros, then the outputs of the observer.
    """

    def __init__(self, specification: Specification) -> None:
        filters, features = specification.filters, specification.features
        used = dict.fromkeys(f.signal for f in filters) | dict.fromkeys(
            f.signal for f in features if f.signal
        )
        self._signals = tuple(used)
        self._resistance_ohm = specification.resistance_ohm
        place = {name: index for index, name in enumerate(self._signals)}
        first = len(place)
        zero = first + len(filters)
        self._drive = np.array([place[f.signal] for f in filters], dtype=np.intp)
        pairs = []
        for feature in features:
            of_signal = place.get(feature.signal, zero)
            of_filters = [first + index for index in feature.filters]
            pairs.append(
                {
                    "raw": (of_signal, zero),
                    "lowpass": (*of_filters, zero),
                    "difference": (of_signal, *of_filters),
                    "between": tuple(of_filters),
                    "observer": (zero + 1 + feature.output, zero),
                }[feature.kind]
            )
        self._plus, self._minus = (np.array(column, dtype=np.intp) for column in zip(*pairs, strict=True))

    def signals(self, channels: Channels) -> Array:
        """The signals (n, used) of n samples."""
        columns: Columns = {"voltage": channels.voltage_V, "current": channels.current_A}
        if channels.ambient_C is not None:
            columns["ambient"] = channels.ambient_C
        table = np.empty((len(channels.voltage_V), len(self._signals)))
        for index, name in enumerate(self._signals):
            table[:, index] = _signal(name, columns, self._resistance_ohm)
        return table

    def drive(self, signals: Array) -> Array:
        """The input (n, S) of each filter."""
        return signals.take(self._drive, axis=1)

    def features(self, signals: Array, filtered: Array, observed: Array | None) -> Array:
        """Features (m, F) in SI, of signals (m, used), filters (m, S) and observer outputs (m, M) after the same samples."""
        parts = [signals, filtered, np.zeros((len(signals), 1))]
        table = np.concatenate(parts if observed is None else [*parts, observed], axis=1)
        features: Array = table.take(self._plus, axis=1)
        features -= table.take(self._minus, axis=1)
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
