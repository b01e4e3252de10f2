"""`train --recordings`: the observer of the motor that they show, or a network where that comes nearer."""

import numpy as np
import pytest
from helpers.duty import MELLAH

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError
from motorlens_train.own_motor import motor_of


def bench(folder, seconds=8):
    """Recordings as a user has them: nothing is said of the motor."""
    paths = []
    for seed in (1, 2, 3):
        paths.append(str(folder / f"r{seed}.csv"))
        done = main(
            ["simulate", "mellah2016", "--scenario", "duty", "--duration", str(seconds), "--rate", "200", "--noise",
             "voltage=0.3", "--noise", "current=0.03", "--seed", str(seed), "-o", paths[-1]]
        )  # fmt: skip
        assert done == 0
    return paths


@pytest.mark.fit
def test_a_motor_of_the_textbook_gets_its_observer(tmp_path, capsys):
    *seen, left_out = bench(tmp_path)
    out = tmp_path / "own.onnx"
    done = main(["train", "--recordings", *seen, "--iterations", "5", "--worlds", "1", "-o", str(out)])
    said = capsys.readouterr()
    assert done == 0, said.err
    assert "observer alone" in said.out and "in 1 worlds it was not made in" in said.out
    card = out.with_suffix(".md").read_text(encoding="utf-8")
    assert "the recordings its motor was fitted to" in card and "| all |  | 1 |" in card
    values, true = read_motor_file(out.with_suffix(".toml")).values(), MELLAH.values()
    for key in ("R_a0", "L", "ke", "J"):
        assert values[key] == pytest.approx(true[key], rel=0.02), key
    answers = tmp_path / "answers.csv"
    assert main(["infer", left_out, "--sensor", str(out), "-o", str(answers)]) == 0
    found = np.genfromtxt(answers, delimiter=",", names=True)
    truth = np.genfromtxt(left_out, delimiter=",", names=True)
    off, counted = found["speed_rad_s"] - truth["speed_rad_s"], truth["time_s"] > 5
    assert 1e-4 < np.sqrt((off[counted] ** 2).mean()) < 2.0
    assert (np.abs(off) <= 1.96 * found["speed_sd_rad_s"])[counted].mean() > 0.9


def test_what_is_no_motor_is_refused_in_words():
    time = np.arange(100) * 0.01
    channels = {"voltage": np.sin(time), "current": -np.sin(time), "speed": np.cos(time)}
    with pytest.raises(DataError, match="not those of a motor: check signs and units"):
        motor_of("m", [Recording("r", time, channels)])
