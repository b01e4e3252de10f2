"""Export of a sensor: a folder of C99 for any compiler, with the proof that it computes what the sensor file says."""

import json
import re
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from motorlens_runtime.errors import DataError, ModelError
from motorlens_runtime.files.shipped import sensor_path
from motorlens_runtime.sensor.c_source import Golden, core_files, written
from motorlens_runtime.sensor.core_library import CALL_S, STRICT_FLAGS, compilers, why_not
from motorlens_runtime.sensor.folded import fold
from motorlens_runtime.sensor.onnx_file import parse
from motorlens_runtime.sensor.sensor import Sensor, load_sensor, scales
from motorlens_runtime.sensor.tables import Tables, tables_of


@dataclass(frozen=True)
class Proof:
    """What the golden test said here: the worst error of estimates and deviations, as shares of scale."""

    compiler: str
    estimate_error: float
    sigma_error: float


def export_c(path: Path, folder: Path, single: bool, name: str) -> dict[str, Any]:
    """Write the sensor in `path` as C99 into `folder`, which must be new or empty.

    Args:
        path: sensor file.
        folder: where the files go.
        single: whether the network computes in single precision.
        name: prefix of the sensor's identifiers, a C identifier.

    Returns:
        the document of `--json`.

    Raises:
        DataError: the folder holds something, or the name is no C identifier.
        ModelError: the sensor is not usable, has a function that the core lacks, or the golden values do not come out.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise DataError(f"--name {name}: small letters, digits and _, a letter first")
    if folder.exists() and any(folder.iterdir()):
        raise DataError(f"{folder}: is not empty; name a new folder")
    sensor, tables, golden = exported(path, single)
    outputs = [(o.name, o.unit) for o in sensor.specification.outputs]
    files = written(name, f"{sensor.name} {sensor.version}", tables, golden, single, outputs)
    proof = prove(files)
    if proof is not None and not max(proof.estimate_error, proof.sigma_error) <= golden.tolerance:
        raise ModelError(
            f"{path}: as C its golden values are {proof.estimate_error:.1e} of scale off, more than {golden.tolerance:g}; "
            "export it in double precision (--double)"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in (*files.items(), ("README.md", _card(sensor, name, single, proof))):
        (folder / file).write_text(text, encoding="utf-8")
    return {
        "schema": "motorlens.export/1", "sensor": {"name": sensor.name, "version": sensor.version, "sha256": sensor.digest},
        "precision": "single" if single else "double", "files": sorted([*files, "README.md"]),
        "proof": None if proof is None else vars(proof),
    }  # fmt: skip


def exported(path: Path, single: bool) -> tuple[Sensor, Tables, Golden]:
    """A verified sensor, its tables and its golden sequence. Raises ModelError if it is not usable."""
    path = sensor_path(path)
    sensor = load_sensor(path, "numpy")
    model = parse(path.read_bytes(), str(path))
    tables = tables_of(
        sensor.specification, fold(model, len(sensor.specification.features), str(path)), single
    )
    document = json.loads(model.metadata["motorlens.golden"])
    n, scale = len(document["time_s"]), scales(sensor.specification)
    column = {key: np.array(document[key], dtype=np.float64) for key in ("voltage_V", "current_A")}
    ambient = np.array(document["ambient_C"]) if sensor.specification.needs_ambient else None
    golden = Golden(
        np.round(np.array(document["time_s"]) * 1e9).astype(np.int64), column["voltage_V"], column["current_A"], ambient,
        np.array(document["estimate"]).reshape(n, -1), np.array(document["sigma"]).reshape(n, -1), scale,
        float(document["tolerance"]),
    )  # fmt: skip
    return sensor, tables, golden


def prove(files: Mapping[str, str]) -> Proof | None:
    """Compile and run the golden test with this machine's compiler; None where there is none.

    Raises:
        ModelError: it does not compile, or one or the other does not end.
    """
    compiler = next(iter(compilers()), None)
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory(prefix="motorlens-") as scratch:
        for name, text in files.items():
            (Path(scratch) / name).write_text(text, encoding="utf-8")
        sources = sorted(name for name in files if name.endswith(".c") and name != "main.c")
        try:
            subprocess.run(
                [compiler, *STRICT_FLAGS, "-O2", "-o", "golden_test", *sources, "-lm"],
                cwd=scratch, check=True, capture_output=True, text=True, timeout=CALL_S,
            )  # fmt: skip
            done = subprocess.run(
                ["./golden_test"], cwd=scratch, capture_output=True, text=True, timeout=CALL_S
            )
        except subprocess.TimeoutExpired as error:
            raise ModelError(
                f"the exported sensor was not checked and not written: {why_not(error)}"
            ) from None
        except (OSError, subprocess.SubprocessError) as error:
            raise ModelError(f"the exported sensor does not compile: {why_not(error)[:300]}") from None
    first, second = done.stdout.split()[:2]
    return Proof(Path(compiler).name, float(first), float(second))


def _card(sensor: Sensor, name: str, single: bool, proof: Proof | None) -> str:
    precision = (
        "Measurements are in single precision, filters in whole numbers of 64 bits, the features' distance from where the\n"
        "sensor was trained and the network's columns in 32; an observer computes in double, which such a core does in\n"
        "software."
        if single
        else "All is computed in double precision."
    )
    said = (
        "Nothing was compiled where this was written: run golden_test before you believe it."
        if proof is None
        else f"Golden values: estimates within {proof.estimate_error:.1e} of scale, deviations within "
        f"{proof.sigma_error:.1e} ({proof.compiler})."
    )
    sources = " ".join(sorted(f for f in core_files() if f.endswith(".c")))
    return f"""# {sensor.name} {sensor.version} in C99

Written by `motorlens export` from the sensor with SHA-256 {sensor.digest}. Licence: {sensor.licence or "not stated"}.

{precision}
{said}

    cc -std=c99 -O2 -ffp-contract=off -o golden_test golden_test.c sensor.c {sources} -lm && ./golden_test
    cc -std=c99 -O2 -ffp-contract=off -o estimate main.c sensor.c {sources} -lm

No allocation, no globals: `{name}_sensor` is constant tables, `motorlens_state` is all that is remembered and may be copied
and put back. Without contraction of products and sums (`-ffp-contract=off`) every machine gives the same bits.
"""
