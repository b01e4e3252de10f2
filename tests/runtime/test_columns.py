"""Headings: what `infer` writes can be read again, by name and by unit."""

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
    ["current_limit_A", "Phase A", "speed_ref", "speed_sd_rad_s", "temperature_rise_K", "min", "Hz", "A", "Current B",
     "counts/s", "field.voltage", "tempo", "par"],
)  # fmt: skip
def test_what_only_resembles_a_quantity_is_none(heading):
    assert understand([heading], {}, "f") == {}


def test_a_symbol_alone_is_proposed_and_not_taken():
    assert candidates("voltage", ["t", "u", "y"]) == ["u"]
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
