"""The runtime alone: the wheel in a clean environment without extras infers a CSV and brings nothing heavy along."""

import json
import os
import subprocess
import sys
import venv
from pathlib import Path

import pytest
from helpers.sensor_files import write_sensor

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "scipy", "sympy", "numba", "pandas", "matplotlib", "onnx")

# Runs in the clean environment: infers, then says what is installed and what was imported.
SCRIPT = """
import importlib.metadata, json, sys
from motorlens_runtime.cli import main
status = main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "out.csv"])
status += main(["run", "--source", "file:rec.csv", "--sensor", "s.onnx", "--publish", "csv:run.csv", "--rate", "0"])
from motorlens_runtime.monitor.page import FILES
from motorlens_runtime.web import asset
status += not all(asset(package, name) for package, name, _ in FILES.values())  # the live page came along
installed = sorted(d.metadata["Name"].lower() for d in importlib.metadata.distributions())
print(json.dumps({"status": status, "installed": installed, "imported": sorted({m.partition(".")[0] for m in sys.modules})}))
"""


def write_inputs(folder):
    write_sensor(folder / "s.onnx")
    rows = "".join(f"{k / 1000},{100 + k % 5},{8 + k % 3}\n" for k in range(200))
    (folder / "rec.csv").write_text("time_s,voltage_V,current_A\n" + rows)


@pytest.mark.slow
def test_the_wheel_without_extras_infers_and_nothing_heavy_is_there(tmp_path):
    write_inputs(tmp_path)
    build = [
        sys.executable,
        "-m",
        "build",
        "--wheel",
        "--no-isolation",
        "--outdir",
        str(tmp_path / "dist"),
        str(ROOT),
    ]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = (tmp_path / "dist").glob("motorlens-*.whl")
    venv.create(tmp_path / "clean", with_pip=True)
    python = tmp_path / "clean" / "bin" / "python"
    installed = subprocess.run([python, "-m", "pip", "install", "-q", wheel], capture_output=True, text=True)
    if installed.returncode and "No matching distribution" in installed.stderr:
        pytest.skip("no package index can be reached from here")
    assert installed.returncode == 0, installed.stderr
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run([python, "-c", SCRIPT], cwd=tmp_path, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout.splitlines()[-1])
    assert result["status"] == 0
    assert not set(HEAVY) & set(result["installed"])
    assert not set(HEAVY) & set(result["imported"])
    assert {"numpy", "onnxruntime", "pyserial", "motorlens"} <= set(result["installed"])
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert len(lines) == 201 and lines == (tmp_path / "run.csv").read_text().splitlines()
    # the one command is there, and says in one line what an extra would bring
    motorlens = tmp_path / "clean" / "bin" / "motorlens"
    command = [motorlens, "infer", "rec.csv", "--sensor", "s.onnx", "-o", "out.parquet"]
    refused = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True)
    assert refused.returncode == 1
    assert (
        refused.stderr.strip()
        == "motorlens infer: needs pyarrow, which is not installed: pip install 'motorlens[publish]'"
    )
    overview = subprocess.run([motorlens, "--help"], env=clean, capture_output=True, text=True)
    assert overview.returncode == 0, overview.stderr


def test_the_runtime_runs_with_every_heavy_import_blocked(tmp_path):
    """Where they are installed, an import of any of them raises."""
    write_inputs(tmp_path)
    block = f"""
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {HEAVY!r}:
            raise AssertionError(f"the runtime imports {{name}}")
sys.meta_path.insert(0, Block())
"""
    done = subprocess.run(
        [sys.executable, "-c", block + SCRIPT], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["status"] == 0
    others = ("motorlens_physics", "motorlens_train", "motorlens_firmware_sim", "motorlens_workbench")
    assert not set(others) & set(json.loads(done.stdout.splitlines()[-1])["imported"])


def test_without_onnx_runtime_the_numpy_backend_gives_the_same(tmp_path):
    write_inputs(tmp_path)
    block = "import sys\nsys.modules['onnxruntime'] = None\n"
    done = subprocess.run(
        [sys.executable, "-c", block + SCRIPT], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    numpy_rows = [
        list(map(float, line.split(","))) for line in (tmp_path / "out.csv").read_text().splitlines()[1:]
    ]
    subprocess.run([sys.executable, "-c", SCRIPT], cwd=tmp_path, check=True, capture_output=True)
    ort_rows = [
        list(map(float, line.split(","))) for line in (tmp_path / "out.csv").read_text().splitlines()[1:]
    ]
    for ours, theirs in zip(numpy_rows, ort_rows, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-3)
