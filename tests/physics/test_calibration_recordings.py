"""Calibration on real motors: what their owners measured by other means comes out."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.recordings import FOLDER, REGBOT_LEFT, needs_recordings, regbot

from motorlens_physics.effects.brush_voltage_drop import BrushVoltageDrop
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.estimate.calibrate import Calibration, calibrate
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording, read_recording
from motorlens_physics.sensors.gain import SensorGain

pytestmark = [needs_recordings, pytest.mark.fit]

# The speed is that of the wheel, behind a gear.
GEAR = 9.68


def wheel_motor(robot: int) -> Recording:
    recording = read_recording(regbot(robot), REGBOT_LEFT)
    channels = {q: recording.channels[q] for q in ("voltage", "current", "speed")}
    return replace(recording, channels=channels | {"speed": GEAR * channels["speed"]})


@pytest.fixture(scope="module")
def wheels() -> Calibration:
    motor = Motor(
        R_a0=3.5, L=5e-3, ke=0.012, J=2e-6, b=1e-6, k0=0.1, kT=0.0, k_ir=0.0, H=50.0,
        effects=(CoulombFriction(tau_c=1e-3, w_s=1.0), BrushVoltageDrop(V_b=0.1, i_s=0.02)),
    )  # fmt: skip
    # The voltage is commanded, duty times battery, not measured: its scale is known to a few percent.
    file = MotorFile(
        "regbot",
        motor,
        Rated(voltage_V=12.0, current_A=1.0, speed_rad_s=900.0, torque_Nm=0.0105),
        sensors=(SensorGain("voltage"),),
        knowledge={"voltage_sensor_gain.gain": Knowledge(0.05, "battery and bridge")},
    )
    keys = [
        "R_a0",
        "L",
        "ke",
        "J",
        "b",
        "coulomb_friction.tau_c",
        "brush_voltage_drop.V_b",
        "voltage_sensor_gain.gain",
    ]
    return calibrate(file, [wheel_motor(1), wheel_motor(4)], keys, held=True)


def test_the_resistance_of_the_wheel_motors_is_recovered(wheels: Calibration) -> None:
    # Documented 2.4 to 3.3 ohm, with the driver's share on top.
    assert wheels.converged
    assert 2.4 - 2 * wheels.sd["R_a0"] < wheels.value["R_a0"] < 3.3 + 2 * wheels.sd["R_a0"]
    assert 0.01 < wheels.sd["R_a0"] < 0.4


def test_the_constant_of_the_wheel_motors_is_recovered(wheels: Calibration) -> None:
    # Documented 0.0105 V s/rad, known to half of its last digit; the scale of the voltage is the scale of ke.
    assert abs(wheels.value["ke"] - 0.0105) < 2 * wheels.sd["ke"] + 0.00005
    assert wheels.sd["ke"] < 0.001
    assert "voltage_sensor_gain.gain" in wheels.unidentified


def test_friction_and_brushes_are_needed_to_explain_the_wheels(wheels: Calibration) -> None:
    assert wheels.value["coulomb_friction.tau_c"] > 5 * wheels.sd["coulomb_friction.tau_c"]
    assert wheels.value["brush_voltage_drop.V_b"] > 5 * wheels.sd["brush_voltage_drop.V_b"]
    plain = replace(wheels.file, motor=replace(wheels.file.motor, effects=()), sensors=())
    linear = calibrate(plain, [wheel_motor(1)], ["R_a0", "L", "ke", "J", "b"], held=True)
    error = [np.sqrt(np.mean(found.residuals[0]["speed"] ** 2)) / GEAR for found in (linear, wheels)]
    assert error[1] < 0.6 * error[0]


def lab_motor(run: str) -> Recording:
    recording = read_recording(
        FOLDER / "fra233" / f"studyV4_{run}_1.csv.gz", ["voltage=v_V", "speed=w_rad_s"]
    )
    return replace(
        recording,
        time_s=recording.time_s[::4],
        channels={q: recording.channels[q][::4] for q in ("voltage", "speed")},
    )


# Measured by their owners: R 3.40 ohm, L 2.853 mH; fitted with R given: ke 0.048, J 9.9e-6.
LAB = MotorFile(
    "fra233",
    Motor(
        R_a0=3.0, L=2.853e-3, ke=0.04, J=2e-5, b=1e-5, k0=0.1, kT=0.0, k_ir=0.0, H=50.0,
        effects=(CoulombFriction(tau_c=5e-3, w_s=0.5),),
    ),
    Rated(voltage_V=12.0, current_A=1.0, speed_rad_s=240.0, torque_Nm=0.04),
)  # fmt: skip
LAB_KEYS = ["R_a0", "L", "ke", "J", "coulomb_friction.tau_c"]


@pytest.mark.long
def test_voltage_and_speed_alone_tell_ke_and_not_the_resistance() -> None:
    # How each ran between its samples is found. Of every eighth, its delay is half a sample: it passes for inductance.
    runs = [lab_motor("Chirp"), lab_motor("Stair")]
    given = replace(LAB, motor=replace(LAB.motor, R_a0=3.40))
    found = calibrate(given, runs, ["ke", "J", "coulomb_friction.tau_c"])
    assert found.value["ke"] == pytest.approx(0.048, rel=0.06)
    assert found.value["J"] == pytest.approx(9.9e-6, rel=0.2)

    found = calibrate(LAB, runs, LAB_KEYS)
    assert found.converged
    assert found.value["ke"] == pytest.approx(0.048, rel=0.06)
    # Of resistance and inertia the product is known, and each by itself hardly.
    assert abs(found.value["R_a0"] - 3.40) < 2 * found.sd["R_a0"]
    assert found.sd["R_a0"] > 0.3
    assert abs(found.value["L"] - 2.853e-3) < 2 * found.sd["L"]


@pytest.mark.long
def test_a_delay_that_shows_in_few_flanks_is_found_and_does_not_pass_for_inductance() -> None:
    # Half of the stair is rest, and the liveliest piece of the chirp says little of the stair's delay of five samples.
    runs = [read_recording(FOLDER / "fra233" / f"V2_{run}.csv.gz") for run in ("Chirp_1", "Stair_2")]
    rough = replace(LAB, motor=replace(LAB.motor, L=4e-3, ke=0.048, J=1.5e-5, b=5e-5))
    found = calibrate(rough, runs, LAB_KEYS)
    assert found.converged
    late = {delay.recording.split("_")[1]: delay.value_s for delay in found.delays}
    assert late["Stair"] == pytest.approx(0.0025, abs=5e-4)
    for key, owners, sd in (("R_a0", 3.40, 0.05), ("L", 2.85e-3, 1e-4)):
        assert abs(found.value[key] - owners) < 2 * np.hypot(found.sd[key], sd)
    # Stuck on the way, it left 9.7 and 7.3 rad/s.
    assert max(float(np.sqrt(np.mean(one["speed"] ** 2))) for one in found.residuals) < 5.5
