"""`motorlens bundle`: installed from the directory alone, without a network, into an empty environment, and run there."""

import csv
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from importlib.metadata import PathDistribution
from pathlib import Path

import numpy as np
import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.sensor import bundle
from motorlens_runtime.sensor.core_library import compilers

ONE_ENGINE = "what is packed is the core itself"

OFFLINE = ["unshare", "--net", "--map-root-user"]


def run(*command, **options):
    return subprocess.run(
        [*map(str, command)], capture_output=True, text=True, check=False, timeout=600, **options
    )


def index_is_there():
    probe = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--no-deps",
        "--only-binary=:all:",
        "pyserial==3.5",
    ]
    folder = Path(os.environ.get("TMPDIR", "/tmp")) / f"motorlens-probe-{os.getpid()}"
    done = run(*probe, "--dest", folder)
    shutil.rmtree(folder, ignore_errors=True)
    return done.returncode == 0


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    if not index_is_there():
        pytest.skip("no package index can be reached, so no wheels can be fetched")
    folder = tmp_path_factory.mktemp("bundle")
    write_sensor(folder / "s.onnx")
    target = folder / "bundle"
    options = ["--publish", "mqtt://127.0.0.1:1883?device=press-7", "--option=--rate=10"]
    assert (
        main(
            ["bundle", str(folder / "s.onnx"), "-o", str(target), "--json", str(folder / "b.json"), *options]
        )
        == 0
    )
    return target, json.loads((folder / "b.json").read_text())


@pytest.mark.fit
def test_installs_and_runs_without_a_network(bundled, tmp_path):
    target, _ = bundled
    offline = OFFLINE if run(*OFFLINE, "true").returncode == 0 else []
    clean = {"PATH": "/usr/local/bin:/usr/bin:/bin", "HOME": str(tmp_path), "PIP_NO_INDEX": "1"}
    clean["PATH"] = f"{Path(sys.base_prefix) / 'bin'}:{clean['PATH']}"
    prefix = tmp_path / "there"
    installed = run(
        *offline, "sh", target / "install.sh", "--no-service", "--prefix", prefix, env=clean, cwd="/"
    )
    assert installed.returncode == 0, installed.stderr
    assert "bytes to estimate" in installed.stdout
    if compilers():  # the core came along: no compiler is needed there
        assert f"/site-packages/motorlens_runtime/core/motorlens-{platform.machine()}.so" in installed.stdout
    packages = {
        path.name.split("-")[0] for path in (prefix / "venv").glob("lib/python*/site-packages/*.dist-info")
    }
    expected = {
        "motorlens",
        "numpy",
        "onnxruntime",
        "pyserial",
        "paho_mqtt",
        "flatbuffers",
        "protobuf",
        "packaging",
    }
    assert packages == expected  # the light runtime, what MQTT needs, and nothing else
    rows = np.column_stack((np.arange(300) / 1000, np.full(300, 120.0), np.full(300, 8.0)))
    np.savetxt(tmp_path / "rec.csv", rows, delimiter=",", header="time_s,voltage_V,current_A", comments="")
    arguments = ("infer", tmp_path / "rec.csv", "--sensor", prefix / "s.onnx", "-o", tmp_path / "out.csv")
    done = run(*offline, prefix / "venv/bin/motorlens", *arguments, env=clean, cwd="/")
    assert done.returncode == 0, done.stderr
    here = tmp_path / "here.csv"
    assert main([*map(str, arguments[:-1]), str(here)]) == 0
    assert here.read_bytes() == (tmp_path / "out.csv").read_bytes()  # there as here, to the last digit
    with open(here) as file:
        assert len(list(csv.DictReader(file))) == 300
    removed = run("sh", prefix / "uninstall.sh", "--prefix", prefix, env=clean, cwd="/")
    assert removed.returncode == 0, removed.stderr
    assert not prefix.exists()


@pytest.mark.fit
def test_a_damaged_copy_and_a_wrong_machine_are_refused(bundled, tmp_path):
    target, _ = bundled
    copy = tmp_path / "copy"
    shutil.copytree(target, copy)
    install = (copy / "install.sh").read_text()
    (copy / "install.sh").write_text(install.replace(f'"{platform.machine()}"', '"vax"'))
    (copy / "SHA256SUMS").write_text(bundle.checksums(copy))
    refused = run("sh", copy / "install.sh", "--no-service", "--prefix", tmp_path / "x")
    assert refused.returncode == 1 and "this is" in refused.stderr
    (copy / "install.sh").write_text(install)
    (copy / "SHA256SUMS").write_bytes((target / "SHA256SUMS").read_bytes())
    with (copy / "s.onnx").open("r+b") as file:
        file.seek(100)
        file.write(b"\xff")
    refused = run("sh", copy / "install.sh", "--no-service", "--prefix", tmp_path / "x")
    assert refused.returncode == 1 and "differs from SHA256SUMS" in refused.stderr
    assert not (tmp_path / "x").exists()
    assert run("sh", copy / "install.sh", "--prefixx").returncode == 2


@pytest.mark.fit
def test_checksums_are_those_of_the_files(bundled):
    target, found = bundled
    listed = dict(reversed(line.split("  ", 1)) for line in (target / "SHA256SUMS").read_text().splitlines())
    present = {str(p.relative_to(target)) for p in target.rglob("*") if p.is_file()} - {"SHA256SUMS"}
    assert set(listed) == present == set(found["files"])
    for name, digest in listed.items():
        assert hashlib.sha256((target / name).read_bytes()).hexdigest() == digest
    assert not any("torch" in name or "scipy" in name for name in listed)


@pytest.mark.fit
def test_the_service_is_one_systemd_accepts_and_finds_hardened(bundled, tmp_path):
    if shutil.which("systemd-analyze") is None:
        pytest.skip("no systemd-analyze here")
    target, _ = bundled
    program = tmp_path / "venv" / "bin" / "motorlens"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    text = (
        (target / "motorlens.service")
        .read_text()
        .replace("@PREFIX@", str(tmp_path))
        .replace("@ETC@", str(target))
    )
    unit = tmp_path / "motorlens.service"
    unit.write_text(text)
    verified = run("systemd-analyze", "verify", unit)
    complaints = [line for line in verified.stderr.splitlines() if "motorlens" in line]
    assert verified.returncode == 0 and not complaints
    rated = run("systemd-analyze", "security", "--offline=true", "--no-pager", unit)
    exposure = float(rated.stdout.rpartition("motorlens.service:")[2].split()[0])
    assert exposure < 3.0  # of 10; systemd calls up to 4 "OK", most services have above 9


@pytest.mark.fit
def test_scripts_are_plain_shell_and_leave_no_word_unfilled(bundled):
    target, _ = bundled
    for name in ("install.sh", "uninstall.sh"):
        assert run("sh", "-n", target / name).returncode == 0
    left = {word for name in bundle._FILES for word in ("@SENSOR@", "@NAME@", "@MACHINE@", "@PYTHON@", "@REQUIREMENTS@")
            if word in (target / name).read_text()}  # fmt: skip
    assert left == set()
    settings = (target / "motorlens.env").read_text()
    assert 'MOTORLENS_OPTIONS="--publish mqtt://127.0.0.1:1883?device=press-7 --rate=10"' in settings


@pytest.mark.fit
def test_another_machine_gets_its_own_wheels(bundled, tmp_path):
    """A drive PC of the other processor: every wheel with machine code is for it."""
    write_sensor(tmp_path / "s.onnx")
    other = next(machine for machine in bundle.MACHINES if machine != platform.machine())
    target = bundle.Target(other, "3.12", 35)
    found = bundle.write_bundle(tmp_path / "b", tmp_path / "s.onnx", target, "tcp://10.0.0.2:5555", [], [])
    wheels = [name for name in found["files"] if name.endswith(".whl")]
    built = [name for name in wheels if not name.endswith("-any.whl")]
    assert any("onnxruntime" in name for name in built) and any("numpy" in name for name in built)
    assert all(other in name for name in built)


@pytest.mark.fit
def test_what_an_ordinary_installation_packs_is_the_same_wheel(bundled, tmp_path):
    """The wheel built from the source, unpacked as an installation, and packed again: the same files, a valid record."""
    target, _ = bundled
    built = next((target / "wheels").glob("motorlens-*.whl"))
    site = tmp_path / "site-packages"
    with zipfile.ZipFile(built) as wheel:
        wheel.extractall(site)
        names = set(wheel.namelist())
    information = next(site.glob("motorlens-*.dist-info"))
    with (information / "RECORD").open("a") as record:
        record.write(
            "../../../bin/motorlens,sha256=x,1\nmotorlens_runtime/__pycache__/cli.cpython-311.pyc,,\n"
        )
    packed = bundle.pack_installed(PathDistribution(information), tmp_path)
    with zipfile.ZipFile(packed) as wheel:
        assert set(wheel.namelist()) == names
        with zipfile.ZipFile(built) as original:
            for name in names - {f"{information.name}/RECORD"}:
                assert wheel.read(name) == original.read(name)
        listed = wheel.read(f"{information.name}/RECORD").decode().splitlines()
    assert {line.split(",")[0] for line in listed} == names


@pytest.mark.fit
def test_what_cannot_be_bundled_is_said_in_a_line(tmp_path, capsys):
    write_sensor(tmp_path / "s.onnx")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("")
    assert main(["bundle", str(tmp_path / "s.onnx"), "-o", str(tmp_path / "full")]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert main(["bundle", str(tmp_path / "s.onnx"), "-o", str(tmp_path / "b"), "--target", "vax"]) == 1
    assert "choose one of x86_64, aarch64" in capsys.readouterr().err
    for value in ("a b", 'a"b', "a$b", "a\nb"):
        with pytest.raises(DataError, match="cannot stand in the settings"):
            bundle.environment_file("tcp://x:1", [value])
    (tmp_path / "no wheels").mkdir()
    with pytest.raises(DeviceError, match=r"cannot be had: .*(motorlens|numpy|pip)"):
        bundle._download(["numpy"], tmp_path / "w", bundle.Target(), tmp_path / "no wheels")
