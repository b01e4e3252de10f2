"""`motorlens doctor`: that what it prints is what it measured, and that its advice follows from it. No figure is judged."""

import json
import os
import socket

import numpy as np
import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime import doctor
from motorlens_runtime.cli import main
from motorlens_runtime.service.notify import Notifier

ONE_ENGINE = "it tells which of the two there is"


def test_percentiles_in_microseconds():
    spread = doctor.Spread.of(np.arange(0, 101_000, 1000.0))
    assert (spread.p50, spread.p99, spread.worst) == (50.0, 99.0, 100.0)


def test_highest_rate_is_the_last_that_leaves_half_a_core():
    assert doctor.Cost(1, 2, {100: 0.1, 1000: 0.5, 2000: 0.51}).highest_rate_Hz == 1000
    assert doctor.Cost(1, 2, {100: 0.6}).highest_rate_Hz is None


def test_everything_is_measured_and_written(tmp_path, capsys):
    path = tmp_path / "s.onnx"
    write_sensor(path, ambient=True)
    assert main(["doctor", "--sensor", str(path), "--seconds", "0.05", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "motorlens.doctor/1"
    for key in ("sleep_us", "line_us"):
        assert 0 < found[key]["p50"] <= found[key]["p99"] <= found[key]["worst"] < 1e8
    sensor = found["sensor"]
    assert 0 < sensor["hot_us"] and 0 < sensor["cold_us"]
    assert [int(rate) for rate in sensor["core_share"]] == list(doctor.RATES_HZ)
    assert all(0 < share for share in sensor["core_share"].values())
    assert found["machine"]["cores"] == len(os.sched_getaffinity(0))


def test_the_report_for_people_names_what_was_found(capsys):
    assert main(["doctor", "--seconds", "0.02"]) == 0
    text = capsys.readouterr().out
    assert "wakes late by" in text and "line to program" in text and "--sensor" in text
    assert main(["doctor", "--seconds", "nan"]) == 1


def test_ports_are_shown_with_their_usb_identity(monkeypatch):
    from serial.tools import list_ports, list_ports_common

    port = list_ports_common.ListPortInfo("/dev/does-not-exist")
    port.vid, port.pid, port.serial_number, port.manufacturer, port.product = (
        0x0403,
        0x6001,
        "FT3K2M1",
        "FTDI",
        "UART",
    )
    monkeypatch.setattr(list_ports, "comports", lambda: [port])
    assert doctor.serial_ports() == [
        {"device": "/dev/does-not-exist", "usb": "0403:6001", "serial_number": "FT3K2M1", "manufacturer": "FTDI",
         "product": "UART", "lasting_name": None, "readable": False, "latency_timer_ms": None}
    ]  # fmt: skip


def test_advice_follows_from_the_figures():
    fine = {
        "machine": {"realtime_priority": True, "governor": None, "load": 0.5, "cores": 2, "clock_set": True},
        "sleep_us": {"p50": 60.0, "p99": 90.0, "worst": 300.0},
        "serial_ports": [],
    }
    assert doctor.advice(fine) == []
    poor = {
        "machine": {
            "realtime_priority": False,
            "governor": "powersave",
            "load": 4.0,
            "cores": 2,
            "clock_set": False,
        },
        "sleep_us": {"p50": 60.0, "p99": 5000.0, "worst": 9000.0},
        "serial_ports": [{"device": "/dev/ttyUSB0", "readable": False, "latency_timer_ms": 16}],
    }
    lines = "\n".join(doctor.advice(poor))
    for word in ("LimitRTPRIO", "performance", "load 4.0", "5.0 ms late", "clock", "dialout", "every 16 ms"):
        assert word in lines
    assert len(doctor.advice(poor)) == 7


def test_systemd_hears_ready_alive_and_stopping(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(2.0)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "2000000"}
        now = [0]
        stops = iter([False] * 30 + [True])
        loop = Notifier(environment).while_running(lambda: next(stops), lambda: now[0])
        while not loop():
            now[0] += 100_000_000  # rounds of 0.1 s for 3 s; the watchdog wants one a second
        heard = []
        manager.setblocking(False)
        while True:
            try:
                heard.append(manager.recv(100))
            except BlockingIOError:
                break
    assert heard == [b"READY=1", *[b"WATCHDOG=1"] * 4, b"STOPPING=1"]


def test_an_abstract_socket_is_understood():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        name = f"motorlens-test-{os.getpid()}"
        manager.bind("\0" + name)
        Notifier({"NOTIFY_SOCKET": "@" + name}).tell("READY=1")
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize(
    "environment", [{}, {"NOTIFY_SOCKET": "/does/not/exist"}, {"WATCHDOG_PID": "1", "WATCHDOG_USEC": "9"}]
)
def test_without_a_manager_nothing_happens(environment):
    notifier = Notifier(environment)
    loop = notifier.while_running(lambda: False, lambda: 0)
    assert loop() is False
