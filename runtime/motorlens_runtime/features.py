"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.bank import FilterBank
from motorlens_runtime.specification import Specification

Array = NDArray[np.float64]


class Signals:
    """The signals of n samples, computed when first asked for."""

    def __init__(
        self, specification: Specification, voltage_V: Array, current_A: Array, ambient_C: Array | None
    ) -> None:
        base = {"voltage": voltage_V, "current": current_A}
        self._known: dict[str, Array] = base if ambient_C is None else {**base, "ambient": ambient_C}
        self._resistance_ohm = specification.resistance_ohm

    def __getitem__(self, name: str) -> Array:
        if name not in self._known:
            self._known[name] = _DEFINITIONS[name](self)
        return self._known[name]

    def emf(self) -> Array:
        """Back-EMF with the winding taken as cold: v - R i, in volts."""
        result: Array = self["voltage"] - self._resistance_ohm * self["current"]
        return result


_DEFINITIONS: Mapping[str, Callable[[Signals], Array]] = {
    "one": lambda s: np.ones_like(s["voltage"]),
    "current_squared": lambda s: s["current"] * s["current"],
    "voltage_squared": lambda s: s["voltage"] * s["voltage"],
    "power": lambda s: s["voltage"] * s["current"],
    "emf": Signals.emf,
    "emf_squared": lambda s: s["emf"] * s["emf"],
    "emf_power": lambda s: s["emf"] * s["current"],
}


def drive_of(bank: FilterBank, signals: Signals) -> Array:
    """The input (n, S) of each filter of the bank."""
    drive = np.empty((len(signals["voltage"]), len(bank.signals)))
    for column, name in enumerate(bank.signals):
        drive[:, column] = signals[name]
    return drive


def feature_rows(
    specification: Specification, signals: Signals, filtered: Array, rows: NDArray[np.intp] | slice
) -> Array:
    """Features (len(rows), F) in SI; `filtered` (n, S) is the bank after each of the n samples."""
    chosen = filtered[rows]
    features = np.empty((len(chosen), len(specification.features)))
    for column, feature in enumerate(specification.features):
        if feature.kind == "raw":
            features[:, column] = signals[feature.signal][rows]
        elif feature.kind == "lowpass":
            features[:, column] = chosen[:, feature.filters[0]]
        elif feature.kind == "difference":
            features[:, column] = signals[feature.signal][rows] - chosen[:, feature.filters[0]]
        else:
            features[:, column] = chosen[:, feature.filters[0]] - chosen[:, feature.filters[1]]
    return features
