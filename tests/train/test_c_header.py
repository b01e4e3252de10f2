"""The C99 header against the training code: the same sensor, compiled."""

import shutil
import subprocess

import numpy as np
import pytest
from helpers.duty import MELLAH, measured_duty
from helpers.sensors import small_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.c_header import c_header
from motorlens_train.features import feature_rows

cffi = pytest.importorskip("cffi")
compiler = shutil.which("cc") or shutil.which("gcc")
needs_compiler = pytest.mark.skipif(compiler is None, reason="no C compiler on this machine")


def _run(header: str, double: bool, folder, time, voltage, current) -> np.ndarray:
    (folder / "s.h").write_text(header)
    real = "double" if double else "float"
    (folder / "s.c").write_text(
        '#include "s.h"\n'
        f"void run(int n, const double *v, const double *i, const double *dt, {real} *out) {{\n"
        "  s_state state = {0};\n"
        "  for (int k = 0; k < n; k++) s_step(&state, v[k], i[k], dt[k], out + 6 * k, out + 6 * k + 3);\n}\n"
    )
    library = folder / "s.so"
    subprocess.run(
        [compiler, "-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC", "-o", library,
         folder / "s.c", "-lm"],
        check=True,
    )  # fmt: skip
    ffi = cffi.FFI()
    ffi.cdef(f"void run(int n, const double *v, const double *i, const double *dt, {real} *out);")
    loaded = ffi.dlopen(str(library))
    out = np.zeros((len(time), 6), dtype=np.float64 if double else np.float32)
    dt = np.diff(time, prepend=time[0] - 0.005)
    arrays = [np.ascontiguousarray(column) for column in (voltage, current, dt)]
    loaded.run(
        len(time),
        *(ffi.cast("double *", a.ctypes.data) for a in arrays),
        ffi.cast(f"{real} *", out.ctypes.data),
    )
    return out.astype(np.float64)


def _uneven(recording):
    """Steps of any length: every third sample is missing, and there is a gap of two seconds."""
    at = np.arange(len(recording))
    keep = np.flatnonzero((at % 3 != 2) & (at // 400 != 4))
    return [y[keep] for y in (recording.time_s, recording.channels["voltage"], recording.channels["current"])]


@pytest.mark.fit
@needs_compiler
@pytest.mark.parametrize("observed", [False, True])
@pytest.mark.parametrize(("double", "tolerance"), [(True, 1e-10), (False, 1e-4)])
def test_c_gives_what_the_training_code_gives(observed, double, tolerance, tmp_path):
    sensor = small_sensor(observed).sensor
    time, v, i = _uneven(measured_duty(3, 60.0, 200.0))
    features = feature_rows(sensor.bank, time, v, i, first_dt_s=0.005)
    estimate, sigma = sensor.evaluate(features)
    found = _run(c_header(sensor, "s", double), double, tmp_path, time, v, i)
    scale = np.array([output.scale for output in sensor.specification.outputs])
    assert np.max(np.abs(found[:, :3] - estimate) / scale) < tolerance
    assert np.max(np.abs(found[:, 3:] - sigma) / np.maximum(scale, sigma)) < tolerance
    # It is the sensor that is compared, not two constants.
    assert np.ptp(found[:, 0]) > 50


@needs_compiler
def test_a_plain_network_too(tmp_path):
    sensor = small_sensor(False, skips=False).sensor
    time, v, i = _uneven(measured_duty(4, 20.0, 200.0))
    estimate, _ = sensor.evaluate(feature_rows(sensor.bank, time, v, i, first_dt_s=0.005))
    found = _run(c_header(sensor, "s", True), True, tmp_path, time, v, i)
    scale = np.array([output.scale for output in sensor.specification.outputs])
    assert np.max(np.abs(found[:, :3] - estimate) / scale) < 1e-10


def test_the_header_allocates_nothing_and_includes_only_math():
    header = c_header(small_sensor(True).sensor, "s")
    assert [line for line in header.splitlines() if line.startswith("#include")] == ["#include <math.h>"]
    assert "malloc" not in header and "printf" not in header


@pytest.mark.fit
def test_the_train_command_writes_sensor_and_header(tmp_path):
    motor = tmp_path / "motor.toml"
    motor.write_text(MELLAH.text)
    status = main(
        ["train", "--motor", str(motor), "--observer", str(motor), "--cycles", "10", "--rate", "100", "--iterations", "4",
         "-o", str(tmp_path / "a-b.onnx"), "--c-header", str(tmp_path / "a.h")]
    )  # fmt: skip
    assert status == 0
    assert "a_b_step" in (tmp_path / "a.h").read_text()
    assert load_sensor(tmp_path / "a-b.onnx").specification.observer is not None
