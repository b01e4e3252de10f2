"""The stream of `infer` and `run` reads a file however it is written, in blocks, as it reads the plain one."""

import gzip

import numpy as np
import pytest

from motorlens_runtime.errors import DataError
from motorlens_runtime.files.csv_stream import CsvStream

N = 20_000  # several blocks
TIME, VOLTAGE, CURRENT = 0.001 * np.arange(N), 6 + np.arange(N) % 7 * 0.25, np.arange(N) % 11 * 0.125


def text(heading: str = "time_s,voltage_V,current_A", mark: str = ",", decimal: str = ".") -> str:
    rows = (mark.join(f"{x:.6g}" for x in row) for row in zip(TIME, VOLTAGE, CURRENT, strict=True))
    return heading.replace(",", mark) + "\n" + "\n".join(row.replace(".", decimal) for row in rows) + "\n"


WRITTEN = {
    "plain": text().encode(),
    "decimal commas": text(mark=";", decimal=",").encode(),
    "blanks": text(mark="   ").encode(),
    "UTF-16": text().encode("utf-16"),
    "a code page": text("time_s,voltage_V,current_A")
    .replace("time_s", "# 20 °C\ntime_s", 1)
    .encode("cp1252"),
    "comments and units": ("# a\n# b\n" + text("time,voltage,current\ns,V,A")).encode(),
    "Windows, zipped": gzip.compress(text().replace("\n", "\r\n").encode()),
}


@pytest.mark.parametrize("how", WRITTEN)
def test_the_same_samples_however_they_are_written(tmp_path, how):
    (tmp_path / "r.csv").write_bytes(WRITTEN[how])
    stream = CsvStream(tmp_path / "r.csv", {})
    blocks = list(stream)
    stream.close()
    np.testing.assert_allclose(np.concatenate([b.samples.time_ns for b in blocks]), np.round(TIME * 1e9))
    np.testing.assert_array_equal(np.concatenate([b.samples.voltage_V for b in blocks]), VOLTAGE)
    np.testing.assert_array_equal(np.concatenate([b.samples.current_A for b in blocks]), CURRENT)
    above = WRITTEN[how].count(b"#") + (2 if how == "comments and units" else 1)
    assert blocks[0].first_row == 1 + (above if how != "Windows, zipped" else 1)


def test_duty_times_supply_is_a_voltage(tmp_path):
    rows = "".join(f"{k / 1000},{k % 100},12.5,1.5\n" for k in range(1000))
    (tmp_path / "r.csv").write_text("t_s,duty_pct,vbat_V,i_A\n" + rows)
    stream = CsvStream(tmp_path / "r.csv", {"voltage": "duty_pct*vbat_V/100"})
    (block,) = stream
    stream.close()
    np.testing.assert_allclose(block.samples.voltage_V, np.arange(1000) % 100 * 0.125)


def test_milliseconds_without_a_unit_are_no_seconds(tmp_path):
    rows = "".join(f"{k},{k % 7},1.5\n" for k in range(1000))
    (tmp_path / "r.csv").write_text("time,voltage_V,current_A\n" + rows)
    stream = CsvStream(tmp_path / "r.csv", {})
    with pytest.raises(DataError, match="--column time_ms=time"):
        list(stream)
    stream.close()


def test_a_binary_file_is_refused(tmp_path):
    (tmp_path / "r.csv").write_bytes(bytes(range(256)) * 10)
    with pytest.raises(DataError, match="not a text file"):
        CsvStream(tmp_path / "r.csv", {})
