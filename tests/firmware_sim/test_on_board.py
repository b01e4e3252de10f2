"""The drive on an emulated microcontroller: codes in, frames with estimates out, and `motorlens run` on its line."""

import csv
import json
import threading
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from helpers.clocks import Standing
from helpers.processes import LIMIT_S, eventually

from motorlens_firmware_sim import boards
from motorlens_firmware_sim.bench import Setup, prepare
from motorlens_firmware_sim.on_board import ROWS, OnBoard
from motorlens_firmware_sim.port import PtyPort
from motorlens_runtime.cli import main
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.framing import Decoder, Kind
from motorlens_runtime.sensor.sensor import load_sensor, scales

SENSOR = Path(__file__).resolve().parents[2] / "models/sensors/mellah2016.onnx"
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(boards.missing_tools() is not None, reason=f"{boards.missing_tools()}"),
]
RATE_HZ = 1000


def frames_of(data):
    """The rows (n, channels) that all SAMPLES frames in `data` hold."""
    runs = [run for run in Decoder().feed(data) if run.kind[0] == Kind.SAMPLES]
    if not runs:
        return np.zeros((0, 1))
    rows = [np.ascontiguousarray(run.payload[:, 2:]).view("<f4").reshape(len(run) * ROWS, -1) for run in runs]
    return np.concatenate(rows).astype(np.float64)


def test_what_the_board_estimates_is_what_the_runtime_estimates_and_run_hears_every_sample(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("motorlens_runtime.service.live.time", Standing)
    bench = prepare(
        Setup(str(SENSOR.parents[1] / "motors/mellah2016.toml"), duration_s=2.0, rate_Hz=RATE_HZ, seed=4)
    )
    assert main(["export", str(SENSOR), "--c", str(tmp_path / "c")]) == 0
    sent, counts = bytearray(), []
    live_csv = tmp_path / "live.csv"
    with ExitStack() as unplugged:
        port = unplugged.enter_context(PtyPort())

        def pass_on(data):
            sent.extend(data)
            port.write(data, patience_s=LIMIT_S)

        def drive():
            with unplugged:
                port.wait_for_reader()
                with OnBoard(boards.BOARDS[2], tmp_path / "c", bench, pass_on) as board:
                    count = board.run(rate_Hz=2000)
                    eventually(lambda: len(frames_of(bytes(sent))) == count, "all frames")
                    eventually(lambda: live_csv.exists() and len(rows_of(live_csv)) == count, "all rows")
                counts.append(count)

        thread = threading.Thread(target=drive)
        thread.start()
        # It ends when the port is unplugged.
        source = ["--source", f"pty://{port.name}", "--reconnect", "0", "--rate", "0"]
        assert main(["run", *source, "--sensor", str(SENSOR), "--publish", f"csv:{live_csv}",
                     "--json", str(tmp_path / "run.json")]) == 1  # fmt: skip
        thread.join()
    (fed,) = counts
    report = json.loads((tmp_path / "run.json").read_text())
    assert (report["samples"], report["lost"], report["feed"]["bad_frames"]) == (fed, 0, 0)
    assert report["device"] == "mellah2016-drive-on-board" and fed == 2000
    # The board works with the numbers that it sends; in single precision the network is off by little.
    rows = frames_of(bytes(sent))
    sensor = load_sensor(SENSOR, "numpy")
    samples = Samples(np.arange(fed) * 10**9 // RATE_HZ, rows[:, 0], rows[:, 1])
    estimates = open_estimator(sensor, 1 / RATE_HZ).push(samples)
    apart = np.abs(rows[::ROWS, 2:] - estimates.values[::ROWS]) / scales(sensor.specification)
    assert np.max(apart) < 1e-4
    assert np.ptp(estimates.values[:, 0]) > 10.0
    assert np.max(np.abs(rows[:, 0] - bench.drive.voltage.value(bench.codes[:fed, 0]))) < 1e-4
    live = np.array(rows_of(live_csv), dtype=float)
    assert len(live) == fed
    assert np.max(np.abs(live[:, 1] - estimates.values[:, 0])) < 1e-6


def rows_of(path):
    """Time and speed of each row."""
    with path.open() as file:
        return [(row["time_s"], row["speed_rad_s"]) for row in csv.DictReader(file) if row["quality"]]
