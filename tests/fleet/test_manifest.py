"""Which recordings a folder or a manifest names."""

from datetime import datetime

import pytest

from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.manifest import entries


def test_a_folder_of_motors(tmp_path):
    for name in (
        "m2/2026-03-01.csv",
        "m1/run_2026-03-02_1430.csv",
        "m1/2026-03-01.csv.gz",
        "alone.csv",
        "m1/notes.md",
    ):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
    found = [(e.motor, e.name, e.date) for e in entries(tmp_path)]
    assert found == [
        ("alone", "alone.csv", None),
        ("m1", "m1/2026-03-01.csv.gz", datetime(2026, 3, 1)),
        ("m1", "m1/run_2026-03-02_1430.csv", datetime(2026, 3, 2, 14, 30)),
        ("m2", "m2/2026-03-01.csv", datetime(2026, 3, 1)),
    ]


def test_a_motor_without_a_recording_is_named_and_where_results_go_is_no_motor(tmp_path):
    for name in ("m1/2026-03-01.csv", "m2/notes.md", "out/fleet/results/ab/abc.json", ".git/config"):
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.touch()
    (tmp_path / "m3").mkdir()
    found = entries(tmp_path, tmp_path / "out/fleet")
    assert [(e.motor, e.name, bool(e.lacks)) for e in found] == [
        ("m1", "m1/2026-03-01.csv", False),
        ("m2", "m2/", True),
        ("m3", "m3/", True),
    ]
    assert found[1].lacks.startswith("holds no recording (.csv")


def test_manifests_as_csv_and_toml(tmp_path):
    (tmp_path / "fleet.csv").write_text("motor,recording,date\nm2,b.csv,2026-01-02\nm1,sub/a.csv,\n")
    (tmp_path / "fleet.toml").write_text(
        '[[recording]]\nmotor = "m2"\nrecording = "b.csv"\ndate = 2026-01-02\n'
        '[[recording]]\nmotor = "m1"\nrecording = "sub/a.csv"\n'
    )
    first, second = entries(tmp_path / "fleet.csv"), entries(tmp_path / "fleet.toml")
    assert first == second
    assert [e.path for e in first] == [tmp_path / "sub/a.csv", tmp_path / "b.csv"]
    assert first[1].date == datetime(2026, 1, 2)


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("a.csv", "motor,file\nm,a.csv\n", "columns motor, recording"),
        ("a.csv", "motor,recording,date\nm,a.csv,last May\n", "entry 2: date 'last May'"),
        ("a.csv", "motor,recording\nm,\n", "entry 2: lacks"),
        ("a.toml", "recording = 3\n", "[[recording]] tables"),
        ("a.toml", "= 3\n", "not a manifest"),
    ],
)
def test_what_is_no_manifest_is_refused_in_one_line(tmp_path, name, text, why):
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError) as told:
        entries(tmp_path / name)
    assert why in str(told.value)


def test_an_empty_folder(tmp_path):
    with pytest.raises(DataError, match="holds no recording"):
        entries(tmp_path)
