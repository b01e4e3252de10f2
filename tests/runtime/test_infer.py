"""`motorlens infer` as a user meets it: what comes out, and one clear line for each way in which a file can be wrong."""

import csv
import gzip
import json
import os
import re
import subprocess
import sys

import numpy as np
import pytest
from helpers.processes import Program
from helpers.recordings import needs_recordings, regbot
from helpers.sensor_files import features_by_loop, write_sensor

from motorlens_runtime.cli import main

pytestmark = pytest.mark.usefixtures("engine")


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx")
    return tmp_path


def rows_of(n=300, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([np.arange(n) / 1000, 100 + rng.normal(size=n), 8 + rng.normal(size=n)])


def write(path, rows, heading="time_s,voltage_V,current_A", separator=","):
    lines = [separator.join("" if np.isnan(x) else repr(float(x)) for x in row) for row in rows]
    path.write_text("\n".join([heading, *lines]) + "\n")


def infer(*arguments):
    return main(["infer", *map(str, arguments), "--sensor", "s.onnx", "-o", "out.csv"])


def read(path="out.csv"):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_every_row_has_the_estimate_of_the_slow_reading(here):
    spec, network = write_sensor("s.onnx")
    rows = rows_of()
    write(here / "rec.csv", rows)
    assert infer("rec.csv", "--json", "summary.json") == 0
    result = read()
    values, sigma = network(features_by_loop(spec, *rows.T))
    names = ["speed_rad_s", "temperature_rise_K", "resistance_ohm"]
    sd_names = ["speed_sd_rad_s", "temperature_rise_sd_K", "resistance_sd_ohm"]
    for column, output in enumerate(spec["outputs"]):
        assert np.abs(result[names[column]] - values[:, column]).max() < 2e-5 * output["scale"]
        assert np.abs(result[sd_names[column]] - sigma[:, column]).max() < 2e-5 * output["scale"]
    assert np.array_equal(result["time_s"], rows[:, 0])
    summary = json.loads((here / "summary.json").read_text())
    assert summary["rows"] == 300 and summary["period_s"] == 0.001
    assert summary["quality"] == {"assumed_cold": 300, "warm_up": 50}


def test_other_headings_separators_units_and_compression_give_the_same(here):
    rows = rows_of()
    write(here / "a.csv", rows)
    infer("a.csv")
    expected = (here / "out.csv").read_bytes()
    write(here / "b.csv", rows, "t[s];Voltage (V);i[A]", ";")
    write(
        here / "c.csv",
        np.column_stack([rows[:, 0], rows[:, 0], rows[:, 1:]]),
        "time_s\tnote\tu\tcurrent_A",
        "\t",
    )
    with gzip.open(here / "d.csv.gz", "wb") as file:
        file.write((here / "a.csv").read_bytes().replace(b"\n", b"\r\n"))
    text = (here / "a.csv").read_text().splitlines()
    (here / "e.csv").write_text(
        "\n".join([text[0] + ",remark", *(f'{line},"hot, really"' for line in text[1:])])
    )
    for arguments in (["b.csv"], ["c.csv", "--column", "voltage=u"], ["d.csv.gz"], ["e.csv"]):
        assert infer(*arguments) == 0
        assert (here / "out.csv").read_bytes() == expected, arguments


def test_parquet_holds_the_same_numbers(here):
    parquet = pytest.importorskip("pyarrow.parquet")
    write(here / "rec.csv", rows_of(5000))
    infer("rec.csv")
    assert main(["infer", "rec.csv", "--sensor", "s.onnx", "-o", "out.parquet"]) == 0
    table = parquet.read_table("out.parquet")
    for name, column in read().items():
        np.testing.assert_allclose(column, table[name].to_numpy(), rtol=5.1e-9, err_msg=name)  # nine digits


def test_a_parquet_recording_gives_what_its_csv_gives(here, capsys):
    """Whole numbers, single precision, nulls and columns that nobody uses among them."""
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = rows_of(5000).astype(np.float32).astype(float)
    rows[:, 0] = np.arange(5000)
    rows[70, 1] = rows[4000, 2] = np.nan
    write(here / "rec.csv", rows, "time_ms,voltage_V,current_A")
    missing = np.isnan(rows)
    table = pa.table(
        {
            "remark": ["hot"] * 5000, "time_ms": pa.array(rows[:, 0].astype(np.int32)),
            "voltage_V": pa.array(rows[:, 1].astype(np.float32), mask=missing[:, 1]), "current_A": pa.array(rows[:, 2]),
        }
    )  # fmt: skip
    parquet.write_table(table, "rec.parquet", row_group_size=777)
    assert infer("rec.csv") == 1
    expected = (here / "out.csv").read_bytes()
    said = capsys.readouterr().err
    assert "rec.csv: row 72: no number" in said
    assert infer("rec.parquet") == 1
    assert (here / "out.csv").read_bytes() == expected
    assert capsys.readouterr().err == said.replace("rec.csv: row 72", "rec.parquet: row 71")


def test_a_wrong_parquet_file_is_one_clear_line(here, capsys):
    pa, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {"time_s": np.arange(300) / 1e3, "voltage_V": np.full(300, 9.0), "current_A": np.full(300, 1.0)}
    for change, message in (
        ({"current_A": ["1 A"] * 300}, "column 'current_A' holds string, not numbers"),
        ({"time_s": -columns["time_s"]}, "row 2, column 'time_s': time runs backwards"),
        ({"current_A": None}, "no current column"),
    ):
        changed = {name: values for name, values in (columns | change).items() if values is not None}
        parquet.write_table(pa.table(changed), "rec.parquet")
        assert infer("rec.parquet") == 1
        said = capsys.readouterr().err
        assert message in said and said.count("\n") == 1, said
    parquet.write_table(pa.table(columns), "rec.parquet")
    (here / "rec.parquet").write_bytes((here / "rec.parquet").read_bytes()[:-20])
    assert infer("rec.parquet") == 1
    said = capsys.readouterr().err
    assert "rec.parquet: not a whole Parquet file" in said and said.count("\n") == 1
    assert not (here / "out.csv").exists()


def test_cells_without_a_number_are_bridged_flagged_and_said(here, capsys):
    rows = rows_of()
    rows[100, 1] = rows[200, 2] = np.nan
    write(here / "rec.csv", rows)
    (here / "rec.csv").write_text((here / "rec.csv").read_text().replace("0.1,,", "0.1,NaN,"))
    assert infer("rec.csv", "--json", "summary.json") == 1
    error = capsys.readouterr().err
    assert "rec.csv: row 102: no number for voltage or current; 2 of " in error and error.count("\n") == 1
    result = read()
    assert np.isfinite(np.concatenate(list(result.values()))).all()
    assert np.flatnonzero(result["quality"].astype(int) & 32).tolist() == [100, 200]
    assert json.loads((here / "summary.json").read_text())["quality"]["not_finite"] == 2


def test_repeated_time_and_a_cut_last_line_are_said(here, capsys):
    rows = rows_of()
    rows[50, 0] = rows[49, 0]
    write(here / "rec.csv", rows)
    with (here / "rec.csv").open("a") as file:
        file.write("0.3,10")
    assert infer("rec.csv") == 0
    error = capsys.readouterr().err
    assert "1 rows repeat the time" in error and "row 302 is cut short" in error
    assert len(read()["time_s"]) == 300


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "rec.csv: the file is empty"),
        (lambda text: text.splitlines()[0] + "\n", "rec.csv: has a heading but no rows"),
        (lambda text: text.replace("current_A", "note"), "no current column"),
        (
            lambda text: text.replace("voltage_V", "voltage_furlong"),
            "unknown unit 'furlong'|no voltage column",
        ),
        (lambda text: text.replace("voltage_V", "voltage_kn"), "column 'voltage_kn': unknown unit 'kn'"),
        (lambda text: text.replace("\n0.1,", "\n0.1,abc"), "row 102, column 'voltage_V': 'abc"),
        (
            lambda text: text.replace("\n0.1,", "\n0.05,"),
            "row 102, column 'time_s': time runs backwards by 0.049 s",
        ),
        (lambda text: text.replace("\n0.1,", "\n,"), "row 102, column 'time_s': nan is no time"),
        (lambda text: text.replace("\n0.1,", "\n1e300,"), "row 102, column 'time_s': 1e[+]300 is no time"),
        (lambda text: text.replace("\n0.1,", "\n0.1\n0.1,"), "row 102: 1 cells where the heading has 3"),
        (lambda text: text.replace("current_A", "voltage_mV"), "both look like voltage"),
        (lambda text: "x" * 3_000_000, "row 2: longer than|no time column"),
    ],
)
def test_a_wrong_file_is_one_clear_line_and_leaves_no_output(here, capsys, change, message):
    write(here / "rec.csv", rows_of())
    (here / "rec.csv").write_text(change((here / "rec.csv").read_text()))
    assert infer("rec.csv") == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("motorlens infer: rec.csv")
    assert re.search(message, lines[0]), lines[0]
    assert sorted(path.name for path in here.iterdir()) == ["rec.csv", "s.onnx"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.csv"], "none.csv: No such file"),
        (["."], "Is a directory"),
        (["rec.csv", "--column", "speed"], "--column speed: write QUANTITY=COLUMN"),
        (["rec.csv", "--column", "voltage=u"], "no column 'u'"),
        (["rec.csv", "--backend", "numpy", "--sensor", "none.onnx"], "none.onnx: No such file"),
        (["rec.csv", "-o", "none/out.csv"], "none: cannot write there|No such file"),
    ],
)
def test_wrong_arguments_are_one_clear_line(here, capsys, arguments, message):
    write(here / "rec.csv", rows_of())
    command = ["infer", "--sensor", "s.onnx", "-o", "out.csv", *arguments]
    assert main(command) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and re.search(message, lines[0]), lines


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("rows", [300, 60_000])
def test_a_full_disk_is_one_clear_line(here, capsys, rows):
    """A file this short is written as it is read, a longer one in a thread."""
    write(here / "rec.csv", rows_of(rows))
    os.symlink("/dev/full", "out.csv")
    assert infer("rec.csv") == 1
    error = [line for line in capsys.readouterr().err.splitlines() if " %, " not in line]
    assert len(error) == 1 and "out.csv" in error[0] and "No space left" in error[0]
    assert os.path.islink("out.csv") and sorted(os.listdir()) == ["out.csv", "rec.csv", "s.onnx"]


def test_a_pipe_is_written_to_and_stays_one(here):
    write(here / "rec.csv", rows_of())
    assert infer("rec.csv") == 0
    expected = (here / "out.csv").read_bytes()
    (here / "out.csv").unlink()
    os.mkfifo("out.csv")
    with Program(["cat", "out.csv"]) as reader:
        assert infer("rec.csv") == 0
        assert reader.ended() == 0 and reader.out.encode() == expected
    assert (here / "out.csv").is_fifo()


def test_damaged_gzip(here, capsys):
    write(here / "a.csv", rows_of(5000))
    (here / "a.csv.gz").write_bytes(gzip.compress((here / "a.csv").read_bytes())[:-1000])
    assert infer("a.csv.gz") == 1
    assert "damaged or cut short" in capsys.readouterr().err


@pytest.mark.fit
def test_a_large_file_gives_the_bits_of_its_pieces(here):
    """Read ahead by pyarrow where that is installed, written behind: the text is that of the plain way."""
    rng = np.random.default_rng(0)
    voltage, current = 100 + rng.normal(size=250_000), 8 + rng.normal(size=250_000)
    rows = [
        f"{k / 1000},{v},{i}\n"
        for k, (v, i) in enumerate(zip(voltage.tolist(), current.tolist(), strict=True))
    ]
    heading = "time_s,voltage_V,current_A\n"
    (here / "large.csv").write_text(heading + "".join(rows))
    (here / "small.csv").write_text(heading + "".join(rows[:20_000]))
    assert (here / "large.csv").stat().st_size > 4 << 20 > (here / "small.csv").stat().st_size
    assert infer("large.csv") == 0
    large = (here / "out.csv").read_bytes()
    assert infer("small.csv") == 0
    assert large.startswith((here / "out.csv").read_bytes()) and large.count(b"\n") == 250_001


@pytest.mark.fit
def test_what_is_wrong_far_into_a_large_file_is_said(here, capsys):
    rows = [f"{k / 1000},100.123456789012,8.123456789012\n" for k in range(200_000)]
    rows[150_000] = "150.0,oops,8\n"
    (here / "large.csv").write_text("time_s,voltage_V,current_A\n" + "".join(rows))
    assert infer("large.csv") == 1
    assert "row 150002, column 'voltage_V': 'oops' is not a number" in capsys.readouterr().err


@pytest.mark.fit
def test_memory_does_not_grow_with_the_file(here):
    """Peak memory of a fresh process on a file and on one three times as long, both read ahead."""
    body = (here / "b.txt").with_suffix(".txt")
    # ru_maxrss is inherited from the parent; VmHWM is this program's own
    script = (
        "import sys; from motorlens_runtime.cli import main; status = main(sys.argv[1:]);"
        "print([line.split()[1] for line in open('/proc/self/status') if line.startswith('VmHWM')][0]); sys.exit(status)"
    )
    peaks = []
    for n in (300_000, 900_000):
        body.write_text(
            "time_s,voltage_V,current_A\n" + "".join(f"{k / 1000},100.5,8.25\n" for k in range(n))
        )
        assert body.stat().st_size > 4 << 20
        command = [sys.executable, "-c", script, "infer", str(body), "--sensor", "s.onnx", "-o", "out.csv"]
        peaks.append(int(subprocess.run(command, capture_output=True, check=True, timeout=600).stdout))
    assert peaks[1] < 1.1 * peaks[0]
    assert peaks[1] < 150_000


@needs_recordings
@pytest.mark.parametrize("robot", [4, 5])
def test_a_real_recording_with_its_own_headings(here, robot):
    assert infer(regbot(robot), "--column", "voltage=vL_V", "--column", "current=iL_A") == 0
    assert len(read()["time_s"]) == 512
