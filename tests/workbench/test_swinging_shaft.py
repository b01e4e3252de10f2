"""Gravity on an arm that never turns a whole revolution, from an integrator of its own."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.plain_motor import RATED, TYPICAL

from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_workbench.diagnose import diagnose
from motorlens_workbench.verdict import settle

PERIOD_S, SAMPLES, SUBSTEPS = 0.005, 3000, 10
PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip


def swung(gravity_Nm: float, phase: float, volts: np.ndarray) -> np.ndarray:
    """(N, 3) current, speed and angle of the textbook's motor, cold, with gravity: classical Runge-Kutta, held voltages."""
    R, L, ke, J, b = (TYPICAL[key] for key in ("R_a0", "L", "ke", "J", "b"))

    def rates(x: np.ndarray, v: float) -> np.ndarray:
        i, w, angle = x
        return np.array(
            [(v - R * i - ke * w) / L, (ke * i - b * w - gravity_Nm * np.sin(angle + phase)) / J, w]
        )

    # It hangs.
    states, h = [np.array([0.0, 0.0, -phase])], PERIOD_S / SUBSTEPS
    for v in volts[:-1]:
        x = states[-1]
        for _ in range(SUBSTEPS):
            k1 = rates(x, v)
            k2 = rates(x + h / 2 * k1, v)
            k3 = rates(x + h / 2 * k2, v)
            x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + rates(x + h * k3, v))
        states.append(x)
    return np.array(states)


@pytest.mark.fit
@pytest.mark.parametrize("share", [0.0, 0.5])
def test_gravity_on_an_arm_is_told_where_its_angle_is_measured(share: float) -> None:
    """As large as a share of the rated torque; without any, nothing is missing."""
    rng = np.random.default_rng(4)
    gravity_Nm = share * RATED["load_torque"]
    volts = np.repeat(rng.uniform(-9, 9, SAMPLES // 100), 100) if share else _to_and_fro()
    current, speed, angle = swung(gravity_Nm, 0.3, volts).T
    assert np.pi / 2 < np.ptp(angle) < 2 * np.pi
    noise = rng.standard_normal((4, SAMPLES))
    channels = {
        "voltage": volts + 0.02 * noise[0], "current": current + 0.02 * noise[1], "speed": speed + 0.05 * noise[2],
        "angle": angle + 0.002 * noise[3],
    }  # fmt: skip
    known = {key: Knowledge(0.1 * TYPICAL[key], "plate") for key in TYPICAL}
    file = MotorFile("arm", Motor(**TYPICAL), PLATE, knowledge=known)
    found = diagnose(file, [Recording("arm", PERIOD_S * np.arange(SAMPLES), channels)])
    verdict = settle(found)
    if not share:
        assert verdict.kind == "adequate"
        return
    assert verdict.kind == "named" and list(verdict.chosen) == ["unbalance_torque"]
    fitted = found.outcome.last.fitted
    values = fitted.model.values()
    assert values["unbalance_torque.A"] == pytest.approx(gravity_Nm, rel=0.03)
    assert values["unbalance_torque.p"] == pytest.approx(0.3, abs=0.02)


@pytest.mark.fit
def test_gravity_on_a_pendulum_is_found_where_a_wrong_motor_makes_up_for_it() -> None:
    """Only its angle was measured, and its plate tells little: another motor, with another timing, swings as it does."""
    rng = np.random.default_rng(6)
    gravity_Nm = 1.2 * RATED["load_torque"]
    volts = np.repeat(rng.uniform(-24, 24, SAMPLES // 100), 100)
    angle = swung(gravity_Nm, 0.0, volts)[:, 2]
    assert np.pi / 2 < np.ptp(angle) < 2 * np.pi
    taken = slice(None, None, 5)
    channels = {"voltage": volts[taken], "angle": (angle + 0.002 * rng.standard_normal(SAMPLES))[taken]}
    known = {key: Knowledge((1.0 if key in ("L", "J", "b") else 0.1) * TYPICAL[key], "plate") for key in TYPICAL}
    file = MotorFile("pendulum", replace(Motor(**TYPICAL), J=0.5 * TYPICAL["J"]), PLATE, knowledge=known)
    found = diagnose(file, [Recording("pendulum", PERIOD_S * np.arange(SAMPLES)[taken], channels)])
    verdict = settle(found)
    print(verdict.kind, verdict.chosen, found.outcome.last.fitted.model.values())
    assert "unbalance_torque" in verdict.chosen


def _to_and_fro() -> np.ndarray:
    return np.asarray(4.0 * np.sin(2 * np.pi * 0.5 * PERIOD_S * np.arange(SAMPLES)))
