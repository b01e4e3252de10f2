"""The sensor that is shipped: it loads, is small, and does on duty cycles of its own what its card says."""

from pathlib import Path

import numpy as np
import pytest
from helpers.changing import drive

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.scenario import perform
from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_train.baselines.method import OUTPUTS
from motorlens_train.duty_cycles import TrainingDuty, duty_cycle, with_noise
from motorlens_train.evaluation.scores import counted
from motorlens_train.evaluation.sensor_file import read_sensor
from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.judge import judged
from motorlens_train.evaluation.worlds.world import at, drawn, record
from motorlens_train.material import noise_of

ROOT = Path(__file__).resolve().parents[2]
SENSOR = ROOT / "models/sensors/mellah2016.onnx"
OBSERVER = ROOT / "models/sensors/mellah2016_observer.onnx"


def test_it_loads_and_is_small() -> None:
    sensor = load_sensor(SENSOR)
    assert [o.name for o in sensor.specification.outputs] == list(OUTPUTS)
    assert SENSOR.stat().st_size <= 20_000
    assert SENSOR.with_suffix(".step.onnx").exists()
    assert sensor.card["training_data_sha256"] in SENSOR.with_suffix(".md").read_text(encoding="utf-8")


@pytest.mark.fit
def test_unseen_duty_cycles_are_estimated_as_the_card_says() -> None:
    """Cycles of a seed that nobody trained on, evaluated from the file: within a factor of the card's figures, both ways."""
    file = read_motor_file(ROOT / "models/motors/mellah2016.toml")
    sensor, card = read_sensor(SENSOR), load_sensor(SENSOR).card["unseen"]
    squares, inside = [], []
    for seed in range(4):
        recording = duty_cycle(file, noise_of(file, []), 1000.0, 600.0, np.random.default_rng([99, seed]))
        estimate = sensor.estimate(recording)
        channels = recording.channels
        rise = channels["temperature"] - channels["ambient"]
        off = estimate.values - np.column_stack([channels["speed"], rise, channels["resistance"]])
        squares.append((off**2).mean(0))
        inside.append((np.abs(off) <= 1.96 * estimate.sds).mean(0))
    rmse = np.sqrt(np.mean(squares, axis=0))
    for k, (name, goal) in enumerate((("speed", 0.5), ("temperature", 0.8), ("resistance", 0.012))):
        # Short cycles are the easier ones: hours of heating are where the error of a temperature grows.
        assert 0.001 * card[name]["rmse"] < rmse[k] < min(4 * card[name]["rmse"], goal), name
        assert 0.8 < np.mean(inside, axis=0)[k] <= 1.0, name


@pytest.mark.fit
def test_with_an_observer_any_start_will_do() -> None:
    """Started warm, which the sensor is not told: a second after the first voltage step the inrush has shown it."""
    file, sensor = read_motor_file(ROOT / "models/motors/mellah2016.toml"), read_sensor(OBSERVER)
    blind = read_sensor(SENSOR)
    errors: dict[str, list[np.ndarray]] = {"observer": [], "filters": []}
    inside, starts = [], []
    for seed in range(3):
        noise, rng = noise_of(file, []), np.random.default_rng([98, seed])
        recording = with_noise(perform(file, TrainingDuty(150.0, 0.004, warm=True), rng), noise, rng)
        rows, channels = counted(recording, file), recording.channels
        rise = channels["temperature"] - channels["ambient"]
        actual = np.column_stack([channels["speed"], rise])[rows]
        for name, each in (("observer", sensor), ("filters", blind)):
            found = each.estimate(recording)
            errors[name].append(((found.values[rows, :2] - actual) ** 2).mean(0))
            if name == "observer":
                inside.append((np.abs(found.values[rows, :2] - actual) <= 1.96 * found.sds[rows, :2]).mean(0))
        starts.append(rise[0])
    assert max(starts) > 20.0
    speed, temperature = np.sqrt(np.mean(errors["observer"], axis=0))
    assert 0.02 < speed < 0.5 and 0.01 < temperature < 3.0
    assert np.sqrt(np.mean(errors["filters"], axis=0))[1] > 10.0, "filters alone cannot know"
    assert np.all(np.mean(inside, axis=0) > 0.85)


@pytest.mark.fit
@pytest.mark.parametrize("motor", ["the file's", "10 % off"])
def test_filters_alone_are_not_surer_than_noise_and_the_motor_file_let_them_be(motor: str) -> None:
    """On a plant that shares nothing with training: filters show neither the noise nor whose motor it is, so that intervals
    must hold at the loudest and on any motor of the make."""
    file, sensor = read_motor_file(ROOT / "models/motors/mellah2016.toml"), read_sensor(SENSOR)
    cells = {"motor": motor, "lacks": "nothing", "start": "cold", "noise": "4-10", "colour": "coloured"}
    held = []
    for number in range(12):
        rate = ("200", "500", "1000")[number % 3]
        world = at(drawn(12, number), **cells, rate=rate)
        found = judged(sensor, world, record(world, Drive.of(file)))
        assert not found.confidently_wrong, world
        held.append(found.covered)
    assert np.mean(held, axis=0).min() >= 0.93


@pytest.mark.fit
def test_filters_alone_state_what_noise_and_the_motor_file_leave_open() -> None:
    """In closed form: a speed v / ke is off by what ke is, evenly spread within 10 %, and by the loudest noise, five volts a
    sample and as much again from the current, which filters halve; a cold resistance by what R_a0 is."""
    file, sensor = read_motor_file(ROOT / "models/motors/mellah2016.toml"), read_sensor(SENSOR)
    recording = duty_cycle(file, noise_of(file, []), 1000.0, 300.0, np.random.default_rng([97, 0]))
    stated, even = sensor.estimate(recording).sds, 0.1 / np.sqrt(3)
    noise = 0.5 * np.hypot(4.8, 3.6) / file.motor.ke
    expected = np.hypot(noise, even * recording.channels["speed"])
    assert 0.8 < np.median(stated[:, 0] / expected) < 1.25
    assert 0.8 < np.median(stated[:, 2] / (even * file.motor.R_a0)) < 1.25


def test_it_is_rebuilt_by_the_command_in_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for name, more in (("mellah2016", "--hidden 12-8"), ("mellah2016_observer", "--cycles 100")):
        command = f"motorlens train --motor models/motors/mellah2016.toml --seed 1 {more} -o models/sensors/{name}.onnx"
        assert command in " ".join(makefile.replace("\\\n", " ").split())


@pytest.mark.fit
def test_training_from_the_motor_is_reproducible(tmp_path: Path) -> None:
    """A small sensor, built twice from one seed: the same bytes."""
    from motorlens_runtime.cli import main

    arguments = [
        "--motor",
        str(ROOT / "models/motors/mellah2016.toml"),
        "--seed",
        "3",
        "--cycles",
        "10",
        "--rate",
        "200",
    ]
    files = []
    for number in (1, 2):
        (tmp_path / str(number)).mkdir()
        files.append(tmp_path / str(number) / "small.onnx")
        more = ["--hidden", "4", "--iterations", "8", "-o", str(files[-1])]
        assert main(["train", *arguments, *more]) == 0
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.fit
@pytest.mark.parametrize("share", [1.0, 1.15])
def test_what_the_observer_cannot_foretell_makes_it_as_unsure_as_at_the_start(share: float) -> None:
    """A contact that goes bad while the motor runs: by a plant of its own, what the next change of the voltage shows is
    believed again; and where nothing has happened nothing is forgotten."""
    dt, n = 2e-3, 12_000
    t = np.arange(n) * dt
    voltage = np.select([t < 1, t < 8, t < 16], [0.0, 120.0, 200.0], 100.0)
    load = np.select([t < 12, t < 18], [2.0, 6.0], 4.0)
    current, speed = drive(voltage, load, dt, resistance=np.where(t < 10, 1.0, share))
    rng = np.random.default_rng(0)
    samples = Samples(
        np.round(t * 1e9).astype(np.int64), voltage + 0.1 * rng.standard_normal(n),
        current + 0.01 * rng.standard_normal(n), np.full(n, 20.0),
    )  # fmt: skip
    rows = np.arange(int(10.5 / dt), n, 50)
    found = open_estimator(load_sensor(OBSERVER), dt).push(samples, rows)
    off = np.abs(found.values[:, 0] - speed[rows]) / found.sigma[:, 0]
    assert np.mean(off < 1.96) >= 0.93
    # The resistance is what is measured; as a temperature its 15 % are 37.5 K, and that interval holds the cold winding.
    assert found.values[-1, 2] == pytest.approx(3.5 * share, rel=0.01)
    kelvin = found.sigma[-1, 2] / (3.5 * 0.004)
    assert (kelvin < 0.4) if share == 1.0 else (0.3 < kelvin < 3.0)
    assert found.values[-1, 1] < 3.0 * found.sigma[-1, 1] and (share > 1.0 or found.sigma[-1, 1] < 0.4)


@pytest.mark.fit
@pytest.mark.parametrize("size_Nm", [6.0, -6.0])
def test_a_load_that_jumps_leaves_the_resistance_known(size_Nm: float) -> None:
    """By a plant of its own: a load far from what was foretold is a load, at whatever sample of a window it comes."""
    dt, n, jump = 2e-3, 7_500, 6_000
    t = np.arange(n) * dt
    voltage = np.select([t < 1, t < 8], [0.0, 120.0], 200.0)
    for phase in range(5):
        load = 2.0 + max(-size_Nm, 0.0) + size_Nm * (np.arange(n) >= jump + phase)
        current, speed = drive(voltage, load, dt, resistance=1.15)
        rng = np.random.default_rng(phase)
        samples = Samples(
            np.round(t * 1e9).astype(np.int64), voltage + 0.2 * rng.standard_normal(n),
            current + 0.02 * rng.standard_normal(n), np.full(n, 20.0),
        )  # fmt: skip
        found = open_estimator(load_sensor(OBSERVER), dt).push(samples, np.array([jump - 10, n - 1]))
        assert found.sigma[1, 2] < 1.2 * found.sigma[0, 2] < 0.02
        assert abs(found.values[1, 0] - speed[-1]) < 3 * found.sigma[1, 0]
        assert found.values[1, 2] == pytest.approx(3.5 * 1.15, rel=0.01)
