"""A make's file beside that of one of its motors."""

from dataclasses import replace

import numpy as np
import pytest

from motorlens_physics.make import believed, led_away, of_make, of_recordings
from motorlens_physics.motor_file import Knowledge, read_motor_file, with_overrides, write_motor_file
from motorlens_runtime.errors import ModelError


def test_what_the_make_knows_better_is_taken_from_it():
    file = read_motor_file("mellah2016")
    file = replace(
        file, knowledge={**file.knowledge, "L": Knowledge(0.0, "measured"), "J": Knowledge(1e-4, "measured")}
    )
    make = with_overrides(file, {"R_a0": 3.7, "L": 0.03, "J": 0.04, "coulomb_friction.tau_c": 0.2})
    told = {"R_a0": 0.05, "L": 0.001, "J": 0.001, "coulomb_friction.tau_c": 0.03}
    make = replace(
        make, knowledge={**file.knowledge, **{k: Knowledge(sd, "population") for k, sd in told.items()}}
    )
    found = of_make(file, make)
    assert found.values()["R_a0"] == 3.7
    assert found.knowledge["R_a0"] == Knowledge(0.05, "population")
    # What the motor's own file knows exactly, or better, stays.
    assert (found.motor.L, found.motor.J) == (file.motor.L, file.motor.J)
    assert found.knowledge["L"].sd == 0
    assert found.values()["coulomb_friction.tau_c"] == 0.2
    assert found.knowledge["coulomb_friction.tau_c"].sd == 0.03
    assert found.knowledge["k0"] == file.knowledge["k0"]


def known(sd, brief_sd, brief_s):
    file = read_motor_file("mellah2016")
    knowledge = {
        **file.knowledge,
        "ke": Knowledge(sd, "population", brief_sd),
        "L": Knowledge(0.001, "population"),
    }
    return replace(file, knowledge=knowledge, brief_s=brief_s)


def test_a_brief_recording_is_believed_as_the_joint_gaussian_says():
    """The motor's ke, the recording's about it and what was seen of that: the first given the last."""
    sd, away, noise, seen = 0.03, 0.05, 0.02, 0.99
    file = known(sd, away, 0.1)
    before = file.motor.ke
    led = led_away(file, 0.1)
    assert led == {"ke": away}
    wide = of_recordings(file, led)
    assert wide.knowledge["ke"] == Knowledge(np.hypot(sd, away), "population", away)
    assert wide.knowledge["L"] == file.knowledge["L"] and wide.values() == file.values()
    # A fit from what is expected of recordings.
    share = (sd**2 + away**2) / (sd**2 + away**2 + noise**2)
    fitted, left = before + share * (seen - before), noise * share**0.5
    value, found = believed(file, led, {"ke": fitted, "L": 0.03}, {"ke": left, "L": 1e-4})
    covariance = np.array([[sd**2, sd**2], [sd**2, sd**2 + away**2 + noise**2]])
    gain = covariance[0, 1] / covariance[1, 1]
    assert value["ke"] == pytest.approx(before + gain * (seen - before), rel=1e-12)
    assert found["ke"] == pytest.approx(np.sqrt(covariance[0, 0] - gain * covariance[0, 1]), rel=1e-12)
    assert (value["L"], found["L"]) == (0.03, 1e-4)


def test_more_recordings_and_longer_ones_lead_less_far_away():
    file = known(0.03, 0.05, 0.1)
    assert led_away(file, 0.4)["ke"] == pytest.approx(0.025)
    # None leads farther away than one that is as brief as those that were looked at.
    assert led_away(file, 0.01) == led_away(file, 0.1)
    # What is known exactly is not led anywhere, and without a make nothing is.
    assert led_away(known(0.0, 0.05, 0.1), 0.1) == {} == led_away(read_motor_file("mellah2016"), 0.1)


def test_it_comes_with_the_make_and_through_a_file(tmp_path):
    make = known(0.03, 0.05, 0.1)
    assert of_make(read_motor_file("mellah2016"), make).brief_s == 0.1
    assert of_make(read_motor_file("mellah2016"), make).knowledge["ke"] == make.knowledge["ke"]
    write_motor_file(make, tmp_path / "make.toml")
    found = read_motor_file(tmp_path / "make.toml")
    assert (found.brief_s, found.knowledge["ke"]) == (0.1, make.knowledge["ke"])
    # What is known no more is gone.
    write_motor_file(replace(found, brief_s=0.0, knowledge={}), tmp_path / "motor.toml")
    assert "brief" not in (tmp_path / "motor.toml").read_text()
    for line in ("brief_s = -1", "brief_s = 'x'"):
        (tmp_path / "bad.toml").write_text(f"{line}\n" + (tmp_path / "motor.toml").read_text())
        with pytest.raises(ModelError, match=r"brief_s is .*, expected a number in s, 0 or more"):
            read_motor_file(tmp_path / "bad.toml")
