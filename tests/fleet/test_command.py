"""The command on a small plant: its files, what it says of what it cannot use, and that a second run finds the first."""

import json

import numpy as np
import pytest
from helpers.plain_fleet import World

from motorlens_physics.motor_file import read_motor_file
from motorlens_runtime.cli import main

pytestmark = pytest.mark.fit


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet")
    World(2, 2, poor=0, samples=300, dwell=50).write(folder / "plant", 4)
    (folder / "plant/motor_001/2026-07-01.csv").write_text("time_s,voltage_V\nnothing\n")
    flat = "".join(f"{k / 100},3,0,0\n" for k in range(200))
    (folder / "plant/motor_002").mkdir()
    (folder / "plant/motor_002/still.csv").write_text("time_s,voltage_V,current_A,speed_rad_s\n" + flat)
    return folder


def run(plant, out):
    words = ["--motor", "mellah2016", "--as-it-is", "--workers", "0", "-o", str(plant / out)]
    assert main(["fleet", str(plant / "plant"), *words, "--json", str(plant / f"{out}.json")]) == 0
    return {p.relative_to(plant / out): p.read_bytes() for p in (plant / out).rglob("*") if p.is_file()}


def a_third(two, expected, known):
    """Deviation of a third motor beside two: the mean was known to a deviation, and any spread up to that may be."""
    before, logs, means, squares = known**2 * np.ones((2, 2)), [], [], []
    for square in np.linspace(0.0, known**2, 4001)[1:]:
        whole = before + square * np.eye(2)
        logs.append(
            -0.5 * ((two - expected) @ np.linalg.solve(whole, two - expected) + np.linalg.slogdet(whole)[1])
        )
        gain = np.linalg.solve(whole, before[0])
        means.append(gain @ (two - expected))
        squares.append(known**2 + square - gain @ before[0])
    weight = np.exp(np.array(logs) - max(logs))
    weight /= weight.sum()
    means = np.array(means)
    return np.sqrt(weight @ (np.array(squares) + means**2) - (weight @ means) ** 2)


def test_files_failures_and_a_second_run(plant, capsys):
    first = run(plant, "out")
    said = capsys.readouterr().out
    assert "motor_001/2026-07-01.csv: " in said
    assert "motor_002/still.csv: nothing can be told" in said
    document = json.loads((plant / "out.json").read_text())
    assert document["schema"] == "motorlens.fleet/1"
    assert [m["motor"] for m in document["motors"]] == ["motor_000", "motor_001"]
    assert [r["recording"] for r in document["recordings"] if "failed" in r] == [
        "motor_001/2026-07-01.csv",
        "motor_002/still.csv",
    ]
    page = first[next(name for name in first if name.name == "index.html")].decode()
    assert "motor_002/still.csv" in page
    assert "</html>" in page
    # The make's file is a motor file. By how much motors differ, two of them hardly tell.
    make = read_motor_file(plant / "out/population.toml")
    assert make.name == "make of mellah2016"
    two = np.array([m["parameters"]["R_a0"]["value"] for m in document["motors"]])
    ratio = make.knowledge["R_a0"].sd / a_third(two, 3.5, 0.35)
    assert 1.0 <= ratio < 1.15, ratio
    results = {name: (plant / "out" / name).stat().st_mtime_ns for name in first if "results" in name.parts}
    # Six by themselves, and again where their motors are likeliest the four that can be used.
    assert len(results) == 6 + 4
    assert run(plant, "out") == first
    assert results == {name: (plant / "out" / name).stat().st_mtime_ns for name in results}


def test_what_brief_recordings_are_worth_is_in_the_file_of_the_make(plant, capsys):
    words = [
        "--motor",
        "mellah2016",
        "--as-it-is",
        "--workers",
        "0",
        "-o",
        str(plant / "brief"),
        "--brief",
        "0.4",
    ]
    assert main(["fleet", str(plant / "plant"), *words, "--json", str(plant / "brief.json")]) == 0
    said = json.loads((plant / "brief.json").read_text())["brief"]
    make = read_motor_file(plant / "brief/population.toml")
    assert said["seconds"] == make.brief_s == 0.4
    assert said["led_away"] == {
        key: known.brief_sd for key, known in make.knowledge.items() if known.brief_sd
    }
    capsys.readouterr()


def test_bad_usage_is_one_line(plant, capsys):
    words = ["--motor", "mellah2016", "-o", str(plant / "no"), "--workers", "0"]
    assert main(["fleet", str(plant / "plant"), *words, "--brief", "0"]) == 1
    assert "--brief 0: write seconds" in capsys.readouterr().err
    assert main(["fleet", str(plant / "plant"), *words, "--history", "motor_9"]) == 1
    assert "no such motor; there are motor_000" in capsys.readouterr().err
    assert main(["fleet", str(plant / "nowhere"), *words]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1
