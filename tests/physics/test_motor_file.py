"""Motor files: they round-trip without loss, keep what people wrote, and refuse mistakes in one clear line."""

import tomllib
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import (
    Knowledge,
    MotorFile,
    Stated,
    parse_override,
    read_motor_file,
    to_toml,
    with_overrides,
    write_motor_file,
)
from motorlens_physics.parameter import Rated, parameters
from motorlens_physics.sensor_model import sensor_models
from motorlens_runtime.errors import DataError, ModelError

PAPER = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
TEXT = PAPER.read_text(encoding="utf-8")


def read(text: str, tmp_path: Path) -> MotorFile:
    path = tmp_path / "motor.toml"
    path.write_text(text, encoding="utf-8")
    return read_motor_file(path)


def test_the_papers_motor_is_the_default_motor():
    file = read_motor_file(PAPER)
    assert file.motor == Motor() and file.name == "mellah2016"
    assert file.knowledge["k_ir"].source.startswith("fitted")
    assert file.knowledge["R_a0"] == Knowledge(0.35, "published")


def test_reading_and_writing_changes_no_byte(tmp_path):
    write_motor_file(read_motor_file(PAPER), tmp_path / "copy.toml")
    assert (tmp_path / "copy.toml").read_text(encoding="utf-8") == TEXT


def test_a_change_keeps_comments_order_and_spelling(tmp_path):
    file = read_motor_file(PAPER).with_values(
        {"R_a0": 3.61}, {"R_a0": Knowledge(0.02, "fitted to bench.csv")}
    )
    written, old = to_toml(file).splitlines(), TEXT.splitlines()
    changed = [k for k, (a, b) in enumerate(zip(written, old, strict=True)) if a != b]
    assert len(changed) == 1 and "3.61" in written[changed[0]] and "bench.csv" in written[changed[0]]
    assert "value = 18e3" in to_toml(file)


def test_what_was_stated_before_a_fit_round_trips_and_goes_with_the_next_calibration(tmp_path):
    before = Stated(3.5, 0.35, "published")
    fitted = Knowledge(0.02, "fitted to bench.csv", prior=before)
    again = read(to_toml(read_motor_file(PAPER).with_values({"R_a0": 3.61}, {"R_a0": fitted})), tmp_path)
    assert again.knowledge["R_a0"] == fitted and again.motor.R_a0 == 3.61
    # What was fitted is forgotten beside what was stated, whose width and bounds are its own.
    assert base_prior(again, ()) == base_prior(read_motor_file(PAPER), ())
    changed = again.with_values({}, {"R_a0": Knowledge(0.02, "calibrated on bench.csv")})
    assert "prior" not in tomllib.loads(to_toml(changed))["parameters"]["R_a0"]


def test_effects_and_sensors_are_added_and_removed(tmp_path):
    file = with_overrides(
        read_motor_file(PAPER),
        {"coulomb_friction.tau_c": 0.3, "speed_sensor_gain.gain": 1.02, "two_node_thermal.G_h": 2.0},
    )
    again = read(to_toml(file), tmp_path)
    assert again.motor == file.motor and again.sensors == file.sensors and again.values() == file.values()
    less = replace(again, motor=again.motor.without_effect("coulomb_friction"), sensors=())
    document = tomllib.loads(to_toml(less))
    assert set(document["effects"]) == {"two_node_thermal"} and not document.get("sensors")
    assert read(to_toml(less), tmp_path).motor == less.motor


def test_an_effect_named_for_the_first_time_has_the_shape_of_the_plate():
    file = with_overrides(read_motor_file(PAPER), {"stribeck_friction.tau_s": 0.2})
    stribeck = file.motor.effect("stribeck_friction")
    assert stribeck.tau_s == 0.2 and stribeck.w_k == pytest.approx(0.03 * 221.0)


def test_what_a_file_leaves_open_fits_the_plate(tmp_path):
    file = read(TEXT + "\n[effects.stribeck_friction]\ntau_s = 0.2\n", tmp_path)
    assert file.motor.effect("stribeck_friction") == replace(
        catalogue()["stribeck_friction"].typical(file.rated), tau_s=0.2
    )


@pytest.mark.parametrize("name", [*catalogue(), *sensor_models()])
def test_every_part_of_the_catalogue_round_trips(name, tmp_path):
    file = read_motor_file(PAPER)
    if name in catalogue():
        file = replace(file, motor=file.motor.with_effect(catalogue()[name].typical(file.rated)))
    else:
        file = replace(file, sensors=(sensor_models()[name].typical(file.rated),))
    again = read(to_toml(file), tmp_path)
    assert (again.motor, again.sensors, again.values()) == (file.motor, file.sensors, file.values())
    for key in file.values():
        assert again.meaning(key) == file.meaning(key)


@settings(max_examples=40, deadline=None)
@given(st.data())
@pytest.mark.fit
def test_any_value_within_bounds_round_trips_to_the_last_bit(tmp_path_factory, data):
    values = {
        name: data.draw(st.floats(*p.bounds, allow_nan=False), label=name)
        for name, p in parameters(Motor).items()
    }
    file = read_motor_file(PAPER).with_values(values)
    path = tmp_path_factory.mktemp("m") / "motor.toml"
    write_motor_file(file, path)
    assert read_motor_file(path).motor == file.motor


def test_a_new_file_needs_no_text():
    file = MotorFile("toy", Motor(), Rated(6.0, 0.3, 20.0, 0.05), description="a toy")
    document = tomllib.loads(to_toml(file))
    assert document["schema"] == "motorlens.motor/1" and document["description"] == "a toy"
    assert document["parameters"]["ke"] == {"value": 0.9346, "unit": "V*s/rad"}


MISTAKES = {
    "not TOML": ("schema = ", "not a motor file"),
    "another schema": (
        TEXT.replace("motorlens.motor/1", "motorlens.motor/9"),
        "expected 'motorlens.motor/1'",
    ),
    "a slip of the pen": (TEXT.replace("R_a0 =", "Ra0 ="), "did you mean 'R_a0'?"),
    "a parameter absent": (TEXT.replace("\nH = {", "\n# H = {"), "[parameters] lacks H"),
    "a plate without speed": (TEXT.replace("speed_rad_s", "# speed_rad_s"), "[rated] lacks speed_rad_s"),
    "another unit": (TEXT.replace('"ohm"', '"mohm"'), "R_a0 is in 'mohm', expected 'ohm'"),
    "out of bounds": (TEXT.replace("value = 3.5,", "value = -3.5,"), "R_a0 = -3.5 is outside"),
    "not a number": (TEXT.replace("value = 3.5,", 'value = "3.5",'), "R_a0 has no number"),
    "nan": (TEXT.replace("value = 3.5,", "value = nan,"), "R_a0 has no number"),
    "a prior without a deviation": (
        TEXT.replace("sd = 0.35", "sd = 0.35, prior = { value = 3.5 }"),
        "the prior of R_a0 has no sd",
    ),
    "a prior that is no table": (TEXT.replace("sd = 0.35", "sd = 0.35, prior = 3.5"), "prior is not a table"),
    "a prior out of bounds": (
        TEXT.replace("sd = 0.35", "sd = 0.35, prior = { value = -3.5, sd = 0.1 }"),
        "the prior of R_a0 = -3.5 is outside",
    ),
    "an unknown key of an entry": (TEXT.replace("sd = 0.35", "std = 0.35"), "did you mean 'sd'?"),
    "an unknown effect": (
        TEXT + "\n[effects.colomb_friction]\ntau_c = 0.3\n",
        "did you mean 'coulomb_friction'?",
    ),
    "an unknown parameter of an effect": (
        TEXT + "\n[effects.coulomb_friction]\ntauc = 0.3\n",
        "did you mean 'tau_c'?",
    ),
    "an unknown sensor": (TEXT + "\n[sensors.speed_gain]\ngain = 1.0\n", "did you mean 'speed_sensor_gain'?"),
    "a negative deviation": (TEXT.replace("sd = 0.35", "sd = -0.35"), "sd of R_a0"),
    "a deviation in words": (TEXT.replace("sd = 0.35", 'sd = "10 %"'), "sd of R_a0"),
    "effects that are no tables": (
        TEXT + "\n[effects]\ncoulomb_friction = 0.3\n",
        "coulomb_friction is not a table",
    ),
    "parameters that are no table": ('schema = "motorlens.motor/1"\nparameters = 3\n', "is not a table"),
    "a plate in words": (TEXT.replace("voltage_V = 240.0", 'voltage_V = "240"'), "voltage_V"),
    "a plate of zero": (TEXT.replace("voltage_V = 240.0", "voltage_V = 0.0"), "voltage_V"),
}


def test_a_file_that_is_no_text_is_no_motor_file(tmp_path):
    (tmp_path / "motor.toml").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(ModelError, match=r"motor\.toml: not a motor file"):
        read_motor_file(tmp_path / "motor.toml")


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_refused_with_file_place_and_remedy(mistake, tmp_path):
    text, said = MISTAKES[mistake]
    with pytest.raises(ModelError) as caught:
        read(text, tmp_path)
    assert said in str(caught.value)
    assert "motor.toml" in str(caught.value)


@pytest.mark.parametrize(
    "override, said",
    [("colomb_friction.tau_c=1", "did you mean 'coulomb_friction'?"), ("coulomb_friction.tau=1", "did you mean"),
     ("Ra0=1", "did you mean 'R_a0'?"), ("R_a0=-1", "outside"), ("R_a0", "NAME=NUMBER"), ("R_a0=big", "NAME=NUMBER")],
)  # fmt: skip
def test_overrides_that_make_no_sense(override, said):
    with pytest.raises(DataError, match=r".") as caught:
        key, value = parse_override(override)
        with_overrides(read_motor_file(PAPER), {key: value})
    assert said in str(caught.value)
