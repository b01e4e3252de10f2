"""Headings: what `infer` writes can be read again, by name and by unit."""

import numpy as np
import pytest

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import speed_of, understand
from motorlens_runtime.files.headings import candidates


def test_the_headings_of_infer_are_understood():
    estimates = ["speed_rad_s", "speed_sd_rad_s", "temperature_rise_K", "temperature_rise_sd_K"]
    estimates += ["resistance_ohm", "resistance_sd_ohm"]
    found = understand(["time_s", *estimates, "quality"], {}, "out.csv")
    assert {quantity: column.heading for quantity, column in found.items()} == {
        "time": "time_s", "speed": "speed_rad_s", "resistance": "resistance_ohm",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("heading", "quantity", "value"),
    [("speed_rpm", "speed", 0.10471975511965977), ("Motor Optical Speed (RPM)", "speed", 0.10471975511965977),
     ("v[mV]", "voltage", 1e-3), ("load_torque_lbf_ft", "load_torque", 1.3558179483314004),
     ("temperature_degF", "temperature", 1 / 1.8)],
)  # fmt: skip
def test_units_of_test_stands(heading, quantity, value):
    assert understand([heading], {}, "f")[quantity].factor == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "heading",
    ["current_limit_A", "motor_current_limit_A", "field_voltage_V", "v_bus_V", "motor_torque_Nm", "case_temp_C",
     "motor_power_W", "v_m_s", "T_L", "speed_ref_rpm", "load", "winding", "encoder_counts", "Phase A", "speed_ref",
     "speed_sd_rad_s", "temperature_rise_K", "min", "Hz", "A", "Current B",
     "counts/s", "field.voltage", "tempo", "par"],
)  # fmt: skip
def test_what_only_resembles_a_quantity_is_none(heading):
    assert understand([heading], {}, "f") == {}


# As drives, test stands, Simulink and spreadsheets name them.
@pytest.mark.parametrize(
    ("headings", "expected"),
    [
        ("time_s motor_voltage_V motor_current_mA motor_speed_rpm winding_temp_C load_Nm",
         {"time": 1, "voltage": 1, "current": 1e-3, "speed": np.pi / 30, "temperature": 1, "load_torque": 1}),
        ("elapsed_s v_term_V armature_current_A measured_speed_rpm T_winding_degC torque_load_mNm room_temp_C",
         {"time": 1, "voltage": 1, "current": 1, "speed": np.pi / 30, "temperature": 1, "load_torque": 1e-3, "ambient": 1}),
        ("t_ms Va Ia wm T_winding T_load(Nm)",
         {"time": 1e-3, "voltage": 1, "current": 1, "speed": 1, "temperature": 1, "load_torque": 1}),
        ("TIME_MS MOTOR_VOLTAGE_MV Vmot_ref_V MotorCurrent_A motor_rpm coil_degC T_amb_C shaft_angle_deg",
         {"time": 1e-3, "voltage": 1e-3, "current": 1, "speed": np.pi / 30, "temperature": 1, "ambient": 1,
          "angle": np.pi / 180}),
        ("sec v_m i_m omega_m theta_deg", {"time": 1, "voltage": 1, "current": 1, "speed": 1, "angle": np.pi / 180}),
        ("timeMs motorVoltageV currentmA leftSpeedRpm motorSpeedRpm windingTempDegC torquemNm currentLimitA",
         {"time": 1e-3, "voltage": 1, "current": 1e-3, "speed": np.pi / 30, "temperature": 1, "load_torque": 1e-3}),
        ("TimeUs voltageV MotorCurrentMA measuredSpeedRadPerSec AngleDeg",
         {"time": 1e-6, "voltage": 1, "current": 1e-3, "speed": 1, "angle": np.pi / 180}),
        ("time_s voltage_meas_V current_actual_A speed_ref_rpm speed_meas_rpm ambient_temp_C",
         {"time": 1, "voltage": 1, "current": 1, "speed": np.pi / 30, "ambient": 1}),
    ],
)  # fmt: skip
def test_where_and_how_it_was_measured_may_stand_beside_the_name(headings, expected):
    found = understand(headings.split(), {}, "f")
    assert {quantity: column.factor for quantity, column in found.items()} == pytest.approx(
        expected, rel=1e-15
    )


def test_a_unit_behind_a_capital_is_proposed_for_its_quantity():
    assert candidates("speed", ["time", "leftSpeedRpm", "leftCommand", "PhaseA"]) == ["leftSpeedRpm"]
    assert candidates("current", ["time", "PhaseA", "loadCurrentmA"]) == ["loadCurrentmA"]


def test_a_symbol_alone_is_proposed_and_not_taken():
    assert candidates("voltage", ["t", "u", "y"]) == ["u"]
    assert candidates("voltage", ["t", "u_a", "y"]) == ["u_a"]
    assert candidates("voltage", ["t", "u", "input_voltage"]) == ["input_voltage"]
    assert candidates("voltage", ["u", "a [mV]", "input_voltage"]) == ["a [mV]"]


def test_of_two_columns_the_one_named_as_usual_is_taken():
    for headings in (["current_A", "I/A"], ["I/A", "current_A"]):
        assert understand(headings, {}, "f")["current"].heading == "current_A"
    with pytest.raises(DataError, match="both look like current"):
        understand(["I/A", "Current, A"], {}, "f")


def test_steps_of_an_encoder_are_no_speed_but_give_one():
    (formula,) = speed_of(["Time (s)", "Speed (steps/s)"])
    assert formula == 'speed="Speed (steps/s)"/1024[counts/rev]'
    assert "speed" not in understand(["Voltage (V)", "Speed (steps/s)"], {}, "f")
    found = understand(["Voltage (V)", "Speed (steps/s)"], {"speed": formula.removeprefix("speed=")}, "f")
    assert "speed" in found


def test_an_unknown_unit_is_said():
    with pytest.raises(DataError, match=r"in the place of UNIT: --column 'speed=\"speed_mph\" \[UNIT\]'"):
        understand(["speed_mph"], {}, "f")
    with pytest.raises(DataError, match="f: column 'speed_mph': unknown unit 'mph' for speed; known: rad/s"):
        understand(["speed_mph"], {}, "f")
