"""A line that falls silent and comes back, in a service whose clock the test moves: what is published, told and withheld."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import OpcUa, Quality, opc_ua, sparkplug
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service.alarms import Watch, parse_alarm
from motorlens_runtime.service.service import Service, Settings

pytestmark = pytest.mark.usefixtures("engine")

RATE_HZ, BLOCK = 1000, 50
# Samples for a second, nothing for ten, samples for two.
SPOKEN_S, SILENT_S, SPOKEN_AGAIN_S = 1.0, 10.0, 2.0


class Line:
    """A feed of blocks of 50 ms; each read moves the clock by as much."""

    live, period_s, device, decoder, ambient_C = True, 1 / RATE_HZ, "bench", None, None

    def __init__(self):
        self.now_ns = self.arrival_ns = 0
        self.down = None

    def read(self, timeout_s):
        self.now_ns += 50_000_000
        now_s = self.now_ns * 1e-9
        if SPOKEN_S < now_s <= SPOKEN_S + SILENT_S:
            self.down = "/dev/ttyUSB0: no such port"
            return Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        if now_s > SPOKEN_S + SILENT_S + SPOKEN_AGAIN_S:
            return None
        self.down, self.arrival_ns = None, self.now_ns
        time_ns = self.now_ns + (np.arange(BLOCK) - BLOCK + 1) * 1_000_000
        return Samples(time_ns, 100 + np.arange(BLOCK) / 8, np.full(BLOCK, 8.0))

    def report(self):
        return {}


class Page:
    """An outlet that keeps what it is given."""

    dead = False

    def __init__(self):
        self.rows, self.values, self.inputs, self.events, self.counted = [], [], [], [], []

    def put(self, estimates, inputs=None):
        self.values += estimates.values[:, 0].tolist()
        self.rows += zip(estimates.time_ns.tolist(), estimates.quality.tolist(), strict=True)
        self.inputs += [None] * len(estimates) if inputs is None else inputs.tolist()

    def put_event(self, event):
        self.events.append(event)

    def put_counts(self, counts):
        self.counted.append(counts)

    def report(self):
        return SimpleNamespace()


@pytest.fixture
def page(tmp_path):
    write_sensor(tmp_path / "s.onnx")
    sensor = load_sensor(str(tmp_path / "s.onnx"))
    line, page = Line(), Page()
    watch = Watch([parse_alarm("speed>1e6,within_s=10,window_s=0.1", sensor.specification)])
    Service(line, sensor, [page], None, Settings(rate_Hz=0), lambda: line.now_ns, watch=watch).run(
        lambda: False
    )
    return page


def words(page, begin_s, end_s):
    found = [word for time_ns, word in page.rows if begin_s <= time_ns * 1e-9 < end_s]
    assert found
    return found


def test_what_a_dead_line_gives_is_bad_and_says_so_until_it_has_been_back_for_a_second(page):
    lost, stale = int(Quality.LINE_LOST), int(Quality.STALE)
    assert not any(word & (lost | stale) for word in words(page, 0.0, 1.0))
    assert all(word & stale and not word & lost for word in words(page, 1.01, 2.99))
    assert all(word & stale and word & lost for word in words(page, 3.01, 10.99))
    assert all(word & stale and word & lost for word in words(page, 11.0005, 11.99))
    assert not any(word & (lost | stale) for word in words(page, 12.1, 13.0))


def test_the_value_stays_the_last_one_until_the_new_ones_have_settled(page):
    fresh = [k for k, (_, word) in enumerate(page.rows) if not word & Quality.STALE]
    begin, end = 1000, len(page.rows) - (SPOKEN_AGAIN_S - 1) * RATE_HZ
    assert len(fresh) == 2000 and not any(begin <= k < end for k in fresh)
    assert set(page.values[begin : int(end)]) == {page.values[999]}
    assert len(set(page.values[int(end) :])) > 100


def test_loss_and_return_are_events_with_their_time(page):
    lost, back = page.events
    assert (lost["event"], lost["timestamp"]) == ("line_lost", pytest.approx(1.0))
    assert lost["message"] == "line lost: no sample for 2.0 s: /dev/ttyUSB0: no such port"
    assert (back["event"], back["timestamp"]) == ("line_back", pytest.approx(11.001))
    assert back["message"] == "line back: samples come again after 10.1 s"


def test_no_time_to_a_limit_is_told_while_the_line_is_lost(page):
    told = [(counts["line_lost"], counts["time_to_limit_s"]["speed within 10 s"]) for counts in page.counted]
    assert any(lost for lost, _ in told) and all(left is None for lost, left in told if lost)
    assert page.counted[0]["limits"] == [
        {"name": "speed within 10 s", "column": 0, "heading": "speed_rad_s", "side": 1, "limit": 1e6}
    ]


def test_voltage_and_current_go_along_while_they_come(page):
    for (time_ns, _), pair in zip(page.rows, page.inputs, strict=True):
        if 1.0 < time_ns * 1e-9 < 11.0005:
            assert pair is None
        else:
            k = (time_ns // 1_000_000 - 1) % BLOCK
            assert pair == [100 + k / 8, 8.0]


class Starved(Line):
    """A line that speaks on; but after each block, and after each look at which there was nothing yet, this process waits
    a second for a processor."""

    def __init__(self):
        super().__init__()
        self.looks = 0

    def read(self, timeout_s):
        self.looks += 1
        if self.looks % 2:
            self.now_ns += 1_000_000_000
            return Samples(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))
        if self.looks > 20:
            return None
        self.arrival_ns = self.now_ns
        time_ns = self.now_ns + (np.arange(1000) - 999) * 1_000_000
        return Samples(time_ns, 100 + np.arange(1000) / 8, np.full(1000, 8.0))


def test_a_process_that_waits_for_a_processor_does_not_take_that_for_silence_of_the_line(tmp_path):
    """What came meanwhile is there at the next look: 10 000 samples, 10 000 rows."""
    write_sensor(tmp_path / "s.onnx")
    line, page = Starved(), Page()
    sensor = load_sensor(str(tmp_path / "s.onnx"))
    Service(line, sensor, [page], None, Settings(rate_Hz=0), lambda: line.now_ns).run(lambda: False)
    assert len(page.rows) == 10_000 and not page.events
    assert not any(word & (Quality.STALE | Quality.LINE_LOST) for _, word in page.rows)


def test_other_systems_call_it_bad_or_stale():
    assert opc_ua(Quality.LINE_LOST | Quality.STALE) is OpcUa.BAD_NO_COMMUNICATION == 0x80310000
    assert sparkplug(Quality.LINE_LOST) == 500
