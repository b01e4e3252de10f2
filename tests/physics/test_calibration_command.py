"""`motorlens calibrate` from datasheet to calibrated motor file."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_runtime.cli import main

pytestmark = pytest.mark.fit

MOTOR = Path(__file__).resolve().parents[2] / "models" / "motors" / "mellah2016.toml"
SHEET = ["voltage_V=240", "current_A=7.27", "speed_rpm=2111", "resistance_ohm=3.5", "no_load_current_A=0.4"]


def test_from_a_datasheet_to_a_calibrated_motor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start, bench, new, report = (
        str(tmp_path / name) for name in ("start.toml", "bench.csv", "new.toml", "report.json")
    )
    assert main(["calibrate", "--datasheet", *SHEET, "-o", start]) == 0
    assert read_motor_file(start).values()["R_a0"] == 3.5
    noise = ["--noise", "current=0.05", "--noise", "speed=0.5", "--noise", "temperature=0.3"]
    assert main(["simulate", str(MOTOR), "--scenario", "duty", "--duration", "120", *noise, "-o", bench]) == 0
    capsys.readouterr()
    assert (
        main(["calibrate", bench, "--motor", start, "--fit", "R_a0,ke,J,kT", "-o", new, "--json", report])
        == 0
    )
    printed = capsys.readouterr().out
    document = json.loads(Path(report).read_text())
    assert document["schema"] == "motorlens.calibrate/1"
    truth = read_motor_file(MOTOR).values()
    for key in ("R_a0", "ke", "J"):
        found = document["parameters"][key]
        assert found["value"] == pytest.approx(truth[key], rel=0.05)
        assert found["identified"]
        assert read_motor_file(new).values()[key] == found["value"]
        assert key in printed
    assert document["residual_rms"][0]["speed"] == pytest.approx(0.5, rel=0.3)
    assert document["converged"]


def test_a_load_that_is_not_in_the_recording_is_said_with_its_size(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Steps of the load, whose column is left out: as large as they were, and no such line where they were measured."""
    bench, new = str(tmp_path / "bench.csv"), str(tmp_path / "new.toml")
    simulate = "simulate mellah2016 --scenario load_steps --duration 4 --noise 0.2% --seed 3 -o"
    assert main([*simulate.split(), bench]) == 0
    load = read_recording(bench).channels["load_torque"]
    said = []
    for mapping in ((), ("--column", "load_torque=none")):
        capsys.readouterr()
        assert main(["calibrate", bench, "--motor", "mellah2016", *mapping, "-o", new]) == 0
        said.append(capsys.readouterr().out)
        assert re.search(r"left over, rms: current .* A \(noise .*\), speed .* rad/s", said[-1])
    assert "nobody measured" not in said[0]
    told = re.search(r"beside a torque that nobody measured, (.*) N\*m \((.*)% of the rated one\)", said[1])
    assert told is not None
    rms = float(np.sqrt(np.mean(load**2)))
    assert 0.5 < float(told[1]) / rms < 2.0
    assert float(told[2]) / 100 == pytest.approx(float(told[1]) / 6.455, rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "give either --motor MOTOR.toml or --datasheet"),
        (["--motor", str(MOTOR)], "no recordings to fit to"),
        (["--datasheet", "voltage_V=24"], "lacks current_A"),
    ],
)
def test_what_is_missing_is_said_in_one_line(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", *arguments, "-o", str(tmp_path / "new.toml")]) == 1
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
