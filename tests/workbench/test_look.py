"""`motorlens look`, and `--range`: what is in a recording, and working on a part of it."""

import json
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.ranges import parse_ranges, within
from motorlens_physics.recording import Recording
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError

TIME = np.arange(5.0, 6.0, 0.01)
WHOLE = Recording("a.csv", TIME, {"voltage": TIME.copy()})


def write(path, headings, rows):
    path.write_text("\n".join([",".join(headings), *(",".join(map(str, row)) for row in rows)]) + "\n")


def test_what_is_in_a_recording(tmp_path, capsys):
    rows = [(k / 100, 24 * (k % 2), k, "on", 60 * k) for k in range(100)]
    write(tmp_path / "r.csv", ["time_s", "voltage_V", "I mot", "state", "n"], rows)
    arguments = ["look", str(tmp_path / "r.csv"), "--column", "current_mA=I mot", "--column", "speed_rpm=n"]
    assert main([*arguments, "--json", str(tmp_path / "r.json"), "--html", str(tmp_path / "r.html")]) == 0
    assert "100 samples in 0.99 s, 100 a second, of " in capsys.readouterr().out
    found = json.loads((tmp_path / "r.json").read_text())
    assert [column["quantity"] for column in found["columns"]] == ["time", "voltage", "current", "", "speed"]
    assert found["columns"][2]["samples"] == ["0", "1", "2"] and found["columns"][3]["samples"] == ["text"]
    assert found["channels"]["current"] == {"unit": "A", "min": 0.0, "max": pytest.approx(0.099)}
    assert found["channels"]["speed"]["max"] == pytest.approx(99 * 60 * np.pi / 30)  # 60 rpm a sample
    assert found["choices"]["speed"][:2] == ["rad/s", "rpm"] and found["error"] == ""
    text = (tmp_path / "r.html").read_text()
    assert 'data-name="I mot"' in text and re.search(r'"kind": "time"', text)


def test_it_is_read_as_other_commands_read_it(tmp_path, capsys):
    """A motor that a current drives has no voltage; a number stands for what was not measured."""
    write(
        tmp_path / "r.csv",
        ["time_s", "current_A", "speed_rad_s"],
        [(k / 100, k / 50, -7 if k == 30 else k) for k in range(100)],
    )
    recording = str(tmp_path / "r.csv")
    assert main(["look", recording]) == 1
    assert "no voltage column" in capsys.readouterr().err
    page = tmp_path / "r.html"
    assert main(["look", recording, "--terminal", "current", "--no-value=-7", "--html", str(page)]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^terminal +current$", said, flags=re.MULTILINE) and "1 missing value of speed" in said
    assert "--no-value=-7 --terminal current" in page.read_text()


def test_what_cannot_be_used_shows_its_columns_all_the_same(tmp_path, capsys):
    write(tmp_path / "r.csv", ["t", "<b>U</b>"], [(k / 100, k) for k in range(50)])
    page = tmp_path / "r.html"
    assert main(["look", str(tmp_path / "r.csv"), "--html", str(page)]) == 1
    said = capsys.readouterr()
    assert "no voltage column" in said.err and said.err.count("\n") == 1 and "<b>U</b>" in said.out
    assert "<b>" not in page.read_text().partition("<body>")[2].partition("<script")[0]


def test_no_heading_line_gets_all_that_is_lacking_at_once_and_a_command_that_reads_it(tmp_path, capsys):
    path = tmp_path / "my run.csv"
    path.write_text("".join(f"{k / 100},{23.5 * (k % 2)},{k / 8},{2.5 * k},20\n" for k in range(50)))
    for command in (
        ["look", str(path)],
        ["infer", str(path), "--sensor", "mellah2016", "-o", str(tmp_path / "x.csv")],
    ):
        assert main(command) == 1
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and "no time column (time_s) and no voltage column (voltage_V)" in said
        words = shlex.split(said.rpartition("for example: ")[2])
        assert words[0] == "motorlens" and main(words[1:]) == 0
        assert "50 samples" in capsys.readouterr().out
    # What has been chosen stays.
    assert main(["look", str(path), "--column", "current=#2"]) == 1
    words = shlex.split(capsys.readouterr().err.rpartition("for example: ")[2])
    assert "current=#2" in words and "voltage=#2" not in words and main(words[1:]) == 0


def test_nothing_is_never_less_than_nothing(tmp_path, monkeypatch, capsys):
    """A current of 0 whose sensor counts the other way, and what a program writes as -0."""
    monkeypatch.chdir(tmp_path)  # a name that holds no "-0" of its own
    write(tmp_path / "r.csv", ["time_s", "voltage_V", "current_A"], [(k / 100, k, "-0.0") for k in range(50)])
    assert main(["look", "r.csv", "--json", "r.json"]) == 0
    assert (
        "-0" not in capsys.readouterr().out.replace("-0.0", "")
        and "-0" not in (tmp_path / "r.json").read_text()
    )


@pytest.mark.parametrize(
    ("ranges", "first", "last"),
    [(["0.2:0.7"], 5.2, 5.7), (["a.csv=0.2:0.7", ":0.5"], 5.2, 5.7), (["0.4:"], 5.4, 5.99), ([], 5.0, 5.99)],
)
def test_a_range_counts_from_the_first_sample(ranges, first, last):
    part = within(WHOLE, "a.csv", parse_ranges(ranges, ["a.csv", "b.csv"]))
    assert part.time_s[0] == pytest.approx(first, abs=0.011) and part.time_s[-1] == pytest.approx(
        last, abs=0.011
    )
    assert np.array_equal(part.time_s, part.channels["voltage"])


def test_a_range_that_is_none_gets_one_line():
    for ranges, said in (
        (["2"], "write [REC=]FROM:TO"),
        (["a:b"], "write [REC=]FROM:TO"),
        (["nan:1"], "write [REC=]FROM:TO"),
        (["c.csv=1:2"], "no recording c.csv; there are a.csv"),
    ):
        with pytest.raises(DataError, match=re.escape(said)):
            parse_ranges(ranges, ["a.csv"])
    with pytest.raises(
        DataError, match=r"11 samples from 0.2 to 0.3 s; at least 40 are needed, and it lasts 0.99 s"
    ):
        within(WHOLE, "a.csv", {"a.csv": (0.2, 0.3)})


@pytest.mark.fit
def test_compare_with_a_range_is_compare_with_a_recording_cut_by_hand(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    simulate = [
        "simulate",
        "mellah2016",
        "--scenario",
        "load_steps",
        "--duration",
        "10",
        "--rate",
        "100",
        "--noise",
        "0.2%",
    ]
    assert main([*simulate, "-o", "r.csv"]) == 0
    heading, *rows = Path("r.csv").read_text().splitlines()
    kept = [row for row in rows if 3 <= float(row.split(",")[0]) <= 8]
    Path("cut.csv").write_text("\n".join([heading, *kept]) + "\n")
    found = []
    for words in (["r.csv", "--range", "3:8"], ["cut.csv"]):
        assert main(["compare", *words, "--motor", "mellah2016", "--json", "c.json", "--html", "c.html"]) == 0
        found.append(json.loads(Path("c.json").read_text())["channels"])
    assert found[0] == found[1]
