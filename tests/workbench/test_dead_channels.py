"""Dead channels: noise in the place of a signal is called a fault; gains, lags and offsets are not, nor is a bad model."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import needs_recordings, regbot

from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.recording import Recording, read_recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.hypotheses.dead_channels import dead_channels, without

pytestmark = pytest.mark.fit

MELLAH = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "hidden_effect" / "regbot.toml"
ROBOTS = (1, 3, 4, 5, 10)


def dead(file: MotorFile, recording: Recording) -> list[tuple[str, float]]:
    run = prepare(recording, file)
    return [(one.channel, one.gain) for one in dead_channels(file, (run,))]


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


@pytest.mark.parametrize("channel", ["current", "speed"])
@pytest.mark.parametrize(("gain", "faulty"), [(-1.0, True), (0.05, True), (0.6, False), (1.5, False)])
def test_a_sensor_with_its_wires_swapped_is_found(channel: str, gain: float, faulty: bool) -> None:
    file = read_motor_file(MELLAH)
    rng, time = np.random.default_rng(2), np.arange(4000) * 0.002
    voltage = 100 * np.repeat(rng.uniform(-1, 1, 16), 250)
    truth = simulate(file.motor, Inputs(time, voltage, np.zeros(4000), np.full(4000, 20.0), held=True))
    shown = {"current": truth.current_A + 0.02 * rng.standard_normal(4000)}
    shown["speed"] = truth.speed_rad_s + 0.2 * rng.standard_normal(4000)
    shown[channel] = gain * shown[channel]
    recording = Recording("bench", time, {"voltage": voltage, "load_torque": np.zeros(4000), **shown})
    found = dead(file, recording)
    assert [name for name, _ in found] == ([channel] if faulty else [])
    if faulty:
        assert found[0][1] == pytest.approx(gain, abs=0.1)


@pytest.mark.parametrize(("channel", "draw"), [("current", 0), ("speed", 16)])
def test_a_sensor_without_a_sign_is_told_from_a_dead_one(channel: str, draw: int) -> None:
    file = read_motor_file(MELLAH)
    rng, time = np.random.default_rng(2), np.arange(4000) * 0.002
    voltage = 100 * np.repeat(rng.uniform(-1, 1, 16), 250)
    truth = simulate(file.motor, Inputs(time, voltage, np.zeros(4000), np.full(4000, 20.0), held=True))
    shown = {"current": truth.current_A, "speed": truth.speed_rad_s}
    shown = {name: y + 0.002 * np.std(y) * rng.standard_normal(4000) for name, y in shown.items()}
    signed = Recording("bench", time, {"voltage": voltage, "load_torque": np.zeros(4000), **shown})
    recording = replace(signed, channels={**signed.channels, channel: np.abs(shown[channel])})
    (found,) = dead_channels(file, (prepare(recording, file),))
    assert found.unsigned and found.channel == channel
    assert found.gain == pytest.approx(1.0, abs=0.1)
    assert "shows no sign" in found.sentence and "sign(VOLTAGE)" in found.sentence
    # Noise alone follows the size of anything a little, by chance: this draw by two deviations.
    noise = np.std(shown[channel]) * np.random.default_rng(draw).standard_normal(4000)
    dead_one = replace(signed, channels={**signed.channels, channel: noise})
    (found,) = dead_channels(file, (prepare(dead_one, file),))
    assert not found.unsigned and "is dead" in found.sentence


@pytest.mark.parametrize(
    ("noise", "until", "hung"), [(0.2, 3000, (6.0, 7.998)), (0.2, 4000, None), (0.0, 3000, None)]
)
def test_a_sensor_that_hangs_is_found_by_its_lack_of_noise(noise: float, until: int, hung: object) -> None:
    """A stuck third is told from a steady speed in a recording without noise."""
    file = read_motor_file(MELLAH)
    rng, time = np.random.default_rng(2), np.arange(4000) * 0.002
    voltage = 100 * np.repeat(rng.uniform(-1, 1, 4), 1000)
    truth = simulate(file.motor, Inputs(time, voltage, np.zeros(4000), np.full(4000, 20.0), held=True))
    speed = truth.speed_rad_s + noise * rng.standard_normal(4000)
    speed[until:] = speed[min(until, 3999)]
    current = truth.current_A + 0.1 * noise * rng.standard_normal(4000)
    channels = {"voltage": voltage, "load_torque": np.zeros(4000), "current": current, "speed": speed}
    run = prepare(Recording("bench", time, channels), file)
    assert run.hung == ({"speed": hung} if hung else {})
    if hung:
        assert not run.valid[3000:].any()
        assert run.valid[:3000].all()
        (found,) = dead_channels(file, (run,))
        assert (found.name, found.hung) == ("speed_sensor_gain", hung)
        assert without((run,), [found])[0].channels == run.channels


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
    found = dead_channels(file, runs)
    assert [(one.run, one.channel, one.name) for one in found] == [(1, "current", "current_sensor_gain")]
    assert "robot_10" in found[0].sentence
    assert [run.channels for run in without(runs, found)] == [("current", "speed"), ("speed",)]
