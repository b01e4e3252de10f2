"""A long recording is fitted to in parts: what is found must be what all of it tells."""

from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.free_run import FreeRun
from motorlens_physics.estimate.model import predict
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording, read_recording
from motorlens_runtime.cli import main
from motorlens_workbench.compare import long_recordings
from motorlens_workbench.compare.comparison import compare
from motorlens_workbench.report.comparison import to_json, to_text

MODEL = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.mark.fit
def test_parts_tell_what_all_of_it_tells(tmp_path, monkeypatch):
    path = tmp_path / "bench.csv"
    simulate = ["simulate", str(MODEL), "--scenario", "load_steps", "--duration", "30", "--rate", "100"]
    assert (
        main([*simulate, "--effect", "coulomb_friction.tau_c=0.4", "--noise", "0.2%", "-o", str(path)]) == 0
    )
    file, recording = read_motor_file(MODEL), read_recording(path)
    said = []
    whole = compare(file, [recording], said.append)
    assert whole.notes == () and not any("along" in text for text in said)
    for name, value in (("LONG", 2000), ("PART", 800), ("BLOCKS", 1000)):
        monkeypatch.setattr(long_recordings, name, value)
    parts = compare(file, [recording], said.append)
    assert "running along bench.csv" in said and "all 3001" in parts.notes[0]
    assert parts.notes[0] in to_text(parts) and to_json(parts, ["bench.csv"], "m")["notes"] == list(
        parts.notes
    )
    for channel, found in whole.channels.items():
        assert parts.channels[channel].rmse == pytest.approx(found.rmse, rel=0.05)
        assert parts.channels[channel].noise_floor == pytest.approx(found.noise_floor, rel=0.1)
    assert [region.samples for region in parts.map] == [region.samples for region in whole.map]
    assert parts.equations["mechanical"].share > 0.9 and whole.equations["mechanical"].share > 0.9


def test_means_of_blocks(monkeypatch):
    monkeypatch.setattr(long_recordings, "LONG", 10)
    monkeypatch.setattr(long_recordings, "BLOCKS", 5)
    k = np.arange(11.0)
    found = long_recordings.means(
        Recording("r", k, {"voltage": k**2, "shaft": np.repeat([0.0, 1.0], [3, 8])})
    )
    assert found.time_s.tolist() == [1.0, 4.0, 7.0]
    assert found.channels["voltage"].tolist() == [5 / 3, 50 / 3, 149 / 3]
    assert found.channels["shaft"].tolist() == [0.0, 1.0, 1.0]


@pytest.mark.fit
def test_a_speed_that_is_a_mean_in_the_liveliest_part_is_one_along_all_of_it():
    file, time = read_motor_file(MODEL), np.arange(600) * 0.02
    voltage = np.repeat(np.random.default_rng(1).uniform(-200, 200, 12), 50)
    runs = prepare_all(
        [Recording("r", time, {"voltage": voltage, "current": voltage, "speed": voltage})], file
    )
    model = start_model(file, runs)
    trajectory, shown = predict(model, runs[0], 0)
    lively = FreeRun(runs[0].delayed("speed", 1).showing(True), trajectory, shown, np.ones(2))
    found = long_recordings._along(model, runs[0], 0, lively)
    assert found.run.late == {"speed": 1} and found.run.mean_speed
    speed, largest = trajectory.states["w"], np.abs(trajectory.states["w"]).max()
    # Halfway between both ends, but for how the speed bends within a sample.
    assert found.predicted[1:, 1] == pytest.approx(0.5 * (speed[1:] + speed[:-1]), abs=0.03 * largest)
    assert np.abs(found.predicted[:, 1] - speed).max() > 0.1 * largest
