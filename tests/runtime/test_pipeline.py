"""Threads around a pure loop: the same items in order, the same errors in their place, nothing left running."""

import threading
import time
from functools import partial

import pytest
from helpers.processes import eventually

from motorlens_runtime.files.pipeline import Behind, ahead


def settled():
    return eventually(
        lambda: not {t.name for t in threading.enumerate()} & {"reader", "writer"}, "the end of all threads"
    )


def test_the_same_items_in_order():
    assert list(ahead(range(1000))) == list(range(1000))
    assert list(ahead([])) == []
    assert settled()


def test_an_error_comes_after_what_was_made_before_it():
    def items():
        yield from range(3)
        raise ValueError("row 4")

    got = []
    with pytest.raises(ValueError, match="row 4"):
        for item in ahead(items()):
            got.append(item)
    assert got == [0, 1, 2]
    assert settled()


def test_no_more_is_made_than_waits():
    made = []

    def items():
        for k in range(100):
            made.append(k)
            yield k

    stream = ahead(items())
    assert next(stream) == 0
    time.sleep(0.1)
    assert len(made) <= 4  # the one taken, the one that waits, the one that is offered
    stream.close()
    assert settled() and len(made) <= 6


class Writer:
    def __init__(self, fails_at=None):
        self.rows, self.closed, self.fails_at = [], False, fails_at

    def publish(self, row):
        if len(self.rows) == self.fails_at:
            raise OSError("disk full")
        self.rows.append(row)

    def flush(self):
        pass

    def close(self):
        self.closed = True


def test_all_is_written_by_the_end():
    writer = Writer()
    behind = Behind(writer)
    for k in range(50):
        behind.publish(k)
    behind.close()
    assert writer.rows == list(range(50)) and writer.closed and settled()


def test_an_error_of_the_writer_is_raised_and_the_file_closed():
    writer = Writer(fails_at=3)
    behind = Behind(writer)
    with pytest.raises(OSError, match="disk full"):
        for k in range(1000):
            behind.publish(k)
            time.sleep(0.001)
    behind.close()
    assert writer.rows == [0, 1, 2] and writer.closed and settled()


def test_an_error_is_raised_once_and_nothing_is_written_after_it():
    """Rows that waited, or are handed over all the same, would fail again, in `close` of all places."""
    writer, raised = Writer(fails_at=0), 0
    behind = Behind(writer)
    for hand_over in [partial(behind.publish, k) for k in range(50)] + [behind.close]:
        try:
            hand_over()
        except OSError:
            raised += 1
    assert raised == 1 and writer.rows == [] and writer.closed and settled()


def test_an_error_at_the_last_rows_is_raised_by_close():
    writer = Writer(fails_at=0)
    behind = Behind(writer)
    behind.publish(0)
    with pytest.raises(OSError, match="disk full"):
        behind.close()
    assert writer.closed
