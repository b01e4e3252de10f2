"""The runtime alone: the wheel in a clean environment without extras infers a CSV and brings nothing heavy along."""

import json
import os
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
from helpers.processes import Program
from helpers.sensor_files import write_sensor

ROOT = Path(__file__).resolve().parents[1]
# Folders of the checkout, and where they are in the wheel.
PACKAGES = {
    **{f"{folder}/motorlens_{folder}/": f"motorlens_{folder}/"
       for folder in ("physics", "train", "runtime", "firmware_sim", "workbench")},
    "models/": "motorlens_runtime/models/", "runtime/core/": "motorlens_runtime/core/",
}  # fmt: skip
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


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel, built once from this checkout."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True, timeout=600)
    (built,) = folder.glob("motorlens-*.whl")
    return built


@pytest.mark.fit
def test_the_installed_wheel_brings_its_models_and_works_in_an_empty_folder(tmp_path, wheel):
    """What the README promises after `pip install`, with the packages it needs borrowed from here."""
    venv.create(tmp_path / "clean", with_pip=False)
    python = tmp_path / "clean" / "bin" / "python"
    (site,) = (tmp_path / "clean" / "lib").glob("python3.*/site-packages")
    (site / "borrowed.pth").write_text("\n".join(path for path in sys.path if path.endswith("site-packages")))
    install = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        str(python),
        "install",
        "-q",
        "--no-compile",
        "--no-deps",
        "--no-index",
        str(wheel),
    ]
    subprocess.run(install, check=True, capture_output=True, timeout=600)
    empty = tmp_path / "empty"
    empty.mkdir()
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    motorlens = tmp_path / "clean" / "bin" / "motorlens"

    def run(*words):
        done = subprocess.run(
            [motorlens, *words], cwd=empty, env=clean, capture_output=True, text=True, timeout=300
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    where = [python, "-c", "import motorlens_runtime as m; print(m.__file__)"]
    assert (
        str(site)
        in subprocess.run(where, env=clean, capture_output=True, text=True, check=True, timeout=600).stdout
    )
    run("simulate", "mellah2016", "--scenario", "load_steps", "--noise", "0.2%", "-o", "bench.csv")
    assert "speed" in run("look", "bench.csv")
    run("infer", "bench.csv", "--sensor", "mellah2016", "-o", "estimates.csv")
    rows = (empty / "bench.csv").read_text().count("\n")
    assert (empty / "estimates.csv").read_text().count("\n") == rows
    drive = [motorlens, "drive", "--duration", "1"]
    with Program(drive, cwd=empty, env=clean) as program:
        assert program.line().startswith("/dev/"), program.told()


@pytest.mark.fit
def test_all_that_stands_in_the_packages_is_in_the_wheel(wheel):
    """Every command works there as it does here: modules, what the pages need, models and the sources in C."""
    kept = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, timeout=600
    )
    if kept.returncode:
        pytest.skip("no checkout, whose list of files tells what was meant")
    expected = {
        next(path.replace(folder, place, 1) for folder, place in PACKAGES.items() if path.startswith(folder))
        for path in kept.stdout.splitlines()
    }
    with zipfile.ZipFile(wheel) as archive:
        assert len(expected) > 400 and expected <= set(archive.namelist())


@pytest.mark.fit
def test_the_wheel_without_extras_infers_and_nothing_heavy_is_there(tmp_path, wheel):
    write_inputs(tmp_path)
    venv.create(tmp_path / "clean", with_pip=False)
    python = tmp_path / "clean" / "bin" / "python"
    installed = subprocess.run(
        [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-compile", wheel],
        capture_output=True,
        text=True,
        timeout=600,
    )
    if installed.returncode and "No matching distribution" in installed.stderr:
        pytest.skip("no package index can be reached from here")
    assert installed.returncode == 0, installed.stderr
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        [python, "-c", SCRIPT], cwd=tmp_path, env=clean, capture_output=True, text=True, timeout=600
    )
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
    refused = subprocess.run(command, cwd=tmp_path, env=clean, capture_output=True, text=True, timeout=600)
    assert refused.returncode == 1
    assert (
        refused.stderr.strip()
        == "motorlens infer: needs pyarrow, which is not installed: pip install 'motorlens[publish]'"
    )
    overview = subprocess.run([motorlens, "--help"], env=clean, capture_output=True, text=True, timeout=600)
    assert overview.returncode == 0, overview.stderr


@pytest.mark.fit
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
        [sys.executable, "-c", block + SCRIPT],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["status"] == 0
    others = ("motorlens_physics", "motorlens_train", "motorlens_firmware_sim", "motorlens_workbench")
    assert not set(others) & set(json.loads(done.stdout.splitlines()[-1])["imported"])


@pytest.mark.fit
def test_without_onnx_runtime_the_numpy_backend_gives_the_same(tmp_path):
    write_inputs(tmp_path)
    block = "import sys\nsys.modules['onnxruntime'] = None\n"
    done = subprocess.run(
        [sys.executable, "-c", block + SCRIPT],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr
    numpy_rows = [
        list(map(float, line.split(","))) for line in (tmp_path / "out.csv").read_text().splitlines()[1:]
    ]
    subprocess.run([sys.executable, "-c", SCRIPT], cwd=tmp_path, check=True, capture_output=True, timeout=600)
    ort_rows = [
        list(map(float, line.split(","))) for line in (tmp_path / "out.csv").read_text().splitlines()[1:]
    ]
    for ours, theirs in zip(numpy_rows, ort_rows, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-3, abs=1e-3)
