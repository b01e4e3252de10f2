"""A virtual sensor from its file: verified before it is believed.

In this order: the hash the file carries of itself, the schema, the specification, two backends that agree, and the golden
sequence. A file that fails any of them does not load; docs/sensor-file.md says what a sensor file holds.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import ModelError
from motorlens_runtime.estimate.bank import FilterBank
from motorlens_runtime.estimate.extractor import Extractor, extractor_of
from motorlens_runtime.estimate.features import Channels
from motorlens_runtime.files.shipped import sensor_path
from motorlens_runtime.sensor.backend import TILE, Backend, NumpyBackend, OrtBackend
from motorlens_runtime.sensor.core_backend import CoreBackend
from motorlens_runtime.sensor.folded import fold
from motorlens_runtime.sensor.onnx_file import OnnxFile, check_seal, parse
from motorlens_runtime.sensor.specification import Specification, parse_specification
from motorlens_runtime.sensor.tables import tables_of

SCHEMA = "motorlens.sensor/1"
BACKENDS = ("auto", "core", "numpy", "onnxruntime")
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sensor:
    """A verified sensor. `checker` is a second backend that must agree with `backend`, None if there is none."""

    path: str
    name: str
    version: str
    licence: str
    digest: str
    specification: Specification
    card: dict[str, Any]
    extractor: Extractor
    backend: Backend
    checker: Backend | None

    @property
    def bank(self) -> FilterBank:
        """The filters of the sensor."""
        return self.extractor.bank


def load_sensor(path: str | Path, backend: str = "auto") -> Sensor:
    """Load and verify a sensor.

    Args:
        path: the core graph, `NAME.onnx`, or the name of a shipped sensor.
        backend: one of `BACKENDS`; "auto" is the C core, or numpy where there is none, checked against onnxruntime where
            that is installed.

    Raises:
        ModelError: the file is absent, damaged, altered, of an unknown kind, or does not give its golden values.
    """
    path = sensor_path(path)
    where = str(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{where}: {error.strerror}") from None
    if not data:
        raise ModelError(f"{where}: the file is empty; copy it again")
    digest = check_seal(data, where)
    model = parse(data, where)
    schema = model.metadata.get("motorlens.schema")
    if schema != SCHEMA:
        raise ModelError(f"{where}: schema {schema!r}; this runtime knows {SCHEMA}")
    specification = parse_specification(_entry(model, "motorlens.spec", where), where)
    chosen, checker = _backends(data, model, specification, backend, where)
    sensor = Sensor(
        where, _entry(model, "motorlens.name", where, path.stem), _entry(model, "motorlens.version", where, ""),
        _entry(model, "motorlens.licence", where, ""), digest, specification,
        _json(model, "motorlens.card", where, default="{}"),
        extractor_of(specification), chosen, checker,
    )  # fmt: skip
    _check_golden(sensor, _json(model, "motorlens.golden", where))
    return sensor


def scales(specification: Specification) -> Array:
    """The scale (K,) of each output."""
    return np.array([output.scale for output in specification.outputs])


def tiled(features: Array, before: int) -> Array:
    """Features (F, m) in tiles (t, F, 16), with `before` columns of zeros before and as many after as fill the last."""
    width, m = features.shape
    count = -(-(before + m) // TILE)
    if before or count * TILE != m:
        table = np.zeros((width, count * TILE))
        table[:, before : before + m] = features
    else:
        table = features
    return table.reshape(width, count, TILE).transpose(1, 0, 2)


def untiled(values: Array) -> Array:
    """Values (K, t * 16) of tiles (t, K, 16)."""
    return values.transpose(1, 0, 2).reshape(values.shape[1], -1)


def _backends(
    data: bytes, model: OnnxFile, specification: Specification, wanted: str, where: str
) -> tuple[Backend, Backend | None]:
    """What computes, and the second that looks now and then, in the order of speed: the C core, numpy, ONNX Runtime."""
    if wanted not in BACKENDS:
        raise ModelError(f"{where}: no backend {wanted!r}; choose {', '.join(BACKENDS)}")
    features, outputs = len(specification.features), len(specification.outputs)
    ways: dict[str, Callable[[], Backend]] = {
        "core": lambda: CoreBackend(tables_of(specification, fold(model, features, where))),
        "numpy": lambda: NumpyBackend(fold(model, features, where), specification.envelope.mean),
        "onnxruntime": lambda: OrtBackend(data, features, outputs, where),
    }
    if wanted == "numpy":
        return ways["numpy"](), None
    made: list[Backend] = []
    for name in dict.fromkeys((*(() if wanted == "auto" else (wanted,)), *ways)):
        if name == "core" and wanted == "onnxruntime":
            continue
        try:
            made.append(ways[name]())
        except ModelError as error:
            if name == wanted or (name == "onnxruntime" and made):
                raise
            refused = error
        except ModuleNotFoundError:
            if name == wanted or not made:
                raise ModelError(
                    f"{where}: needs onnxruntime, which is not installed: pip install onnxruntime"
                ) from None
    if not made:
        raise refused
    # The second is the one that shares least with the first.
    return made[0], made[-1] if len(made) > 1 else None


def _check_golden(sensor: Sensor, golden: dict[str, Any]) -> None:
    """Run the golden sequence from a fresh state through every backend; raises ModelError where it does not come out."""
    specification, where = sensor.specification, sensor.path
    try:
        time_ns = np.round(np.array(golden["time_s"], dtype=np.float64) * 1e9).astype(np.int64)
        voltage, current = (np.array(golden[key], dtype=np.float64) for key in ("voltage_V", "current_A"))
        ambient = np.array(golden["ambient_C"], dtype=np.float64) if specification.needs_ambient else None
        shape = (len(time_ns), len(specification.outputs))
        expected = {
            key: np.array(golden[key], dtype=np.float64).reshape(shape) for key in ("estimate", "sigma")
        }
        tolerance = float(golden["tolerance"])
        if not len(time_ns):
            raise ValueError("empty")
        dt_s = np.diff(time_ns, prepend=time_ns[0] - specification.first_dt_ns) * 1e-9
        channels = Channels(voltage, current, ambient)
        used = np.ones(len(time_ns), dtype=bool)
        *_, features = sensor.extractor.advance(*sensor.extractor.start(), channels, dt_s, used, None)
    except (KeyError, ValueError, TypeError) as error:
        raise ModelError(f"{where}: golden sequence is damaged ({type(error).__name__}: {error})") from None
    tiles = tiled(features, 0)
    for backend in (sensor.backend, sensor.checker):
        if backend is None:
            continue
        for key, values in zip(("estimate", "sigma"), backend.evaluate(tiles), strict=True):
            off = np.abs(untiled(values)[:, : len(time_ns)].T - expected[key]) / scales(specification)
            if not bool(np.all(off <= tolerance)):
                row, column = np.unravel_index(int(np.argmax(np.where(np.isnan(off), np.inf, off))), shape)
                raise ModelError(
                    f"{where}: golden values do not come out: {backend.name} gives {key} of "
                    f"{specification.outputs[column].name} {off[row, column]:.1e} of its scale off in row {row + 1}; "
                    "do not use this file"
                )


def _entry(model: OnnxFile, key: str, where: str, default: str | None = None) -> str:
    text = model.metadata.get(key, default)
    if text is None:
        raise ModelError(f"{where}: no {key} in its metadata; export it again")
    return text


def _json(model: OnnxFile, key: str, where: str, default: str | None = None) -> dict[str, Any]:
    try:
        document = json.loads(_entry(model, key, where, default))
    except (ValueError, RecursionError):
        document = None
    if not isinstance(document, dict):
        raise ModelError(f"{where}: {key} is not a JSON object; export it again")
    return document
