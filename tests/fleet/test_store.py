"""Results by content: the same bytes whoever is killed, nothing computed twice, one failure stops nothing."""

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path

import pytest

from motorlens_physics.queue import here
from motorlens_runtime.errors import DataError
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.store import Store, digest, write_atomically
from motorlens_workbench.fleet.study import results


@dataclass(frozen=True)
class Toy:
    """A job that takes a moment; number 3 is a recording that cannot be used, and number 4 a fault of ours."""

    number: int
    sleep_s: float = 0.0
    paths: tuple[Path, ...] = ()

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


def test_the_longest_are_worked_on_first(tmp_path):
    sizes = [100, 5000, 104, 101, 70000]
    for n, count in enumerate(sizes):
        (tmp_path / f"{n}.csv").write_text("x" * count)
    asked = []

    def work(todo):
        asked.extend(job.number for job in todo)
        return here(worked_out, todo)

    jobs = [
        (Entry(f"m{n}", tmp_path / f"{n}.csv", f"{n}.csv"), Toy(10 + n, paths=(tmp_path / f"{n}.csv",)))
        for n in range(len(sizes))
    ]
    results(jobs, Store(tmp_path / "results"), work, lambda done, of: None)
    assert asked == [14, 11, 10, 12, 13]


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_killed_in_the_middle_of_a_write_it_ends_with_the_same_bytes(tmp_path):
    """Before a result is on the disk, and before it has its name; after none, two or five results."""
    toys(tmp_path / "peace")
    for step in ("fsync", "replace"):
        for after in (0, 2, 5):
            # A child of this very process: its start costs nothing.
            if (child := os.fork()) == 0:
                _die_at(step, after)
                toys(tmp_path / "war")
                os._exit(0)
            _, status = os.waitpid(child, 0)
            assert os.WTERMSIG(status) == signal.SIGKILL
    assert len(content(tmp_path / "war")) == 14
    toys(tmp_path / "war")
    assert content(tmp_path / "war") == content(tmp_path / "peace")


def _die_at(step, after):
    """Have this process kill itself where it calls a function of `os` once more than so often."""
    whole, calls = getattr(os, step), iter(range(after))

    def dying(*arguments):
        if next(calls, None) is None:
            os.kill(os.getpid(), signal.SIGKILL)
        return whole(*arguments)

    setattr(os, step, dying)


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
