"""`motorlens run` on drives that speak their own protocol: made-up ones at the other end of a pseudo-terminal."""

import json
import os
import select
import struct
import threading
import tty
from pathlib import Path

import numpy as np
import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime.cli import main
from motorlens_runtime.dialects import make_dialect
from motorlens_runtime.feed import LineFeed
from motorlens_runtime.sources import split

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
    """Answers in a thread of its own; every `deaf_every`-th question is not heard."""

    def __init__(self, answer, deaf_every=0):
        self._ours, self.theirs = os.openpty()
        tty.setraw(self._ours)
        tty.setraw(self.theirs)
        self.port = os.ttyname(self.theirs)
        self.questions = self.answers = self.misunderstood = 0
        self._answer, self._deaf_every = answer, deaf_every
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work)
        self._thread.start()

    def _work(self):
        while not self._stop.is_set():
            if not select.select([self._ours], [], [], 0.02)[0]:
                continue
            reply = self._answer(os.read(self._ours, 100), self.questions)
            self.questions += 1
            if reply is None:
                self.misunderstood += 1
            elif not self._deaf_every or self.questions % self._deaf_every:
                os.write(self._ours, reply)
                self.answers += 1

    def close(self):
        self._stop.set()
        self._thread.join()
        os.close(self._ours)
        os.close(self.theirs)


@pytest.mark.parametrize(("answer", "name", "each"), [(vesc, "vesc", 1), (roboclaw, "roboclaw", 3)])
@pytest.mark.parametrize("deaf_every", [0, 40])
def test_a_drive_that_must_be_asked_is_asked_and_followed(
    tmp_path, monkeypatch, answer, name, each, deaf_every
):
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx", rate_Hz=100.0)
    drive = Drive(answer, deaf_every)
    try:
        source = f"pty://{drive.port}?dialect={name}&poll_Hz=100"
        options = ["--record", "rec.csv", "--publish", "csv:out.csv", "--json", "r.json", "--duration", "2"]
        assert main(["run", "--source", source, "--sensor", "s.onnx", *options]) == 0
    finally:
        drive.close()
    report = json.loads(Path("r.json").read_text())
    assert drive.misunderstood == 0
    # Each complete round of answers is a sample; a round that lost one, and the last, may be none.
    lost_rounds = drive.questions - drive.answers + 1
    assert drive.answers // each - lost_rounds <= report["samples"] <= drive.answers // each
    assert report["samples"] > 40
    time_s, voltage, current, _ = np.loadtxt("rec.csv", delimiter=",", skiprows=1).T
    assert voltage == pytest.approx(12.0 if name == "vesc" else 24 * 16384 / 32767)
    assert current == pytest.approx(3.0)
    assert (np.diff(time_s) > 0).all()


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
    monkeypatch.setattr("motorlens_runtime.feed.open_source", lambda parts, options: source)
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
