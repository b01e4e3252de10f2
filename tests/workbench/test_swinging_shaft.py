"""Gravity on an arm that never turns a whole revolution, from an integrator of its own."""

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
@pytest.mark.parametrize("share", [0.0, pytest.param(0.5, marks=pytest.mark.long)])
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


def disc(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(N,) time in s, voltage held at 40 Hz and angle of the disc of github.com/GerbenBeintema/gym-unbalanced-disk.

    Its equation and numbers were found by its owners from the real one; its friction is dry.
    """
    stiffness, damping, dry, gain, period_s, substeps = 11.34**2, 1.333, 6.06, 28.14, 0.025, 25
    rng = np.random.default_rng(seed)
    time_s = period_s * np.arange(1000)
    tones = rng.uniform(0.6, 2.6, 40)
    volts = np.sum(np.cos(2 * np.pi * tones * time_s[:, None] + rng.uniform(0, 2 * np.pi, 40)), axis=1)
    volts *= 0.84 / np.std(volts)
    angle, speed, shown, h = 0.0, 0.0, [0.0], period_s / substeps
    for v in volts[:-1]:
        for _ in range(substeps):
            # Euler's method, the angle with the new speed (semi-implicit).
            rate = -stiffness * np.sin(angle) - damping * speed - dry * np.tanh(speed / 0.05) + gain * v
            speed += h * rate
            angle += h * speed
        shown.append(angle)
    return time_s, volts, np.array(shown)


@pytest.mark.fit
@pytest.mark.long
@pytest.mark.parametrize("torque_Nm", [0.04, 0.101])
def test_gravity_on_a_disc_is_found_where_another_motor_and_timing_make_up_for_it(torque_Nm: float) -> None:
    """Only its angle was measured, and its plate is guessed: what it swings is as heavy as the motor is strong, or less.

    Of the second nothing shows from where the fit without it has ended.
    """
    time_s, volts, angle = disc(seed=2)
    turned = angle + 0.002 * np.random.default_rng(3).standard_normal(len(angle))
    speed = np.append(0.0, np.diff(turned) / np.diff(time_s))
    plate = Rated(voltage_V=24.0, current_A=1.5, speed_rad_s=209.4, torque_Nm=torque_Nm)
    guessed = {
        "R_a0": (5.0, 0.5), "L": (0.016, 0.016), "ke": (0.0788, 0.012), "J": (0.00024, 0.00024), "b": (8.3e-5, 8.3e-5),
        "alpha": (0.004, 0.00012), "k0": (0.183, 0.091), "kT": (0.0029, 0.0029), "k_ir": (8.2e-5, 8.2e-5), "H": (300, 300),
    }  # fmt: skip
    motor = Motor(**{key: value for key, (value, _) in guessed.items()})
    known = {key: Knowledge(sd, "plate") for key, (_, sd) in guessed.items()}
    file = MotorFile("disc", motor, plate, knowledge=known)
    channels = {"voltage": volts, "speed": speed, "angle": turned}
    found = diagnose(file, [Recording("disc", time_s, channels, speed_from_angle=True)])
    verdict = settle(found)
    # Without a temperature nothing tells hysteresis from it, and a Stribeck friction may have little of its own.
    alone, friction = verdict.groups
    assert alone == ("unbalance_torque",)
    assert (
        {"coulomb_friction"}
        < set(friction)
        <= {"coulomb_friction", "hysteresis_iron_loss", "stribeck_friction"}
    )
    values = found.outcome.last.fitted.model.values()
    assert values["unbalance_torque.A"] / values["J"] == pytest.approx(11.34**2, rel=0.03)


def _to_and_fro() -> np.ndarray:
    return np.asarray(4.0 * np.sin(2 * np.pi * 0.5 * PERIOD_S * np.arange(SAMPLES)))
