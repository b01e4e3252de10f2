"""One thread-and-queue worker: order, room, errors and an end, each against what was handed over."""

import threading

import numpy as np
import pytest
from helpers.processes import eventually

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.service.recorder import Recorder
from motorlens_runtime.worker import Worker


class Gate:
    """Work that stands still until it is let through."""

    def __init__(self):
        self.opened, self.done = threading.Event(), []

    def __call__(self, item):
        assert self.opened.wait(60.0)
        self.done.append(item)


def test_all_is_done_in_order_and_the_end_comes_last():
    done = []
    worker = Worker("w", done.append, 10_000, finish=lambda: done.append("end"))
    for k in range(1000):
        worker.put(k)
    assert worker.close() == 0
    assert done == [*range(1000), "end"]
    assert (worker.done, worker.lost, worker.errors) == (1000, 0, 0)


def test_without_room_what_has_waited_longest_is_dropped_and_counted():
    gate = Gate()
    worker = Worker("w", gate, 10, weight=lambda item: item)
    worker.put(1)
    eventually(lambda: not worker._items, "the first is being done")
    for heavy in (2, 3, 4, 5):
        worker.put(heavy)
    gate.opened.set()
    worker.close()
    # 2, 3, 4 and 5 are more than 10; without 2 and 3 they are not.
    assert gate.done == [1, 4, 5]
    assert (worker.done, worker.lost) == (10, 5)


def test_one_item_may_wait_however_heavy():
    gate = Gate()
    worker = Worker("w", gate, 10, weight=lambda item: item)
    worker.put(100)
    eventually(lambda: not worker._items, "the first is being done")
    worker.put(200)
    gate.opened.set()
    worker.close()
    assert gate.done == [100, 200] and worker.lost == 0


def test_one_that_waits_loses_nothing():
    done = []
    worker = Worker("w", done.append, 1, waits=True)
    for k in range(500):
        worker.put(k)
    worker.close()
    assert done == list(range(500)) and worker.lost == 0


def test_after_an_error_the_next_is_tried_unless_it_was_for_good():
    def do(item):
        if item in (3, 4):
            raise OSError(28, "No space left on device")
        if item == 7:
            raise BrokenPipeError
        done.append(item)

    done = []
    worker = Worker("w", do, 1, waits=True, ends=(BrokenPipeError,))
    for k in range(10):
        worker.put(k)
    worker.close()
    assert done == [0, 1, 2, 5, 6]
    assert (worker.done, worker.lost, worker.errors, worker.dead) == (5, 5, 3, True)
    assert isinstance(worker.error, BrokenPipeError)


def test_what_a_stuck_line_does_not_take_is_given_up_and_counted():
    gate = Gate()
    worker = Worker("w", gate, 10)
    worker.put(0)
    eventually(lambda: not worker._items, "the first is being done")
    worker.put(1)
    worker.put(2)
    assert worker.close(0.05) == 2
    assert worker.lost == 2
    gate.opened.set()
    worker._thread.join(60.0)


def test_it_settles_when_asked_and_after_what_was_done():
    settled = []
    worker = Worker("w", settled.append, 10, settle=lambda: settled.append("settled"))
    worker.nudge()
    eventually(lambda: settled == ["settled"], "asked to settle")
    worker.put(1)
    worker.close()
    assert settled[:3] == ["settled", 1, "settled"]


@pytest.mark.parametrize("room", [0, 40, 90, 1000])
def test_a_disk_that_is_full_for_a_while_leaves_whole_rows(tmp_path, room):
    """The recorder on a disk with room for so many bytes, then none, then again: every row is there whole, or not at all."""

    class Disk:
        def __init__(self, file):
            self.file, self.room = file, room

        def write(self, data):
            if not self.room:
                raise OSError(28, "No space left on device")
            taken = min(self.room, len(data))
            self.room -= taken
            return self.file.write(data[:taken])

        def __getattr__(self, name):
            return getattr(self.file, name)

    recorder = Recorder(str(tmp_path / "rec.csv"))
    disk = recorder._file = Disk(recorder._file)
    k = np.arange(10).reshape(5, 2)
    parts = [Samples(row * 1_000_000, row.astype(float), -row.astype(float)) for row in k]
    for part in parts[:4]:
        recorder.put(part)
    eventually(lambda: recorder._worker.done + recorder.lost == 8, "four parts were tried")
    disk.room = 1 << 20
    recorder.put(parts[4])
    recorder.close()
    heading, *rows = (tmp_path / "rec.csv").read_text().splitlines()
    assert heading == "time_s,voltage_V,current_A,link_flags"
    assert len(rows) == 10 - recorder.lost
    whole = {",".join(map(repr, (k / 1000, float(k), -float(k), 0))) for k in range(10)}
    assert set(rows) <= whole and rows[-1] in whole
    assert (recorder.error is None) == (room == 1000)
    assert room == 1000 or recorder.error.endswith("rec.csv: No space left on device")


def test_a_recording_holds_what_was_wrong_with_the_line_and_not_that_the_machine_was_late(tmp_path):
    recorder, words = (
        Recorder(str(tmp_path / "rec.csv")),
        (0, Quality.OVERLOAD, Quality.OVERLOAD | Quality.BRIDGED),
    )
    recorder.put(
        Samples(np.arange(3) * 1_000_000, np.ones(3), np.ones(3), None, np.array(words, dtype=np.uint32))
    )
    recorder.close()
    told = [int(row.rpartition(",")[2]) for row in (tmp_path / "rec.csv").read_text().splitlines()[1:]]
    assert told == [0, 0, Quality.BRIDGED]
