"""`motorlens evaluate`: figures that can be worked out by hand, and the command from file to table, JSON and drawings."""

import json
from dataclasses import dataclass, replace

import numpy as np
import pytest
from helpers.duty import MELLAH, measured_duty
from helpers.sensors import small_sensor

from motorlens_physics.recording import Recording, write_recording
from motorlens_runtime.cli import main
from motorlens_train.baselines.method import Estimate, truth
from motorlens_train.bound import Noise
from motorlens_train.build import golden
from motorlens_train.evaluation.scores import counted, evaluate, idle, text_table
from motorlens_train.evaluation.sensor_file import bank_from, read_sensor
from motorlens_train.export import write_sensor
from motorlens_train.features import feature_rows


@dataclass(frozen=True)
class Off:
    """The truth and a known error on top, with a stated deviation."""

    by: np.ndarray
    sd: float

    def fit(self, recordings, motor_file):
        return self

    def estimate(self, recording):
        actual = truth(recording, MELLAH)
        return Estimate.of(actual + self.by[:, None], np.full_like(actual, self.sd))


@pytest.fixture(scope="module")
def recording():
    return measured_duty(4, 100.0)


def test_scores_are_what_they_say(recording):
    rows = counted(recording, MELLAH)
    rng = np.random.default_rng(0)
    noise = 0.3 * rng.standard_normal(len(recording))
    found = evaluate(
        {"noisy": Off(noise, 0.3), "constant": Off(np.full(len(recording), -0.2), 0.05)}, [recording], MELLAH
    )
    noisy, constant = (found.scores[name]["speed"] for name in ("noisy", "constant"))
    assert noisy.rms == pytest.approx(np.sqrt(np.mean(noise[rows] ** 2)))
    assert noisy.max == pytest.approx(np.abs(noise[rows]).max())
    # One normal error in twenty is outside.
    assert noisy.coverage == pytest.approx(0.95, abs=0.01)
    assert [constant.rms, constant.max, constant.steady] == pytest.approx([0.2, 0.2, 0.2])
    assert constant.coverage == 0.0
    assert np.isnan(noisy.ratio)
    shares = found.coverage_by_excitation()["noisy"]["temperature"]
    assert len(shares) == 3 and all(0.92 < share < 0.98 for share in shares)


@pytest.mark.fit
def test_the_ratio_to_the_bound_is_the_error_over_the_bound(recording):
    found = evaluate(
        {"constant": Off(np.full(len(recording), 0.5), 1.0)}, [recording], MELLAH, Noise(0.5, 0.05, 0.02)
    )
    limit = found.traces[0].bound[found.traces[0].counted]
    for k, output in enumerate(("speed", "temperature", "resistance")):
        expected = 0.5 / np.sqrt(np.mean(limit[:, k] ** 2))
        assert found.scores["constant"][output].ratio == pytest.approx(expected)
    # A tighter bound than the noise of one sample, and no bound of zero but of a speed that is known to be none.
    assert 0.01 < np.median(limit[:, 0]) < 0.55
    rests = recording.channels["speed"][found.traces[0].counted] == 0.0
    assert np.all(limit[:, 1:] > 0) and np.array_equal(limit[:, 0] == 0.0, rests) and 0.0 < rests.mean() < 0.5


def test_errors_count_from_a_second_after_the_first_step():
    time = np.arange(1000) * 0.01
    v = np.where(time < 4.0, 0.0, 200.0)
    recording = Recording("step", time, {"voltage": v, "current": np.zeros(1000), "speed": np.zeros(1000)})
    rows = counted(recording, MELLAH)
    assert time[np.argmax(rows)] == pytest.approx(5.0)
    still = idle(recording, MELLAH)
    assert still[390] == pytest.approx(3.9, abs=0.05)
    assert still[405] < 0.1
    assert still[-1] == pytest.approx(5.0, abs=0.8)


def test_what_was_not_measured_is_not_scored(recording):
    bare = replace(recording, channels={q: recording.channels[q] for q in ("voltage", "current", "speed")})
    found = evaluate({"constant": Off(np.full(len(bare), 0.1), 1.0)}, [bare], MELLAH, Noise())
    assert np.isnan(found.scores["constant"]["temperature"].rms)
    assert found.notes and "no bound" in found.notes[0]
    assert "temperature" not in text_table(found)
    json.dumps(found.document(), allow_nan=False)


@pytest.mark.fit
def test_a_bank_read_from_the_file_is_the_bank_that_was_written(recording):
    for observed in (False, True):
        sensor = small_sensor(observed).sensor
        again = bank_from(json.loads(json.dumps(sensor.specification.document())))
        args = recording.time_s, recording.channels["voltage"], recording.channels["current"]
        np.testing.assert_array_equal(feature_rows(again, *args), feature_rows(sensor.bank, *args))


@pytest.mark.fit
def test_the_command_from_files_to_table_json_and_drawings(tmp_path, recording, capsys):
    built = small_sensor(True)
    write_sensor(built.sensor, built.card, golden(built.sensor), tmp_path / "small.onnx")
    write_recording(recording, tmp_path / "duty.csv")
    short = measured_duty(3, 60.0)
    write_recording(short, tmp_path / "bench.csv")
    motor = tmp_path / "motor.toml"
    motor.write_text(MELLAH.text)
    status = main(
        ["evaluate", str(tmp_path / "small.onnx"), str(tmp_path / "duty.csv"), "--motor", str(motor), "--fit",
         str(tmp_path / "bench.csv"), "--png", str(tmp_path / "e.png"), "--html", str(tmp_path / "e.html"), "--json",
         str(tmp_path / "e.json")]
    )  # fmt: skip
    assert status == 0
    shown = capsys.readouterr().out
    document = json.loads((tmp_path / "e.json").read_text())
    assert set(document["methods"]) >= {
        "small",
        "extended Kalman",
        "steady-state voltage",
        "perceptron",
        "two-step Kalman",
    }
    for name, row in document["methods"].items():
        assert name in shown
        assert row["speed"]["rms"] > 0 and 0 <= row["speed"]["coverage"] <= 1
        # A genie-aided bound on one trajectory; nothing is far below it.
        assert row["speed"]["ratio"] > 0.5
    assert (tmp_path / "e.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "e.html").read_text()
    assert "data:image/png;base64" in page and "http" not in page.replace("http-equiv", "")
    # What the command says of the sensor is what the sensor does.
    estimate = read_sensor(tmp_path / "small.onnx").estimate(recording)
    error = (estimate.speed - recording.channels["speed"])[counted(recording, MELLAH)]
    assert document["methods"]["small"]["speed"]["rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3)


@pytest.mark.fit
def test_refusals_are_one_line(tmp_path, recording, capsys):
    (tmp_path / "no.onnx").write_bytes(b"not a model")
    write_recording(recording, tmp_path / "duty.csv")
    assert main(["evaluate", str(tmp_path / "no.onnx"), str(tmp_path / "duty.csv")]) == 1
    built = small_sensor(True)
    write_sensor(built.sensor, built.card, golden(built.sensor), tmp_path / "small.onnx")
    blind = replace(recording, channels={q: recording.channels[q] for q in ("voltage", "current")})
    write_recording(blind, tmp_path / "blind.csv")
    assert main(["evaluate", str(tmp_path / "small.onnx"), str(tmp_path / "blind.csv")]) == 1
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 2
    assert "not a motorlens sensor" in errors[0] and "no speed, temperature or resistance" in errors[1]
