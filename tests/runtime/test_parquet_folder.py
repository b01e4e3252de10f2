"""A folder of Parquet files: the rows that went in, and what a kill at any instant leaves behind."""

import random
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import Program

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.sensor.specification import Output

pq = pytest.importorskip("pyarrow.parquet", reason="the extra `publish` is not installed")

HEADER = Header("s", "1.0", "ab" * 32, (Output("speed", "rad/s", 1.0), Output("resistance", "ohm", 1.0)))


def rows(first, n):
    number = np.arange(first, first + n)
    values = np.column_stack((number, number / 3.0))
    return Estimates(number * 1_000_000_000, values, -values, number.astype(np.uint32))


def opened(folder, rows=10):
    return open_publisher(f"parquet:{folder}/?rows={rows}", HEADER)


def parts(folder):
    return [pq.read_table(path) for path in sorted(folder.glob("part-*.parquet"))]


def numbers(folder):
    return [int(t) for table in parts(folder) for t in table.column("time_s").to_pylist()]


def test_parts_hold_the_rows_to_the_last_bit(tmp_path):
    folder = tmp_path / "log"
    publisher = opened(folder)
    publisher.publish(rows(0, 7))
    publisher.publish(rows(7, 25))
    publisher.publish(rows(32, 0))
    assert [table.num_rows for table in parts(folder)] == [10, 10, 10]
    publisher.close()
    assert sorted(path.name for path in folder.iterdir()) == [f"part-00000{k}.parquet" for k in (1, 2, 3, 4)]
    table = parts(folder)[1]
    assert table.column_names == [
        "time_s",
        "speed_rad_s",
        "speed_sd_rad_s",
        "resistance_ohm",
        "resistance_sd_ohm",
        "quality",
    ]
    assert table.column("resistance_sd_ohm").to_pylist() == [-k / 3.0 for k in range(10, 20)]
    assert table.column("quality").to_pylist() == list(range(10, 20))
    assert table.schema.metadata[b"motorlens.sha256"] == b"ab" * 32
    again = opened(folder)
    again.publish(rows(32, 1))
    again.close()
    assert numbers(folder) == list(range(33))


def test_an_empty_run_leaves_nothing(tmp_path):
    publisher = opened(tmp_path / "log")
    publisher.flush()
    publisher.close()
    assert list((tmp_path / "log").iterdir()) == []


def test_one_writer_at_a_time(tmp_path):
    first = opened(tmp_path / "log")
    with pytest.raises(DeviceError, match="another process writes there"):
        opened(tmp_path / "log")
    first.publish(rows(0, 3))
    first.close()
    assert numbers(tmp_path / "log") == [0, 1, 2]
    with pytest.raises(DataError, match="rows=0"):
        opened(tmp_path / "log", rows=0)


@pytest.mark.fit
def test_a_journal_cut_or_damaged_anywhere_gives_its_whole_rows(tmp_path):
    folder = tmp_path / "log"
    publisher = opened(folder, rows=1000)
    publisher.publish(rows(0, 40))
    publisher.flush()
    journal = folder / "part-000001.journal"
    whole = journal.read_bytes()
    publisher.close()
    head = whole.index(b"\n") + 1
    size = (len(whole) - head) // 40
    for cut in range(0, len(whole) + 1, 37):
        target = tmp_path / f"cut{cut}"
        target.mkdir()
        (target / journal.name).write_bytes(whole[:cut])
        opened(target).close()
        assert numbers(target) == list(range(max(cut - head, 0) // size))
        assert not list(target.glob("*.journal")) and not list(target.glob("*.draft"))
    generator = np.random.default_rng(0)
    for trial in range(40):
        target = tmp_path / f"bit{trial}"
        target.mkdir()
        at = int(generator.integers(head, len(whole)))
        broken = bytearray(whole)
        broken[at] ^= 1 << int(generator.integers(8))
        (target / journal.name).write_bytes(broken)
        opened(target).close()
        assert numbers(target) == list(range((at - head) // size))


@pytest.mark.fit
def test_killed_at_random_every_part_is_readable_and_nothing_flushed_is_missing(tmp_path):
    folder = tmp_path / "log"
    script = f"""
        import sys
        sys.path[:0] = {[str(folder) for folder in list(Path(__file__).parents)[:2]]!r}
        import test_parquet_folder as t
        publisher = t.opened({str(folder)!r}, rows=50)
        first = int(sys.argv[1])
        while True:
            publisher.publish(t.rows(first, 7))
            publisher.flush()
            first += 7
            print(first, flush=True)
    """
    chance = random.Random(3)
    done = 0
    for _ in range(12):
        command = [sys.executable, "-c", textwrap.dedent(script), str(done)]
        with Program(command) as program:
            program.line()
            time.sleep(chance.uniform(0.0, 0.02))
        said = [int(line) for line in program.out.splitlines(keepends=True) if line.endswith("\n")]
        flushed = [done, *said][-1]
        parts(folder)  # what is there before anybody tidied up can be read
        opened(folder).close()
        kept = numbers(folder)
        assert kept == list(range(len(kept)))  # none twice, none missing
        assert len(kept) >= flushed
        done = len(kept)
