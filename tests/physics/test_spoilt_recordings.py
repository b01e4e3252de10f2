"""A real run spoilt in the ways that come up in life: read right, or refused with the cure."""

import numpy as np
import pytest
from helpers.recordings import FOLDER, needs_recordings

from motorlens_physics.recording import read_recording
from motorlens_runtime.errors import DataError


@needs_recordings
def test_milliseconds_stamped_as_seconds_are_suspected_of_a_real_motor(tmp_path):
    lines = (FOLDER / "bad" / "ms.csv").read_text().splitlines()
    path = tmp_path / "run.csv"
    path.write_text("\n".join([lines[0].replace("time_ms", "time_s"), *lines[1:]]))
    assert any("are the stamps in ms" in note for note in read_recording(path).notes)
    assert not any("stamps" in note for note in read_recording(FOLDER / "bad" / "ms.csv").notes)


# What is done to the run of robot 11 in each file of bad/: it reads as the original does ("same"), reads with a word
# about it, or is refused with a cure.
SAME, SAID, NO = "same", "said", "refused"
BAD = {
    "adc": (NO, "--column voltage_V=voltage"), "binary": (NO, "not a text file"), "blank": (SAME, ""),
    "comment": (SAME, ""), "const": (SAID, "current never changes"),
    "counts": (SAME, "'angle=encoder_counts/1024[counts/rev]'"),
    "counts_angle": (SAID, "from the angle"), "crlf": (SAME, ""), "dup_time": (SAME, "steady clock"),
    "duty_pct": (NO, "voltage=duty_pct*vbat_V/100"), "duty_signed": (NO, "voltage=pwm/255*battery_V"),
    "empty": (NO, "empty"), "german": (SAME, ""), "jitter": (SAME, "steady clock"),
    "missing_cells": (SAME, "missing values of speed left out"),
    "missing_rows": (SAID, "49 samples of a steady clock are not there, the first after 0.002 s"),
    "missing_voltage": (SAID, "rows without a value of voltage left out"), "ms": (SAME, ""),
    "ms_wrong": (NO, "--column time_ms=time"), "nan_words": (SAME, "missing values"),
    "noheader": (NO, "no heading line"), "rest": (SAID, "speed never changes"),
    "revsign": (SAID, "is the current reversed"), "semicolon_comma": (SAME, ""), "semicolon_dot": (SAME, ""),
    "sentinel": (SAME, "current is exactly -1"), "sentinel9999": (SAME, "current is exactly -9999"),
    "short": (SAID, ""), "short60": (SAID, ""), "swapped": (SAID, "voltage and current swapped?"), "tab": (SAME, ""),
    "trunc": (SAID, "cut short"), "units_row": (SAME, ""), "us_t": (SAID, ""), "utf16": (SAME, ""),
}  # fmt: skip


@needs_recordings
def test_every_spoilt_recording_has_its_line_here():
    assert {path.stem for path in (FOLDER / "bad").glob("*.csv")} == set(BAD)


@needs_recordings
@pytest.mark.parametrize("name", BAD)
def test_spoilt_recordings_are_read_right_or_refused_with_the_cure(name):
    what, words = BAD[name]
    path = FOLDER / "bad" / f"{name}.csv"
    if what == NO:
        with pytest.raises(DataError) as caught:
            read_recording(path)
        assert words in str(caught.value)
        return
    recording = read_recording(path)
    assert words in " / ".join(recording.notes)
    if what == SAME:
        good = read_recording(FOLDER / "regbot" / "robot_11_L.csv")
        assert np.abs(recording.time_s - good.time_s).max() < 0.002
        for quantity, y in recording.channels.items():
            there = np.isfinite(y)
            assert there.mean() > 0.85
            np.testing.assert_allclose(y[there], good.channels[quantity][there], rtol=2e-3, atol=6e-3)


@needs_recordings
@pytest.mark.parametrize(
    ("name", "formula"), [("duty_pct", "duty_pct*vbat_V/100"), ("duty_signed", "pwm/255*battery_V")]
)
def test_duty_times_supply_is_the_voltage(name, formula):
    good = read_recording(FOLDER / "regbot" / "robot_11_L.csv")
    recording = read_recording(FOLDER / "bad" / f"{name}.csv", [f"voltage={formula}"])
    np.testing.assert_allclose(
        recording.channels["voltage"], good.channels["voltage"], atol=12.15 / 255 / 2 + 1e-3
    )
