"""The command on a small plant: its files, what it says of what it cannot use, and that a second run finds the first."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.fleet_tasks import Hungry
from helpers.plain_fleet import World, write

from motorlens_physics import queue
from motorlens_physics.motor_file import read_motor_file
from motorlens_runtime.cli import main
from motorlens_workbench.fleet import work

pytestmark = pytest.mark.fit


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet")
    World(2, 2, poor=0, samples=300, dwell=50).write(folder / "plant", 4)
    (folder / "plant/motor_001/2026-07-01.csv").write_text("time_s,voltage_V\nnothing\n")
    flat = "".join(f"{k / 100},3,0,0\n" for k in range(200))
    (folder / "plant/motor_002").mkdir()
    (folder / "plant/motor_002/still.csv").write_text("time_s,voltage_V,current_A,speed_rad_s\n" + flat)
    (folder / "plant/motor_003").mkdir()
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
    assert [line for line in said.splitlines() if line.startswith("motor_003/")] == [
        "motor_003/: holds no recording (.csv, .tsv, .txt, .parquet, .mat, .mf4, .mdf, also as .gz)"
    ]
    document = json.loads((plant / "out.json").read_text())
    assert document["schema"] == "motorlens.fleet/1"
    assert [m["motor"] for m in document["motors"]] == ["motor_000", "motor_001"]
    assert [r["recording"] for r in document["recordings"] if "failed" in r] == [
        "motor_001/2026-07-01.csv",
        "motor_002/still.csv",
        "motor_003/",
    ]
    page = first[next(name for name in first if name.name == "index.html")].decode()
    assert page.count("motor_002/still.csv") == page.count("motor_003/<") == 1
    assert "2 recordings could not be used, 1 folder held none: listed below." in page
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


@pytest.mark.long
@pytest.mark.filterwarnings("ignore")
def test_a_recording_that_takes_more_memory_than_a_worker_may_is_one_line_and_the_rest_goes_on(
    tmp_path, monkeypatch, capsys
):
    """Dask ends the worker, truly. The recordings behind it are not blamed, and their results those of a run in peace."""
    pytest.importorskip("distributed")
    monkeypatch.setattr(queue, "DEATHS", 0)
    monkeypatch.setattr(work, "Job", Hungry)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]), prepend=os.pathsep)
    World(2, 1, poor=0, samples=300, dwell=50).write(tmp_path / "plant", 4)
    words = ["fleet", str(tmp_path / "plant"), "--motor", "mellah2016", "--as-it-is", "-o"]
    assert main([*words, str(tmp_path / "peace"), "--workers", "0"]) == 0
    (tmp_path / "plant/a_first").mkdir()
    write(World(3, 1, samples=300, dwell=50).recorded(2, 0, 4), tmp_path / "plant/a_first/huge.csv")
    capsys.readouterr()
    assert main([*words, str(tmp_path / "war"), "--workers", "1", "--memory", "1GB"]) == 0
    why = "a_first/huge.csv: ended 1 worker: out of memory? (--memory)"
    assert [line for line in capsys.readouterr().out.splitlines() if "huge" in line] == [why]
    page = (tmp_path / "war/index.html").read_text()
    assert page.count("a_first/huge.csv") == 1 and "1 recording could not be used: listed below." in page
    peace, war = (
        {p.name: p.read_bytes() for p in (tmp_path / out / "results").rglob("*.json")}
        for out in ("peace", "war")
    )
    assert len(peace) == 4 and peace == war


@pytest.mark.long
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
    (plant / "gone.csv").write_text("motor,recording\nm1,gone/a.csv\n")
    assert main(["fleet", str(plant / "gone.csv"), *words]) == 1
    (told,) = capsys.readouterr().err.splitlines()[-1:]
    assert "none of 1 recordings can be used; gone/a.csv: cannot be read: No such file" in told
