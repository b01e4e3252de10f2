"""What a command says of itself while it works: on a terminal, and only if it takes long."""

import io
import sys
import threading

import pytest
from helpers.processes import eventually

from motorlens_runtime import progress
from motorlens_runtime.progress import patience


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_who_waits_on_a_terminal_is_told_once_that_it_is_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    monkeypatch.setattr(progress, "_QUIET_S", 0.0)
    with patience("compare"):
        eventually(sys.stderr.getvalue, "a sentence")
    assert sys.stderr.getvalue().startswith("motorlens compare: at work")
    assert sys.stderr.getvalue().count("\n") == 1


@pytest.mark.parametrize("error", [Terminal, io.StringIO])
def test_nothing_is_said_of_what_is_soon_done_or_goes_into_a_file(
    monkeypatch: pytest.MonkeyPatch, error: type[io.StringIO]
) -> None:
    monkeypatch.setattr(sys, "stderr", error())
    before = threading.active_count()
    with patience("compare"):
        pass
    eventually(lambda: threading.active_count() == before, "the end of the clock")
    assert sys.stderr.getvalue() == ""
