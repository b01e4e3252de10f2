"""Coloured noise of every sensor: it is found as what it is, and does not bend the motor."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import plain_motor
from helpers.hidden import draw, generate, known
from helpers.plain_motor import RATED, TYPICAL
from scipy.signal import lfilter

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.noise import TORQUE, VOLTAGE
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile, read_motor_file
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
) -> Estimate:
    """A motor of which all sensors are noisy, as shares of rated values; of coloured noise a share `remains` each sample.

    Its magnet has `lost` a share from the middle on; noise is coloured `until` a sample.
    """
    rng = np.random.default_rng(23)
    volts = np.repeat(RATED["voltage"] * rng.uniform(-0.3, 0.3, SAMPLES // 150), 150)
    load = np.repeat(RATED["load_torque"] * rng.uniform(0.0, 0.2, SAMPLES // 150), 150) * np.sign(volts)
    test = plain_motor.Test(PERIOD_S, SAMPLES, 150, True, 0.0)
    states = plain_motor.simulated(motor, volts, load, test)
    weaker = plain_motor.simulated({**motor, "ke": (1 - lost) * motor["ke"]}, volts, load, test)
    states[SAMPLES // 2 :] = weaker[SAMPLES // 2 :]
    shown = dict(zip(CHANNELS, (volts, load, states[:, 0], states[:, 1]), strict=True))
    for channel, y in shown.items():
        drift = lfilter([np.sqrt(1 - remains**2)], [1.0, -remains], rng.standard_normal(SAMPLES))
        drift[until:] = 0.0
        shown[channel] = y + RATED[channel] * (white * rng.standard_normal(SAMPLES) + coloured * drift)
    file = MotorFile("plate", Motor(), PLATE)
    return estimate(file, prepare_all([Recording("drifting", PERIOD_S * np.arange(SAMPLES), shown)], file))


@pytest.mark.fit
def test_coloured_noise_is_found_beside_white_noise_and_the_motor_is_told() -> None:
    motor = {**TYPICAL, "ke": 0.9 * TYPICAL["ke"], "R_a0": 1.15 * TYPICAL["R_a0"], "J": 0.85 * TYPICAL["J"]}
    found = fitted(motor, white=0.005, coloured=0.01, remains=0.96)
    noise = found.runs[0].noise
    assert noise is not None
    # All noise of the voltage, and the two of the speed; a load's and a current's show alike where a motor follows so soon.
    correlated = noise.disturbances[3:]
    voltage_V2 = noise.disturbances[VOLTAGE] + correlated[VOLTAGE]
    assert np.sqrt(voltage_V2) / RATED["voltage"] == pytest.approx(np.hypot(0.005, 0.01), rel=0.25)
    assert np.sqrt(correlated[-1]) / RATED["speed"] == pytest.approx(0.01, rel=0.2)
    assert np.sqrt(noise.channels[-1]) / RATED["speed"] == pytest.approx(0.005, rel=0.2)
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


@pytest.mark.fit
def test_white_noise_is_not_taken_for_coloured() -> None:
    noise = fitted(TYPICAL, white=0.01, coloured=0.0, remains=0.5).runs[0].noise
    assert noise is not None and len(noise.disturbances) == TORQUE + 1


@pytest.mark.fit
@pytest.mark.parametrize(("remains", "is_noise"), [(0.7, True), (0.995, False)])
def test_what_lasts_longer_than_noise_is_none(remains: float, is_noise: bool) -> None:
    """Correlated over 3 samples, and over 200."""
    noise = fitted(TYPICAL, white=0.005, coloured=0.01, remains=remains).runs[0].noise
    assert noise is not None and (len(noise.disturbances) > TORQUE + 1) == is_noise


@pytest.mark.fit
@pytest.mark.parametrize(
    "missing", [{"lost": 0.1}, {"coloured": 0.01, "until": SAMPLES // 8}], ids=["magnet", "spell"]
)
def test_what_the_model_lacks_is_not_taken_for_noise(missing: dict[str, float]) -> None:
    """A magnet weaker by a tenth halfway through, which no motor that stays the same shows; or what comes for a while."""
    noise = fitted(TYPICAL, **{"white": 0.002, "coloured": 0.0, "remains": 0.96, **missing}).runs[0].noise
    assert noise is not None and len(noise.disturbances) == TORQUE + 1


@pytest.mark.fit
def test_coloured_noise_is_told_from_a_torque_that_nobody_measured(tmp_path: Path) -> None:
    """A world of the hidden-effect simulator in which nothing is hidden: its noise keeps 0.95 from sample to sample."""
    drawn = draw("dev", 60, small=True)[49]
    assert (drawn.noise_kind, drawn.channels) == ("coloured", "voltage_current")
    world = generate(replace(drawn, kind="none", hidden=(), seed=3), tmp_path)
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
