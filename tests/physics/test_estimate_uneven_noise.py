"""Noise that differs with how hard a motor is driven: it is found as what it is, and what is missing does not hide in it."""

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL

from motorlens_physics.estimate import weighed
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

SAMPLES, PERIOD_S = 6000, 0.1
# A converter of 10 bits over the stall currents of both ways, the noise of the sensor, and the ripple at half the range.
STEP_A, QUIET_A, RIPPLE_A = 0.165, 0.015, 0.2
PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip


def ripple_A(volts: np.ndarray) -> np.ndarray:
    """Half the width of what the current's ripple leaves at any moment, of a converter that chops the rated voltage."""
    duty = np.abs(volts) / RATED["voltage"]
    return RIPPLE_A * 4 * duty * (1 - duty)


def driven(
    seed: int, *, ripple: bool, step_A: float, drag: float = 0.0, calm: int = 0
) -> tuple[Estimate, np.ndarray]:
    """A free motor of which `b` is to be told, in steps of voltage, and what the voltage was.

    Its viscous friction has besides what grows with the voltage, by a share `drag` at the largest. So many `calm` samples
    come before, at levels between those of the steps.
    """
    rng, samples = np.random.default_rng([48, seed]), calm + SAMPLES
    # Every other step is to the end of the converter's range.
    volts = np.repeat(RATED["voltage"] * rng.uniform(0.05, 0.4 if calm else 1.0, samples // 150), 150)
    volts[np.arange(samples) // 150 % 2 == 1] = RATED["voltage"]
    volts[:calm] = RATED["voltage"] * np.repeat(np.linspace(0.6, 0.85, 4), calm // 4)
    test = plain_motor.Test(PERIOD_S, samples, 150, True, 0.0)
    load = drag * TYPICAL["b"] * RATED["speed"] * (volts / RATED["voltage"]) ** 2
    states = plain_motor.simulated(TYPICAL, volts, load, test)
    current = states[:, 0] + QUIET_A * rng.standard_normal(samples)
    if ripple:
        current += ripple_A(volts) * rng.uniform(-1, 1, samples)
    if step_A:
        current = step_A * np.round(current / step_A)
    speed = states[:, 1] + 0.002 * RATED["speed"] * rng.standard_normal(samples)
    recording = Recording(
        "chopped", PERIOD_S * np.arange(samples), {"voltage": volts, "current": current, "speed": speed}
    )
    spread = {key: Knowledge(0.1 * y, "plate") for key, y in TYPICAL.items()}
    file = MotorFile("plate", Motor(**TYPICAL), PLATE, knowledge=spread)
    return estimate(file, prepare_all([recording], file)), volts


@pytest.mark.fit
@pytest.mark.parametrize("calm", [0, 12_000])
def test_a_ripple_is_found_where_it_is(calm: int) -> None:
    """Also at voltages of which the liveliest piece of a long recording has none: those were as quiet as the full one."""
    found, volts = driven(1, ripple=True, step_A=0.0, calm=calm)
    run = found.runs[0]
    assert not run.spikes
    assert run.noise is not None and len(run.noise.edges_V) > 4
    group, sd_A = run.noise.group(run), np.sqrt(run.noise.sensors[0])
    variance = QUIET_A**2 + ripple_A(volts) ** 2 / 3
    for k in range(len(sd_A)):
        assert sd_A[k] == pytest.approx(np.sqrt(variance[group == k].mean()), rel=0.15)
        assert np.ptp(variance[group == k]) < 0.5 * variance.max()
    # The speed is as noisy everywhere.
    speed = np.sqrt(run.noise.sensors[1]) / RATED["speed"]
    assert np.all(np.abs(speed / 0.002 - 1) < 0.2)


@pytest.mark.fit
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_what_a_coarse_converter_shows_is_read_by_the_noise_that_there_is(seed: int, monkeypatch) -> None:
    """At full voltage nothing dithers the current: were it as noisy as on the average, its steps would be friction."""

    def off() -> float:
        found, _ = driven(seed, ripple=True, step_A=STEP_A)
        return abs(found.fit.model.values()["b"] / TYPICAL["b"] - 1)

    assert off() < 0.008
    monkeypatch.setattr(weighed, "uneven", lambda noise, *of: noise)
    assert off() > 0.03


@pytest.mark.fit
@pytest.mark.parametrize("drag", [0.0, 1.0])
def test_noise_that_is_even_or_a_torque_that_is_missing_is_not_taken_for_uneven(drag: float) -> None:
    found, _ = driven(3, ripple=False, step_A=0.0, drag=drag)
    assert found.runs[0].noise is not None and found.runs[0].noise.edges_V.size == 0
