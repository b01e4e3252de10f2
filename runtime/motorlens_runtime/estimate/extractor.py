"""From gated samples to the features of a network: filter bank, observer, and the map that joins them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.bank import BankState, FilterBank, bank_of
from motorlens_runtime.estimate.features import Channels, FeatureMap
from motorlens_runtime.estimate.observer import Observer, State
from motorlens_runtime.sensor.specification import Specification

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Extractor:
    """What runs at every sample of a sensor."""

    bank: FilterBank
    observer: Observer | None
    map: FeatureMap

    def start(self) -> tuple[BankState, State]:
        """A fresh state."""
        return self.bank.start(), () if self.observer is None else self.observer.start()

    def advance(
        self, bank: BankState, observer: State, channels: Channels, dt_s: Array, used: NDArray[np.bool_],
        rows: NDArray[np.intp] | None,
    ) -> tuple[BankState, State, Array]:  # fmt: skip
        """Feed n samples; the new states, and the features (F, m) at `rows` (None: all).

        `dt_s` (n,) is the time since the previous used sample, 0 where a sample is not `used`.
        """
        signals = self.map.signals(channels)
        bank, filtered = self.bank.advance(bank, dt_s, signals, rows)
        observed = None
        if self.observer is not None:
            observer, outputs = self.observer.advance(
                observer, channels.voltage_V, channels.current_A, channels.ambient_C, dt_s, used, rows
            )
            observed = outputs.T
        raw = None
        if self.map.uses_signals:
            raw = signals if rows is None else signals.take(rows, axis=1)
        return bank, observer, self.map.features(filtered, raw, observed)


def extractor_of(specification: Specification) -> Extractor:
    """What a specification asks for."""
    return Extractor(bank_of(specification), specification.observer, FeatureMap(specification))
