"""`motorlens run` on drives that speak their own protocol: made-up ones at the other end of a pseudo-terminal."""

import json
import os
import select
import struct
import threading
import time
import tty
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import LIMIT_S
from helpers.sensor_files import write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.line.dialects import make_dialect
from motorlens_runtime.line.feed import LineFeed
from motorlens_runtime.line.sources import split

pytestmark = pytest.mark.usefixtures("engine")

MS = 1_000_000


def crc16(data):
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021) & 0xFFFF if crc & 0x8000 else crc << 1 & 0xFFFF
    return crc.to_bytes(2, "big")


def vesc(question, turn):
    """A VESC at 24 V, duty cycle 0.5, 3 A; the answer to what it was asked, None to anything else."""
    if question != bytes.fromhex("02 05 32 00000144") + crc16(bytes.fromhex("32 00000144")) + b"\x03":
        return None
    payload = bytes.fromhex("32 00000144") + struct.pack(">ihh", 300, 500, 240)
    return bytes((2, len(payload))) + payload + crc16(payload) + b"\x03"


def roboclaw(question, turn):
    """A RoboClaw at 24 V, half of it on motor 1, 3 A."""
    values = {24: struct.pack(">H", 240), 48: struct.pack(">hh", 16384, 0), 49: struct.pack(">hh", 300, -1)}
    if len(question) != 2 or question[0] != 0x80 or question[1] not in values:
        return None
    reply = values[question[1]]
    return reply + crc16(question + reply)


class Drive:
    """Answers in a thread of its own, one question after another even where several have gathered."""

    def __init__(self, answer, length):
        self._ours, self.theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(self.theirs)
        self.port = os.ttyname(self.theirs)
        self.answers = self.misunderstood = 0
        self._answer, self._length = answer, length
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _work(self):
        heard = b""
        while not self._stop.is_set():
            if not select.select([self._ours], [], [], 0.02)[0]:
                continue
            heard += os.read(self._ours, 100)
            while len(heard) >= self._length:
                reply, heard = self._answer(heard[: self._length], self.answers), heard[self._length :]
                if reply is None:
                    self.misunderstood += 1
                else:
                    os.write(self._ours, reply)
                    self.answers += 1

    def close(self):
        self._stop.set()
        self._thread.join()
        os.close(self._ours)
        os.close(self.theirs)


def voltage_of(name):
    return pytest.approx(12.0 if name == "vesc" else 24 * 16384 / 32767)


@pytest.mark.parametrize(
    ("answer", "name", "length", "each"), [(vesc, "vesc", 10, 1), (roboclaw, "roboclaw", 2, 3)]
)
@pytest.mark.fit
def test_a_drive_that_must_be_asked_is_asked_and_followed(tmp_path, monkeypatch, answer, name, length, each):
    """On a real line, where a busy machine decides how many answers come in time: it ends with the first sample that is
    two seconds younger than the first of all, and there are the 32 at least that tell the rate."""
    monkeypatch.setattr("motorlens_runtime.service.service._GRACE_NS", int(LIMIT_S * 1e9))
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx", rate_Hz=100.0)
    drive = Drive(answer, length)
    try:
        source = f"pty://{drive.port}?dialect={name}&poll_Hz=100"
        options = ["--record", "rec.csv", "--publish", "csv:out.csv", "--json", "r.json", "--duration", "2"]
        assert main(["run", "--source", source, "--sensor", "s.onnx", *options]) == 0
    finally:
        drive.close()
    assert drive.misunderstood == 0
    assert 32 <= json.loads(Path("r.json").read_text())["samples"] <= drive.answers // each
    time_s, voltage, current, _ = np.loadtxt("rec.csv", delimiter=",", skiprows=1).T
    assert voltage == voltage_of(name)
    assert current == pytest.approx(3.0)
    assert (np.diff(time_s) > 0).all() and time_s[-1] - time_s[0] > 1.9


class MadeUpTime:
    """A drive as a source, and the only thing that lets time pass: an answer takes 1 ms, silence as long as is waited.

    Every `deaf_every`-th question is not heard. `rounds` of `each` answers in a row have been given.
    """

    name, lasting = "drive", False
    process_time = staticmethod(time.process_time)

    def __init__(self, answer, each, deaf_every):
        self._answer, self._each, self._deaf_every = answer, each, deaf_every
        self._now_ns, self._replies, self._row = 0, [], 0
        self.questions = self.rounds = 0

    def monotonic_ns(self):
        return self._now_ns

    def write(self, data):
        reply = self._answer(data, self.questions)
        assert reply is not None
        self.questions += 1
        if self._deaf_every and self.questions % self._deaf_every == 0:
            self._row = 0
            return
        self._replies.append(reply)
        self._row += 1
        if self._row == self._each:
            self._row, self.rounds = 0, self.rounds + 1

    def read(self, timeout_s):
        if self._replies:
            self._now_ns += MS
            return self._replies.pop(0)
        self._now_ns += max(round(timeout_s * 1e9), 1)
        return b""

    def close(self):
        pass


@pytest.mark.parametrize(
    ("answer", "name", "each", "given_up"), [(vesc, "vesc", 1, 10), (roboclaw, "roboclaw", 3, 3)]
)
@pytest.mark.parametrize("deaf_every", [0, 40])
@pytest.mark.fit
def test_each_complete_round_of_answers_is_a_sample(
    tmp_path, monkeypatch, answer, name, each, given_up, deaf_every
):
    """`given_up` is how many rounds of 10 ms pass until a question that was not heard is given up, and its round with it."""
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx", rate_Hz=100.0)
    drive = MadeUpTime(answer, each, deaf_every)
    monkeypatch.setattr("motorlens_runtime.line.feed.open_source", lambda parts, options: drive)
    monkeypatch.setattr("motorlens_runtime.service.live.time", drive)
    source = f"tcp://127.0.0.1:1?dialect={name}&poll_Hz=100"
    options = ["--record", "rec.csv", "--publish", "csv:out.csv", "--json", "r.json", "--duration", "2"]
    assert main(["run", "--source", source, "--sensor", "s.onnx", *options]) == 0
    assert json.loads(Path("r.json").read_text())["samples"] == drive.rounds
    time_s, voltage, current, _ = np.loadtxt("rec.csv", delimiter=",", skiprows=1).T
    assert len(time_s) == drive.rounds
    assert voltage == voltage_of(name)
    assert current == pytest.approx(3.0)
    deaf = drive.questions // deaf_every if deaf_every else 0
    assert 200 - (given_up + 1) * deaf - 1 <= drive.rounds <= 200 - (given_up - 1) * deaf + 1
    gaps = np.diff(time_s)
    assert (gaps > 0.005).all() and (gaps > 0.015).sum() == pytest.approx(deaf, abs=1)


class Recorded:
    """A source that is silent, and notes how long it was waited for."""

    name, lasting = "recorded", False

    def __init__(self):
        self.waited, self.sent = [], []

    def read(self, timeout_s):
        self.waited.append(timeout_s)
        return b""

    def write(self, data):
        self.sent.append(data)

    def close(self):
        pass


def test_the_line_is_waited_for_no_longer_than_until_the_next_question(monkeypatch):
    source, now = Recorded(), [0]
    monkeypatch.setattr("motorlens_runtime.line.feed.open_source", lambda parts, options: source)
    feed = LineFeed(*split("tcp://127.0.0.1:1?dialect=vesc&poll_Hz=100"), None, 0.0, lambda: now[0])
    feed.read(0.05)
    assert len(source.sent) == 1 and source.waited[-1] == 0.05
    now[0] = 60 * MS
    feed.read(0.05)
    assert len(source.sent) == 1 and source.waited[-1] == pytest.approx(0.04)  # given up after 100 ms
    now[0] = 100 * MS
    feed.read(0.05)
    assert len(source.sent) == 2


def test_questions_keep_to_their_grid():
    """A loop that is late by a little asks a hundred times a second all the same."""
    dialect = make_dialect("vesc", {"poll_Hz": "100"})
    now, asked = 0, []
    while now < 1000 * MS:
        question = dialect.request(now)
        if question:
            asked.append(now)
            dialect.feed(vesc(question, 0), now + MS)
        now += round(max(dialect.patience_s(now), 0.0) * 1e9) + 2 * MS
    assert len(asked) == pytest.approx(100, abs=2)
    dialect = make_dialect("roboclaw", {"poll_Hz": "50"})
    now, rounds = 0, 0
    while now < 1000 * MS:
        question = dialect.request(now)
        if question:
            rounds += len(dialect.feed(roboclaw(question, 0), now + MS))
        now += round(max(dialect.patience_s(now), 0.0) * 1e9) + 2 * MS
    assert rounds == pytest.approx(50, abs=2)
    assert make_dialect("text").patience_s(0) == float("inf")
