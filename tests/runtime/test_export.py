"""`motorlens export`: the sensor as C99 computes what the file says, on this machine and on four microcontroller cores."""

import ctypes
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import ran
from helpers.sensor_files import write_sensor

from motorlens_firmware_sim import boards
from motorlens_runtime.cli import main
from motorlens_runtime.estimate.estimator import Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor import core_library
from motorlens_runtime.sensor.core_library import STRICT_FLAGS, compilers
from motorlens_runtime.sensor.sensor import load_sensor, scales, tiled, untiled

ONE_ENGINE = "what is exported is the core itself"

SHIPPED = Path(__file__).resolve().parents[2] / "models/sensors"
needs_compiler = pytest.mark.skipif(
    not compilers(), reason="no C compiler on this machine (cc, gcc or clang)"
)
needs_boards = pytest.mark.skipif(
    boards.missing_tools() is not None or not compilers(), reason=f"{boards.missing_tools()}"
)


def export(folder, sensor, *more):
    assert main(["export", str(sensor), "--c", str(folder), *more, "--json", f"{folder}.json"]) == 0
    return json.loads(Path(f"{folder}.json").read_text())


def sources(folder):
    return sorted(path for path in folder.glob("*.c") if path.name not in ("main.c", "golden_test.c"))


@pytest.mark.fit
@needs_compiler
@pytest.mark.parametrize("precision", [[], ["--double"]])
@pytest.mark.parametrize("name", ["mellah2016", "mellah2016_observer", "ambient"])
def test_what_is_exported_compiles_strictly_and_gives_its_golden_values(name, precision, tmp_path):
    sensor = SHIPPED / f"{name}.onnx"
    if name == "ambient":
        sensor = tmp_path / "s.onnx"
        write_sensor(sensor, ambient=True)
    found = export(tmp_path / "c", sensor, *precision)
    assert found["precision"] == ("double" if precision else "single")
    assert 0 < found["proof"]["estimate_error"] < 1e-5 and 0 < found["proof"]["sigma_error"] < 1e-4
    strict = ["-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror"]
    compiler, shared = [compilers()[0], *STRICT_FLAGS, *strict, "-O1"], sources(tmp_path / "c")
    for words in (
        ["-c", *(path.name for path in shared)],
        *(
            ["-o", program, f"{program}.c", *(path.with_suffix(".o").name for path in shared), "-lm"]
            for program in ("golden_test", "main")
        ),
    ):
        subprocess.run([*compiler, *words], cwd=tmp_path / "c", check=True, timeout=600)
    assert (
        subprocess.run([tmp_path / "c/golden_test"], stdout=subprocess.DEVNULL, timeout=600).returncode == 0
    )
    text = "\n".join(path.read_text() for path in sources(tmp_path / "c"))
    assert "malloc" not in text and "printf" not in text


@pytest.mark.fit
@needs_compiler
@pytest.mark.parametrize("talkative", [False, True])
def test_a_compiler_that_does_not_end_is_said_in_one_line(talkative, tmp_path, monkeypatch, capsys):
    """One of a tenth of a second's patience, silent or not; what it has said by then is no text but bytes."""
    stuck = tmp_path / "stuck-cc"
    stuck.write_text(f"#!/bin/sh\n{'echo warning >&2' if talkative else ''}\nexec sleep 1000\n")
    stuck.chmod(0o755)
    monkeypatch.setattr("motorlens_runtime.sensor.export.compilers", lambda: [str(stuck)])
    monkeypatch.setattr("motorlens_runtime.sensor.export.CALL_S", 0.1)
    assert main(["export", str(SHIPPED / "mellah2016.onnx"), "--c", str(tmp_path / "c")]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and not (tmp_path / "c").exists()
    said = "the exported sensor was not checked and not written: stuck-cc did not end within 0.1 s; is this PC busy"
    assert said in lines[0]
    monkeypatch.setattr("motorlens_runtime.sensor.core_library.compilers", lambda: [str(stuck)])
    monkeypatch.setattr("motorlens_runtime.sensor.core_library.CALL_S", 0.1)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("MOTORLENS_CORE", raising=False)
    core_library._core.cache_clear()
    reason = core_library.core().reason
    core_library._core.cache_clear()
    assert reason.startswith("it does not compile here: stuck-cc did not end within 0.1 s")


@pytest.mark.fit
@needs_compiler
def test_the_example_follows_a_stream_as_the_runtime_does(tmp_path):
    export(tmp_path / "c", SHIPPED / "mellah2016_observer.onnx", "--double", "--name", "winding")
    subprocess.run(
        [compilers()[0], *STRICT_FLAGS, "-O2", "-o", "main", "main.c",
         *(path.name for path in sources(tmp_path / "c")), "-lm"], cwd=tmp_path / "c", check=True, timeout=600,
    )  # fmt: skip
    n, rng = 3000, np.random.default_rng(2)
    time_ns = np.cumsum(rng.choice([1_000_000, 1_000_000, 3_000_000], n))
    voltage = 120 + 80 * np.sign(np.sin(np.arange(n) / 200)) + rng.normal(size=n)
    current = 8 + 3 * np.sin(np.arange(n) / 70) + 0.05 * rng.normal(size=n)
    voltage[500], current[600] = np.nan, 1e30
    rows = zip((time_ns * 1e-9).tolist(), voltage.tolist(), current.tolist(), strict=True)
    text = "\n".join(f"{t:.9f},{v!r},{i!r}" for t, v, i in rows)
    out = subprocess.run(
        [tmp_path / "c/main"], input=text, capture_output=True, text=True, check=True, timeout=600
    ).stdout
    table = np.array([[float(cell) for cell in line.split(",")] for line in out.splitlines()])
    sensor = load_sensor(SHIPPED / "mellah2016_observer.onnx", "numpy")
    expected = Estimator(sensor, 1e-3).push(Samples(time_ns, voltage, current))
    assert np.array_equal(table[:, -1], expected.quality)
    assert (
        np.max(np.abs(table[:, 1:-1:2] - expected.values) / scales(sensor.specification)) < 1e-6
    )  # it prints 9 digits
    assert np.max(np.abs(table[:, 2:-1:2] / expected.sigma - 1)) < 1e-6


@pytest.fixture(scope="module", params=["mellah2016", "mellah2016_observer"])
def proven(request, tmp_path_factory):
    """What the proof says on this PC and on each core, in single precision, with what it costs there."""
    folder = tmp_path_factory.mktemp("proof")
    export(folder / "c", SHIPPED / f"{request.param}.onnx")
    listed = [*sources(folder / "c"), boards.FOLDER / "proof.c"]
    subprocess.run(
        [compilers()[0], *STRICT_FLAGS, "-O2", f"-I{folder / 'c'}", "-o", folder / "pc", *listed, "-lm"],
        check=True,
        timeout=600,
    )
    here = subprocess.run([folder / "pc"], capture_output=True, text=True, check=True, timeout=600).stdout
    said = {}
    for board in boards.BOARDS:
        (folder / board.name).mkdir()
        program = boards.compile_for(board, listed, folder / board.name / "proof.elf", (f"-I{folder / 'c'}",))
        text = boards.run_on(board, program)
        said[board.name] = text, boards.cost_of(text, program)
    return request.param, here, said


@pytest.mark.fit
@needs_boards
def test_four_cores_give_the_bits_of_this_pc(proven):
    _, here, said = proven
    rows = here.splitlines()
    assert len(rows) == 41 and rows[-1].startswith("hash ")
    assert len({row.split(" ", 2)[2] for row in rows[:-1]}) == 40  # it is not one row again and again
    for name, (text, _) in said.items():
        assert text.splitlines()[:41] == rows, name


@pytest.mark.fit
@needs_boards
def test_what_a_core_needs(proven):
    """Budgets, counted by the emulator, so the same on every machine: with an observer 19 kB and 4 kB; filters and network
    alone 10 kB and 2 kB, and a core without floating-point unit at most six times the instructions of one that has it.

    Weighing whether the motor is the file's (`observer/belief.py`) is 2 kB of the 19, and runs where a value is asked for:
    inertia and inductance together, and with how the voltage runs between samples, is 15 000 instructions of the 95 000.
    """
    name, _, said = proven
    observed = name.endswith("observer")
    for core, (_, cost) in said.items():
        print(f"{name} {core}: {cost}")
        assert cost.memory + cost.stack <= (4096 if observed else 2048)
        assert cost.update_most >= cost.update > 100 and cost.evaluate > 100
    cost = said["cortex-m4f"][1]
    assert cost.flash <= (19 * 1024 if observed else 10 * 1024)
    assert cost.update <= (32_000 if observed else 1_300)
    assert cost.evaluate <= (95_000 if observed else 11_500)
    assert observed or said["cortex-m3"][1].evaluate <= 6 * cost.evaluate


def test_what_cannot_be_exported_is_said_in_one_line(tmp_path, capsys):
    write_sensor(tmp_path / "s.onnx")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").touch()
    assert main(["export", str(tmp_path / "s.onnx"), "--c", str(tmp_path / "full")]) == 1
    assert "not empty" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "s.onnx"), "--c", str(tmp_path / "c"), "--name", "9x"]) == 1
    assert "--name 9x" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "absent.onnx"), "--c", str(tmp_path / "c")]) == 1
    assert not (tmp_path / "c").exists()


@needs_compiler
@pytest.mark.fit
@pytest.mark.parametrize("name", ["mellah2016", "mellah2016_observer"])
def test_another_generator_of_c_agrees_on_the_core_graph(name, tmp_path):
    """emx-onnx-cgen reads the ONNX graph node by node and shares nothing with the folding or the core."""
    pytest.importorskip("emx_onnx_cgen", reason="emx-onnx-cgen is not installed")
    source = tmp_path / "other.c"
    ran([sys.executable, "-m", "emx_onnx_cgen", "compile", SHIPPED / f"{name}.onnx", source])
    library = tmp_path / "other.so"
    subprocess.run(
        [compilers()[0], "-std=c11", "-O1", "-w", "-shared", "-fPIC", "-o", library, source, "-lm"],
        check=True,
        timeout=600,
    )
    sensor = load_sensor(SHIPPED / f"{name}.onnx", "core")
    rows = np.random.default_rng(0).normal(size=(160, len(sensor.specification.features)))
    envelope = sensor.specification.envelope
    # An observer alone: its estimates, then logarithms.
    features = rows * np.array([*(3 * scales(sensor.specification)), *[1.0] * (rows.shape[1] - 3)])
    if envelope.mean is not None:
        # Where the sensor was trained, row after row in memory.
        features = np.ascontiguousarray(envelope.mean + np.linalg.solve(envelope.cholesky.T, 2 * rows.T).T)
    estimate, sigma = np.empty((2, 160, 3))
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (features, estimate, sigma)]
    ctypes.CDLL(str(library)).model(160, *pointers)
    found = [untiled(values).T for values in sensor.backend.evaluate(tiled(features.T, 0))]
    scale = scales(sensor.specification)
    assert np.max(np.abs(found[0] - estimate) / scale) < 1e-6
    assert np.max(np.abs(found[1] - sigma) / np.maximum(scale, sigma)) < 1e-6
    assert np.ptp(estimate[:, 0]) > scale[0]
