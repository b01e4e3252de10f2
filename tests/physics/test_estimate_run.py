"""What a prepared recording tells of its sensors: an exact zero at rest leaves no room for an offset."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.model import predict, through_sensors
from motorlens_physics.estimate.notes import notes_of
from motorlens_physics.estimate.prepare import prepare, prepare_all
from motorlens_physics.estimate.readings import largest_offset
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.sensor_model import sensor_catalogue
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.hypotheses.sensors import sensors
from motorlens_workbench.standing import stand

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.mark.parametrize(
    ("shown", "largest"),
    [
        ([0, 0, 0, 0, 0, 3.0, 3.4, 3.2, 3.1, 3.3], 1.5),  # an encoder at rest, then running
        ([3.0, 3.4, 3.2, 3.1, 3.3, 0, 0, 0, 0, 0], 1.5),  # at rest in the end
        ([0.4, 0.4, 0.4, 0.4, 0.4, 3.4, 3.8, 3.6, 3.5, 3.7], None),  # the same with an offset
        ([0.1, -0.2, 0, 0.2, -0.1, 3.0, 3.4, 3.2, 3.1, 3.3], None),  # noise around zero
        ([3.0, 0, 0, 0, 0, 0, 3.4, 3.2, 3.1, 3.3], None),  # passing zero slowly, on a coarse converter
        ([0] * 10, None),  # nothing at all: no word on offsets
    ],
)
def test_only_an_exact_zero_at_rest_bounds_the_offset(shown, largest):
    assert largest_offset(np.array(shown, dtype=float)) == largest


def test_small_changes_go_through_sensors_as_the_sensors_record_them():
    """The difference of two records, whose equation of a lag scipy integrates; no columns are none."""
    file = read_motor_file(MOTOR)
    lag, gain = sensor_catalogue()["speed_sensor_lag"], sensor_catalogue()["current_sensor_gain"]
    file = replace(file, sensors=(replace(lag, tau=0.3), replace(gain, gain=1.2)))
    time = np.linspace(0.0, 2.0, 401)
    rest = Recording("rest", time, {"voltage": time, "current": np.sin(time), "speed": np.cos(time)})
    (run,) = prepare_all([rest], file)
    model = start_model(file, [run])
    columns = np.random.default_rng(1).standard_normal((len(time), 2, 3)).cumsum(axis=0)
    moved = through_sensors(model, run, 0, columns)
    assert moved[:, 0] == pytest.approx(1.2 * columns[:, 0])
    for j in range(3):
        u = columns[:, 1, j]
        # From where it rested at the first sample.
        late = lsim(([1.0], [0.3, 1.0]), u - u[0], time)[1] + u[0]
        assert moved[:, 1, j] == pytest.approx(late, abs=1e-9)
    assert through_sensors(model, run, 0, columns[:, :, :0]).shape == (len(time), 2, 0)


def wheel(offset: float) -> Recording:
    """An encoder that shows whole steps of 0.2 rad/s, at rest first; its reading is shifted by `offset` while it turns."""
    time = np.arange(2000) / 1000
    voltage = np.where(time < 0.01, 0.0, 60.0 + 30.0 * np.sign(np.sin(7 * time)))
    rng = np.random.default_rng(0)
    current, speed = np.zeros_like(time), np.zeros_like(time)
    i = w = 0.0
    for k, v in enumerate(voltage):
        current[k], speed[k] = i, w
        for _ in range(10):
            i += 1e-4 * (v - 3.5 * i - 0.93 * w) / 0.034
            w += 1e-4 * (0.93 * i - 0.0018 * w) / 0.032
    speed = np.where(speed > 0, np.round((speed + offset + 0.1 * rng.standard_normal(2000)) / 0.2) * 0.2, 0.0)
    current += 0.05 * rng.standard_normal(2000)
    return Recording("wheel", time, {"voltage": voltage, "current": current, "speed": speed})


@pytest.mark.fit
def test_an_offset_that_the_rest_forbids_is_no_candidate():
    file = read_motor_file(MOTOR)
    base = estimate(file, [prepare(wheel(4.0), file)])
    here = stand(fitted_of(base))
    # Coloured noise explains as much: without it.
    bare = here.looks[1]
    seen = [score for score in bare.scores if score.name == "speed_sensor_offset"]
    assert seen and seen[0].weight > 20 and not seen[0].possible
    assert "speed_sensor_offset" not in bare.best()
    free = {one.name: one for one in sensors(file, [replace(run, offset_below={}) for run in base.runs])}
    low, high = free["speed_sensor_offset"].shapes[0].limits()
    assert low < -1e3 and high > 1e3


def test_cogging_is_looked_for_where_the_angle_is_known():
    file = read_motor_file(MOTOR)
    fine = wheel(0.0)
    angle = {**fine.channels, "angle": np.cumsum(fine.channels["speed"]) / 1000}
    coarse = Recording("coarse", fine.time_s * 100, fine.channels)
    assert [run.turns for run in prepare_all([coarse, fine], file)] == [False, True]
    assert [run.turns for run in prepare_all([coarse], file)] == [False]
    measured = replace(coarse, channels=angle)
    assert [run.turns for run in prepare_all([measured, fine], file)] == [True, False]
    cogging = catalogue()["cogging_torque"].typical(file.rated)
    toothed = replace(file, motor=file.motor.with_effect(cogging))
    runs = prepare_all([measured, fine], file)
    with_teeth, without = (start_model(one, runs) for one in (toothed, file))
    assert np.array_equal(predict(with_teeth, runs[1], 1)[1], predict(without, runs[1], 1)[1])
    assert not np.allclose(predict(with_teeth, runs[0], 0)[1], predict(without, runs[0], 0)[1], atol=1e-3)


def test_few_levels_are_a_converters_if_they_toggle():
    file, run = read_motor_file(MOTOR), wheel(0.0)
    steps = np.repeat([1.0, 3.0, 2.0, 5.0], 500)
    noisy = np.round(steps + 0.3 * np.random.default_rng(1).standard_normal(2000))

    def step(voltage: np.ndarray) -> float:
        return prepare(replace(run, channels={**run.channels, "voltage": voltage}), file).input_step[0]

    assert step(steps) == 0.0 and step(noisy) == pytest.approx(1.0)


def test_a_run_whose_channels_were_moved_remembers_what_was_recorded():
    run = prepare(wheel(0.0), read_motor_file(MOTOR))
    moved = run.delayed("speed", 5).delayed("voltage", 3).delayed("speed", -2)
    assert moved.late == {"speed": 3, "voltage": 3} and not moved.valid.all()
    again = moved.as_recorded
    np.testing.assert_array_equal(again.measured, run.measured)
    np.testing.assert_array_equal(again.inputs.voltage_V, run.inputs.voltage_V)
    np.testing.assert_array_equal(again.there, run.there)
    assert not again.late


def turning(rest_s: float, *, held: int = 1) -> Recording:
    """An encoder of 0.5 rad/s noise that shows each reading `held` times, behind a rest with the supply off."""
    rng = np.random.default_rng(3)
    moving = np.arange(4000)
    voltage = 60.0 + 30.0 * np.sign(np.sin(moving / 150))
    w, speed = 0.0, np.zeros(len(moving))
    for k, v in enumerate(voltage):
        speed[k] = w
        w += 1e-3 * (0.93 * (v - 0.93 * w) / 3.5 - 0.0018 * w) / 0.032
    speed = np.repeat((speed + 0.5 * rng.standard_normal(len(speed)))[::held], held)
    rest = np.zeros(round(rest_s * 1000))
    return Recording(
        "encoder",
        np.arange(len(rest) + len(moving)) / 1000,
        {"voltage": np.concatenate([rest, voltage]), "speed": np.concatenate([rest, speed])},
    )


@pytest.mark.parametrize("held", [1, 20])
def test_a_rest_is_where_nothing_changes_and_a_slow_sensor_is_none(held: int):
    run = prepare(turning(3.0, held=held), read_motor_file(MOTOR))
    assert run.rests[:2990].all()
    assert not run.rests[3010:].any()
    assert not prepare(turning(0.0, held=held), read_motor_file(MOTOR)).rests.any()


@pytest.mark.long
@pytest.mark.fit
def test_a_rest_does_not_make_the_noise_smaller():
    file = read_motor_file(MOTOR)
    found = [estimate(file, [prepare(turning(rest), file)]).runs[0] for rest in (0.0, 4.0)]
    alone, beside = (float(np.sqrt(run.noise.of_sensors(run)[0])) for run in found)
    assert 0.4 < alone < 0.6
    assert beside == pytest.approx(alone, rel=0.1)


@pytest.mark.parametrize("every", [2, 5, "at random"])
def test_samples_that_are_no_new_readings_are_left_out_and_the_motor_is_found_as_without(
    every: int | str,
) -> None:
    """A bus that hands on the last speed: what is left of it is as if the rest were missing."""
    rng = np.random.default_rng(4)
    time = np.arange(2000) * 0.002
    speed = 100 * np.sin(3 * time) + 0.3 * rng.standard_normal(2000)
    fresh = rng.random(2000) < 0.4 if every == "at random" else np.arange(2000) % every == 0
    fresh[0] = True
    shown = speed[np.maximum.accumulate(np.where(fresh, np.arange(2000), 0))]
    channels = {"voltage": 24 * np.sign(np.sin(3 * time)), "current": rng.standard_normal(2000)}
    run = prepare(Recording("bus.csv", time, channels | {"speed": shown}), read_motor_file(MOTOR))
    bare = prepare(
        Recording("bus.csv", time, channels | {"speed": np.where(fresh, speed, np.nan)}),
        read_motor_file(MOTOR),
    )
    c = run.channels.index("speed")
    assert np.array_equal(run.there[:, c], fresh) and run.there[:, 1 - c].all()
    assert np.array_equal(run.there, bare.there) and np.array_equal(run.valid, bare.valid)
    assert np.array_equal(run.measured[run.valid], bare.measured[bare.valid])
    assert dict(run.repeats) == {"speed": int(np.sum(~fresh))} and not bare.repeats
    (note,) = notes_of([run])
    assert (
        f"the one before again to all digits and so no new readings: {np.sum(~fresh)} samples of speed"
        in note
    )


@pytest.mark.parametrize("kind", ["rounded to three digits", "counted", "at rest", "a converter's levels"])
def test_equal_neighbours_that_are_readings_stay(kind: str) -> None:
    rng = np.random.default_rng(5)
    time = np.arange(4000) * 0.002
    speed = 100 * np.sin(3 * time) + 0.3 * rng.standard_normal(4000)
    shown = {
        "rounded to three digits": np.array([float(f"{y:.3g}") for y in speed]),
        "counted": np.diff(np.floor(np.cumsum(speed) * 0.05), prepend=0.0) * 20.0,
        "at rest": np.where(time < 3, 0.0, speed),
        "a converter's levels": np.round(speed / 0.5) * 0.5,
    }[kind]  # fmt: skip
    channels = {
        "voltage": 24 * np.sign(np.sin(3 * time)),
        "current": rng.standard_normal(4000),
        "speed": shown,
    }
    run = prepare(Recording("bus.csv", time, channels), read_motor_file(MOTOR))
    assert not run.repeats and run.there.all()
