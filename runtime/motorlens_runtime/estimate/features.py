"""From samples to features: the signals of a specification, and the rows that the network is given."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.records import record
from motorlens_runtime.sensor.specification import Specification, signals_of

Array = NDArray[np.float64]


@record(frozen=True)
class Channels:
    """What was measured at n instants: volts, amperes, degrees Celsius, each (n,)."""

    voltage_V: Array
    current_A: Array
    ambient_C: Array | None


NO_COLUMN = 0xFFFF


class FeatureMap:
    """How features are made of signals and filters, as index arrays: each is a column, or the difference of two.

    The columns are the S filters, then, only if features need them, the U signals and the outputs of the observer. All
    arrays have time along their last axis.

    Attributes:
        factors: of each signal, the two of one, voltage, current, back-EMF and ambient temperature whose product it is.
        filter_signals: which signal each filter takes.
        plus, minus: the columns of each feature; `NO_COLUMN` where nothing is taken away.
    """

    def __init__(self, specification: Specification) -> None:
        filters, features = specification.filters, specification.features
        self._signals = signals_of(specification)
        factors = [(*_FACTORS[name], "one", "one")[:2] for name in self._signals]
        self._first, self._second = (
            np.array([_MEASURED.index(pair[k]) for pair in factors], dtype=np.intp) for k in (0, 1)
        )
        self._pairs = list(zip(self._first.tolist(), self._second.tolist(), strict=True))
        self._resistance_ohm = specification.resistance_ohm
        first = len(filters)
        self.uses_signals = any(feature.signal for feature in features)
        observed = first + (len(self._signals) if self.uses_signals else 0)
        pairs: list[tuple[int, ...]] = []
        for feature in features:
            if feature.kind == "observer":
                pairs.append((observed + feature.output,))
            elif feature.signal:
                pairs.append((first + self._signals.index(feature.signal), *feature.filters))
            else:
                pairs.append(feature.filters)
        self.factors = tuple(self._pairs)
        self.filter_signals = tuple(self._signals.index(f.signal) for f in filters)
        self.plus = tuple(pair[0] for pair in pairs)
        self.minus = tuple(pair[1] if len(pair) > 1 else NO_COLUMN for pair in pairs)
        self._plus = np.array(self.plus, dtype=np.intp)
        self._differences = _stretches([(k, pair[1]) for k, pair in enumerate(pairs) if len(pair) > 1])

    def signals(self, channels: Channels) -> Array:
        """The signals (U, n) of n samples."""
        voltage, current = channels.voltage_V, channels.current_A
        if len(voltage) == 1:
            # The same operations in plain numbers, which are faster for a sample alone.
            volts, amperes = voltage.item(), current.item()
            ambient_C = 0.0 if channels.ambient_C is None else channels.ambient_C.item()
            alone = 1.0, volts, amperes, volts - self._resistance_ohm * amperes, ambient_C
            products = [alone[first] * alone[second] for first, second in self._pairs]
            # An observer that stands alone has no signals: an array of none would be flat.
            return np.array(products, dtype=np.float64).reshape(len(products), 1)
        measured = np.empty((len(_MEASURED), len(voltage)))
        measured[0], measured[1], measured[2] = 1.0, voltage, current
        # Back-EMF with the winding taken as cold.
        np.subtract(voltage, self._resistance_ohm * current, out=measured[3])
        measured[4] = 0.0 if channels.ambient_C is None else channels.ambient_C
        signals = measured.take(self._first, axis=0)
        signals *= measured.take(self._second, axis=0)
        return signals

    def features(self, filtered: Array, signals: Array | None, observed: Array | None) -> Array:
        """Features (F, m) in SI, of filters (S, m), signals (U, m) and observer outputs (M, m) after the same samples; the
        last two None where no feature uses them."""
        parts = [part for part in (filtered, signals, observed) if part is not None]
        columns = filtered if len(parts) == 1 else np.concatenate(parts)
        features = columns.take(self._plus, axis=0)
        for rows, minus in self._differences:
            features[rows] -= columns[minus]
        return features


def _stretches(pairs: list[tuple[int, int]]) -> list[tuple[slice, slice]]:
    """Pairs of rows as pairs of slices, as long as both count up."""
    stretches: list[tuple[slice, slice]] = []
    for row, minus in pairs:
        rows, before = stretches[-1] if stretches else (slice(0, -1), slice(0, -1))
        if (rows.stop, before.stop) == (row, minus):
            stretches[-1] = slice(rows.start, row + 1), slice(before.start, minus + 1)
        else:
            stretches.append((slice(row, row + 1), slice(minus, minus + 1)))
    return stretches


_MEASURED = ("one", "voltage", "current", "emf", "ambient")
# Each signal as a product of at most two of them; without a second, or any, it is one.
_FACTORS: Mapping[str, tuple[str, ...]] = {
    "one": (), "voltage": ("voltage",), "current": ("current",), "ambient": ("ambient",), "emf": ("emf",),
    "current_squared": ("current", "current"), "voltage_squared": ("voltage", "voltage"), "power": ("voltage", "current"),
    "emf_squared": ("emf", "emf"), "emf_power": ("emf", "current"),
}  # fmt: skip
