"""`motorlens run` over a pseudo-terminal: every sample accounted for, the bits of `infer`, a clean end, clear refusals."""

import csv
import fcntl
import itertools
import json
import os
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from helpers.clocks import Standing
from helpers.ports import free_place
from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually, ran
from helpers.sensor_files import write_sensor
from helpers.wire_device import WireDevice

from motorlens_runtime.cli import main
from motorlens_runtime.estimate.quality import Quality

pytestmark = pytest.mark.usefixtures("engine")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a sensor; `--duration` counts the stream alone, however long a busy machine takes to bring it."""
    monkeypatch.setattr("motorlens_runtime.service.service._GRACE_NS", int(LIMIT_S * 1e9))
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx")
    return tmp_path


def run(*arguments, sensor="s.onnx"):
    return main(["run", "--sensor", sensor, "--json", "report.json", *map(str, arguments)])


def report():
    with open("report.json") as file:
        return json.load(file)


def lines(path):
    with open(path) as file:
        return file.read().splitlines()


def estimates(path):
    """Rows of a CSV but for what a busy machine adds: repeats of the last row, and that it was late."""
    rows = [line.rpartition(",") for line in lines(path)[1:]]
    fresh = [(row, int(quality)) for row, _, quality in rows if not int(quality) & Quality.STALE]
    return [(row, quality & ~Quality.OVERLOAD) for row, quality in fresh]


@pytest.mark.fit
@pytest.mark.parametrize(("rate_Hz", "n"), [(1000, 1), (10_000, 10), (20_000, 20)])
def test_loopback_loses_nothing_and_equals_infer_bit_for_bit(here, monkeypatch, rate_Hz, n):
    monkeypatch.setattr("motorlens_runtime.service.live.time", Standing)
    with WireDevice(rate_Hz, n, count=2000) as device:
        device.start_when_open()
        seconds = 2000 * n / rate_Hz
        assert run("--source", f"pty://{device.path}", "--record", "rec.csv", "--publish", "csv:live.csv",
                   "--publish", "jsonl:live.jsonl?rate=10", "--publish", "csv:all.csv", "--rate", 0,
                   "--duration", seconds) == 0  # fmt: skip
    result = report()
    assert (result["samples"], result["lost"], result["feed"]["bad_frames"]) == (2000 * n, 0, 0)
    assert result["published"] == 2000 * n and result["bridged"] == 0
    with open("rec.csv") as file:
        recorded = list(csv.DictReader(file))
    assert [float(row["time_s"]) for row in recorded] == [k / rate_Hz for k in range(2000 * n)]
    assert [float(row["voltage_V"]) for row in recorded] == [0.13 * float(v) for v in device.codes[:, 0]]
    assert main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "replay.csv"]) == 0
    assert lines("live.csv") == lines("replay.csv")
    times = [json.loads(line)["timestamp"] for line in lines("live.jsonl")]
    assert len(times) == int(10 * seconds) and times[:2] == [0.0, 0.1]


@pytest.mark.fit
def test_publishing_at_a_rate_gives_rows_of_the_full_output(here, monkeypatch):
    monkeypatch.setattr("motorlens_runtime.service.live.time", Standing)
    with WireDevice(1000, 10, count=300) as device:
        device.start_when_open()
        run(
            "--source",
            device.path,
            "--record",
            "rec.csv",
            "--publish",
            "csv:live.csv",
            "--rate",
            50,
            "--duration",
            3,
        )
    main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "replay.csv"])
    live, replay = lines("live.csv"), lines("replay.csv")
    assert live == [replay[0], *replay[1::20]]


@pytest.mark.fit
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_end_it_cleanly_with_a_summary(here, number):
    command = ["--sensor", "s.onnx", "--publish", "csv:live.csv", "--json", "report.json"]
    with WireDevice(1000, 10, count=100_000, paced=True) as device:
        with Program([*MOTORLENS, "run", "--source", device.path, *command]) as program:
            device.start_when_open()
            eventually(lambda: os.path.exists("live.csv") and len(lines("live.csv")) > 20, "20 rows", program)
            program.send(number)
            assert program.ended() == 0, program.told()
    assert re.search(r"motorlens run: \d+ samples from bench .* 0 lost", program.error)
    result = report()
    assert result["samples"] > 200 and result["published"] == len(lines("live.csv")) - 1
    assert lines("live.csv")[-1].count(",") == 7


@pytest.mark.fit
def test_an_unplugged_device_is_taken_up_again_where_it_was(here):
    first = WireDevice(1000, 10, count=100)
    os.symlink(first.path, "port")
    done = threading.Event()
    second = []

    def rows(end=None):
        return [[float(x) for x in line.split(",")] for line in lines("live.csv")[1:end]]

    def written(what):
        # The last line may be half a line.
        return os.path.exists("live.csv") and any(map(what, rows(-1)))

    def stale(row):
        return int(row[-1]) & Quality.STALE

    def replug():
        # What was sent and not yet read is lost with the line.
        eventually(lambda: written(lambda row: row[0] >= 0.99), "the row of the last frame")
        first.unplug()
        os.unlink("port")
        eventually(lambda: written(stale), "a stale row")
        second.append(WireDevice(1000, 10, count=5000, boot=2, paced=True))
        os.symlink(second[0].path, "port")
        second[0].start_when_open()
        done.set()

    first.start_when_open()
    threading.Thread(target=replug, daemon=True).start()
    assert run("--source", here / "port", "--publish", "csv:live.csv", "--rate", 100, "--duration", 4) == 0
    assert done.is_set()
    second[0].unplug()
    result = report()
    assert result["feed"]["reconnects"] == 1 and result["feed"]["restarts"] == 1 and result["lost"] == 0
    assert result["samples"] > 1100
    assert all(a[0] <= b[0] for a, b in itertools.pairwise(rows()))
    assert any(map(stale, rows())) and not stale(rows()[-1])


@pytest.mark.fit
def test_a_device_that_stays_away_ends_it_when_asked(here, capsys):
    device = WireDevice(1000, 10, count=100)
    device.start_when_open()

    def unplug():
        # The last row comes from the last frame: everything has been read.
        eventually(lambda: os.path.exists("live.csv") and len(lines("live.csv")) > 100, "100 rows")
        device.unplug()

    threading.Thread(target=unplug, daemon=True).start()
    assert run("--source", device.path, "--publish", "csv:live.csv", "--reconnect", 1) == 1
    error = capsys.readouterr().err
    assert "no such port" in error and "gave up after" in error
    assert report()["samples"] == 1000


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("serial:///dev/ttyNONE7", "/dev/ttyNONE7: no such port"),
        ("/dev/ttyNONE7", "/dev/ttyNONE7: no such port"),
        ("serial://NOSUCHADAPTER", "no port of serial number NOSUCHADAPTER"),
        ("serial:///dev/null", "/dev/null: is not a usable serial port"),
        ("serial:", "name a port"),
        ("carrier-pigeon://x", "unknown scheme 'carrier-pigeon'; known: .*pty, serial"),
        ("tcp://127.0.0.1:1", "tcp://127.0.0.1:1: no connection"),
        ("tcp://127.0.0.1", "give a port"),
        ("udp://127.0.0.1:99999", "give a port"),
        ("file:none.csv", "none.csv: No such file"),
        ("file:", "name a file"),
        ("file:none.csv?sped=1", "unknown option 'sped'"),
        ("stdin:?dialect=klingon", "no dialect 'klingon'"),
        ("stdin:?bald=1", "unknown option 'bald'"),
    ],
)
def test_a_source_that_cannot_be_is_one_clear_line(here, capsys, source, message):
    assert main(["run", "--sensor", "s.onnx", "--source", source]) == 1
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1 and re.search(message, error[0]), error


def test_a_port_that_is_taken_names_its_owner(here, capsys):
    with WireDevice() as device:
        script = f"import os, sys; os.open({device.path!r}, os.O_RDWR | os.O_NOCTTY)"
        script += "; print('open', flush=True); sys.stdin.read()"
        with Program([sys.executable, "-c", script], stdin=subprocess.PIPE) as other:
            assert other.line() == "open"
            assert main(["run", "--sensor", "s.onnx", "--source", device.path]) == 1
            said = capsys.readouterr().err
            assert re.search(rf"{device.path}: taken by process {other.pid} \(python", said)
            assert other.ended() == 0, other.told()
        mine = os.open(device.path, os.O_RDWR | os.O_NOCTTY)
        fcntl.flock(mine, fcntl.LOCK_EX)
        assert main(["run", "--sensor", "s.onnx", "--source", device.path]) == 1
        assert "taken by this process" in capsys.readouterr().err
        os.close(mine)


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("telex:x", "unknown scheme 'telex'; known: .*csv, jsonl"),
        ("csv:", "name a file"),
        ("csv:none/out.csv", "none/out.csv: No such file"),
        ("csv:x.csv?rate=fast", "rate=fast is not a rate"),
        ("csv:x.csv?rate=1&decimate=worst", "decimate=worst; known: last, mean"),
        ("csv:x.csv?colour=red", "unknown option 'colour'"),
        ("stdout:xml", "write stdout:csv or stdout:jsonl"),
    ],
)
def test_a_publisher_that_cannot_be_is_one_clear_line(here, capsys, url, message):
    (here / "rec.csv").write_text("time_s,voltage_V,current_A\n0,1,1\n0.001,1,1\n")
    assert main(["run", "--sensor", "s.onnx", "--source", "file:rec.csv", "--publish", url]) == 1
    error = capsys.readouterr().err.splitlines()
    assert len(error) == 1 and re.search(message, error[0]), error


def write_recording(n=3000, gap_s=0.0):
    """A kilohertz, with a gap after half of it."""
    with open("rec.csv", "w") as file:
        file.write(
            "time_s,voltage_V,current_A\n"
            + "".join(
                f"{k / 1000 + (gap_s if 2 * k >= n else 0.0)},{100 + k % 7},{8 + k % 3}\n" for k in range(n)
            )
        )


@pytest.mark.fit
def test_a_file_replayed_is_what_infer_gives(here, capsys):
    write_recording()
    assert run("--source", "file:rec.csv", "--rate", 0) == 0
    replayed = capsys.readouterr().out
    main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "-"])
    assert replayed == capsys.readouterr().out
    assert run("--source", "file:rec.csv?speed=20", "--rate", 0, "--publish", "csv:out.csv") == 0
    assert "\n".join(lines("out.csv")) + "\n" == replayed


class Slow:
    """A clock of a machine on which 0.4 s pass between any two looks at it, and nobody sleeps less than a second."""

    process_time = staticmethod(time.process_time)

    def __init__(self):
        self.now_ns = 0

    def monotonic_ns(self):
        self.now_ns += 400_000_000
        return self.now_ns

    def sleep(self, seconds):
        self.now_ns += 1_000_000_000


@pytest.mark.fit
@pytest.mark.parametrize("speed", [0.05, 20])
def test_a_file_is_never_late_or_silent_however_slow_the_machine(here, monkeypatch, speed):
    """At a twentieth of its time, and with a gap of 100 s in it, which is bridged, as `infer` does, and not a line lost."""
    write_recording(gap_s=100.0)
    clock = Slow()
    monkeypatch.setattr("motorlens_runtime.service.live.time", clock)
    monkeypatch.setattr("motorlens_runtime.line.feed.time", clock)
    assert run("--source", f"file:rec.csv?speed={speed}", "--rate", 0, "--publish", "csv:out.csv") == 0
    assert main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "replay.csv"]) == 0
    assert lines("out.csv") == lines("replay.csv") and len(lines("out.csv")) == 3001
    assert not report()["events"] and report()["bridged"] > 0
    # A minute of the recording is asked for and is there, in whatever time it takes.
    assert run("--source", f"file:rec.csv?speed={speed}", "--duration", 60, "--publish", "csv:out.csv") == 0
    assert 3000 >= report()["samples"] > 1500


@pytest.mark.fit
def test_mean_decimation(here):
    write_recording()
    run(
        "--source",
        "file:rec.csv",
        "--rate",
        0,
        "--publish",
        "csv:all.csv",
        "--publish",
        "csv:mean.csv?rate=10&decimate=mean",
    )
    every = [[float(x) for x in line.split(",")] for line in lines("all.csv")[1:]]
    mean = [[float(x) for x in line.split(",")] for line in lines("mean.csv")[1:]]
    assert len(mean) == 30 and [row[0] for row in mean] == [row[0] for row in every[::100]]
    for k in range(1, 30):
        block = every[100 * k - 99 : 100 * k + 1]
        assert mean[k][1] == pytest.approx(sum(row[1] for row in block) / 100, rel=1e-8)


@pytest.mark.fit
def test_frames_over_tcp_and_udp_and_a_pipe(here):
    device = WireDevice(1000, 10, count=200)
    wire = [frame for _, frame in device.frames()]
    device.unplug()
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        connection, _ = server.accept()
        with connection:
            connection.sendall(b"".join(wire))
            while connection.recv(1024):  # until the reader leaves
                pass

    threading.Thread(target=serve, daemon=True).start()
    place = f"127.0.0.1:{server.getsockname()[1]}"
    run("--source", f"tcp://{place}", "--publish", "csv:a.csv", "--duration", 2)
    server.close()
    assert report()["samples"] == 2000
    expected = estimates("a.csv")

    place = free_place(socket.SOCK_DGRAM)
    host, _, port = place.partition(":")

    def listens():
        return (
            f"{socket.inet_aton(host)[::-1].hex().upper()}:{int(port):04X}"
            in Path("/proc/net/udp").read_text()
        )

    def send():
        # What is sent to a port that nobody listens at is lost.
        eventually(listens, "the listener")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for frame in wire:
                sender.sendto(frame, (host, int(port)))

    threading.Thread(target=send, daemon=True).start()
    run("--source", f"udp://{place}", "--publish", "csv:b.csv", "--duration", 2)
    assert estimates("b.csv") == expected

    command = [*MOTORLENS, "run", "--source", "stdin:", "--sensor", "s.onnx", "--publish", "csv:c.csv"]
    subprocess.run(command, input=b"".join(wire), check=True, capture_output=True, timeout=LIMIT_S)
    assert estimates("c.csv") == expected


@pytest.mark.fit
def test_a_reader_that_leaves_ends_it(here):
    write_recording(200_000)
    command = f"{sys.executable} -m motorlens_runtime run --source file:rec.csv --sensor s.onnx --rate 0"
    done = ran(["sh", "-c", f"{command} | head -2"])
    assert len(done.stdout.splitlines()) == 2 and "Traceback" not in done.stderr, done


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.fit
def test_a_full_disk_does_not_stop_the_estimator(here, capsys):
    write_recording(30_000)
    assert run("--source", "file:rec.csv", "--publish", "csv:///dev/full", "--publish", "csv:good.csv") == 0
    result = report()
    full, good = result["outlets"]
    assert full["errors"] > 0 and "No space left" in full["last_error"]
    assert good["published"] == result["published"] == len(lines("good.csv")) - 1 == 3000
    assert "/dev/full" in capsys.readouterr().err


@pytest.mark.fit
def test_a_blocked_consumer_delays_nothing_and_its_losses_are_counted(here):
    write_recording(300_000)
    read_end, write_end = os.pipe()
    os.set_inheritable(write_end, True)
    assert (
        run(
            "--source",
            "file:rec.csv",
            "--rate",
            0,
            "--publish",
            f"csv:///proc/self/fd/{write_end}",
            "--publish",
            "csv:good.csv?rate=10",
        )
        == 0
    )
    blocked, good = report()["outlets"]
    assert blocked["dropped"] > 100_000 and good["published"] == 3000 and good["dropped"] == 0
    while select.select([read_end], [], [], 0.1)[0] and os.read(read_end, 1 << 16):
        pass
    os.close(write_end)
    os.close(read_end)
