"""Worlds for anybody's motor: the plant is the file's motor, the table counts what it says, commands and card hold it."""

import json
from pathlib import Path

import numpy as np
import pytest
from helpers.duty import MELLAH

from motorlens_physics.motor_file import read_motor_file, write_motor_file
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.cli import main
from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.judge import verdict
from motorlens_train.evaluation.worlds.plant import run
from motorlens_train.evaluation.worlds.table import cells, text
from motorlens_train.evaluation.worlds.world import FACTORS, at, drawn, record

pytestmark = pytest.mark.fit

SHIPPED = Path(__file__).resolve().parents[2] / "models" / "sensors" / "mellah2016_observer.onnx"


def wheel():
    """A small motor: 12 V, its own time constants."""
    return read_motor_file(Path(__file__).resolve().parents[2] / "examples" / "hidden_effect" / "regbot.toml")


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("file", [MELLAH, wheel()], ids=["mellah2016", "wheel"])
def test_the_plant_is_the_motor_of_the_file(file, held):
    drive, n = Drive.of(file), 4000
    rng = np.random.default_rng(0)
    time = np.arange(n) * 2e-3
    voltage = drive.rated_V * np.repeat(rng.uniform(0.2, 1.0, 8), n // 8)
    load = np.full(n, 0.4 * drive.rated_Nm)
    mine, _ = run(drive.constants, time, voltage, held, np.zeros(n), load, np.array([0.0, 0.0, 12.0]))
    theirs = simulate(file.motor, Inputs(time, voltage, load, np.full(n, 20.0), held=held), {"theta": 12.0})
    for k, (other, size) in enumerate(
        ((theirs.current_A, file.rated.current_A), (theirs.speed_rad_s, file.rated.speed_rad_s), (theirs.rise_K, 1.0))
    ):  # fmt: skip
        np.testing.assert_allclose(mine[:, k], other, atol=2e-3 * size)


@pytest.mark.parametrize("load", ["brake", "drive"])
def test_what_truly_happened_obeys_the_equations_of_the_motor(load):
    """Newton's law and Kirchhoff's, integrated over quarters of a second, at rest and in reverse too."""
    drive = Drive.of(MELLAH)
    world = at(
        drawn(3, 4), excitation="steps", rate="5000", between="held", start="warm", load=load, lacks="nothing"
    )
    found = record(world, drive)
    c, h, every = found.constants, np.diff(found.time_s), 1250
    i, w, R = found.true_A, found.truth[:, 0], found.truth[:, 2]
    shaft = 0.5 * (found.shaft_Nm[1:] + found.shaft_Nm[:-1])
    means = [0.5 * (x[1:] + x[:-1]) for x in (i, w, R * i)]
    angular = np.concatenate([[0.0], np.cumsum(h * (c.ke * means[0] - c.b * means[1] - shaft))])
    linked = np.concatenate([[0.0], np.cumsum(h * (found.true_V[:-1] - means[2] - c.ke * means[1]))])
    for sum_, state, size in ((angular / c.J, w, 1.0), (linked / c.L, i, 0.2)):
        off = np.diff(sum_[::every]) - np.diff(state[::every])
        assert np.median(np.abs(off)) < 0.01 * size and np.abs(off).max() < size
    assert w.min() < -1.0 if load == "drive" else w.min() > -1.0


def test_a_world_is_its_seed_and_its_noise_is_what_it_says():
    drive = Drive.of(wheel())
    world = at(
        drawn(3, 1), excitation="steps", rate="500", noise="0.5-2", colour="white", converter="exact",
        motor="the file's", lacks="nothing",
    )  # fmt: skip
    one, again = record(world, drive), record(world, drive)
    np.testing.assert_array_equal(one.voltage_V, again.voltage_V)
    assert 0.5 <= one.noise_V / drive.noise_V <= 2.0
    rest = one.time_s < 0.4
    assert one.current_A[rest].std() == pytest.approx(one.noise_A, rel=0.3)
    other = record(at(world, motor="10 % off"), drive).constants
    shares = np.array(other[:10])[np.array(drive.constants[:10]) > 0] / [
        c for c in drive.constants[:10] if c > 0
    ]
    assert 0.9 <= shares.min() < shares.max() <= 1.1 and other.alpha == drive.constants.alpha


def test_the_table_counts_what_verdicts_say():
    drive = Drive.of(MELLAH)
    kinds = {"excitation": "steps", "rate": "200", "lacks": "nothing", "motor": "the file's", "start": "cold"}
    worlds = [at(drawn(1, k), **kinds) for k in range(2)]
    found = []
    for world, off in zip(worlds, (0.0, 3.0), strict=True):
        recorded = record(world, drive)
        rows = np.arange(0, len(recorded.time_s), 50)
        # Three kelvin off, with a stated deviation of half a kelvin: confidently wrong.
        values = recorded.truth[rows] + np.array([0.0, off, 0.0])
        found.append(
            verdict(world, recorded, rows, values, np.full((len(rows), 3), 0.5), np.ones(len(rows), bool))
        )
    table = cells(found)
    whole = table[0]
    assert (whole.worlds, whole.wrong, whole.good) == (2, 1, 1.0)
    assert whole.covered == pytest.approx([1.0, 0.5], abs=0.01)
    assert whole.worst[1] == pytest.approx(3.0) and whole.worst_world == 1
    per_factor = {factor: sum(c.worlds for c in table if c.factor == factor) for factor in FACTORS}
    assert set(per_factor.values()) == {2}
    assert len(text(table).splitlines()) == len(table) + 1


def test_evaluate_prints_the_table_and_writes_it(tmp_path, capsys):
    words = ["evaluate", str(SHIPPED), "--motor", "mellah2016", "--worlds", "2", "--seed", "5"]
    assert main([*words, "--json", str(tmp_path / "w.json")]) == 0
    printed = capsys.readouterr().out
    document = json.loads((tmp_path / "w.json").read_text())
    assert document["schema"] == "motorlens.evaluate/1" and document["worlds"][0]["worlds"] == 2
    assert printed.count("\n") == len(document["worlds"]) + 2
    assert all(0.0 <= cell["good"] <= 1.0 for cell in document["worlds"])


def test_what_cannot_be_judged_in_worlds_is_said_in_one_line(capsys):
    for words, said in (
        (["mellah2016", "--motor", "mellah2016"], "sensors with an observer"),
        ([str(SHIPPED)], "--motor MOTOR.toml"),
        ([str(SHIPPED), "--motor", "mellah2016", "--worlds", "-1"], "at least 0"),
    ):
        assert main(["evaluate", *words]) == 1
        error = capsys.readouterr().err
        assert said in error and error.count("\n") == 1


def test_a_motor_file_alone_gives_its_observer_and_a_card_with_worlds(tmp_path, capsys):
    write_motor_file(wheel(), tmp_path / "wheel.toml")
    out = tmp_path / "wheel.onnx"
    words = ["--motor", str(tmp_path / "wheel.toml"), "--cycles", "10", "--rate", "200", "--worlds", "3"]
    assert main(["train", *words, "-o", str(out), "--json", str(tmp_path / "t.json")]) == 0
    assert "in 3 worlds it was not made in" in capsys.readouterr().out
    card = json.loads((tmp_path / "t.json").read_text())["card"]
    assert card["network"] == "observer alone" and card["worlds"]["cells"][0]["worlds"] == 3
    page = out.with_suffix(".md").read_text()
    assert "| all |  | 3 |" in page and "| lacks | " in page
    assert out.stat().st_size < 100_000
