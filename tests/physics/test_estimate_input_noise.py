"""What is rough of a measured input is its sensor's noise, or was at the motor: the errors follow the one, not the other."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from helpers import plain_motor
from helpers.hidden import known
from helpers.plain_motor import RATED, TYPICAL

from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.input_noise import least_noise
from motorlens_physics.estimate.noise import VOLTAGE, Noise
from motorlens_physics.estimate.points import first_point
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile, read_motor_file
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording, read_recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
FILE = MotorFile("plate", replace(Motor(), **TYPICAL), PLATE)
SAMPLES, ROUGH = 4000, {"voltage": 0.5, "load_torque": 0.05}
SENSORS = {"current": 0.02, "speed": 0.1}


def shares(period_s: float, of_sensor: float, seed: int, *, samples: int = SAMPLES) -> np.ndarray:
    """What share is found of inputs of whose roughness this share of the variance is noise of their sensors."""
    rng = np.random.default_rng(seed)
    corners = np.linspace(0, samples, 12)
    smooth = {
        name: np.interp(np.arange(samples), corners, 0.3 * RATED[name] * rng.uniform(-1, 1, 12))
        for name in ROUGH
    }
    applied, seen = {}, {}
    for name, sd in ROUGH.items():
        true, wrong = sd * rng.standard_normal((2, samples))
        applied[name] = smooth[name] + np.sqrt(1 - of_sensor) * true
        seen[name] = applied[name] + np.sqrt(of_sensor) * wrong
    test = plain_motor.Test(period_s, samples, 1, False, 0.0)
    states = plain_motor.simulated(TYPICAL, applied["voltage"], applied["load_torque"], test)
    for k, (name, sd) in enumerate(SENSORS.items()):
        seen[name] = states[:, k] + sd * rng.standard_normal(samples)
    runs = prepare_all([Recording("rough.csv", period_s * np.arange(samples), seen)], FILE)
    (part,) = first_point(start_model(FILE, runs), runs).parts
    least = least_noise(part.frame.model, part.run, 0, part.linear, part.error, part.columns, part.used)
    return least / np.square([*ROUGH.values()])


@pytest.mark.fit
@pytest.mark.parametrize("of_sensor", [0.0, pytest.param(0.5, marks=pytest.mark.long), 1.0])
def test_the_share_of_a_roughness_that_is_noise_is_found(of_sensor: float) -> None:
    np.testing.assert_allclose(
        np.mean([shares(1.0, of_sensor, seed) for seed in range(3)], axis=0), of_sensor, atol=0.1
    )


@pytest.mark.parametrize("of_sensor", [0.0, 0.5, 1.0])
def test_it_is_found_where_the_motor_is_slower_than_the_samples(of_sensor: float) -> None:
    voltage, _ = np.mean([shares(1e-3, of_sensor, seed) for seed in range(3)], axis=0)
    assert voltage == pytest.approx(of_sensor, abs=0.15)


def test_no_more_is_noise_than_the_errors_tell() -> None:
    # In a tenth of a second the inertia hides what a load does from one sample to the next.
    _, load = shares(1e-3, 1.0, 0, samples=100)
    assert load < 0.1


@dataclass(frozen=True)
class Swept:
    """A motor whose voltage sweeps, with noise of every channel, and its estimate."""

    voltage_V: np.ndarray
    found: Estimate

    @property
    def noise(self) -> Noise:
        """As it is found."""
        (run,) = self.found.runs
        assert run.noise is not None
        return run.noise

    def off(self) -> dict[str, float]:
        """Deviations by which parameters and skews end off the truth."""
        fit = self.found.fit
        sd = dict(zip(fit.prior.keys, np.sqrt(np.diagonal(fit.covariance)), strict=True))
        assert (
            sd["L"] < 0.1 * TYPICAL["L"] and sd["ke"] < 0.01 * TYPICAL["ke"] and sd["J"] < 0.01 * TYPICAL["J"]
        )
        true = {key: TYPICAL[key] for key in ("R_a0", "L", "ke", "J")} | {
            key: 0.0 for key in sd if key.startswith("skew.")
        }
        return {key: (fit.model.values()[key] - value) / sd[key] for key, value in true.items()}


def swept(frequencies_Hz: np.ndarray, noise: dict[str, float], seed: int) -> Swept:
    period_s, samples = 1e-2, len(frequencies_Hz)
    voltage = 0.9 * RATED["voltage"] * np.sin(2 * np.pi * period_s * np.cumsum(frequencies_Hz))
    test = plain_motor.Test(period_s, samples, 1, True, 0.0)
    states = plain_motor.simulated(TYPICAL, voltage, np.zeros(samples), test)
    rng = np.random.default_rng(seed)
    true = {"voltage": voltage, "current": states[:, 0], "speed": states[:, 1]}
    seen = {name: y + noise[name] * rng.standard_normal(samples) for name, y in true.items()}
    runs = prepare_all([Recording("swept.csv", period_s * np.arange(samples), seen)], FILE)
    return Swept(voltage, estimate(FILE, runs))


@pytest.mark.fit
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_what_a_smooth_drive_bends_by_is_no_noise(seed: int) -> None:
    volts = 0.5
    end = swept(np.linspace(0.5, 6.0, 4000), {"voltage": volts, "current": 0.3, "speed": 0.5}, seed)
    # Half of the time it bends from one sample to the next by more than its sensor errs.
    assert np.median(np.abs(np.diff(end.voltage_V, 2))) > 3 * np.sqrt(6) * volts
    assert np.sqrt(end.noise.least[0]) < 1.1 * volts
    assert np.sqrt(end.noise.disturbances[0]) == pytest.approx(volts, rel=0.3)
    off = end.off()
    assert max(map(abs, off.values())) < 3, off


@pytest.mark.fit
@pytest.mark.parametrize("volts", [0.05, 0.1])
def test_no_more_of_it_is_noise_where_the_errors_do_not_tell(volts: float) -> None:
    """That of the current hides what the voltage's does to it: it is told by the voltage alone."""
    end = swept(np.geomspace(0.1, 3.0, 2000), {"voltage": volts, "current": 0.6, "speed": 0.5}, seed=0)
    assert np.sqrt(end.noise.disturbances[0]) == pytest.approx(volts, rel=0.2)
    off = end.off()
    assert max(map(abs, off.values())) < 3, off


@pytest.mark.fit
@pytest.mark.parametrize("alike", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_converter_is_as_noisy_in_one_recording_as_in_another(tmp_path: Path, alike: bool) -> None:
    """A slow recording, of another's plant, whose current at rest stays at one reading: alone it says a half of the noise.

    A converter of other steps says nothing of it.
    """
    made = known("dev-3492", tmp_path)
    file = read_motor_file(made.motor)
    fast, slow = (read_recording(path) for path in sorted(made.recordings))
    if not alike:
        # As after a divider that is one hundredth larger.
        slow = replace(slow, channels={**slow.channels, "voltage": 1.01 * slow.channels["voltage"]})
    # Noise and rounding of the samples by which the voltage stands still.
    bent = np.diff(fast.channels["voltage"], 2)
    true_V = float(np.median(np.abs(bent)) / 0.6745 / np.sqrt(6))
    noises = [run.noise for run in estimate(file, prepare_all([fast, slow], file)).runs]
    sd_V = [float(np.sqrt(noise.disturbances[VOLTAGE])) for noise in noises if noise is not None]
    assert sd_V[0] == pytest.approx(true_V, rel=0.1)
    assert (0.75 < sd_V[1] / true_V < 1.1) if alike else (0.3 < sd_V[1] / true_V < 0.65)
