"""Recordings: units against hand-converted values, and one clear line for each way a file can be wrong."""

import gzip
from pathlib import Path

import numpy as np
import pytest
from helpers.recordings import FOLDER, REGBOT_LEFT, needs_recordings, regbot

from motorlens_physics.recording import Recording, read_recording, under, write_recording
from motorlens_runtime.errors import DataError

GOOD = "time_s,voltage_V,current_A\n0,1,2\n0.1,3,4\n0.2,5,6\n"


def written(tmp_path: Path, text: str, name: str = "rec.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_canonical_columns_are_read_as_they_stand(tmp_path: Path) -> None:
    recording = read_recording(written(tmp_path, GOOD))
    assert recording.time_s.tolist() == [0.0, 0.1, 0.2]
    assert recording.channels["voltage"].tolist() == [1.0, 3.0, 5.0]
    assert recording.channels["current"].tolist() == [2.0, 4.0, 6.0]
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("heading", "value", "quantity", "expected"),
    [
        # Worked by hand: 60 rpm is 2 pi rad/s; 1 lbf ft is 1.3558 N m (NIST SP 811, B.8); 50 degF is 10 degC.
        ("speed_rpm", 60.0, "speed", 6.283185307179586),
        ("Motor Optical Speed (RPM)", 60.0, "speed", 6.283185307179586),
        ("speed_deg_s", 180.0, "speed", 3.141592653589793),
        ("w[rad/s]", 7.0, "speed", 7.0),
        ("temperature_degF", 50.0, "temperature", 10.0),
        ("temperature_K", 300.0, "temperature", 26.85),
        ("load_torque_lbf_ft", 2.0, "load_torque", 2.7116358966628),
        ("Torque (lbf·ft)", 2.0, "load_torque", 2.7116358966628),
        ("load_torque_mNm", 250.0, "load_torque", 0.25),
        ("current_mA", 1500.0, "current", 1.5),
        ("i[A]", 1.5, "current", 1.5),
        ("angle_deg", 90.0, "angle", 1.5707963267948966),
        ("Ambient (ºF)", 77.0, "ambient", 25.0),
    ],
)
def test_units_are_converted(
    tmp_path: Path, heading: str, value: float, quantity: str, expected: float
) -> None:
    path = written(tmp_path, f"t[s],v[V],{heading}\n0,1,{value}\n1,1,{value}\n")
    recording = read_recording(path)
    np.testing.assert_allclose(recording.channels[quantity], expected, rtol=1e-12)


def test_columns_are_mapped_by_name_and_unit(tmp_path: Path) -> None:
    path = written(tmp_path, "t,u,y\n0,1,180\n0.1,2,360\n")
    recording = read_recording(path, ["voltage=u", "speed_deg_s=y"])
    np.testing.assert_allclose(recording.channels["speed"], [np.pi, 2 * np.pi])
    path.with_name("rec.csv.columns.toml").write_text('[columns]\nvoltage = "u"\nspeed = "y"\n')
    np.testing.assert_allclose(read_recording(path).channels["speed"], [180.0, 360.0])


@pytest.mark.parametrize(
    ("text", "mapping", "said"),
    [
        ("", (), "empty"),
        ("\n\n", (), "empty"),
        ("time_s,voltage_V\n", (), "0 rows"),
        ("time_s,current_A\n0,1\n1,2\n", (), "no voltage column (voltage_V); it has time_s, current_A"),
        ("time_s,voltage_V\n0,1\n1,oops\n", (), "row 3, column 'voltage_V': 'oops' is not a number"),
        ("time_s,voltage_furlong\n0,1\n1,2\n", ("voltage=voltage_furlong",), ""),
        ("time_s,voltage_V,speed_kn\n0,1,1\n1,2,1\n", (), "column 'speed_kn': unknown unit 'kn' for speed"),
        ("time_s,voltage_V\n0,1\n1,nan\n2,nan\n", (), "row 3, column 'voltage_V'"),
        ("time_s,voltage_V\n0,1\nnan,2\n2,3\n", (), "row 3, column 'time_s': time is missing"),
        ("time_s,voltage_V\n0,1\n2,1\n1,1\n", (), "row 4: time does not increase (1 s)"),
        ("time_s,voltage_V\n0,1\n1,1\n1,1\n", (), "row 4: time does not increase"),
        (GOOD, ("speed=wL",), "no column 'wL' for speed"),
        (GOOD, ("current=curent_A",), "did you mean 'current_A'?"),
        (GOOD, ("spede=voltage_V",), "did you mean 'speed'?"),
        (GOOD, ("speed",), "write QUANTITY=COLUMN"),
        ("time_s,voltage_V,speed_rpm,speed_rad_s\n0,1,1,1\n1,1,1,1\n", (), "both look like speed"),
    ],
)
def test_a_bad_file_gets_one_clear_line(
    tmp_path: Path, text: str, mapping: tuple[str, ...], said: str
) -> None:
    path = written(tmp_path, text)
    if not said:  # a mapped column without a known unit is taken in the canonical one, as documented
        assert read_recording(path, mapping).channels["voltage"].tolist() == [1.0, 2.0]
        return
    with pytest.raises(DataError) as caught:
        read_recording(path, mapping)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_binary_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rec.csv"
    path.write_bytes(bytes(range(256)))
    with pytest.raises(DataError, match="not a text file"):
        read_recording(path)


def test_rare_defects_are_repaired_and_reported(tmp_path: Path) -> None:
    rows = [f"{0.01 * k:.2f},{k % 7},{k % 5}" for k in range(1000)]
    rows[300] = "3.00,nan,0"  # 300 % 7 = 6 between 5 and 0: interpolated to 2.5
    rows[500] = "0.50,1,1"
    rows[700] = "7.00,0,"
    recording = read_recording(written(tmp_path, "time_s,voltage_V,current_A\n" + "\n".join(rows)))
    assert len(recording) == 999
    assert recording.channels["voltage"][300] == pytest.approx(2.5)
    assert np.flatnonzero(np.isnan(recording.channels["current"])).tolist() == [699]
    assert len(recording.notes) == 3


def test_lost_samples_are_counted_where_the_clock_is_steady(tmp_path: Path) -> None:
    """Of 400 rows of a clock some are taken out: so many are said. Stamps of no clock at all say nothing."""
    rng = np.random.default_rng(2)
    kept = np.sort(rng.choice(np.arange(1, 399), 350, replace=False))
    kept = np.array([0, *kept, 399])
    late = rng.uniform(-0.03, 0.03, len(kept))
    for time, lost in (
        (kept + late, 48),
        (np.arange(352) + late, 0),
        (np.cumsum(rng.uniform(0.5, 4.0, 352)), 0),
    ):
        rows = "".join(f"{0.01 * t:.6f},{k % 7}.5,{k % 5}.25\n" for k, t in enumerate(time))
        (tmp_path / "r.csv").write_text("time_s,voltage_V,current_A\n" + rows)
        said = [note for note in read_recording(tmp_path / "r.csv").notes if "steady clock" in note]
        assert [note.split()[0] for note in said] == ([str(lost)] if lost else [])


def test_gaps_dead_and_clipped_channels_are_reported(tmp_path: Path) -> None:
    time = np.r_[0:100:0.1, 200:300:0.1]
    current = np.clip(5 * np.sin(time), -4, 4)
    table = np.column_stack([time, time, current, 0 * time])
    lines = "\n".join(",".join(f"{x:.6f}" for x in row) for row in table)
    notes = " / ".join(
        read_recording(written(tmp_path, "time_s,voltage_V,current_A,speed_rpm\n" + lines)).notes
    )
    assert "1 gaps in time, the longest 100 s" in notes
    assert "current stays at its extreme value 4" in notes
    assert "speed never changes" in notes


def test_a_speed_as_coarse_at_its_peak_as_elsewhere_is_not_clipped(tmp_path: Path) -> None:
    """Counts of an encoder at four steady speeds; and the same with noise, cut off below its peaks."""
    rng = np.random.default_rng(5)
    steady = np.repeat([110.3, 40.2, 90.6, 20.4], 200)
    counted = np.round(steady + 0.1 * rng.standard_normal(800))
    clipped = np.minimum(steady + 3 * rng.standard_normal(800), 108.0)
    for speed, said in ((counted, False), (clipped, True)):
        rows = "".join(f"{0.01 * k:.2f},{0.1 * y:.3f},{y:.6f}\n" for k, y in enumerate(speed))
        notes = read_recording(written(tmp_path, "time_s,voltage_V,speed_rad_s\n" + rows)).notes
        assert any("clipped?" in note for note in notes) == said


def test_a_voltage_is_needed_only_where_it_drives_the_terminals(tmp_path) -> None:
    def read(heading: str, row) -> Recording:
        lines = [heading, *(row(k) for k in range(60))]
        (tmp_path / "r.csv").write_text("\n".join(lines) + "\n")
        return read_recording(tmp_path / "r.csv")

    none = read("time_s,current_A,speed_rad_s,terminal", lambda k: f"{k},{1 + k % 3},{k},current")
    assert (none.channels["voltage"] == 0).all() and none.channels["current"][2] == 3
    some = read(
        "time_s,voltage_V,speed_rad_s,terminal", lambda k: f"{k},,{k},open" if k > 20 else f"{k},6,{k},driven"
    )
    assert (some.channels["voltage"] == np.where(np.arange(60) > 20, 0.0, 6.0)).all()
    with pytest.raises(DataError, match="no voltage column, and from row 32 on the terminals are driven"):
        read("time_s,speed_rad_s,terminal", lambda k: f"{k},{k},{'open' if k < 30 else 'driven'}")
    with pytest.raises(DataError, match=r"no voltage column \(voltage_V\)"):
        read("time_s,speed_rad_s", lambda k: f"{k},{k}")


@pytest.mark.parametrize(
    ("volts", "turns", "dead"), [(6.0, True, False), (0.0, True, True), (6.0, False, True)]
)
def test_a_voltage_that_never_changes_is_a_step_where_the_motor_answers(tmp_path, volts, turns, dead) -> None:
    rows = "".join(f"{0.01 * k:.2f},{volts},{k if turns else 0}\n" for k in range(50))
    (tmp_path / "step.csv").write_text("time_s,voltage_V,speed_rad_s\n" + rows)
    notes = read_recording(tmp_path / "step.csv").notes
    assert any("voltage never changes" in note for note in notes) == dead


def test_written_recordings_read_back(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    channels = {
        "voltage": rng.normal(size=50),
        "temperature": 20 + rng.random(50),
        "load_torque": rng.random(50),
    }
    write_recording(Recording("x", 0.5 * np.arange(50), channels), tmp_path / "x.csv")
    back = read_recording(tmp_path / "x.csv")
    for quantity, y in channels.items():
        np.testing.assert_allclose(back.channels[quantity], y, rtol=1e-8)


def test_a_zipped_recording_reads_like_the_plain_one(tmp_path: Path) -> None:
    path = tmp_path / "rec.csv.gz"
    path.write_bytes(gzip.compress(GOOD.encode()))
    assert read_recording(path).channels["voltage"].tolist() == [1.0, 3.0, 5.0]


def test_a_channel_computed_from_the_voltage_is_no_measurement(tmp_path: Path) -> None:
    volts = 3 + 2 * np.sin(np.arange(200) / 7)
    path = tmp_path / "rec.csv"
    for noise, kept in ((0.0, {"voltage", "speed"}), (1e-3, {"voltage", "current", "speed"})):
        amps = 35.15 * volts * (1 + noise * np.cos(np.arange(200)))
        rows = np.column_stack([np.arange(200) / 1000, volts, amps, 10 * volts + np.cos(np.arange(200))])
        np.savetxt(path, rows, "%.9g", ",", header="time_s,voltage_V,current_A,speed_rad_s", comments="")
        recording = read_recording(path)
        assert set(recording.channels) == kept
        assert any("current is 35.15 times the voltage" in note for note in recording.notes) == (not noise)
        # What a drive was told to impose is an input all the same.
        driven = under(recording.part(slice(20, 180)), "current")
        assert set(driven.channels) == {"voltage", "current", "speed", "terminal"}
        assert driven.channels["current"] == pytest.approx(amps[20:180])
        assert not any("times the voltage" in note for note in driven.notes)
        assert set(under(recording, "driven", "turned").channels) == kept | {"terminal", "shaft"}
        # Likewise where a column says so.
        words = path.read_text().splitlines()
        told = [
            f"{words[0]},terminal",
            *(f"{row},{'current' if k > 20 else 'driven'}" for k, row in enumerate(words[1:])),
        ]
        path.write_text("\n".join(told))
        assert set(read_recording(path).channels) == {"voltage", "current", "speed", "terminal"}


@needs_recordings
def test_real_recordings_are_understood() -> None:
    robot = read_recording(regbot(1), REGBOT_LEFT)
    assert len(robot) == 512
    assert robot.period_s == pytest.approx(0.001)
    # Test stand: the second row is stamped before the first, and the headings are in words.
    stand = read_recording(next((FOLDER / "ksu_thermal").glob("Level(Cooled)-KDE-1200*")))
    assert {"voltage", "current", "speed", "load_torque"} <= set(stand.channels)
    assert any("does not increase" in note for note in stand.notes)
    assert 45 < np.median(stand.channels["voltage"]) < 55
    lab = read_recording(FOLDER / "fra233" / "studyV4_Step_1.csv.gz")
    assert set(lab.channels) == {"voltage", "speed"}
