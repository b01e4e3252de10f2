"""A sensor file as a method among others: its core graph in ONNX Runtime, its features by the training feature bank."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError, ModelError
from motorlens_runtime.files.shipped import sensor_path
from motorlens_train.baselines.method import OUTPUTS, Estimate, inputs
from motorlens_train.features import feature_rows
from motorlens_train.observer.file import Observer
from motorlens_train.specification import Array, Bank, Envelope, Feature, Filter

_ROWS = 65536


@dataclass(frozen=True)
class SensorFile:
    """An exported sensor; `session` is ONNX Runtime's, `kind` the type of its features, `envelope` its inputs' ranges."""

    name: str
    session: Any
    bank: Bank
    promised: tuple[str, ...]
    first_dt_s: float
    kind: str
    envelope: Envelope

    def fit(self, recordings: Sequence[Recording], motor_file: MotorFile) -> "SensorFile":
        """A sensor file is trained already."""
        return self

    def estimate(self, recording: Recording) -> Estimate:
        """See `Method.estimate`. A temperature in degC is given as the rise above the ambient it was told."""
        time, v, i = inputs(recording)
        ambient = None
        if self.bank.ambient:
            if not recording.has("ambient"):
                raise DataError(
                    f"{recording.name}: {self.name} needs the ambient temperature: an ambient_C column"
                )
            ambient = recording.channels["ambient"]
        features = feature_rows(self.bank, time, v, i, None, ambient, self.first_dt_s)
        values, sds = np.full((len(time), 3), np.nan), np.full((len(time), 3), np.nan)
        columns = [OUTPUTS.index(name) for name in self.promised]
        values[:, columns], sds[:, columns] = self.evaluate(features)
        if ambient is not None:
            values[:, 1] -= ambient
        return Estimate.of(values, sds)

    def evaluate(self, features: Array) -> tuple[Array, Array]:
        """Estimate and sigma `[N, K]` for features `[N, F]`."""
        features = features.astype(np.float64 if self.kind == "tensor(double)" else np.float32)
        parts = [
            self.session.run(["estimate", "sigma"], {"features": features[first : first + _ROWS]})
            for first in range(0, len(features), _ROWS)
        ]
        values, sds = (np.concatenate(part) for part in zip(*parts, strict=True))
        return np.asarray(values, dtype=np.float64), np.asarray(sds, dtype=np.float64)


def read_sensor(path: Path | str) -> SensorFile:
    """Open an exported sensor for evaluation, or the shipped one of that name.

    Raises:
        ModelError: it is not an ONNX file of the kind that `motorlens train` writes.
        OSError: it cannot be read.
    """
    import onnxruntime

    data = sensor_path(path).read_bytes()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        known = session.get_modelmeta().custom_metadata_map
        document = json.loads(known["motorlens.spec"])
        bank = bank_from(document)
        outputs = tuple(entry["name"] for entry in document["outputs"])
        step = 1 / float(document["sample_rate_Hz"]["nominal"])
        envelope = Envelope(
            tuple(document["envelope"]["voltage_V"]), tuple(document["envelope"]["current_A"])
        )
    except Exception as error:
        raise ModelError(f"{path}: not a motorlens sensor: {type(error).__name__}: {error}") from None
    kind = session.get_inputs()[0].type
    return SensorFile(
        known.get("motorlens.name", Path(path).stem), session, bank, outputs, step, kind, envelope
    )


def bank_from(document: dict[str, Any]) -> Bank:
    """The feature bank of a specification (`motorlens.spec` of docs/sensor-file.md).

    Raises:
        KeyError, ValueError: it is not one.
    """

    def feature(entry: dict[str, Any]) -> Feature:
        match entry["kind"]:
            case "raw":
                return Feature("raw", entry["signal"])
            case "lowpass":
                return Feature("lowpass", filters=(int(entry["filter"]),))
            case "difference":
                return Feature("difference", entry["signal"], (int(entry["filter"]),))
            case "between":
                return Feature("between", filters=tuple(int(index) for index in entry["filters"]))
            case "observer":
                return Feature("observer", filters=(int(entry["output"]),))
            case kind:
                raise ValueError(f"unknown feature {kind!r}")

    observer = document.get("observer")
    return Bank(
        float(document["resistance_ohm"]), float(document["inductance_H"]),
        tuple(Filter(entry["signal"], float(entry["tau_s"])) for entry in document["filters"]),
        tuple(feature(entry) for entry in document["features"]), "ambient" in document["inputs"],
        Observer.from_document(observer) if observer else None,
    )  # fmt: skip
