"""A load that nobody measured is told as a torque over time, not as a term that happens to be the largest by chance."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.evidence.unmeasured_torque import UnmeasuredTorque
from motorlens_workbench.report.json import sentence, to_json
from motorlens_workbench.verdict import settle

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
PERIOD_S, SAMPLES = 5e-3, 4000


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("seed", [0, 1])
def test_a_load_in_steps_that_nobody_measured(seed: int) -> None:
    rng = np.random.default_rng(seed)
    voltage = np.repeat(rng.uniform(0.2, 1.0, SAMPLES // 100) * RATED["voltage"], 100)
    load = np.repeat(rng.uniform(0.0, 0.6, SAMPLES // 400) * RATED["load_torque"], 400)
    test = plain_motor.Test(PERIOD_S, SAMPLES, 100, True, 0.0)
    states = plain_motor.simulated(TYPICAL, voltage, load, test)
    seen = {
        "voltage": voltage + 0.1 * rng.standard_normal(SAMPLES),
        "current": states[:, 0] + 0.02 * rng.standard_normal(SAMPLES),
        "speed": states[:, 1] + 0.3 * rng.standard_normal(SAMPLES),
    }
    file = MotorFile("plate", replace(Motor(), **TYPICAL), PLATE)
    found = diagnose(file, [Recording("loaded.csv", PERIOD_S * np.arange(SAMPLES), seen)])
    verdict = settle(found)
    assert (verdict.kind, verdict.equation, verdict.chosen) == ("unknown", "mechanical", ())
    assert verdict.torque is not None and verdict.shape is None
    assert "a torque over time" in sentence(found, verdict)
    shown = to_json(found, verdict, None, ["loaded.csv"], "plate.toml")["unknown_shape"]
    assert (shown["term"], shown["against"], shown["unit"]) == ("torque", "time", "N*m")
    # A load brakes; a constant one passes for another motor, friction and constant torque.
    true, told = -np.interp(shown["x"], PERIOD_S * np.arange(SAMPLES), load), np.array(shown["y"])
    assert np.corrcoef(true, told)[0, 1] > 0.95
    assert np.std(told) == pytest.approx(np.std(true), rel=0.2)
    # It is good to what it says, but for the flanks, which are no such noise, and for what a constant may be.
    assert 0.2 < np.std(told - true) / shown["sd"][0] < 2.0


@pytest.mark.fit
@pytest.mark.parametrize("torque", ["constant", "ramp"])
def test_an_offset_is_told_from_a_torque_that_comes_and_goes(torque: str) -> None:
    """Both of 6 mN m, a thousandth of the rated torque: a torque that lasts makes up for all but a little of an offset."""
    rng, share = np.random.default_rng(0), np.arange(SAMPLES) / SAMPLES
    voltage = np.repeat(rng.uniform(-1.0, 1.0, SAMPLES // 100) * RATED["voltage"], 100)
    load = np.repeat(rng.uniform(0.0, 0.6, SAMPLES // 200) * RATED["load_torque"], 200) * np.sign(voltage)
    beside = 6e-3 * (np.ones(SAMPLES) if torque == "constant" else np.sqrt(3) * (2 * share - 1))
    test = plain_motor.Test(PERIOD_S, SAMPLES, 100, True, 0.0)
    states = plain_motor.simulated(TYPICAL, voltage, load + beside, test)
    seen = {
        "voltage": voltage + 0.1 * rng.standard_normal(SAMPLES),
        "current": states[:, 0] + 0.02 * rng.standard_normal(SAMPLES),
        "speed": states[:, 1] + 0.3 * rng.standard_normal(SAMPLES),
        "load_torque": load + 0.01 * rng.standard_normal(SAMPLES),
    }
    file = MotorFile("plate", replace(Motor(), **TYPICAL), PLATE)
    verdict = settle(diagnose(file, [Recording("offset.csv", PERIOD_S * np.arange(SAMPLES), seen)]))
    if torque == "constant":
        assert [set(group) for group in verdict.groups] == [{"load_torque_sensor_offset", "constant_torque"}]
    else:
        assert verdict.kind == "adequate"


@pytest.mark.parametrize(("sd_Nm", "about"), [(3e-4, " about a mean of -0.0015 N*m"), (1e-3, "")])
def test_that_it_hardly_changes_does_not_hide_how_large_it_is(sd_Nm: float, about: str) -> None:
    """The offset of a load's sensor in a blind case; from the least to the most it was less than half of its mean."""
    torque = UnmeasuredTorque("slow.csv", np.arange(3.0), np.array([-0.0018, -0.0015, -0.0012]), sd_Nm, 50.0)
    assert torque.size == f"0.0006 N*m from the least to the most{about} in slow.csv"


@pytest.mark.fit
@pytest.mark.parametrize("loaded", [True, False])
def test_a_small_one_is_said_beside_an_answer_that_nothing_is_missing(loaded: bool) -> None:
    rng = np.random.default_rng(3)
    voltage = np.repeat(rng.uniform(0.2, 1.0, SAMPLES // 100) * RATED["voltage"], 100)
    load = np.where(np.arange(SAMPLES) > SAMPLES // 2, 0.1 * RATED["load_torque"], 0.0) * loaded
    states = plain_motor.simulated(
        TYPICAL, voltage, load, plain_motor.Test(PERIOD_S, SAMPLES, 100, True, 0.0)
    )
    seen = {
        "voltage": voltage + 0.5 * rng.standard_normal(SAMPLES),
        "current": states[:, 0] + 0.3 * rng.standard_normal(SAMPLES),
        "speed": states[:, 1] + 2.0 * rng.standard_normal(SAMPLES),
    }
    file = MotorFile("plate", replace(Motor(), **TYPICAL), PLATE)
    found = diagnose(file, [Recording("loaded.csv", PERIOD_S * np.arange(SAMPLES), seen)])
    verdict = settle(found)
    assert (verdict.kind, verdict.torque) == ("adequate", None)
    assert ("A torque that nobody measured acts on the shaft, " in verdict.beside) == loaded
    assert (verdict.beside in sentence(found, verdict)) and bool(verdict.beside) == loaded
