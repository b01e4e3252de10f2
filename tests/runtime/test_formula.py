"""Formulas over columns: numbers worked by hand, and units that do not fit are refused with what to do."""

import numpy as np
import pytest

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.columns import understand
from motorlens_runtime.files.units import name_of, parse

HEADINGS = [
    "time_s", "duty_pct", "vbat_V", "sense_mV", "wheel_velocity_m_s", "tacho_V", "encoder_counts", "n_rpm", "f_Hz", "raw",
    "pwm", "Motor Voltage (V)", "i_A", "wL_rad_s", "F_lbf",
]  # fmt: skip
ROW = [0.1, 50.0, 12.0, 2500.0, 0.6, 0.3, 512.0, 60.0, 10.0, 2148.0, 127.5, 24.0, 2.0, 7.0, 10.0]


def value(quantity: str, formula: str) -> float:
    (column,) = [c for c in understand(HEADINGS, {quantity: formula}, "f").values() if c.heading == formula]
    return float(column.values(lambda index: np.array([ROW[index]]))[0])


@pytest.mark.parametrize(
    ("quantity", "formula", "expected"),
    [
        ("voltage", "duty_pct*vbat_V/100", 6.0),
        ("voltage", "duty_pct*vbat_V", 6.0),  # 50 % of 12 V: the unit says it
        ("voltage", "vbat_V/100*duty_pct", 6.0),
        ("voltage", "pwm/255*vbat_V", 6.0),
        ("voltage", "pwm/255*12[V]", 6.0),
        ("voltage", "sense_mV", 2.5),
        ("voltage", "sense_mV/1000", 2.5),  # the conversion typed out is not applied twice
        ("voltage", "sense_mV*11", 27.5),  # a divider
        ("voltage", "'Motor Voltage (V)'/2", 12.0),
        ("voltage", "Motor Voltage (V)/2", 12.0),
        ("voltage", "vbat_V-i_A*0.5[ohm]", 11.0),
        ("voltage", "-vbat_V", -12.0),
        ("voltage", "(raw-2048)*0.01[V]", 1.0),
        ("voltage", "(raw-2048)*0.01", 1.0),  # nothing has a unit: volts are assumed
        ("voltage_mV", "raw*2", 4.296),
        ("speed", "wheel_velocity_m_s/0.03[m]", 20.0),
        ("speed", "tacho_V/0.01[V*s/rad]", 30.0),
        ("speed", "tacho_V/3[V/krpm]", 10.471975511965978),
        ("speed", "n_rpm/2", 3.141592653589793),
        ("speed", "n_rpm*0.1047198", 6.283185307179586),
        ("speed", "n_rpm*2*pi/60", 6.283185307179586),
        ("speed", "2*pi/60*n_rpm/3", 2.0943951023931953),  # a ratio of gears beside it: nothing was typed twice
        ("speed", "(2*pi/60)*n_rpm", 6.283185307179586),
        ("speed", "raw*pi/180", 37.489672335838325),
        ("speed", "raw[deg/s]", 37.489672335838325),
        ("speed", "raw [deg/s] / 2", 18.744836167919163),
        ("voltage", "raw[mV]+vbat_V", 14.148),
        ("voltage", "sense_mV[mV]", 2.5),
        ("speed", "f_Hz*6.283185307179586[rad/cycle]/5", 12.566370614359172),
        ("speed", "wL_rad_s*9.68", 67.76),
        ("angle", "encoder_counts/1024[counts/rev]", 3.141592653589793),
        ("load_torque", "F_lbf*0.1[m]", 4.4482216152605),
        ("load_torque", "-0.5[N*m]*sin(pwm[deg] + 22.5[deg])", -0.25),  # of 150 degrees
        ("load_torque", "0.5*cos(i_A*30[deg/A])", 0.25),  # of 60 degrees; a number without a unit is in N m
        ("current", "i_A*sign(tacho_V - 1[V])", -2.0),
        ("current", "raw*sign(tacho_V - 0.3[V])", 0.0),
        ("current", "abs(i_A*sign(tacho_V - 1[V]))", 2.0),
    ],
)  # fmt: skip
def test_by_hand(quantity, formula, expected):
    assert value(quantity, formula) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("quantity", "formula", "said"),
    [
        (
            "speed",
            "wheel_velocity_m_s",
            "is in m_s, speed is in rad/s; divide it by the radius, as in --column 'speed=wheel",
        ),
        ("speed", "tacho_V", "speed=tacho_V/0.01[V*s/rad]"),
        ("speed", "encoder_counts", "--column 'angle=encoder_counts/1024[counts/rev]'"),
        ("voltage", "duty_pct", "--column 'voltage=duty_pct*SUPPLY_V/100'"),
        (
            "voltage",
            "duty_pct*12",
            "comes out in 1, voltage is in V; give a column or a constant its unit, as in supply[V]",
        ),
        ("voltage", "vbat_V*vbat_V", "voltage is in V"),
        ("speed", "f_Hz/5", "comes out in cycle/s"),
        # A unit belongs to what stands before it: a number of turns by this would be 39 times as few.
        (
            "angle",
            "raw/512 [rev]",
            "comes out in 1/rad, angle is in rad; give a column or a constant its unit, as in encoder[",
        ),
        ("terminal", "raw*0+3", "terminal has no unit, and no formula; name a column that holds it"),
        ("speed", "wheel_velocity_m_s/0.03", "comes out in m/s"),
        ("voltage", "vbat_V+1", "cannot be added; give a constant its unit, as in 0.5[V]"),
        ("voltage", "vbat_V*", "it ends too early"),
        ("voltage", "(vbat_V*2", "a closing bracket is missing"),
        ("voltage", "2*3", "it holds no column"),
        ("voltage", "vbt_V*2", "did you mean 'vbat_V'?"),
        ("voltage", "vbat_V*2[furlong]", "'furlong' is no unit"),
        ("voltage", "vbat_V[mV]", "the heading 'vbat_V' says another unit"),
        ("voltage", "vbat_V*2)", "')' is not understood"),
        ("voltage", "__import__('os')*2", "no column '__import__'"),
        ("voltage", "vbat_V*sin(i_A)", "sin() is of an angle, and this is in A"),
        ("voltage", "vbat_V*abs(i_A", "a closing bracket is missing"),
        ("voltage", "vbat_V*tan(n_rpm)", "no column 'tan'"),
        ("current_V", "i_A", "unknown unit 'V' for current"),
    ],
)
def test_refused_with_the_cure(quantity, formula, said):
    with pytest.raises(DataError) as caught:
        value(quantity, formula)
    assert said in str(caught.value) and "\n" not in str(caught.value)


def test_a_heading_that_misleads_is_overruled_by_the_unit_on_the_left():
    assert value("speed_rad_s", "tacho_V") == 0.3


def test_small_letters_are_names_and_not_units():
    """`i_m` is the motor's current and `u_s` a supply, not metres and seconds."""
    columns = understand(["t_s", "u_s", "i_m"], {"voltage": "u_s", "current": "i_m"}, "f")
    assert columns["voltage"].factor == columns["current"].factor == 1.0
    assert columns["voltage"].assumed


@pytest.mark.parametrize(
    ("text", "factor", "dimension"),
    [("V*s/rad", 1.0, "V*s/rad"), ("m/s/(rad/s)", 1.0, "m/rad"), ("mV/krpm", 1e-3 / 104.71975511965977, "V*s/rad"),
     ("kg*m^2/s^3/A", 1.0, "V"), ("lbf*ft", 1.3558179483314004, "N*m"), ("1/s", 1.0, "1/s"), ("%", 0.01, "1")],
)  # fmt: skip
def test_units_are_products_and_quotients(text, factor, dimension):
    unit = parse(text)
    assert unit is not None
    assert unit.factor == pytest.approx(factor, rel=1e-12)
    assert name_of(unit.dimension) == dimension
