"""Samples that stand alone are left out, and all of those; the plant is an integrator of its own, the places are drawn."""

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.notes import notes_of
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"], ambient_C=AMBIENT_C,
)  # fmt: skip
FILE = MotorFile("plate", Motor(**TYPICAL), PLATE)
SAMPLES, NOISE, APART = 4000, 0.002, 20
# Deviations of the noise by which a sample is off, at least: an ADC that catches a switching edge is off by much more.
LEAST = 30.0
CHANNELS = ("voltage", "current", "speed")


def driven(period_s: float, seed: int, dwell: int = 200) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Random steps of a held voltage on a free shaft."""
    rng = np.random.default_rng(seed)
    truth = TYPICAL | {"R_a0": 1.1 * TYPICAL["R_a0"], "J": 0.9 * TYPICAL["J"]}
    voltage = np.repeat(rng.uniform(-RATED["voltage"], RATED["voltage"], SAMPLES // dwell), dwell)
    test = plain_motor.Test(period_s, SAMPLES, dwell, True, NOISE)
    states = plain_motor.simulated(truth, voltage, np.zeros(SAMPLES), test)
    shown = dict(zip(CHANNELS, (voltage, states[:, 0], states[:, 1]), strict=True))
    noisy = {q: y + NOISE * RATED[q] * rng.standard_normal(SAMPLES) for q, y in shown.items()}
    return np.arange(SAMPLES) * period_s, noisy


def fitted(time: np.ndarray, channels: dict[str, np.ndarray]) -> Estimate:
    runs = prepare_all([Recording("spikes.csv", time, channels)], FILE)
    return estimate(FILE, runs)


@pytest.mark.fit
@pytest.mark.parametrize("late", [0, pytest.param(3, marks=pytest.mark.long)])
def test_samples_that_stand_alone_are_left_out_and_no_others(late: int) -> None:
    time, channels = driven(0.002, 1)
    rng = np.random.default_rng(2)
    places = rng.permutation(np.arange(APART + 7, SAMPLES - APART, APART))[:45].reshape(3, 15)
    clean = fitted(time, channels)
    for name, at in zip(CHANNELS, places, strict=True):
        size = rng.uniform(LEAST, 4 * LEAST, len(at)) * rng.choice([-1, 1], len(at))
        channels[name][at] += size * NOISE * RATED[name]
    channels["speed"] = np.concatenate([np.full(late, channels["speed"][0]), channels["speed"]])[:SAMPLES]

    found = fitted(time, channels)

    (run,), (before,) = found.runs, clean.runs
    assert dict(before.spikes) == {} and dict(run.spikes) == dict.fromkeys(CHANNELS, 15)
    (note,) = notes_of([run])
    assert "15 samples of voltage and 15 samples of current and 15 samples of speed" in note
    # Also as it was recorded, before the speed was moved.
    recorded = run.as_recorded
    assert run.late == ({"speed": late} if late else {})
    for c, shift in enumerate((0, late)):
        out = np.flatnonzero(~recorded.there[:, c])
        assert sorted(places[1 + c] + shift) == out.tolist()
    assert (
        np.abs(run.inputs.voltage_V[places[0]] - before.inputs.voltage_V[places[0] - 1]).max()
        < 6 * NOISE * RATED["voltage"]
    )
    value, other, sd = found.fit.model.values(), clean.fit.model.values(), clean.fit.sd()
    for key in ("R_a0", "L", "ke", "J", "b"):
        assert abs(value[key] - other[key]) < 0.5 * sd[key]
        assert found.fit.sd()[key] == pytest.approx(sd[key], rel=0.35)


@pytest.mark.fit
def test_what_a_motor_answers_within_a_sample_is_no_spike() -> None:
    """Its electrical time constant is half a sample: with half the inductance, one sample after each flank is far off."""
    time, channels = driven(0.02, 3)
    half = MotorFile("half", Motor(**(TYPICAL | {"L": 0.5 * TYPICAL["L"]})), PLATE)
    runs = prepare_all([Recording("fast.csv", time, channels)], half)
    prior = base_prior(half, runs)
    found = estimate(half, runs, prior.only([key for key in prior.keys if key != "L"]))
    assert (
        np.sum(np.abs(found.fit.residuals[0]) > 5 * NOISE * np.array([RATED["current"], RATED["speed"]])) > 10
    )
    assert dict(found.runs[0].spikes) == {}


@pytest.mark.fit
@pytest.mark.parametrize("dwell", [1, pytest.param(4, marks=pytest.mark.long)])
def test_pulses_of_the_voltage_that_drove_the_motor_are_no_spikes(dwell: int) -> None:
    """However much the model is off: the load that the file does not know brakes, and its inductance is half."""
    time, channels = driven(0.002, 5, dwell)
    half = MotorFile("half", Motor(**(TYPICAL | {"L": 0.5 * TYPICAL["L"], "b": 0.0})), PLATE)
    runs = prepare_all([Recording("pulses.csv", time, channels)], half)
    prior = base_prior(half, runs)
    found = estimate(half, runs, prior.only([key for key in prior.keys if key not in ("L", "b")]))
    assert np.std(found.fit.residuals[0][:, 0]) > 5 * NOISE * RATED["current"]
    assert "voltage" not in found.runs[0].spikes
