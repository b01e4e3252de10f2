"""Dead channels: noise in the place of a signal is called a fault; gains, lags and offsets are not, nor is a bad model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import needs_recordings, regbot

from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.recording import Recording, read_recording
from motorlens_workbench.dead_channels import dead_channels, without
from motorlens_workbench.diagnosis import base_fit
from motorlens_workbench.run import prepare

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "hidden_effect" / "regbot.toml"
ROBOTS = (1, 3, 4, 5, 10)


def dead(file: MotorFile, recording: Recording) -> list[tuple[str, float]]:
    run = prepare(recording, file)
    base, used = base_fit(file, (run,))
    return [(one.channel, one.gain) for one in dead_channels(file, base, used)]


def robot(number: int, side: str) -> Recording:
    columns = [f"voltage=v{side}_V", f"current=i{side}_A", f"speed=w{side}_rad_s"]
    return read_recording(regbot(number), columns)


@needs_recordings
@pytest.mark.parametrize("side", ["L", "R"])
def test_of_the_robots_only_the_broken_current_sensor_is_dead(side: str) -> None:
    file = read_motor_file(EXAMPLE)
    found = {number: dead(file, robot(number, side)) for number in ROBOTS}
    broken = found.pop(10)
    assert not any(found.values())
    if side == "L":
        assert not broken
    else:
        ((channel, gain),) = broken
        assert channel == "current"
        assert abs(gain) < 0.2


def changed(recording: Recording, channel: str, values: np.ndarray) -> Recording:
    return replace(recording, channels={**recording.channels, channel: values})


@needs_recordings
def test_a_signal_replaced_by_noise_is_dead_and_one_scaled_or_shifted_is_not() -> None:
    file = read_motor_file(EXAMPLE)
    whole = robot(4, "L")
    noise = np.random.default_rng(1).normal(0.1, 0.3, len(whole.time_s))
    assert [name for name, _ in dead(file, changed(whole, "current", noise))] == ["current"]
    assert not dead(file, changed(whole, "current", 0.6 * whole.channels["current"] + 0.2))
    assert not dead(file, changed(whole, "speed", 0.6 * whole.channels["speed"]))


@needs_recordings
def test_a_dead_channel_is_left_out_of_its_own_recording_only() -> None:
    file = read_motor_file(EXAMPLE)
    runs = tuple(prepare(robot(number, "R"), file) for number in (4, 10))
    base, used = base_fit(file, runs)
    found = dead_channels(file, base, used)
    assert [(one.run, one.channel, one.name) for one in found] == [(1, "current", "current_sensor_gain")]
    assert "robot_10" in found[0].sentence
    assert [run.channels for run in without(runs, found)] == [("current", "speed"), ("speed",)]
