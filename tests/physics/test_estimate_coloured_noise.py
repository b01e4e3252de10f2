"""Coloured noise of every sensor: it is found as what it is, and does not bend the motor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import plain_motor
from helpers.hidden import draw, generate, known
from helpers.plain_motor import RATED, TYPICAL
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from motorlens_physics.estimate import between_samples
from motorlens_physics.estimate.estimate import Estimate, estimate, near, whole
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.noise import TORQUE, VOLTAGE
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile, read_motor_file
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording, read_recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
SAMPLES, PERIOD_S = 6000, 0.1
CHANNELS = ("voltage", "load_torque", "current", "speed")


def fitted(
    motor: dict[str, float],
    white: float,
    coloured: float,
    remains: float,
    lost: float = 0.0,
    until: int = SAMPLES,
    samples: int = SAMPLES,
) -> Estimate:
    """A motor of which all sensors are noisy, as shares of rated values; of coloured noise a share `remains` each sample.

    Its magnet has `lost` a share from the middle on; noise is coloured `until` a sample.
    """
    rng = np.random.default_rng(23)
    volts = np.repeat(RATED["voltage"] * rng.uniform(-0.3, 0.3, samples // 150), 150)
    load = np.repeat(RATED["load_torque"] * rng.uniform(0.0, 0.2, samples // 150), 150) * np.sign(volts)
    test = plain_motor.Test(PERIOD_S, samples, 150, True, 0.0)
    states = plain_motor.simulated(motor, volts, load, test)
    weaker = plain_motor.simulated({**motor, "ke": (1 - lost) * motor["ke"]}, volts, load, test)
    states[samples // 2 :] = weaker[samples // 2 :]
    shown = dict(zip(CHANNELS, (volts, load, states[:, 0], states[:, 1]), strict=True))
    for channel, y in shown.items():
        drift = lfilter([np.sqrt(1 - remains**2)], [1.0, -remains], rng.standard_normal(samples))
        drift[until:] = 0.0
        shown[channel] = y + RATED[channel] * (white * rng.standard_normal(samples) + coloured * drift)
    file = MotorFile("plate", Motor(), PLATE)
    return estimate(file, prepare_all([Recording("drifting", PERIOD_S * np.arange(samples), shown)], file))


@pytest.mark.fit
def test_coloured_noise_is_found_beside_white_noise_and_the_motor_is_told() -> None:
    motor = {**TYPICAL, "ke": 0.9 * TYPICAL["ke"], "R_a0": 1.15 * TYPICAL["R_a0"], "J": 0.85 * TYPICAL["J"]}
    found = fitted(motor, white=0.005, coloured=0.01, remains=0.96, samples=SAMPLES // 2)
    noise = found.runs[0].noise
    assert noise is not None
    # All noise of the voltage, and the two of the speed; a load's and a current's show alike where a motor follows so soon.
    correlated = noise.disturbances[3:]
    voltage_V2 = noise.disturbances[VOLTAGE] + correlated[VOLTAGE]
    assert np.sqrt(voltage_V2) / RATED["voltage"] == pytest.approx(np.hypot(0.005, 0.01), rel=0.25)
    assert np.sqrt(correlated[-1]) / RATED["speed"] == pytest.approx(0.01, rel=0.2)
    assert np.sqrt(noise.of_sensors(found.runs[0])[-1]) / RATED["speed"] == pytest.approx(0.005, rel=0.2)
    lasts = noise.lasts_s[-1] / PERIOD_S
    assert lasts == pytest.approx(-1 / np.log(0.96), rel=0.3)
    # Noise drawn by what was found is as large, and as rough from sample to sample, as what was put in.
    drawn = noise.drawn(found.runs[0], np.random.default_rng(5))[:, VOLTAGE] / RATED["voltage"]
    assert np.std(drawn) == pytest.approx(np.hypot(0.005, 0.01), rel=0.25)
    rough = np.sqrt(2 * (0.005**2 + 0.01**2 * (1 - 0.96)))
    assert np.std(np.diff(drawn)) == pytest.approx(rough, rel=0.25)
    values, sd = found.fit.model.values(), found.fit.sd()
    off = {key: (values[key] - motor[key]) / sd[key] for key in ("R_a0", "ke", "J", "b")}
    assert found.converged and max(map(abs, off.values())) < 3, off
    assert sd["ke"] < 0.01 * motor["ke"]


def drifting(
    volts: np.ndarray, seed: int, held: bool, of_voltage: float
) -> tuple[dict[str, float], MotorFile, tuple[Run, ...]]:
    """A motor up to 30 % from its file, and its recording: at 500 Hz, sensors drift by 0.9 % and are noisy by 0.5 %.

    The voltage's by a share of that.
    """
    rng = np.random.default_rng([41, seed])
    motor, samples = plain_motor.scattered(rng), len(volts)
    states = plain_motor.simulated(
        motor, volts, np.zeros(samples), plain_motor.Test(0.002, samples, 1, held, 0.0)
    )
    shown = {
        "voltage": volts,
        "load_torque": np.zeros(samples),
        "current": states[:, 0],
        "speed": states[:, 1],
    }
    for channel, y in shown.items():
        drift = lfilter([np.sqrt(1 - 0.95**2)], [1.0, -0.95], rng.standard_normal(samples))
        noise = 0.5 * rng.standard_normal(samples) + 0.87 * drift
        shown[channel] = y + 0.01 * RATED[channel] * noise * (of_voltage if channel == "voltage" else 1.0)
    spread = {key: Knowledge(0.3 / np.sqrt(3) * y, "plate") for key, y in TYPICAL.items()}
    file = MotorFile("plate", Motor(**TYPICAL), PLATE, knowledge=spread)
    return motor, file, prepare_all([Recording("driven", 0.002 * np.arange(samples), shown)], file)


def driven(
    volts: np.ndarray, seed: int, *, held: bool = False, of_voltage: float = 1 / 3
) -> tuple[dict[str, float], Estimate]:
    """Such a motor and its estimate; the voltage drifts by a third, as dividers do."""
    motor, file, runs = drifting(volts, seed, held, of_voltage)
    return motor, estimate(file, runs)


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize(("seed", "told"), [(1, 0.03), (2, 0.05)])
def test_the_noise_of_a_voltage_in_ramps_is_told_from_the_current_s(seed: int, told: float) -> None:
    """White noise of the voltage, through the inductance, is much as coloured noise of the current: the voltage shows it."""
    rng = np.random.default_rng(seed)
    begins = np.sort(rng.uniform(1, 11, 4))
    knots = np.concatenate([[0.0], np.ravel([begins, begins + 0.2], order="F"), [13.0]])
    levels = np.repeat(0.8 * RATED["voltage"] * rng.uniform(-1, 1, 5), 2)
    motor, found = driven(np.interp(0.002 * np.arange(SAMPLES), knots, levels), seed)
    value, sd, noise = found.fit.model.values(), found.fit.sd(), found.runs[0].noise
    assert noise is not None and found.converged
    assert np.sqrt(noise.disturbances[VOLTAGE]) == pytest.approx(0.005 / 3 * RATED["voltage"], rel=0.35)
    off = {key: (value[key] - motor[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")}
    assert max(map(abs, off.values())) < 3.5, off
    assert sd["L"] < told * motor["L"]


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("seed", [1, 3])
def test_a_creeping_motor_is_not_told_by_the_noise_of_its_voltage(seed: int) -> None:
    """Coloured noise that is left in a voltage looks as if it moved the motor: at rest it would tell the inertia."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0.0, 15.0, 2.0)
    volts = CubicSpline(knots, 0.06 * RATED["voltage"] * rng.uniform(-1, 1, len(knots)))
    motor, found = driven(volts(0.002 * np.arange(SAMPLES)), seed)
    value, sd = found.fit.model.values(), found.fit.sd()
    off = {key: (value[key] - motor[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")}
    assert max(map(abs, off.values())) < 3.5, off
    assert 0.03 * motor["R_a0"] < sd["R_a0"] < 0.15 * motor["R_a0"]


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize(
    ("seed", "held"),
    [(1, True), (2, True), (2, False)],
)
def test_a_chirp_is_timed_as_it_was_beside_noise_that_lasts(seed: int, held: bool) -> None:
    """Smoothing leaves most of it in the voltage. Where the sensitivities held it too, all seemed to come early."""
    time = 0.002 * np.arange(SAMPLES)
    volts = 0.6 * RATED["voltage"] * np.sin(2 * np.pi * (0.1 * time + 0.25 * time**2))
    motor, found = driven(volts, seed, held=held, of_voltage=1.0)
    value, sd = found.fit.model.values(), found.fit.sd()
    assert found.converged and not found.runs[0].late
    assert max(abs(value[f"skew.{channel}@0"]) for channel in ("current", "speed")) < 0.5 * 0.002
    off = {key: (value[key] - motor[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")}
    assert max(map(abs, off.values())) < 3.5, off
    assert sd["L"] < 0.1 * motor["L"] and sd["ke"] < 0.01 * motor["ke"]


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("seed", [1, 2])
def test_a_sample_and_a_skew_are_one_delay_beside_noise_that_lasts(seed: int) -> None:
    """Where a skew may make up for it, that all is moved by a sample makes a recording no likelier."""
    time = 0.002 * np.arange(SAMPLES)
    volts = 0.6 * RATED["voltage"] * np.sin(2 * np.pi * (0.1 * time + 0.25 * time**2))
    _, file, runs = drifting(volts, seed, held=True, of_voltage=1.0)
    prior = base_prior(file, runs)
    point = whole(near(runs, prior, start_model(file, runs)), start_model(file, runs), runs, prior)
    part = point.parts[0]
    assert len(part.noise.disturbances) > TORQUE + 1
    quiet = between_samples._quiet(part.run, part.noise)
    ends = between_samples._ends(
        point, prior, 0, quiet, point.model.held[0], (-1, 0, 1), mean=False, straight=False
    )
    costs = np.array([ends[late].cost for late in (-1, 0, 1)])
    assert np.ptp(costs) < 30 and np.mean(costs) > 1000


@pytest.mark.fit
def test_white_noise_is_not_taken_for_coloured() -> None:
    noise = fitted(TYPICAL, white=0.01, coloured=0.0, remains=0.5).runs[0].noise
    assert noise is not None and len(noise.disturbances) == TORQUE + 1


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize(("remains", "is_noise"), [(0.7, True), (0.995, False)])
def test_what_lasts_longer_than_noise_is_none(remains: float, is_noise: bool) -> None:
    """Correlated over 3 samples, and over 200."""
    noise = fitted(TYPICAL, white=0.005, coloured=0.01, remains=remains).runs[0].noise
    assert noise is not None and (len(noise.disturbances) > TORQUE + 1) == is_noise


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize(
    "missing",
    [{"lost": 0.1}, {"coloured": 0.01, "until": SAMPLES // 8}],
    ids=["magnet", "spell"],
)
def test_what_the_model_lacks_is_not_taken_for_noise(missing: dict[str, float]) -> None:
    """A magnet weaker by a tenth halfway through, which no motor that stays the same shows; or what comes for a while."""
    noise = fitted(TYPICAL, **{"white": 0.002, "coloured": 0.0, "remains": 0.96, **missing}).runs[0].noise
    assert noise is not None and len(noise.disturbances) == TORQUE + 1


@pytest.mark.fit
@pytest.mark.parametrize(
    ("plan", "case", "seed"),
    [
        pytest.param(60, "dev-0049", 3221405000646549988, marks=pytest.mark.long),
        (2400, "dev-1528", 3),
        (120, "dev-0059", 443656928243061465),
    ],
)
def test_coloured_noise_is_told_from_a_torque_that_nobody_measured(
    plan: int, case: str, seed: int, tmp_path: Path
) -> None:
    """Worlds of the hidden-effect simulator in which nothing is hidden: noise keeps 0.95 from sample to sample.

    Of the second, 60 samples are likelier than the usual 30, and what noise does likelier still; of the third, they seem to
    be where the noise of only one of two durations has converged.
    """
    drawn = next(one for one in draw("dev", plan, small=True) if one.id == case)
    assert (drawn.noise_kind, drawn.channels) == ("coloured", "voltage_current")
    world = generate(replace(drawn, kind="none", hidden=(), seed=seed), tmp_path)
    file = read_motor_file(world.motor)
    run = estimate(file, prepare_all([read_recording(world.recordings[0])], file)).runs[0]
    assert run.noise is not None and len(run.noise.disturbances) > TORQUE + 1
    assert run.noise.lasts_s[-1] / run.period_s == pytest.approx(-1 / np.log(0.95), rel=0.4)


@pytest.mark.fit
def test_what_leaves_more_than_white_noise_is_none(tmp_path: Path) -> None:
    """A shaft with backlash: its errors last as long as noise does, but are no autoregression."""
    world = known("dev-0061", tmp_path)
    assert [hidden["name"] for hidden in world.truth["hidden"]] == ["shaft_backlash"]
    file = read_motor_file(world.motor)
    noise = estimate(file, prepare_all([read_recording(world.recordings[0])], file)).runs[0].noise
    assert noise is not None and len(noise.disturbances) == TORQUE + 1
