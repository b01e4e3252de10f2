"""Alarms, memory of heat and the service manager, as `motorlens run` has them; the rows of `infer` are the oracle."""

import csv
import json
import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually
from helpers.sensor_files import write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.estimate.estimator import Estimates, Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.publish import Header
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.sensor.specification import Output
from motorlens_runtime.service import memory as memory_module
from motorlens_runtime.service.memory import Memory
from motorlens_runtime.service.outlet import Outlet

pytestmark = pytest.mark.usefixtures("engine")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx", warm_up_s=0.2)
    rng = np.random.default_rng(3)
    time_s = np.arange(3000) / 1000
    voltage = 120 + 80 * np.sin(2 * np.pi * time_s) + rng.normal(size=3000)
    rows = np.column_stack((time_s, voltage, 8 + 6 * np.cos(2 * np.pi * time_s)))
    np.savetxt("rec.csv", rows, delimiter=",", header="time_s,voltage_V,current_A", comments="", fmt="%.9g")
    return tmp_path


def run(*arguments):
    return main(["run", "--source", "file:rec.csv", "--sensor", "s.onnx", *arguments])


def read(path):
    with open(path) as file:
        return list(csv.DictReader(file))


def crossings(values, limit, hysteresis):
    """(row, on) by the book, one row at a time."""
    on, found = False, []
    for row, value in enumerate(values):
        if (value > limit and not on) or (value < limit - hysteresis and on):
            on = not on
            found.append((row, on))
    return found


@pytest.mark.fit
def test_alarms_are_events_of_every_publisher_that_has_a_word_for_them(here):
    assert main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "all.csv"]) == 0
    speed = np.array([float(row["speed_rad_s"]) for row in read("all.csv")])
    limit = float(np.round((speed.max() + speed.min()) / 2, 3))
    expected = crossings(speed, limit, 5.0)
    assert len(expected) >= 2
    options = [
        "--publish",
        "jsonl:rows.jsonl",
        "--publish",
        "csv:rows.csv",
        "--rate",
        "0",
        "--json",
        "report.json",
    ]
    assert run(*options, "--alarm", f"speed>{limit},hysteresis=5,name=fast") == 0
    lines = [json.loads(line) for line in Path("rows.jsonl").read_text().splitlines()]
    events = [line for line in lines if "event" in line]
    assert [(round(e["timestamp"] * 1000), e["active"]) for e in events] == expected
    assert {e["alarm"] for e in events} == {"fast"}
    assert len(lines) - len(events) == 3000 == len(read("rows.csv"))
    report = json.loads(Path("report.json").read_text())
    assert report["events"] == events
    assert all(outlet["dropped"] == 0 for outlet in report["outlets"])


def test_an_alarm_that_makes_no_sense_ends_the_run_before_it_begins(here, capsys):
    assert run("--alarm", "pressure>3") == 1
    assert "does not estimate 'pressure'" in capsys.readouterr().err


@pytest.mark.fit
def test_heat_is_remembered_over_a_restart(here, capsys):
    assert run("--publish", "csv:cold.csv", "--memory", "heat.json", "--rate", "0", "--json", "1.json") == 0
    assert json.loads(Path("1.json").read_text())["memory"] == {
        "restored": False,
        "message": None,
        "saved": 1,
        "failed": 0,
    }
    assert run("--publish", "csv:hot.csv", "--memory", "heat.json", "--rate", "0", "--json", "2.json") == 0
    report = json.loads(Path("2.json").read_text())["memory"]
    assert report["restored"] and "heat remembered from" in report["message"]
    assert "heat remembered" in capsys.readouterr().err
    cold, hot = read("cold.csv"), read("hot.csv")
    flagged = [int(row["quality"]) & Quality.RESTORED > 0 for row in hot]
    assert flagged == [k < 200 for k in range(3000)]  # the sensor's warm-up of 0.2 s
    assert not any(int(row["quality"]) & Quality.RESTORED for row in cold)
    assert cold[0] != {**hot[0], "quality": cold[0]["quality"]}
    # Another sensor does not take it over.
    write_sensor("s.onnx", seed=1)
    assert run("--publish", "csv:other.csv", "--memory", "heat.json", "--json", "3.json") == 0
    assert "another sensor's" in json.loads(Path("3.json").read_text())["memory"]["message"]


@pytest.mark.fit
def test_a_disk_that_refuses_costs_the_memory_and_nothing_else(here):
    assert (
        run("--publish", "csv:rows.csv", "--memory", "absent/heat.json", "--rate", "0", "--json", "r.json")
        == 0
    )
    report = json.loads(Path("r.json").read_text())
    assert report["memory"]["failed"] == 1 and "not remembered" in report["memory"]["message"]
    assert len(read("rows.csv")) == 3000


def test_the_state_is_kept_every_ten_seconds_without_waiting_for_the_disk(here, monkeypatch):
    sensor = load_sensor("s.onnx")
    estimator = Estimator(sensor, 0.001)
    estimator.push(Samples(np.arange(100) * 1_000_000, np.full(100, 100.0), np.full(100, 5.0)))
    begun, kept, released = [], [], []

    def slow(path, taken):
        begun.append(taken)
        eventually(lambda: released, "the disk answers")
        kept.append(taken.wall_time_ns)

    monkeypatch.setattr(memory_module.snapshot, "save", slow)
    wall = [0]
    memory = Memory("heat.json", sensor, wall_clock=lambda: wall[0])
    for second in range(61):
        wall[0] = second
        memory.keep(estimator, "", second * 10**9)
        if second == 10:
            eventually(lambda: begun, "the first is being written")
    assert kept == []  # the disk has not answered, and nobody waited for it
    released.append(True)
    memory.close(estimator.state, "")
    assert kept == [10, 60]


def test_events_count_as_rows_where_they_are_dropped():
    header = Header("s", "1", "", (Output("speed", "rad/s", 1.0),))
    outlet = Outlet("udp://127.0.0.1:9", header)
    outlet.put_event({"event": "alarm", "many": 1, "keys": 2, "here": 3})
    outlet.put(Estimates(np.array([1]), np.ones((1, 1)), np.ones((1, 1)), np.zeros(1, dtype=np.uint32)))
    outlet.close()
    assert outlet.report().published == 2
    assert outlet.report().dropped == 0


@pytest.mark.fit
def test_systemd_sees_it_ready_alive_and_stopping(here):
    """Type=notify: a live run under a made-up service manager, ended by SIGTERM."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("notify")
        manager.settimeout(LIMIT_S)
        environment = {**os.environ, "NOTIFY_SOCKET": str(here / "notify"), "WATCHDOG_USEC": "200000"}
        environment.pop("WATCHDOG_PID", None)
        command = [
            *MOTORLENS, "run", "--sensor", "s.onnx", "--memory", "heat.json", "--source", "file:rec.csv?speed=0.05",
            "--publish", "csv:rows.csv",
        ]  # fmt: skip
        with Program(command, env=environment) as program:
            heard = [manager.recv(100) for _ in range(4)]
            assert heard == [b"READY=1", *[b"WATCHDOG=1"] * 3], program.told()
            program.send(signal.SIGTERM)
            while (last := manager.recv(100)) == b"WATCHDOG=1":
                pass
            assert last == b"STOPPING=1"
            assert program.ended() == 0, program.told()
    assert (here / "heat.json").exists()
