"""What is computed before the network: `motorlens.spec` of docs/sensor-file.md, from the side that writes it."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_train.observer.file import Observer

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Output:
    """A promised quantity, its unit and the size by which its errors are judged."""

    name: str
    unit: str
    scale: float


@dataclass(frozen=True)
class Filter:
    """First-order low-pass of a signal."""

    signal: str
    tau_s: float


@dataclass(frozen=True)
class Feature:
    """One input of the network, as the difference of two quantities.

    Attributes:
        kind: "raw" (a signal), "lowpass" (a filter), "difference" (signal less filter), "between" (filter less filter) or
            "observer" (an output of the observer).
        signal: of raw and difference.
        filters: indices of the filters that take part; for an observer, the index of its output.
    """

    kind: str
    signal: str = ""
    filters: tuple[int, ...] = ()

    def document(self) -> dict[str, object]:
        """As the specification writes it."""
        match self.kind:
            case "raw":
                return {"kind": "raw", "signal": self.signal}
            case "lowpass":
                return {"kind": "lowpass", "filter": self.filters[0]}
            case "difference":
                return {"kind": "difference", "signal": self.signal, "filter": self.filters[0]}
            case "observer":
                return {"kind": "observer", "output": self.filters[0]}
            case _:
                return {"kind": "between", "filters": list(self.filters)}


@dataclass(frozen=True)
class Envelope:
    """Where the sensor was trained: ranges of its inputs, and the cloud of its features.

    Attributes:
        voltage_V, current_A: lowest and highest value.
        cloud: of the features; None where nothing was learned from them.
    """

    voltage_V: tuple[float, float]
    current_A: tuple[float, float]
    cloud: "Cloud | None" = None


@dataclass(frozen=True)
class Cloud:
    """Where the features were in training.

    Attributes:
        mean: `[F]` mean of the features.
        precision_cholesky: `[F, F]` lower triangular C with C C^T the inverse covariance.
        limit: largest `|C^T (x - mean)|^2` that counts as inside.
    """

    mean: Array
    precision_cholesky: Array
    limit: float

    def near(self, features: Array) -> Array:
        """`[N]` from 1 where features `[N, F]` are inside, to 0 where their squared distance is twice the limit or more."""
        squared = (((features - self.mean) @ self.precision_cholesky) ** 2).sum(1)
        return np.asarray(np.clip(2 - squared / self.limit, 0.0, 1.0))

    def document(self) -> dict[str, object]:
        """As the specification writes it."""
        cholesky = _rounded(self.precision_cholesky)
        return {"mean": _rounded(self.mean), "precision_cholesky": cholesky, "limit": self.limit}


@dataclass(frozen=True)
class Rate:
    """Sample rates in hertz."""

    nominal: float
    minimum: float
    maximum: float


@dataclass(frozen=True)
class Bank:
    """Signals, filters and features of a sensor; `ambient` says whether the ambient temperature is an input.

    An `observer`, where there is one, runs beside the filters on the same samples.
    """

    resistance_ohm: float
    inductance_H: float
    filters: tuple[Filter, ...]
    features: tuple[Feature, ...]
    ambient: bool = False
    observer: Observer | None = None

    @property
    def distrust(self) -> int | None:
        """The feature that is above 0 where the observer is not to be believed."""
        if self.observer is None or "distrust" not in self.observer.outputs:
            return None
        return self.features.index(Feature("observer", filters=(self.observer.outputs.index("distrust"),)))

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of all signals that filters and features use, each once, in order of first use."""
        used = [f.signal for f in self.filters] + [f.signal for f in self.features if f.signal]
        return tuple(dict.fromkeys(used))


@dataclass(frozen=True)
class Specification:
    """All of `motorlens.spec`."""

    outputs: tuple[Output, ...]
    bank: Bank
    rate: Rate
    warm_up_s: float
    envelope: Envelope

    def document(self) -> dict[str, object]:
        """The JSON document; see docs/sensor-file.md."""
        bank, envelope = self.bank, self.envelope
        return {
            "schema": "motorlens.spec/1",
            "outputs": [asdict(output) for output in self.outputs],
            "inputs": ["voltage", "current", *(["ambient"] if bank.ambient else [])],
            "resistance_ohm": bank.resistance_ohm,
            "inductance_H": bank.inductance_H,
            "filters": [asdict(f) for f in bank.filters],
            "features": [f.document() for f in bank.features],
            **({"observer": bank.observer.document()} if bank.observer else {}),
            "sample_rate_Hz": asdict(self.rate),
            "warm_up_s": self.warm_up_s,
            "envelope": {
                "voltage_V": list(envelope.voltage_V),
                "current_A": list(envelope.current_A),
                **({"features": envelope.cloud.document()} if envelope.cloud else {}),
            },
        }


def bank_from(document: Mapping[str, Any]) -> Bank:
    """The bank of a `motorlens.spec` document, as `Specification.document` writes it."""

    def feature(entry: Mapping[str, Any]) -> Feature:
        filters = entry.get("filters", [entry["filter"]] if "filter" in entry else [])
        return Feature(entry["kind"], entry.get("signal", ""), tuple(filters))

    return Bank(
        document["resistance_ohm"],
        document["inductance_H"],
        tuple(Filter(**entry) for entry in document["filters"]),
        tuple(feature(entry) for entry in document["features"]),
        "ambient" in document["inputs"],
    )


def _rounded(values: Array) -> list[object]:
    """Five digits: the envelope is a fence, and the file is to stay small."""
    if values.ndim == 2:
        return [_rounded(row) for row in values]
    return [float(f"{value:.5g}") + 0.0 for value in values]
