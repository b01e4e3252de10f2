"""What a motor's terminals and shaft are tied to counts in fits; recordings follow closed forms from sample to sample."""

import numpy as np
import pytest

from motorlens_physics.conditions import Shaft, Terminal
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare, prepare_all
from motorlens_physics.estimate.report import findings
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording, under
from motorlens_runtime.errors import DataError

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
ROWS, PERIOD_S = 3000, 1e-3


def held(rng: np.random.Generator, low: float, high: float) -> np.ndarray:
    return np.repeat(rng.uniform(low, high, ROWS // 100), 100)


def lag(keep: float, driven: np.ndarray) -> np.ndarray:
    """y' = keep y + (1 - keep) driven, from 0."""
    y = np.zeros(len(driven))
    for k in range(len(driven) - 1):
        y[k + 1] = keep * y[k] + (1 - keep) * driven[k]
    return y


@pytest.mark.fit
def test_a_locked_shaft_tells_resistance_and_inductance_and_nothing_of_the_shaft() -> None:
    truth, rng = Motor(R_a0=4.1, L=0.05, alpha=0.0, H=1e9), np.random.default_rng(0)
    volts, time = held(rng, -25.0, 25.0), np.arange(ROWS) * PERIOD_S
    current = lag(np.exp(-PERIOD_S * truth.R_a0 / truth.L), volts / truth.R_a0) + 0.02 * rng.standard_normal(
        ROWS
    )
    recording = Recording("locked", time, {"voltage": volts, "current": current, "speed": np.zeros(ROWS)})
    file = MotorFile("plate", Motor(alpha=0.0, H=1e9), PLATE)
    found = estimate(file, prepare_all([under(recording, shaft="locked")], file))
    sd, values = found.fit.sd(), found.fit.model.values()
    for key, true in (("R_a0", truth.R_a0), ("L", truth.L)):
        assert abs(values[key] - true) < 3 * sd[key] and sd[key] < 0.01 * true
    assert {"ke", "J", "b"} <= set(findings(found.fit).untold)


@pytest.mark.fit
def test_an_imposed_current_is_an_input_and_tells_the_shaft() -> None:
    truth, rng = Motor(ke=0.8, J=0.04, b=0.02), np.random.default_rng(1)
    current, load, time = held(rng, -8.0, 8.0), held(rng, 0.0, 1.0), np.arange(ROWS) * PERIOD_S
    speed = lag(np.exp(-PERIOD_S * truth.b / truth.J), (truth.ke * current - load) / truth.b)
    channels = {
        "voltage": np.zeros(ROWS), "load_torque": load, "current": current,
        "speed": speed + 0.05 * rng.standard_normal(ROWS),
    }  # fmt: skip
    file = MotorFile("plate", Motor(), PLATE)
    runs = prepare_all([under(Recording("drive", time, channels), terminal="current")], file)
    assert runs[0].channels == ("speed",) and runs[0].imposed == ("current",)
    found = estimate(file, runs, held=True)
    sd, values = found.fit.sd(), found.fit.model.values()
    for key, true in (("ke", truth.ke), ("J", truth.J), ("b", truth.b)):
        assert abs(values[key] - true) < 3 * sd[key] and sd[key] < 0.03 * true
    assert {"R_a0", "L"} <= set(findings(found.fit).untold)


def test_a_channel_is_no_output_while_it_is_imposed() -> None:
    time, one = np.arange(200) * PERIOD_S, np.linspace(0.0, 1.0, 200)
    tied = np.where(time < 0.05, Shaft.TURNED, Shaft.FREE).astype(float)
    channels = {"voltage": one, "current": one, "speed": 100 * one, "shaft": tied}
    file = MotorFile("plate", Motor(), PLATE)
    run = prepare(Recording("turned", time, channels), file)
    assert run.channels == ("current", "speed") and not run.imposed
    assert run.there[:, 0].all() and np.array_equal(run.there[:, 1], tied == Shaft.FREE)
    assert run.inputs.shaft is not None and run.inputs.speed_rad_s is not None
    alone = Recording(
        "alone", time, {"voltage": one, "current": one, "terminal": np.full(200, float(Terminal.CURRENT))}
    )
    with pytest.raises(DataError, match="while nothing imposes it"):
        prepare(alone, file)
