"""Serial loopback: simulated drive, pseudo-terminal, runtime, estimates; every sample accounted for."""

import csv
import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import MOTORLENS, Program, eventually, ran
from helpers.sensor_files import make_spec, write_sensor

from motorlens_firmware_sim.bench import Setup, prepare
from motorlens_firmware_sim.sim_source import SimulatedLine
from motorlens_firmware_sim.telemetry import Sending
from motorlens_physics.recording import read_recording
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.quality import Quality

ROOT = Path(__file__).resolve().parents[2]


def start(*arguments: object) -> Program:
    return Program([*MOTORLENS, *arguments], cwd=ROOT)


def drive_port(drive: Program) -> str:
    port = drive.line()
    assert port.startswith("/dev/pts/"), drive.told()
    return port


@pytest.fixture
def sensor(tmp_path: Path) -> Path:
    path = tmp_path / "sensor.onnx"
    write_sensor(path, spec=make_spec(rate_Hz=1000.0))
    return path


@pytest.mark.fit
def test_every_sample_is_accounted_for_and_live_equals_infer(tmp_path: Path, sensor: Path) -> None:
    samples, live, replayed = tmp_path / "samples.csv", tmp_path / "live.csv", tmp_path / "replayed.csv"
    setup = ["--duration", "20", "--rate", "1000", "--seed", "3"]
    with start(
        "drive", *setup, "--speedup", "5", "--truth", tmp_path / "truth.csv", "--json", tmp_path / "sent.json"
    ) as drive:
        with start(
            "run", "--source", f"pty://{drive_port(drive)}", "--sensor", sensor, "--publish", f"csv:{live}", "--rate", "0",
            "--record", samples, "--reconnect", "0", "--json", tmp_path / "run.json",
        ) as run:  # fmt: skip
            drive.ended()
            run.ended()
    sent = json.loads((tmp_path / "sent.json").read_text())
    assert (sent["sent"], sent["lost"]) == (20_001, 0), drive.told()
    # What came in is what the drive digitised, code by code.
    bench = prepare(Setup(duration_s=20.0, rate_Hz=1000, seed=3))
    recorded = read_recording(samples)
    assert len(recorded) == 20_001, run.told()
    np.testing.assert_allclose(np.diff(recorded.time_s), 1e-3, rtol=1e-9)
    for column, channel, adc in ((0, "voltage", bench.drive.voltage), (1, "current", bench.drive.current)):
        np.testing.assert_array_equal(np.rint(recorded.channels[channel] / adc.step), bench.codes[:, column])
    # Live and recorded estimates are the same to the last digit written.
    assert main(["infer", *map(str, (samples, "--sensor", sensor, "-o", replayed))]) == 0
    with live.open() as one, replayed.open() as other:
        # After the last sample the line is silent for a moment, and the runtime says so with stale rows.
        a = [row for row in csv.DictReader(one) if not int(row["quality"]) & Quality.STALE]
        b = list(csv.DictReader(other))
    assert len(a) == len(b) == 20_001
    for x, y in zip(a, b, strict=True):
        assert {k: v for k, v in x.items() if k != "quality"} == {
            k: v for k, v in y.items() if k != "quality"
        }
        # The live run knows that the drive is simulated, and may have been late; the recording says neither.
        assert int(x["quality"]) & ~Quality.OVERLOAD == int(y["quality"]) | Quality.SIMULATED
    # The truth written beside it belongs to the same instants: the converter is right to half a step plus noise.
    truth = read_recording(tmp_path / "truth.csv")
    error = recorded.channels["voltage"] - truth.channels["voltage"]
    assert np.std(error) == pytest.approx(np.hypot(0.24, bench.drive.voltage.step / 12**0.5), rel=0.05)


@pytest.mark.fit
@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_both_sides_in_order(tmp_path: Path, sensor: Path, end: signal.Signals) -> None:
    live = tmp_path / "live.jsonl"
    with start("drive", "--duration", "600", "--rate", "500", "--link", tmp_path / "port") as drive:
        drive_port(drive)
        publish = ["--publish", f"jsonl:{live}", "--rate", "20"]
        with start("run", "--source", tmp_path / "port", "--sensor", sensor, *publish) as run:
            eventually(lambda: live.exists() and live.stat().st_size > 2000, "estimates", run, drive)
            run.send(end)
            assert run.ended() == 0, run.told()
        assert "0 lost" in run.error
        rows = [json.loads(line) for line in live.read_text().splitlines()]
        assert len(rows) >= 5
        # The drive notices that nobody listens any more.
        assert drive.ended() == 0, drive.told()
    assert "0 lost on the line" in drive.error
    assert not os.path.lexists(tmp_path / "port")


@pytest.mark.fit
def test_a_port_that_is_not_there_or_taken_gets_one_line(tmp_path: Path, sensor: Path) -> None:
    done = ran([*MOTORLENS, "run", "--source", "/dev/pts/99999", "--sensor", sensor, "--reconnect", "0"])
    assert done.returncode == 1
    assert "/dev/pts/99999" in done.stderr and done.stderr.count("\n") == 1
    rows = tmp_path / "a.csv"
    with start("drive", "--duration", "600", "--rate", "100") as drive:
        port = drive_port(drive)
        source = ["run", "--source", f"pty://{port}", "--sensor", sensor]
        with start(*source, "--publish", f"csv:{rows}") as first:
            # A row shows that the line is open; the file itself only that the publisher is.
            eventually(lambda: rows.exists() and rows.read_text().count("\n") > 1, "a row", first, drive)
            second = ran([*MOTORLENS, *source, "--reconnect", "0"])
            assert second.returncode == 1
            assert port in second.stderr and str(first.pid) in second.stderr
            assert second.stderr.count("\n") == 1


def test_the_simulated_line_hands_over_what_is_due_and_no_more() -> None:
    now = [0.0]

    def sleep(seconds: float) -> None:
        now[0] += seconds

    sent = iter([Sending(0.0, b"a", 1), Sending(1.0, b"b", 1), Sending(1.5, b"c", 1), Sending(9.0, b"d", 1)])
    line = SimulatedLine(sent, 2.0, "sim:", clock=lambda: now[0], sleep=sleep)
    assert line.read(0.1) == b"a"
    assert line.read(0.1) == b""
    assert now[0] == pytest.approx(0.1)
    now[0] = 0.8  # 1.6 s of device time
    assert line.read(0.1) == b"bc"
    assert line.read(10.0) == b"d"
    assert now[0] == pytest.approx(4.5)
    assert line.read(1.0) is None


@pytest.mark.parametrize(
    "wrong", [{"rate_Hz": 0}, {"bits": 30}, {"rows_per_frame": 0}, {"duration_s": -1.0}, {"scenario": "x"}]
)
def test_a_bench_out_of_range_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(DataError):
        prepare(Setup(**wrong))  # type: ignore[arg-type]
