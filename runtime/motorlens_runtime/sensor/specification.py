"""What a sensor file says the runtime must compute: `motorlens.spec`, as docs/sensor-file.md defines it."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.observer import Observer

SIGNALS = (
    "one", "voltage", "current", "current_squared", "voltage_squared", "power", "emf", "emf_squared", "emf_power", "ambient",
)  # fmt: skip
# Output and unit -> heading of its column in a file. `temperature` in kelvin is the rise above ambient.
HEADINGS = {
    ("speed", "rad/s"): ("speed_rad_s", "speed_sd_rad_s"),
    ("temperature", "K"): ("temperature_rise_K", "temperature_rise_sd_K"),
    ("temperature", "degC"): ("temperature_C", "temperature_sd_C"),
    ("resistance", "ohm"): ("resistance_ohm", "resistance_sd_ohm"),
}


@dataclass(frozen=True)
class Output:
    """One promised quantity; `scale` is the size by which its errors are judged."""

    name: str
    unit: str
    scale: float

    @property
    def heading(self) -> str:
        """Its column in a file, `quantity_unit`."""
        return HEADINGS[self.name, self.unit][0]

    @property
    def sd_heading(self) -> str:
        """The column of its standard deviation."""
        return HEADINGS[self.name, self.unit][1]


@dataclass(frozen=True)
class Filter:
    """First-order low-pass of a signal."""

    signal: str
    tau_s: float


@dataclass(frozen=True)
class Feature:
    """One input of the network: kind, its signal (raw, difference; else ""), its filters (lowpass, difference, between),
    the output of the observer that it is (observer)."""

    kind: str
    signal: str
    filters: tuple[int, ...]
    output: int = 0


@dataclass(frozen=True)
class Envelope:
    """Where the sensor was trained. `mean` (F,), `cholesky` (F, F) and `limit` are absent if features are not limited."""

    voltage_V: tuple[float, float]
    current_A: tuple[float, float]
    mean: NDArray[np.float64] | None = None
    cholesky: NDArray[np.float64] | None = None
    limit: float = np.inf


@dataclass(frozen=True)
class Specification:
    """Everything between a sample and a row of features."""

    outputs: tuple[Output, ...]
    needs_ambient: bool
    resistance_ohm: float
    inductance_H: float
    filters: tuple[Filter, ...]
    features: tuple[Feature, ...]
    rate_Hz: float
    minimum_rate_Hz: float
    maximum_rate_Hz: float
    warm_up_s: float
    envelope: Envelope
    observer: Observer | None = None

    @property
    def cold_ns(self) -> int:
        """How long an estimate of heat rests on the start being at ambient temperature: a twentieth of it is left after.

        Three times the slowest filter's time constant; 0 with an observer, which reads the temperature off the inrush, and
        where speed alone is estimated.
        """
        heat = any(output.name != "speed" for output in self.outputs)
        slowest = max((f.tau_s for f in self.filters), default=0.0)
        return round(3e9 * slowest) if heat and self.observer is None else 0

    @property
    def distrust(self) -> int:
        """The feature that is above 0 where the observer is not to be believed; -1 is none."""
        output = -1 if self.observer is None else self.observer.distrust
        places = [k for k, f in enumerate(self.features) if f.kind == "observer" and f.output == output]
        return places[0] if places else -1

    @property
    def first_dt_ns(self) -> int:
        """The step of the very first sample."""
        return round(1e9 / self.rate_Hz)


def signals_of(specification: Specification) -> tuple[str, ...]:
    """The signals that its filters and features use, each once: the rows in which the runtime keeps them."""
    filters, features = specification.filters, specification.features
    return tuple(dict.fromkeys([*(f.signal for f in filters), *(f.signal for f in features if f.signal)]))


def parse_specification(text: str, where: str) -> Specification:
    """Read `motorlens.spec`.

    Raises:
        ModelError: a key is missing, a number is not usable, or something is in it that this runtime does not know.
    """
    try:
        document = json.loads(text)
        if document["schema"] != "motorlens.spec/1":
            raise ModelError(
                f"{where}: specification {document['schema']!r}; this runtime knows motorlens.spec/1"
            )
        rate = document["sample_rate_Hz"]
        observer = Observer(document["observer"]) if document.get("observer") else None
        specification = Specification(
            outputs=tuple(_output(entry, where) for entry in document["outputs"]),
            needs_ambient=_needs_ambient(document["inputs"], where),
            resistance_ohm=_number(document["resistance_ohm"]),
            inductance_H=_number(document.get("inductance_H") or 0.0),
            filters=tuple(Filter(_signal(f["signal"], where), _positive(f["tau_s"])) for f in document["filters"]),
            features=tuple(
                _feature(entry, len(document["filters"]), observer.outputs if observer else 0, where)
                for entry in document["features"]
            ),
            rate_Hz=_positive(rate["nominal"]),
            minimum_rate_Hz=_positive(rate["minimum"]), maximum_rate_Hz=_positive(rate["maximum"]),
            warm_up_s=_number(document["warm_up_s"]),
            envelope=_envelope(document["envelope"], len(document["features"])),
            observer=observer,
        )  # fmt: skip
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as error:
        raise ModelError(f"{where}: specification is damaged ({type(error).__name__}: {error})") from None
    used = {f.signal for f in specification.filters} | {f.signal for f in specification.features}
    if "ambient" in used and not specification.needs_ambient:
        raise ModelError(f"{where}: uses the ambient temperature but does not list it among its inputs")
    return specification


def _output(entry: dict[str, Any], where: str) -> Output:
    if (entry["name"], entry["unit"]) not in HEADINGS:
        raise ModelError(f"{where}: unknown output {entry['name']!r} in {entry['unit']!r}; update motorlens")
    return Output(entry["name"], entry["unit"], _positive(entry["scale"]))


def _needs_ambient(inputs: list[str], where: str) -> bool:
    if inputs not in (["voltage", "current"], ["voltage", "current", "ambient"]):
        raise ModelError(f"{where}: inputs {inputs}; this runtime knows voltage, current and ambient")
    return len(inputs) == 3


def _signal(name: str, where: str) -> str:
    if name not in SIGNALS:
        raise ModelError(f"{where}: unknown signal {name!r}; update motorlens")
    return name


def _feature(entry: dict[str, Any], filters: int, observed: int, where: str) -> Feature:
    kind = entry["kind"]
    if kind == "observer":
        if not 0 <= entry["output"] < observed:
            raise ValueError("a feature names an output of the observer that is not there")
        return Feature(kind, "", (), int(entry["output"]))
    signal = _signal(entry["signal"], where) if kind in ("raw", "difference") else ""
    chosen = {
        "raw": (),
        "lowpass": (entry.get("filter"),),
        "difference": (entry.get("filter"),),
        "between": tuple(entry.get("filters", ())),
    }
    if kind not in chosen:
        raise ModelError(f"{where}: unknown feature {kind!r}; update motorlens")
    if len(chosen[kind]) != {"raw": 0, "lowpass": 1, "difference": 1, "between": 2}[kind]:
        raise ValueError(f"feature {kind} names {len(chosen[kind])} filters")
    if any(not 0 <= index < filters for index in chosen[kind]):
        raise ValueError(f"feature {kind} names a filter that is not there")
    return Feature(kind, signal, chosen[kind])


def _envelope(entry: dict[str, Any], features: int) -> Envelope:
    voltage, current = (
        (_number(low), _number(high)) for low, high in (entry["voltage_V"], entry["current_A"])
    )
    cloud = entry.get("features")
    if cloud is None:
        return Envelope(voltage, current)
    mean = np.array(cloud["mean"], dtype=np.float64).reshape(features)
    cholesky = np.array(cloud["precision_cholesky"], dtype=np.float64).reshape(features, features)
    return Envelope(voltage, current, mean, cholesky, _positive(cloud["limit"]))


def _number(value: float) -> float:
    if not np.isfinite(value := float(value)):
        raise ValueError("not finite")
    return value


def _positive(value: float) -> float:
    if (value := _number(value)) <= 0:
        raise ValueError(f"{value} is not positive")
    return value
