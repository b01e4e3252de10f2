"""Results by content: the same bytes whoever is killed, nothing computed twice, one failure stops nothing."""

import json
import os
import random
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
from helpers.processes import Program, eventually

from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.queue import here
from motorlens_workbench.fleet.store import Store, digest, write_atomically
from motorlens_workbench.fleet.study import results

PROGRAM = """
import sys
from pathlib import Path
sys.path[:0] = [{tests!r}, {here!r}]
from test_store import toys
toys(Path(sys.argv[1]), sleep_s=0.02)
"""


@dataclass(frozen=True)
class Toy:
    """A job that takes a moment; number 3 is a recording that cannot be used, and number 4 a fault of ours."""

    number: int
    sleep_s: float = 0.0

    def key(self):
        if self.number == 5:
            raise FileNotFoundError(2, "No such file or directory", "five.csv")
        return digest(b"toy", str(self.number % 20).encode())


def worked_out(toy):
    import time

    time.sleep(toy.sleep_s)
    if toy.number == 3:
        raise DataError("three.csv: three")
    if toy.number == 4:
        raise ZeroDivisionError("four")
    return {"number": toy.number % 20, "third": toy.number % 20 / 3}


def toys(folder, sleep_s=0.0, count=22):
    """Outcomes of some jobs; the last two are the same as the first two."""
    jobs = [(Entry(f"m{n}", Path(f"{n}.csv"), f"{n}.csv"), Toy(n, sleep_s)) for n in range(count)]
    return results(jobs, Store(folder), lambda todo: here(worked_out, todo), lambda done, of: None)


def content(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.rglob("*.json"))}


def test_one_failure_is_one_line_and_the_rest_goes_on(tmp_path):
    found = toys(tmp_path)
    said = {o.entry.name: o.failure for o in found if o.failure}
    assert said == {
        "3.csv": "three.csv: three",
        "4.csv": "ZeroDivisionError: four",
        "5.csv": "cannot be read: No such file or directory",
    }
    assert found[20].document == found[0].document == {"number": 0, "third": 0.0}
    assert len(content(tmp_path)) == 17


def test_nothing_is_computed_twice(tmp_path):
    first = toys(tmp_path)
    asked = []

    def work(todo):
        asked.extend(job.number for job in todo)
        return here(worked_out, todo)

    jobs = [(o.entry, Toy(n)) for n, o in enumerate(first)]
    again = results(jobs, Store(tmp_path), work, lambda done, of: None)
    assert asked == [3, 4]
    assert again == first


@pytest.mark.fit
def test_killed_at_random_it_ends_with_the_same_bytes(tmp_path):
    toys(tmp_path / "peace")
    text = PROGRAM.format(tests=str(Path(__file__).parents[1]), here=str(Path(__file__).parent))
    rng = random.Random(0)
    for _ in range(2):
        before = len(content(tmp_path / "war"))
        more = before + rng.randint(1, 4)
        with Program([sys.executable, "-c", text, str(tmp_path / "war")]) as program:
            eventually(lambda more=more: len(content(tmp_path / "war")) >= more, "some results")
            os.kill(program.pid, signal.SIGKILL)
    assert len(content(tmp_path / "war")) < 17
    toys(tmp_path / "war")
    assert content(tmp_path / "war") == content(tmp_path / "peace")


def test_what_is_half_written_is_no_result(tmp_path):
    store, key = Store(tmp_path), digest(b"x")
    store.path(key).parent.mkdir()
    store.path(key).write_text('{"a": 1')
    assert store.read(key) is None
    half = store.path(key).with_name(f".{key}.json.123")
    half.write_text("{")
    store.clear_halves()
    assert not half.exists()
    store.write(key, {"a": 1 / 3})
    assert store.read(key) == {"a": 1 / 3}
    assert json.loads(store.path(key).read_text()) == {"a": 1 / 3}


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    write_atomically(tmp_path / "a", b"old")
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        write_atomically(tmp_path / "a", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert (tmp_path / "a").read_bytes() == b"old"
