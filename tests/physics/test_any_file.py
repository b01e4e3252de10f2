"""One run in the many ways people write it: read as the plain file is, or refused with what to do about it."""

import contextlib
import gc
import gzip
import itertools
import shlex
import struct
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.reading.clock import steady
from motorlens_physics.reading.suspicion import without_sign
from motorlens_physics.recording import Recording, read_recording, under
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.csv_stream import CsvStream
from motorlens_runtime.files.parquet_stream import ParquetStream

N = 400
TIME = 0.001 * np.arange(1, N + 1)
VOLTAGE = np.where(TIME < 0.2, 6.0, 3.25)
SPEED = np.round(100 * (1 - np.exp(-TIME / 0.05)) - 40 * (TIME > 0.2) * (1 - np.exp(-(TIME - 0.2) / 0.05)), 3)
CURRENT = np.round((VOLTAGE - 0.05 * SPEED) / 2, 4)
NAMES = ("time_s", "voltage_V", "current_A", "speed_rad_s")


def text(
    columns: Sequence[np.ndarray] = (TIME, VOLTAGE, CURRENT, SPEED),
    names: Sequence[str] = NAMES,
    mark: str = ",",
    cell: Callable[[float], str] = "{:.7g}".format,
) -> str:
    rows = [mark.join(names)] if names else []
    return "\n".join(rows + [mark.join(map(cell, row)) for row in np.column_stack(columns)]) + "\n"


def comma(x: float) -> str:
    return f"{x:.7g}".replace(".", ",")


def read(
    folder: Path, content: str | bytes, mapping: Sequence[str] = (), name: str = "rec.csv", **more
) -> Recording:
    raw = content.encode() if isinstance(content, str) else content
    (folder / name).write_bytes(raw)
    return read_recording(folder / name, mapping, **more)


PLAIN = text()
WRITTEN: dict[str, str | bytes] = {
    "semicolons and decimal commas": text(mark=";", cell=comma),
    "German words and units": text(
        names=("Zeit [s]", "Spannung [V]", "Strom [A]", "Drehzahl [rad/s]"), mark=";", cell=comma
    ),
    "tabs and decimal commas": text(mark="\t", cell=comma),
    "runs of blanks": text(mark="   "),
    "blanks at both ends": "\n".join(f"  {line}  " for line in text(mark=" ").splitlines()),
    "quoted cells": text(cell=lambda x: f'"{x:.7g}"'),
    "quoted cells with decimal commas": text(cell=lambda x: f'"{comma(x)}"'),
    "blanks after commas": text(mark=", "),
    "a preamble of words": "Test stand 3\nOperator: K. M., shift 2\n\n" + PLAIN,
    "comments above and between": "# logger\n% run 7\n" + PLAIN.replace("\n0.1,", "\n# a mark\n0.1,"),
    "the heading in a comment": "# " + PLAIN,
    "a row of units": PLAIN.replace(",".join(NAMES), "time,voltage,current,speed\ns,V,A,rad/s"),
    "a row of units in brackets": PLAIN.replace(",".join(NAMES), "time,voltage,current,speed\n[s],[V],[A],[rad/s]"),
    "symbols below a row of units": text((1e3 * TIME, VOLTAGE, CURRENT, SPEED), ("time", "voltage", "current", "speed"),
                                         cell="{:.12g}".format).replace("speed\n", "speed\nms,V,A,rad/s\nt,u,i,w\n"),
    "units as headings": text((1e3 * TIME, VOLTAGE, CURRENT, SPEED), ("millisec", "Volt", "Ampere", "rad/s"),
                              cell="{:.12g}".format),
    "separators at the end": PLAIN.replace("\n", ",\n"),
    "Windows line ends": PLAIN.replace("\n", "\r\n"),
    "old Macintosh line ends": PLAIN.replace("\n", "\r"),
    "UTF-16 with a mark": PLAIN.encode("utf-16"),
    "UTF-16 without": PLAIN.encode("utf-16-le"),
    "UTF-8 with a mark": PLAIN.encode("utf-8-sig"),
    "Windows code page": PLAIN.replace("speed_rad_s", "speed_rad_s,temperature (°C)").replace("\n", ",20\n")
    .replace("(°C),20", "(°C)").encode("cp1252"),
    "zipped": gzip.compress(PLAIN.encode()),
    "other units": text((1e6 * TIME, 1e3 * VOLTAGE, 1e3 * CURRENT, SPEED * 30 / np.pi),
                        ("t_us", "voltage_mV", "current_mA", "n_rpm"), cell="{:.12g}".format),
    "name and unit by a stroke": text(names=("t/s", "U / V", "I/A", "n/(rad/s)")),
    "name and unit by a comma": text((1e3 * TIME, VOLTAGE, CURRENT, SPEED * 30 / np.pi),
                                     ("Time, ms", "Motor Voltage, V", "Current, Amps", "Speed, rpm"), ";", "{:.12g}".format),
    "name in unit": text(names=("Zeit t in s", "Spannung U in V", "Strom I in A", "Drehzahl n in rad/s")),
    "units written out": text(names=("Time (sec)", "Voltage (Volts)", "Current (amps)", "Motor Speed (rad/sec)")),
    "capitals": text(names=[name.upper() for name in NAMES]),
    "Chinese": text(names=("时间(s)", "电压(V)", "电流(A)", "转速(rad/s)")),
    "French": text(names=("Temps (s)", "Tension (V)", "Courant (A)", "Vitesse (rad/s)"), mark=";", cell=comma),
    "bars": text(mark="|"),
    "a spreadsheet's separator": "sep=;\n" + text(mark=";"),
    "minus signs of a typesetter": PLAIN.replace("-", "\u2212"),
    "groups of three, German": text((TIME, 1e3 * VOLTAGE, 1e3 * CURRENT, 1e3 * SPEED),
                                    ("time_s", "voltage_mV", "current_mA", "speed_mrad/s"), ";",
                                    lambda x: f"{x:,.4f}".replace(",", "'").replace(".", ",").replace("'", ".")),
    "groups of three by narrow blanks": text((TIME, 1e3 * VOLTAGE, 1e3 * CURRENT, 1e3 * SPEED),
                                             ("time_s", "voltage_mV", "current_mA", "speed_mrad/s"), ";",
                                             lambda x: f"{x:,.4f}".replace(",", "\u202f")),
    "UTF-32": PLAIN.encode("utf-32"),
    "exponents": text(cell="{:.7e}".format),
    "a line cut off": PLAIN + "0.401,3.2",
}  # fmt: skip


@pytest.mark.parametrize("how", WRITTEN)
def test_the_same_run_is_read_however_it_is_written(tmp_path, how):
    recording = read(tmp_path, WRITTEN[how])
    np.testing.assert_allclose(recording.time_s, TIME, rtol=1e-9)
    for quantity, y in (("voltage", VOLTAGE), ("current", CURRENT), ("speed", SPEED)):
        np.testing.assert_allclose(recording.channels[quantity], y, rtol=1e-6, atol=1e-9)


def test_columns_that_are_told_apart_by_their_numbers_alone(tmp_path):
    """As oscilloscopes write two channels; a heading of which most are numbers is one all the same."""
    rows = text((TIME, VOLTAGE, CURRENT), names=())
    scope = "x-axis,1,2\nsecond,Volt,Volt\n" + rows
    for mapping in (["voltage=1 [Volt]", "current=2 [Volt]/0.5[ohm]"], ["voltage=#2", "current=#3/0.5[ohm]"]):
        recording = read(tmp_path, scope, ["time=#1", *mapping])
        np.testing.assert_allclose(recording.channels["voltage"], VOLTAGE, rtol=1e-6)
        np.testing.assert_allclose(recording.channels["current"], 2 * CURRENT, rtol=1e-6, atol=1e-9)
    twice = read(tmp_path, "time_s,u_V,u_V\n" + rows, ["voltage=#2", "current=#3/0.5[ohm]"])
    np.testing.assert_allclose(twice.channels["current"], 2 * CURRENT, rtol=1e-6, atol=1e-9)
    with pytest.raises(DataError, match="no column '#4'"):
        read(tmp_path, scope, ["time=#1", "voltage=#4"])


@pytest.mark.parametrize(
    ("columns", "suggested"),
    [
        ((TIME, VOLTAGE, CURRENT), ["time=#1", "voltage=#2", "current=#3"]),
        ((VOLTAGE, CURRENT, TIME), ["time=#3", "voltage=#1", "current=#2"]),
        ((VOLTAGE, CURRENT), ["time=row*0.001[s]", "voltage=#1", "current=#2"]),
    ],
)
def test_without_headings_the_time_is_a_column_that_rises_or_the_rows_are_counted(
    tmp_path, columns, suggested
):
    """What is suggested, taken at its word, reads the recording."""
    with pytest.raises(DataError, match="no heading line") as refused:
        read(tmp_path, text(columns, names=()))
    words = shlex.split(str(refused.value).partition("for example: ")[2])
    mapping = [word for option, word in itertools.pairwise(words) if option == "--column"]
    assert mapping == suggested
    recording = read(tmp_path, text(columns, names=()), mapping)
    assert np.all(np.diff(recording.time_s) > 0)
    np.testing.assert_allclose(recording.channels["voltage"], VOLTAGE, rtol=1e-6)


def test_a_first_row_with_a_word_in_it_is_no_heading(tmp_path):
    with pytest.raises(DataError, match=r"row 2.*'overload' is not a number"):
        read(tmp_path, text().replace("\n", "\n0,overload,0,0\n", 1))


def test_a_constant_voltage_is_said_with_its_unit(tmp_path):
    recording = read(tmp_path, text((TIME, SPEED), ("time_s", "speed_rad_s")), ["voltage=7.8[V]"])
    assert len(recording) == N and np.all(recording.channels["voltage"] == 7.8)
    np.testing.assert_allclose(recording.channels["speed"], SPEED, rtol=1e-6)


def test_rows_of_a_known_rate_need_no_time(tmp_path):
    """Of a recording and of a stream of one, in blocks: the number of the row goes on."""
    rows = text((VOLTAGE, CURRENT, SPEED), NAMES[1:])
    for column in ("time=0.001[s]*(row+1)", "time=(row+1)/1000", "time_ms=row+1"):
        recording = read(tmp_path, rows, [column])
        np.testing.assert_allclose(recording.time_s, TIME, rtol=1e-9)
        np.testing.assert_allclose(recording.channels["speed"], SPEED, rtol=1e-6)
    constant = read(tmp_path, text((SPEED,), ("speed_rad_s",)), ["time_ms=row", "voltage=7.8[V]"])
    assert len(constant) == N and np.all(constant.channels["voltage"] == 7.8)
    (tmp_path / "many.csv").write_text(NAMES[1] + "," + NAMES[2] + "\n" + "1.5,0.25\n" * 200_000)
    with contextlib.closing(CsvStream(tmp_path / "many.csv", {"time_ms": "row"}, None)) as stream:
        blocks = list(stream)
    assert len(blocks) > 1
    stamps = np.concatenate([block.samples.time_ns for block in blocks])
    np.testing.assert_array_equal(stamps, 1_000_000 * np.arange(200_000))
    with pytest.raises(DataError, match=r"no time column.*'time=row\*0\.001\[s\]'"):
        read(tmp_path, rows)
    with pytest.raises(DataError, match="whole numbers without a unit"):
        read(tmp_path, rows, ["time=row"])
    named = read(
        tmp_path, text((TIME, VOLTAGE, 2 * CURRENT), ("time_s", "voltage_V", "row")), ["current=row/2"]
    )
    np.testing.assert_allclose(named.channels["current"], CURRENT, rtol=1e-6, atol=1e-9)


def test_what_a_heading_says_can_be_refused(tmp_path):
    """A column that is another machine's, whatever it is called."""
    recording = read(tmp_path, text(), ["current=none"])
    assert not recording.has("current") and recording.has("speed")
    assert any(note.startswith("not used: current_A") for note in recording.notes)
    with pytest.raises(DataError, match="no voltage column"):
        read(tmp_path, text(), ["voltage=none"])


def test_a_voltage_is_needed_only_where_it_drives_the_terminals(tmp_path):
    run = text((TIME, CURRENT, SPEED), ("time_s", "current_A", "speed_rad_s"))
    recording = read(tmp_path, run, terminal="current")
    np.testing.assert_allclose(recording.channels["current"], CURRENT, rtol=1e-6, atol=1e-9)
    assert np.all(recording.channels["terminal"] == 3) and not recording.channels["voltage"].any()
    for terminal in (None, "driven"):
        with pytest.raises(DataError, match="no voltage column"):
            read(tmp_path, run, terminal=terminal)


@pytest.mark.parametrize("word", ["n/a", "NaN", "", "NULL", "-", "#N/A"])
def test_words_for_nothing_are_missing_values(tmp_path, word):
    lines = PLAIN.splitlines()
    for at in (11, 57):
        cells = lines[at].split(",")
        lines[at] = ",".join([*cells[:3], word])
    recording = read(tmp_path, "\n".join(lines))
    assert np.flatnonzero(np.isnan(recording.channels["speed"])).tolist() == [10, 56]
    assert any("2 missing values of speed left out" in note for note in recording.notes)


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%dT%H:%M:%S.%f", "%Y-%m-%d %H:%M:%S.%fZ", "%d.%m.%Y %H:%M:%S.%f", "%m/%d/%Y %I:%M:%S.%f %p", "%H:%M:%S.%f",
     "%Y/%m/%d %H:%M:%S.%f"],
)  # fmt: skip
def test_dates_and_times_of_day_are_seconds_since_the_first_also_over_midnight(tmp_path, form):
    begin = datetime(2026, 11, 23, 23, 59, 59, 800_000)
    stamps = [(begin + timedelta(milliseconds=k)).strftime(form) for k in range(N)]
    rows = zip(stamps, VOLTAGE, CURRENT, strict=True)
    # Whatever unit the heading names: what stands in the cells is a moment.
    content = "time [ms];voltage_V;current_A\n" + "\n".join(f"{t};{v:g};{i:g}" for t, v, i in rows)
    np.testing.assert_allclose(read(tmp_path, content).time_s, TIME - TIME[0], atol=1e-6)
    stream = CsvStream(tmp_path / "rec.csv", {})
    np.testing.assert_allclose(
        np.concatenate([b.samples.time_ns for b in stream]) * 1e-9, TIME - TIME[0], atol=1e-6
    )
    stream.close()


def test_moments_in_parquet_are_seconds_since_the_first(tmp_path):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    begin = datetime(2026, 11, 23, 23, 59, 59, 800_000)
    stamps = pa.array([begin + timedelta(milliseconds=k) for k in range(N)], type=pa.timestamp("us"))
    table = pa.table({"timestamp": stamps, "voltage_V": VOLTAGE, "current_A": CURRENT})
    parquet.write_table(table, tmp_path / "rec.parquet")
    np.testing.assert_allclose(read_recording(tmp_path / "rec.parquet").time_s, TIME - TIME[0], atol=1e-6)
    stream = ParquetStream(tmp_path / "rec.parquet", {})
    np.testing.assert_allclose(
        np.concatenate([b.samples.time_ns for b in stream]) * 1e-9, TIME - TIME[0], atol=1e-6
    )
    stream.close()


def test_a_comma_that_may_be_decimal_is_no_group(tmp_path):
    """1,245 among cells with points may be a thousand or one and a quarter: refused, not guessed."""
    with pytest.raises(DataError, match="'1,245' is not a number"):
        read(tmp_path, text(mark=";").replace(";3.25;", ";1,245;", 1))


def test_numbers_beyond_all_that_is_measured_are_left_out(tmp_path):
    current = CURRENT.copy()
    current[[40, 41]] = 1e300, -1e13
    recording = read(tmp_path, text((TIME, VOLTAGE, current, SPEED)))
    assert np.flatnonzero(np.isnan(recording.channels["current"])).tolist() == [40, 41]
    assert any("2 values of current are beyond" in note for note in recording.notes)


@pytest.mark.parametrize("jitter_s", [0.0002, 0.0006])
def test_stamps_that_jitter_give_way_to_the_clock_behind_them(tmp_path, jitter_s):
    late = np.random.default_rng(1).uniform(0, jitter_s * 3, N)
    recording = read(tmp_path, text((TIME + late, VOLTAGE, CURRENT, SPEED)))
    assert len(recording) == N and np.all(np.diff(recording.time_s) > 0)
    if np.any(np.diff(TIME + late) <= 0):
        assert np.ptp(np.diff(recording.time_s)) < 1e-12
        assert recording.period_s == pytest.approx(0.001, rel=0.01)
        assert any("steady clock" in note for note in recording.notes)


def test_coarse_stamps_give_way_to_the_clock_behind_them(tmp_path):
    recording = read(tmp_path, text((np.round(TIME, 2), VOLTAGE, CURRENT, SPEED)))
    np.testing.assert_allclose(recording.time_s, TIME, atol=0.001)


def test_no_steady_clock_is_seen_where_there_is_none():
    rng = np.random.default_rng(2)
    restarted = np.r_[TIME[:200], TIME[:200]]
    lossy = np.delete(np.arange(500), np.s_[100:200]) * 0.001
    assert steady(restarted) is None
    assert steady(rng.permutation(TIME)) is None
    assert steady(np.round(lossy, 2)) is None


def test_a_measured_angle_gives_the_mean_speed_since_the_sample_before_also_where_it_wraps(tmp_path):
    """Of a shaft that turns at one speed from each sample to the next, at uneven steps of time."""
    time = np.cumsum(np.random.default_rng(1).uniform(0.5e-3, 1.5e-3, N)).round(6)
    angle = np.append(0.0, np.cumsum(SPEED[1:] * np.diff(time)))
    columns = (time, VOLTAGE, CURRENT, np.degrees(angle) % 360)
    recording = read(tmp_path, text(columns, (*NAMES[:3], "angle_deg"), cell="{:.9g}".format))
    speed = recording.channels["speed"]
    assert np.isnan(speed[0]) and recording.speed_from_angle
    np.testing.assert_allclose(speed[1:], SPEED[1:], atol=1e-3)
    assert any("from the angle" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("word", "quantity"), [(-9999.0, 2), (-1.0, 2), (65535.0, 3), (0.0, 3), (-9999.0, 1)]
)
def test_a_number_that_means_no_value_is_left_out_and_said(tmp_path, word, quantity):
    columns = [TIME, VOLTAGE, CURRENT, SPEED.copy()]
    columns[quantity] = columns[quantity].copy()
    at = np.arange(30, 390, 33)
    columns[quantity][at] = word
    recording = read(tmp_path, text(columns))
    name = ("time", "voltage", "current", "speed")[quantity]
    assert any(f"{name} is exactly {word:g}" in note for note in recording.notes)
    if name != "voltage":
        assert np.flatnonzero(np.isnan(recording.channels[name])).tolist() == at.tolist()
    else:
        assert len(recording) == N - len(at)
    kept = read(tmp_path, text(columns), no_values=())
    assert np.sum(kept.channels[name] == word) >= len(at)


def test_pulses_and_stops_are_not_taken_for_missing_values(tmp_path):
    """A voltage given in short pulses, and a motor that stands still between them, are what was done."""
    voltage = np.where(np.arange(N) % 40 < 3, 12.0, 0.0)
    speed = np.where(np.arange(N) % 40 < 3, 80.0, 0.0)
    recording = read(tmp_path, text((TIME, voltage, voltage / 4, speed)))
    assert np.isfinite(recording.channels["speed"]).all() and len(recording) == N
    assert not any("no value" in note for note in recording.notes)


def test_rows_without_an_input_are_left_out(tmp_path):
    lines = PLAIN.splitlines()
    for at in range(10, 400, 20):
        cells = lines[at].split(",")
        lines[at] = ",".join([cells[0], "", *cells[2:]])
    recording = read(tmp_path, "\n".join(lines))
    assert len(recording) == N - 20
    assert any("20 rows without a value of voltage left out" in note for note in recording.notes)


REFUSED = {
    "whole stamps without a unit": (text((np.arange(N), VOLTAGE), ("time", "voltage_V")), "--column time_ms=time"),
    "counts": (text((TIME, np.round(VOLTAGE * 77) + np.arange(N) % 50, CURRENT), ("time_s", "voltage", "current")),
               "--column voltage_V=voltage"),
    "no headings": (text(names=()), "no heading line"),
    "decimal commas between commas": (text(cell=comma), "cells where the heading has 4"),
    "duty and supply": (text((TIME, 100 * VOLTAGE / 12, 12 + 0 * TIME), ("time_s", "duty_pct", "vbat_V")),
                        "--column 'voltage=duty_pct*vbat_V/100'"),
    "a clock that was started anew": (text((np.r_[TIME[:200], TIME[:200]], VOLTAGE), NAMES[:2]), "split the file"),
    "half of an input": (text((TIME, np.where(np.arange(N) % 3, np.nan, VOLTAGE)), NAMES[:2]), "fill the column"),
    "binary": (bytes(range(256)) * 4, "not a text file"),
    "a spreadsheet": (b"PK\x03\x04" + bytes(200), "save it as CSV"),
    "many zeros": (bytes(3000) + b"voltage", "not a text file"),
    "a row of other bytes": (PLAIN.encode().replace(b"\n0.1,", b"\n\xff\xfe\x80"), "is not a number"),
    "duty without a supply": (text((TIME, 50 + 0 * TIME), ("time_s", "duty_pct")), "--column 'voltage=duty_pct*24[V]'"),
    "nothing": ("", "empty"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_read_is_refused_in_one_line_with_the_cure(tmp_path, what):
    content, cure = REFUSED[what]
    with pytest.raises(DataError) as caught:
        read(tmp_path, content)
    assert cure in str(caught.value) and "\n" not in str(caught.value)


def test_spoilt_bytes_are_read_or_refused_in_one_line(tmp_path):
    rng = np.random.default_rng(3)
    starts = [how.encode() if isinstance(how, str) else how for how in WRITTEN.values()]
    pieces = [
        b",",
        b";",
        b"\t",
        b"\n",
        b"nan",
        b"-9999",
        b"1e400",
        b'"',
        b"\xff\xfe",
        b"\x00",
        b"#",
        b"[V]",
        b"1,5",
        b"\xb0",
        b"",
    ]
    for _ in range(40):
        data = bytearray(starts[rng.integers(len(starts))][:2000])
        for _ in range(rng.integers(1, 8)):
            at = int(rng.integers(len(data)))
            data[at : at + int(rng.integers(20))] = pieces[rng.integers(len(pieces))]
        try:
            read(tmp_path, bytes(data))
        except DataError as error:
            assert "\n" not in str(error)


@pytest.mark.filterwarnings("error")
@pytest.mark.fit
def test_a_damaged_mdf_file_is_one_line(tmp_path):
    pytest.importorskip("asammdf")
    (tmp_path / "rec.mf4").write_bytes(b"MDF     4.10" + bytes(range(200, 256)) * 5)
    with pytest.raises(DataError, match="not an MDF file"):
        read_recording(tmp_path / "rec.mf4")
    gc.collect()


def test_temperatures_of_no_winding_are_suspected(tmp_path):
    content = text((TIME, VOLTAGE, CURRENT, 1800 + TIME), (*NAMES[:3], "temperature"))
    assert any("counts of a converter" in note for note in read(tmp_path, content).notes)


@pytest.mark.parametrize("duty", ["duty_pct", "PWM (%)", "Tastgrad in %", "pwm", "PWM value"])
@pytest.mark.parametrize("supply", ["vbat_V", "Batt V", "U_bat [V]", "supply", "bus mV"])
def test_duty_times_supply_is_read_as_the_refusal_says(tmp_path, duty, supply):
    full, volts = 100 if "%" in duty or "pct" in duty else 255, 1000 if "mV" in supply else 1
    content = text(
        (TIME, VOLTAGE / 12 * full, 12 * volts + 0 * TIME, SPEED), ("time_s", duty, supply, "speed_rad_s")
    )
    with pytest.raises(DataError) as refused:
        read(tmp_path, content)
    words = shlex.split(
        str(refused.value).partition("; duty times supply is ")[2].replace(";", " ").replace(",", " ")
    )
    assert "--voltage-commanded" in words
    recording = read(tmp_path, content, [words[words.index("--column") + 1]])
    np.testing.assert_allclose(recording.channels["voltage"], VOLTAGE, rtol=1e-5)


def test_where_no_unit_is_given_another_is_said_as_the_note_does(tmp_path):
    plain = text((TIME, VOLTAGE, SPEED), ("time_s", "voltage_V", "my speed"))
    taken = read(tmp_path, plain, ["speed=my speed"])
    (note,) = [note for note in taken.notes if "no unit is given" in note]
    assert "taken as rad/s" in note
    word, option = shlex.split(note)[-2:]
    assert word == "--column"
    other = read(tmp_path, plain, [option])
    assert not any("no unit is given" in note for note in other.notes)
    np.testing.assert_allclose(other.channels["speed"], SPEED * np.pi / 30)


def test_columns_that_were_not_used_are_listed_and_what_they_may_be(tmp_path):
    recording = read(tmp_path, text(names=("time_s", "voltage_V", "iL_A", "wheel_omega_rad_s")))
    assert any(note == "not used: iL_A, wheel_omega_rad_s" for note in recording.notes)
    assert any("--column current=iL_A" in note for note in recording.notes)
    assert any("--column speed=wheel_omega_rad_s" in note for note in recording.notes)


@pytest.mark.parametrize(("sign", "which"), [((1, -1, 1), "current"), ((1, 1, -1), "speed")])
def test_a_reversed_sensor_is_suspected(tmp_path, sign, which):
    columns = (TIME, sign[0] * VOLTAGE, sign[1] * CURRENT, sign[2] * SPEED)
    assert any(f"is the {which} reversed" in note for note in read(tmp_path, text(columns)).notes)
    assert not any("reversed" in note for note in read(tmp_path, PLAIN).notes)


def test_a_current_without_a_sign_is_suspected_where_the_motor_is_driven_backwards():
    time = np.arange(2000) * 0.001
    voltage, current = np.where(time < 1.5, 12.0, -12.0), np.where(time < 1.5, 0.8, -0.7)
    current[:20], current[1500:1520] = 4.0, -7.0
    (note,) = without_sign({"voltage": voltage, "current": np.abs(current)})
    assert "negative in 25% of the samples" in note and "--column 'current=NAME*sign(VOLTAGE)'" in note
    assert not without_sign({"voltage": voltage, "current": current})
    assert not without_sign({"voltage": np.abs(voltage), "current": np.abs(current)})
    # Off while it is driven back, as a bridge of one direction leaves it.
    assert not without_sign({"voltage": voltage, "current": np.maximum(current, 0.0)})


def test_the_voltage_of_a_supply_is_suspected_where_the_motor_stands_still_under_it(tmp_path):
    """Behind a speed controller the voltage stays when the motor is off; at its own terminals it would drive v / R."""
    on = TIME < 0.3
    supply = (TIME, np.where(on, 37.0, 38.0), 20.0 * on, 270.0 * on)
    said = "the voltage stays at 38 V while no current flows"
    recording = read(tmp_path, text(supply))
    assert any(said in note for note in recording.notes)
    # Once that is answered nobody asks again, and the rest is still said.
    tied = under(recording, "current", "turned")
    assert set(recording.notes) - set(tied.notes) == {note for note in recording.notes if said in note}
    assert under(recording, "driven").notes == recording.notes
    # Switched off itself, held by stiction below half of the voltage, or without a current on record: nothing is said.
    for voltage in (np.where(on, 37.0, 0.0), np.where(on, 37.0, 5.0)):
        assert not any(
            "the voltage stays" in note for note in read(tmp_path, text((TIME, voltage, *supply[2:]))).notes
        )
    assert not any("the voltage stays" in note for note in read(tmp_path, PLAIN).notes)


def test_matlab_files_are_read_by_channel(tmp_path):
    io = pytest.importorskip("scipy.io")
    run = {"time_s": TIME, "voltage_V": VOLTAGE, "current_mA": 1000 * CURRENT, "note": "bench 3"}
    io.savemat(tmp_path / "rec.mat", {"run": run, "gain": 3.0, "short": np.arange(7)})
    recording = read_recording(tmp_path / "rec.mat")
    np.testing.assert_allclose(recording.channels["current"], CURRENT)
    assert any("of another length" in note and "short" in note for note in recording.notes)
    (tmp_path / "no.mat").write_bytes(b"MATLAB 7.3 MAT-file nothing")
    with pytest.raises(DataError, match=r"no\.mat"):
        read_recording(tmp_path / "no.mat")
    with pytest.raises(DataError, match=r"gone\.mat: No such file"):
        read_recording(tmp_path / "gone.mat")
    # A row for each channel, as Simulink's "To File" writes them.
    given = {"time": "log_1", "voltage": "log_2 [V]", "current": "log_3 [A]"}
    for log in (np.array([TIME, VOLTAGE, CURRENT]), np.array([TIME, VOLTAGE, CURRENT]).T):
        io.savemat(tmp_path / "log.mat", {"log": log})
        np.testing.assert_allclose(read_recording(tmp_path / "log.mat", given).channels["current"], CURRENT)


def matlab_object(name: bytes, kind: bytes) -> bytes:
    """An object as MATLAB writes it: an opaque array of its class, whose content only MATLAB knows."""

    def element(code: int, data: bytes) -> bytes:
        return struct.pack("<II", code, len(data)) + data + bytes(-len(data) % 8)

    content = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"")
    words = b"".join(element(1, word) for word in (name, b"MCOS", kind))
    hidden = element(14, content + element(6, struct.pack("<I", 0xDD000000)))
    return element(14, element(6, struct.pack("<II", 17, 0)) + words + hidden)


def test_an_object_of_matlab_is_named_with_what_to_do(tmp_path):
    """A timetable, or a log of Simulink, alone and beside vectors."""
    io = pytest.importorskip("scipy.io")
    for name, vectors in (
        ("alone", {}),
        ("beside", {"time_s": TIME, "voltage_V": VOLTAGE, "current_A": CURRENT}),
    ):
        io.savemat(tmp_path / f"{name}.mat", vectors)
        with (tmp_path / f"{name}.mat").open("ab") as file:
            file.write(matlab_object(b"log", b"timetable") + matlab_object(b"speeds", b"timeseries"))
    with pytest.raises(
        DataError, match="holds the timeseries 'speeds', which only MATLAB reads; save its vectors"
    ):
        read_recording(tmp_path / "alone.mat")
    recording = read_recording(tmp_path / "beside.mat")
    np.testing.assert_array_equal(recording.channels["voltage"], VOLTAGE)
    assert "not used, which only MATLAB reads: the timeseries 'speeds'" in recording.notes


@pytest.mark.fit
@pytest.mark.filterwarnings("ignore")
def test_mdf_files_are_read_by_channel(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        fast = [asammdf.Signal(VOLTAGE, TIME, unit="V", name="Motor Voltage"),
                asammdf.Signal(1000 * CURRENT, TIME, unit="mA", name="Current")]  # fmt: skip
        file.append(fast)
        file.append([asammdf.Signal(20.0 + np.arange(4), TIME[::100], unit="degC", name="Temperature")])
        file.save(tmp_path / "rec.mf4")
    recording = read_recording(tmp_path / "rec.mf4")
    np.testing.assert_allclose(recording.time_s, TIME)
    np.testing.assert_allclose(recording.channels["voltage"], VOLTAGE)
    np.testing.assert_allclose(recording.channels["current"], CURRENT)
    temperature = recording.channels["temperature"]
    assert np.flatnonzero(np.isfinite(temperature)).tolist() == [0, 100, 200, 300]
    assert temperature[[0, 300]].tolist() == [20.0, 23.0]


@pytest.mark.parametrize("tau_s", [0.005, 0.08, 1.0])
@pytest.mark.parametrize("turns", ["both ways", "one way"])
def test_stamps_in_another_unit_than_they_say_are_suspected(tmp_path, tau_s, turns):
    # First-order from a staircase of the voltage, exact: tau dw/dt = 2 v - w - friction.
    t = np.arange(4000) * tau_s / 20
    rng = np.random.default_rng(1)
    v = np.repeat(rng.uniform(-10.0 if turns == "both ways" else 3.0, 10.0, 40), 100)
    w = np.zeros(4000)
    for k in range(1, 4000):
        goal = 2 * v[k - 1] - np.sign(v[k - 1])
        w[k] = goal + (w[k - 1] - goal) * np.exp(-1 / 20)
    w += 0.01 * rng.standard_normal(4000)
    for stretch, words in ((1.0, ""), (1e3, "time_ms=NAME"), (1e6, "time_ms=NAME"), (1e-6, "time_s=NAME")):
        table = np.column_stack((stretch * t, v, w))
        path = tmp_path / "run.csv"
        np.savetxt(path, table, delimiter=",", header="time_s,voltage_V,speed_rad_s", comments="")
        told = [note for note in read_recording(path).notes if note.startswith("as stamped")]
        expected = words if not (stretch == 1e3 and tau_s * stretch < 10) else ""
        assert (expected in told[0]) if expected else not told
