"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.records import record
from motorlens_runtime.specification import Specification, signals_of

Array = NDArray[np.float64]


@record(frozen=True)
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
        factors = [(*_FACTORS[name], "one", "one")[:2] for name in self._signals]
        self._first, self._second = (
            np.array([_MEASURED.index(name) for name in names], dtype=np.intp)
            for names in zip(*factors, strict=True)
        )
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
        voltage, current = channels.voltage_V, channels.current_A
        measured = np.empty((len(_MEASURED), len(voltage)))
        measured[0], measured[1], measured[2] = 1.0, voltage, current
        # Back-EMF with the winding taken as cold.
        np.subtract(voltage, self._resistance_ohm * current, out=measured[3])
        measured[4] = 0.0 if channels.ambient_C is None else channels.ambient_C
        signals = measured.take(self._first, axis=0)
        signals *= measured.take(self._second, axis=0)
        return signals

    def features(self, signals: Array, filtered: Array, observed: Array | None) -> Array:
        """Features (F, m) in SI, of signals (U, m), filters (S, m) and observer outputs (M, m) after the same samples."""
        columns = np.concatenate((signals, filtered) if observed is None else (signals, filtered, observed))
        features = columns.take(self._plus, axis=0)
        if len(self._minus):
            features[self._differences] -= columns[self._minus]
        return features


_MEASURED = ("one", "voltage", "current", "emf", "ambient")
# Each signal as a product of at most two of them; without a second, or any, it is one.
_FACTORS: Mapping[str, tuple[str, ...]] = {
    "one": (), "voltage": ("voltage",), "current": ("current",), "ambient": ("ambient",), "emf": ("emf",),
    "current_squared": ("current", "current"), "voltage_squared": ("voltage", "voltage"), "power": ("voltage", "current"),
    "emf_squared": ("emf", "emf"), "emf_power": ("emf", "current"),
}  # fmt: skip
