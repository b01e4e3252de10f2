"""Columns that a preamble names by their numbers."""

import numpy as np
import pytest
from helpers.recordings import FOLDER, REGBOT_LEFT, needs_recordings, regbot

from motorlens_physics.recording import read_recording
from motorlens_runtime.files.layout import layout_of
from motorlens_runtime.files.numbered import names_by_number

ROWS = "0.001 6.0 0.25\n0.002 6.0 0.5\n"
WRITTEN = {
    "a line each": "# column 1: time [s]\n# column 2: voltage [V]\n# column 3: current [A]\n",
    "from zero": "% 0 = time_s\n% 1 = voltage_V\n% 2 = current_A\n",
    "in brackets, with words before and after": "Test stand 3 of 2026 11 23\n[1] time (s)\n[2] voltage (V)\n"
    "[3] current (A)\nrun 7 begins\n",
    "two in a line": "# 1 time 0.000 sec\n# 2 3 Motor voltage, current [V,A]: 6.0 0.1\n",
    "a heading that counts": "# 1:time_s 2:voltage_V 3:current_A\n",
}  # fmt: skip


@pytest.mark.parametrize("how", WRITTEN)
def test_names_are_read_by_number(how):
    layout = layout_of((WRITTEN[how] + ROWS).encode(), "rec.txt", True)
    assert layout.named and len(layout.headings) == 3
    words = [heading.lower() for heading in layout.headings]
    assert all(word in heading for word, heading in zip(("time", "voltage", "current"), words, strict=True))
    units = [heading.rstrip(")]").replace("(", "[").replace("_", "[").split("[")[-1] for heading in words]
    assert units in (["s", "v", "a"], ["sec", "v", "a"])


@pytest.mark.parametrize(
    "preamble",
    [
        ["# 1 time [s]", "# 3 current [A]"],  # one is not named
        ["# 1 time [s]", "# 2 voltage [V]", "# 2 current [A]"],  # one is named twice
        ["# 1 time [s]", "# 2 voltage [V]"],  # the file has three
        ["# 12 V supply", "# 3 runs"],
    ],
)
def test_lines_that_do_not_name_every_column_once_are_not_believed(preamble):
    assert names_by_number(preamble, 3) is None


@needs_recordings
def test_a_robots_own_log_reads_as_its_owners_table():
    columns = ["voltage=Motor voltage left [V]", "current=Motor current left [A]",
               "speed_rad_s=Wheel velocity left [r/s]"]  # fmt: skip
    log = read_recording(FOLDER / "regbot" / "robot_04_raw_log.txt", columns)
    table = read_recording(regbot(4), REGBOT_LEFT)
    np.testing.assert_allclose(log.time_s, table.time_s, atol=1e-9)
    for quantity in ("voltage", "current", "speed"):
        np.testing.assert_allclose(log.channels[quantity], table.channels[quantity], atol=1e-9)
