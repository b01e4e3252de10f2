"""`--realtime`: what is asked of the system is undone, what it refuses is said, and the estimates are the same."""

import gc
import os
import sys

import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.service.realtime import collecting, realtime


def profile():
    return (
        os.sched_getscheduler(0), os.sched_getparam(0).sched_priority, os.sched_getaffinity(0), gc.isenabled(),
        sys.getswitchinterval(),
    )  # fmt: skip


def test_all_is_as_before_afterwards():
    before = profile()
    with pytest.raises(KeyError), realtime() as answer:
        assert len(answer.granted) + len(answer.refused) == 4
        assert not gc.isenabled()
        raise KeyError
    assert profile() == before


def test_what_is_refused_is_said_with_what_allows_it(monkeypatch):
    def refuse(*arguments):
        raise PermissionError(1, "Operation not permitted")

    with monkeypatch.context() as patched:
        patched.setattr(os, "sched_setscheduler", refuse)
        patched.setattr("motorlens_runtime.service.realtime._libc", lambda: Refusing())
        with realtime("/nowhere/cpu_dma_latency") as answer:
            assert len(answer.granted) == 1
            assert "LimitRTPRIO=40" in answer.refused[0] and "ulimit -r" in answer.refused[0]
            assert "LimitMEMLOCK=infinity" in answer.refused[1]
            assert "sleep" in answer.refused[2] and "udev rule" in answer.refused[2]


def open_files():
    return {os.path.realpath(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")}


def test_processors_are_kept_awake_as_long_as_it_runs(tmp_path):
    """The file has its say as long as it is open, and only then; an int32 of zero microseconds."""
    file = tmp_path / "cpu_dma_latency"
    file.touch()
    with pytest.raises(KeyError), realtime(str(file)) as answer:
        assert str(file) in open_files()
        assert answer.granted[-1] == "processors stay awake"
        raise KeyError
    assert str(file) not in open_files()
    assert file.read_bytes() == b"\0\0\0\0"


def test_a_kernel_that_does_not_take_it_is_no_reason_to_stop():
    with realtime("/dev/full") as answer:
        assert "No space left on device: processors may sleep" in answer.refused[-1]
        assert "/dev/full" not in open_files()


class Refusing:
    def mlockall(self, flags):
        return -1

    def munlockall(self):
        return 0


@pytest.mark.fit
def test_garbage_is_collected_between_blocks_every_ten_seconds():
    now, runs = [0], []

    def note(phase, info):
        runs.append(phase)

    stop = collecting(lambda: False, lambda: now[0])
    gc.disable()
    gc.callbacks.append(note)
    try:
        for second in range(25):
            now[0] = second * 10**9
            assert not stop()
    finally:
        gc.callbacks.remove(note)
        gc.enable()
    assert runs.count("start") == 2


@pytest.mark.fit
def test_the_estimates_are_the_same(engine, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_sensor(tmp_path / "s.onnx")
    rows = "".join(f"{k / 1000:.3f},{100 + k % 7},{8 + k % 5}\n" for k in range(2000))
    (tmp_path / "rec.csv").write_text("time_s,voltage_V,current_A\n" + rows)
    command = ["run", "--source", "file:rec.csv", "--sensor", "s.onnx", "--rate", "0", "--ambient", "20"]
    assert main([*command, "--publish", "csv:plain.csv"]) == 0
    capsys.readouterr()
    assert main([*command, "--publish", "csv:realtime.csv", "--realtime"]) == 0
    said = capsys.readouterr().err
    assert "priority" in said and "memory" in said
    assert (tmp_path / "realtime.csv").read_bytes() == (tmp_path / "plain.csv").read_bytes()
