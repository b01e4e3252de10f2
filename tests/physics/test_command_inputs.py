"""The flags that commands share, and what they stand for in a motor file."""

import argparse

import numpy as np
import pytest

from motorlens_physics import command_inputs
from motorlens_physics.command_inputs import add_input_arguments, input_words, inputs_from, print_notes
from motorlens_physics.motor_file import read_motor_file, to_toml, voltage_commanded, write_motor_file
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_input_arguments(parser)
    return parser.parse_args(words)


def test_the_words_repeat_the_command():
    words = ["--motor", "mellah2016", "--voltage-commanded", "--column", "voltage=u_V*2", "--column", "speed=w",
             "--no-value=-9999", "--no-value=-1", "--terminal", "open", "--range", "1:2"]  # fmt: skip
    arguments = parsed(*words)
    assert input_words(arguments) == words
    assert input_words(parsed(*input_words(arguments))) == words


def test_recordings_are_read_as_the_flags_say(tmp_path, monkeypatch):
    rows = "".join(f"{0.001 * k:.3f},{k % 50},12,{-7 if k % 9 == 4 else k}\n" for k in range(100))
    (tmp_path / "r.csv").write_text("t_s,duty_pct,vbat_V,i_A\n" + rows)
    given = inputs_from(
        parsed("--motor", "mellah2016", "--column", "voltage=duty_pct*vbat_V/100", "--no-value=-7")
    )
    (recording,) = given.recordings([str(tmp_path / "r.csv")])
    assert recording.channels["voltage"][10] == pytest.approx(1.2)
    assert any("11 missing values of current" in note for note in recording.notes)
    # A large file is announced before it is read.
    said = []
    monkeypatch.setattr(command_inputs, "LARGE_BYTES", 1000)
    given.recordings([str(tmp_path / "r.csv")], said.append)
    assert said == [f"reading {tmp_path / 'r.csv'}"]
    with pytest.raises(DataError, match="write a number"):
        inputs_from(parsed("--motor", "mellah2016", "--no-value=nothing"))


def test_what_holds_for_several_recordings_is_said_once(capsys):
    time, none = np.arange(3.0), {"voltage": np.ones(3)}
    notes = {"a": ("same", "own"), "b": ("same",), "c": ("other", "same")}
    print_notes([Recording(f"{name}.csv", time, none, notes=said) for name, said in notes.items()])
    assert capsys.readouterr().out == "a.csv and 2 more: same\na.csv: own\nc.csv: other\n"


def test_a_commanded_voltage_is_a_sensor_without_faults_and_survives_a_round_trip(tmp_path):
    """The tables that a motor file says it with by hand, see the recordings' command.toml."""
    file = inputs_from(parsed("--motor", "mellah2016", "--voltage-commanded")).file
    assert {s.name() for s in file.sensors} == {f"voltage_sensor_{k}" for k in ("gain", "offset", "lag")}
    assert all(sensor.at_null(file.rated) == sensor for sensor in file.sensors)
    write_motor_file(file, tmp_path / "m.toml")
    back = read_motor_file(tmp_path / "m.toml")
    for key in ("voltage_sensor_gain.gain", "voltage_sensor_offset.offset", "voltage_sensor_lag.tau"):
        assert back.knowledge[key].sd == 0.0
        assert back.knowledge[key].source.startswith("measured")
    assert to_toml(voltage_commanded(back)) == to_toml(back)
