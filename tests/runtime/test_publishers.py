"""Publishers as their consumers meet them: sockets, a real broker, the official parser, a process that maps the memory."""

import itertools
import json
import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import textwrap
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest
from helpers.ports import free_place
from helpers.processes import LIMIT_S, Program, eventually

from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.files.shared_memory import Reader, Writer
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.publish.prometheus import PrometheusPublisher
from motorlens_runtime.sensor.specification import Output
from motorlens_runtime.service.outlet import Outlet

HEADER = Header(
    'press "7"',
    "1.2",
    "ab" * 32,
    (Output("speed", "rad/s", 100.0), Output("temperature", "K", 40.0), Output("resistance", "ohm", 0.5)),
)
EVENT = {
    "event": "alarm",
    "alarm": "too hot",
    "active": True,
    "message": "temperature_rise_K is 91, above 90",
}


def estimates(first=1, n=3, quality=0):
    number = np.arange(first, first + n, dtype=np.float64)
    values = np.column_stack((number, number + 0.25, number / 8))
    return Estimates(
        (number * 1e9).astype(np.int64), values, values / 16, np.full(n, quality, dtype=np.uint32)
    )


def listening_addresses():
    """Local addresses that this process listens on, from the kernel's own tables."""
    inodes = set()
    for fd in Path("/proc/self/fd").iterdir():
        try:
            target = os.readlink(fd)
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/self/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                found.add(fields[1].rpartition(":")[0])
    return found


# UDP


def test_udp_sends_what_plotjuggler_reads():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(LIMIT_S)
        publisher = open_publisher(f"udp://127.0.0.1:{listener.getsockname()[1]}?rate=10", HEADER)
        publisher.publish(estimates(quality=Quality.STALE))
        publisher.event(EVENT)
        rows = [json.loads(listener.recv(65536)) for _ in range(4)]
        publisher.close()
    assert [row["timestamp"] for row in rows[:3]] == [1.0, 2.0, 3.0]
    assert rows[1]["speed_rad_s"] == 2.0 and rows[1]["temperature_rise_sd_K"] == 2.25 / 16
    assert rows[1]["quality"] == 4 and rows[1]["reasons"] == ["stale"]
    assert rows[3] == EVENT


def test_udp_without_a_listener_and_with_a_deaf_one_neither_waits_nor_raises():
    absent = open_publisher(f"udp://{free_place(socket.SOCK_DGRAM)}", HEADER)
    absent.publish(estimates(n=100))
    absent.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind(("127.0.0.1", 0))
        publisher = open_publisher(f"udp://127.0.0.1:{deaf.getsockname()[1]}", HEADER)
        publisher.publish(estimates(n=20_000))  # far more than the receiver's buffer
        publisher.close()
    with pytest.raises(DataError, match="unknown option 'ratee'"):
        open_publisher("udp://127.0.0.1:9?ratee=1", HEADER)


# Prometheus


def fetch(address, path):
    try:
        with urllib.request.urlopen(f"http://{address[0]}:{address[1]}{path}", timeout=LIMIT_S) as answer:
            return answer.status, answer.headers["Content-Type"], answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.headers["Content-Type"], error.read().decode()


@pytest.fixture
def prometheus():
    publisher = PrometheusPublisher(("127.0.0.1", 0), HEADER, stale_s=3600.0)
    yield publisher
    publisher.close()


def test_prometheus_text_is_what_the_official_parser_reads(prometheus):
    parser = pytest.importorskip("prometheus_client.parser", reason="prometheus_client is not installed")
    rows = estimates(quality=Quality.WARM_UP | Quality.STALE)
    rows.values[-1, 1] = math.nan
    rows.sigma[-1, 2] = math.inf
    prometheus.publish(rows)
    prometheus.event(EVENT)
    status, kind, text = fetch(prometheus.address, "/metrics")
    assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    families = {family.name: family for family in parser.text_string_to_metric_families(text)}
    sample = {name: family.samples[0] for name, family in families.items()}
    assert sample["motorlens_info"].labels["sensor"] == 'press "7"'
    assert sample["motorlens_speed_radians_per_second"].value == 3.0
    assert sample["motorlens_speed_standard_deviation_radians_per_second"].value == 3.0 / 16
    assert math.isnan(sample["motorlens_temperature_rise_kelvin"].value)
    assert math.isinf(sample["motorlens_resistance_standard_deviation_ohms"].value)
    assert sample["motorlens_rows"].value == 3 and families["motorlens_rows"].type == "counter"
    assert sample["motorlens_sample_timestamp_seconds"].value == 3.0
    reasons = {s.labels["reason"]: s.value for s in families["motorlens_quality_reason"].samples}
    assert len(reasons) == len(Quality)
    assert {name for name, on in reasons.items() if on} == {"warm_up", "stale"}
    assert sample["motorlens_alarm_active"].labels == {"alarm": "too hot"}
    assert all(name.startswith("motorlens_") for name in families)


def test_health_is_for_supervisors(prometheus):
    assert fetch(prometheus.address, "/health")[0] == 503
    assert json.loads(fetch(prometheus.address, "/health")[2])["status"] == "waiting"
    prometheus.publish(estimates())
    status, kind, text = fetch(prometheus.address, "/health?x=1")
    assert (status, kind, json.loads(text)["status"]) == (200, "application/json", "good")
    prometheus.publish(estimates(quality=Quality.WARM_UP))
    assert (
        fetch(prometheus.address, "/health")[0],
        json.loads(fetch(prometheus.address, "/health")[2])["status"],
    ) == (
        200,
        "uncertain",
    )
    prometheus.publish(estimates(quality=Quality.STUCK))
    prometheus.event(EVENT)
    document = json.loads(fetch(prometheus.address, "/health")[2])
    assert fetch(prometheus.address, "/health")[0] == 503
    assert (document["status"], document["reasons"], document["alarms"]) == ("bad", ["stuck"], ["too hot"])
    assert fetch(prometheus.address, "/etc/passwd")[0] == 404


def test_prometheus_counts_what_the_service_counts(prometheus):
    parser = pytest.importorskip("prometheus_client.parser", reason="prometheus_client is not installed")
    counts = {
        "samples": 1000,
        "lost": 7,
        "bad_frames": 2,
        "reconnects": 1,
        "time_to_limit_s": {"hot": 90.5, "cold": None},
    }
    prometheus.counts(counts)
    families = {
        f.name: f for f in parser.text_string_to_metric_families(fetch(prometheus.address, "/metrics")[2])
    }
    for name, value in (("samples", 1000), ("lost_samples", 7), ("bad_frames", 2), ("reconnects", 1)):
        family = families[f"motorlens_{name}"]
        assert family.type == "counter" and family.samples[0].value == value
    left = {s.labels["alarm"]: s.value for s in families["motorlens_time_to_limit_seconds"].samples}
    assert left == {"hot": 90.5, "cold": math.inf}


def test_health_says_stale_when_rows_stop():
    now = [100.0]
    publisher = PrometheusPublisher(("127.0.0.1", 0), HEADER, stale_s=5.0, clock=lambda: now[0])
    publisher.publish(estimates())
    now[0] += 4.9
    assert publisher.health()[0]
    now[0] += 0.2
    assert publisher.health() == (False, publisher.health()[1])
    assert publisher.health()[1]["status"] == "stale"
    # Rows that are ten seconds apart have not stopped after five.
    for _ in range(2):
        publisher.publish(estimates())
        now[0] += 10.0
    assert publisher.health()[0]
    now[0] += 10.2
    assert publisher.health()[1]["status"] == "stale"
    # An outage says nothing of how far apart rows come.
    for apart_s in (1.0, 1.0, 1000.0):
        publisher.publish(estimates())
        now[0] += apart_s
    publisher.publish(estimates())
    now[0] += 4.9
    assert publisher.health()[0]
    now[0] += 0.2
    assert publisher.health()[1]["status"] == "stale"
    publisher.close()


def test_prometheus_listens_on_this_machine_only_and_a_client_that_hangs_harms_nobody(prometheus):
    assert listening_addresses() == {"0100007F"}
    with socket.create_connection(prometheus.address) as hanging:
        hanging.sendall(b"GET /metrics HTTP/1.1\r\n")  # and nothing more
        prometheus.publish(estimates())
        assert fetch(prometheus.address, "/metrics")[0] == 200
    with pytest.raises(DeviceError, match="cannot listen there"):
        open_publisher(f"prometheus://127.0.0.1:{prometheus.address[1]}", HEADER)


# MQTT

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
needs_broker = pytest.mark.skipif(MOSQUITTO is None, reason="no mosquitto here (apt-get install mosquitto)")


class Broker:
    def __init__(self, folder):
        self.place = free_place()
        host, _, port = self.place.partition(":")
        self._config = folder / "mosquitto.conf"
        self._config.write_text(f"listener {port} {host}\nallow_anonymous true\npersistence false\n")
        self.process = None

    def start(self):
        self.process = subprocess.Popen(
            [MOSQUITTO, "-c", str(self._config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        eventually(self._answers, "the broker's answer")

    def _answers(self):
        try:
            socket.create_connection(self.place.split(":"), timeout=LIMIT_S).close()
        except OSError:
            return False
        return True

    def stop(self):
        if self.process is not None:
            self.process.terminate()
            self.process.wait(LIMIT_S)
            self.process = None


class Listener:
    """A client of another make than ours would be better; this one at least shares nothing but paho."""

    def __init__(self, place):
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion

        self.seen, self.retained = [], {}
        self.client = Client(CallbackAPIVersion.VERSION2)
        self.client.on_message = self._take
        self.client.on_connect = lambda client, *_: client.subscribe("#", qos=1)
        host, _, port = place.partition(":")
        self.client.connect(host, int(port))
        self.client.loop_start()

    def _take(self, client, data, message):
        self.seen.append((message.topic, message.payload.decode()))
        self.retained[message.topic] = message.payload.decode()

    def of(self, topic):
        return [payload for name, payload in list(self.seen) if name == topic]

    def until(self, topic, value, *programs):
        eventually(lambda: self.retained.get(topic) == value, f"{topic} to be {value!r}", *programs)

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


@pytest.fixture
def broker(tmp_path):
    pytest.importorskip("paho.mqtt", reason="the extra `publish` is not installed")
    broker = Broker(tmp_path)
    broker.start()
    yield broker
    broker.stop()


@needs_broker
def test_mqtt_announces_a_homie_device_and_keeps_its_values(broker):
    listener = Listener(broker.place)
    publisher = open_publisher(f"mqtt://{broker.place}?device=Press%207&rate=10", HEADER)
    base = "homie/5/press-7"
    listener.until(f"{base}/$state", "ready")
    assert listener.of(f"{base}/$state") == ["init", "ready"]
    document = json.loads(listener.retained[f"{base}/$description"])
    assert document["homie"] == "5.0" and isinstance(document["version"], int)
    properties = document["nodes"]["motor"]["properties"]
    assert properties["temperature"] == {
        "name": "Temperature",
        "datatype": "float",
        "unit": "K",
        "settable": False,
    }
    publisher.publish(estimates(quality=Quality.STALE))
    eventually(lambda: f"{base}/motor/quality-word" in listener.retained, "the quality word")
    values = {name: listener.retained[f"{base}/motor/{name}"] for name in properties}
    assert float(values["speed"]) == 3.0 and float(values["speed-standard-deviation"]) == 3.0 / 16
    assert values["quality"] in properties["quality"]["format"].split(",")
    assert values["quality"] == "uncertain_last_usable"
    rows = [json.loads(text) for text in listener.of("motorlens/press-7/estimates")]
    assert [row["timestamp"] for row in rows] == [1.0, 2.0, 3.0]
    # An alarm stands for as long as it is on; whoever comes later sees it too.
    publisher.event(EVENT)
    eventually(lambda: f"{base}/$alert/too-hot" in listener.retained, "the alarm")
    late = Listener(broker.place)
    late.until(f"{base}/$alert/too-hot", EVENT["message"])
    publisher.event({**EVENT, "active": False})
    late.until(f"{base}/$alert/too-hot", "")
    publisher.close()
    late.until(f"{base}/$state", "disconnected")
    assert publisher.dropped == 0
    late.close()
    listener.close()


@needs_broker
def test_mqtt_last_will_says_lost_when_the_process_is_killed(broker):
    script = f"""
        import sys, time
        sys.path[:0] = {[str(folder) for folder in list(Path(__file__).parents)[:2]]!r}
        import test_publishers as t
        publisher = t.open_publisher("mqtt://{broker.place}?device=m", t.HEADER)
        while True:
            publisher.publish(t.estimates())
            time.sleep(0.05)
    """
    listener = Listener(broker.place)
    with Program([sys.executable, "-c", textwrap.dedent(script)]) as program:
        listener.until("homie/5/m/$state", "ready", program)
    listener.until("homie/5/m/$state", "lost")
    listener.close()


@needs_broker
def test_mqtt_without_a_broker_drops_and_counts_and_comes_back(broker):
    broker.stop()
    publisher = open_publisher(f"mqtt://{broker.place}?device=m", HEADER)
    publisher.publish(estimates())
    publisher.event(EVENT)
    assert publisher.dropped == 12  # 3 rows, 6 values, 2 words of quality, 1 event
    broker.start()
    listener = Listener(broker.place)
    listener.until("homie/5/m/$state", "ready")
    # The alarm that was raised while nobody listened is told now.
    listener.until("homie/5/m/$alert/too-hot", EVENT["message"])
    publisher.publish(estimates(first=7, n=1))
    listener.until("homie/5/m/motor/speed", "7.0")
    publisher.close()
    listener.close()


@needs_broker
def test_mqtt_with_a_broker_that_stops_reading_holds_bounded_memory(broker):
    from motorlens_runtime.publish import mqtt

    publisher = open_publisher(f"mqtt://{broker.place}?device=m", HEADER)
    eventually(lambda: publisher._ready, "the connection")
    broker.process.send_signal(signal.SIGSTOP)
    try:
        for k in range(300):
            publisher.publish(estimates(first=100 * k, n=100))
        assert publisher.dropped > 0
        assert publisher._waiting <= mqtt._MOST_WAITING
        assert len(publisher._client._out_packet) <= mqtt._MOST_WAITING + 10
    finally:
        broker.process.send_signal(signal.SIGCONT)
    publisher.close()


# Shared memory


def columns_of(path):
    return open_publisher(f"shm:{path}?rows=8", HEADER)


def test_shared_memory_holds_the_newest_rows(tmp_path):
    path = tmp_path / "ring"
    publisher = columns_of(path)
    reader = Reader(path)
    assert reader.latest() is None
    assert reader.columns["values"] == ["speed_rad_s", "temperature_rise_K", "resistance_ohm"]
    publisher.publish(estimates(first=1, n=5, quality=Quality.BRIDGED))
    row = reader.latest()
    assert (row.number, row.time_ns, row.quality) == (5, 5_000_000_000, 2)
    assert row.values.tolist() == [5.0, 5.25, 0.625] and row.sigma.tolist() == [5 / 16, 5.25 / 16, 0.625 / 16]
    rows, lost = reader.since_last()
    assert rows["values"][:, 0].tolist() == [1, 2, 3, 4, 5] and lost == 0
    publisher.publish(estimates(first=6, n=20))  # more than the ring holds
    rows, lost = reader.since_last()
    assert rows["values"][:, 0].tolist() == list(range(18, 26)) and lost == 12
    assert reader.since_last()[0].size == 0
    for k in range(30):
        publisher.publish(estimates(first=26 + 3 * k, n=3))
        assert reader.latest().values[0] == 28 + 3 * k
    assert not reader.replaced()
    publisher.close()
    assert reader.replaced()
    assert reader.latest().values[0] == 115  # what was there can still be read
    reader.close()


def test_shared_memory_is_one_writers_and_is_taken_over_from_a_dead_one(tmp_path):
    path = tmp_path / "ring"
    script = f"""
        import sys
        sys.path[:0] = {[str(folder) for folder in list(Path(__file__).parents)[:2]]!r}
        import test_publishers as t
        publisher = t.columns_of({str(path)!r})
        publisher.publish(t.estimates(first=41, n=2))
        print("ready", flush=True)
        sys.stdin.read()
    """
    with Program([sys.executable, "-c", textwrap.dedent(script)], stdin=subprocess.PIPE) as program:
        assert program.line() == "ready"
        reader = Reader(path)
        assert reader.writer_pid == program.pid and reader.latest().values[0] == 42
        with pytest.raises(DeviceError, match=f"process {program.pid} publishes there already"):
            columns_of(path)
    publisher = columns_of(path)
    assert reader.replaced() and reader.latest().values[0] == 42
    assert Reader(path).latest() is None
    publisher.close()
    path.write_bytes(b"a letter to my aunt" * 20)
    with pytest.raises(DeviceError, match="file of another kind"):
        columns_of(path)
    with pytest.raises(DataError, match="is not the shared memory"):
        Reader(path)


@pytest.mark.fit
def test_shared_memory_reader_never_sees_half_a_row(tmp_path):
    """A writer that runs free while another process reads: every row read is one that was written."""
    path = tmp_path / "ring"
    writer = Writer(path, {}, outputs=3, capacity=4)
    script = f"""
        from motorlens_runtime.files.shared_memory import Reader
        reader = Reader({str(path)!r})
        print("ready", flush=True)
        seen = set()
        while len(seen) < 400:
            row = reader.latest()
            if row is not None:
                assert row.values.tolist() == [row.number] * 3 and row.sigma.tolist() == [-row.number] * 3, row
                assert row.time_ns == 7 * row.number
                seen.add(row.number)
            rows, _ = reader.since_last()
            assert (rows["values"].T == rows["number"]).all()
    """
    with Program([sys.executable, "-c", textwrap.dedent(script)]) as program:
        assert program.line() == "ready"
        number, end = 0, time.monotonic() + LIMIT_S
        while program.returncode is None and time.monotonic() < end:
            number += 1
            row = np.full((1, 3), float(number))
            writer.write(np.array([7 * number]), row, -row, np.zeros(1, dtype=np.uint32))
        assert program.ended() == 0, program.told()
    writer.close()


def test_rows_gather_for_a_file_and_all_are_written(tmp_path):
    """A thousand rows, one at a time: a write for what came in each pause of 20 ms, none late, none lost, in order."""
    outlet = Outlet(f"csv:{tmp_path}/out.csv", HEADER)
    publisher, path = outlet._publisher, tmp_path / "out.csv"
    published, flushes = [], []
    publish, flush = publisher.publish, publisher.flush

    def flushed():
        begun_s = time.monotonic()
        flush()
        flushes.append((begun_s, time.monotonic(), len(published), len(path.read_text().splitlines()) - 1))

    publisher.publish = lambda rows: (publish(rows), published.extend(rows.time_ns.tolist()))
    publisher.flush = flushed
    for k in range(1000):
        outlet.put(estimates(k + 1, 1))
        time.sleep(0.0002)
    eventually(lambda: flushes and flushes[-1][2] == 1000, "all rows")  # before it is closed
    before_close = flushes.copy()
    outlet.close(LIMIT_S)
    times = [float(line.split(",")[0]) for line in path.read_text().splitlines()[1:]]
    assert times == sorted(times) and len(times) == 1000
    # However long it all took: whoever writes has paused before, and then leaves nothing behind.
    assert all(after[0] - before[1] >= 0.019 for before, after in itertools.pairwise(before_close))
    assert all(rows == written for _, _, rows, written in flushes)
    assert len(before_close) >= 2 and outlet.report().dropped == 0
