"""The live page: what a browser receives is what the publishers write, from a run of its own or one it attaches to."""

import csv
import itertools
import json
import math
import os
import re
import signal
import socket
import threading
import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.ports import free_place
from helpers.processes import LIMIT_S, MOTORLENS, Program, eventually
from helpers.sensor_files import write_sensor
from helpers.wire_device import WireDevice

from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError, DeviceError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.monitor.attach import attach
from motorlens_runtime.monitor.history import History
from motorlens_runtime.monitor.motor import WORDS
from motorlens_runtime.monitor.page import FILES, MonitorPage
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.sensor.specification import Output

HEADER = Header(
    "bench",
    "1.2",
    "ab" * 32,
    (Output("speed", "rad/s", 100.0), Output("temperature", "K", 40.0), Output("resistance", "ohm", 0.5)),
)
HEADINGS = [(output.heading, output.sd_heading) for output in HEADER.outputs]
RUBBISH = (
    b"", b"\xff", b"[" * 5000, b"[]", b'{"timestamp": "x"}', b'{"timestamp": 1e300}', b'{"event": 3}',
    b'{"event": "alarm", "message": "m"}', b'{"timestamp": 4.0, "speed_rad_s": [1], "quality": -1}',
)  # fmt: skip
ALARM = {"event": "alarm", "alarm": "hot", "active": True, "timestamp": 2.0, "message": "91, above 90"}


def rows(time_s, quality=0, seed=0):
    rng = np.random.default_rng(seed)
    n = len(time_s)
    words = np.broadcast_to(np.asarray(quality, dtype=np.uint32), n).copy()
    return Estimates(
        np.round(np.asarray(time_s) * 1e9).astype(np.int64),
        rng.normal(size=(n, 3)),
        rng.random((n, 3)),
        words,
    )


def ask(page, path, **headers):
    request = urllib.request.Request(page.url.partition("?")[0].rstrip("/") + path, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=LIMIT_S) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def key(url):
    return {"Authorization": f"Bearer {url.partition('token=')[2]}"}


def live(page, window=60, level=-1, after=0):
    """All that the page's script gathers, in as many answers as it takes."""
    gathered = None
    while True:
        status, body = ask(page, f"/live?window={window}&level={level}&after={after}", **key(page.url))
        assert status == 200, body
        found = json.loads(body)
        level, after = found["level"], found["after"]
        assert len(found["time_s"]) <= 200
        if gathered is not None:
            assert found["first"] == gathered["after"]
            found["time_s"] = gathered["time_s"] + found["time_s"]
            for name in ("values", "sigma"):
                found[name] = [old + new for old, new in zip(gathered[name], found[name], strict=True)]
        gathered = found
        if not found["more"]:
            return found


@pytest.fixture
def page():
    page = MonitorPage(HEADER, wall_clock=lambda: 5000.0)
    yield page
    page.close()


# What is kept


@pytest.mark.parametrize("block", [1, 7, 500])
def test_means_over_bins_are_those_of_a_slow_reading_however_rows_arrive(block):
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.01, 0.7, 2000))
    reasons = rng.choice([0, int(Quality.BRIDGED), int(Quality.JUMP)], 2000)
    given = rows(time_s, reasons)
    history = History(3, rows=300, bins_s=(1.0, 20.0))
    for start in range(0, 2000, block):
        part = slice(start, start + block)
        history.append(
            Estimates(given.time_ns[part], given.values[part], given.sigma[part], given.quality[part])
        )
    assert history.view(10.0).level == 0 and history.view(200.0).level == 1
    coarse = history.view(1e4)
    assert coarse.level == 2
    bins = (given.time_ns // 20_000_000_000).tolist()
    for k, number in enumerate(sorted(set(bins))[:-1]):  # the last bin is not complete
        inside = [j for j, b in enumerate(bins) if b == number]
        assert coarse.rows.time_ns[k] == number * 20_000_000_000 + 10_000_000_000
        for column in range(3):
            mean = sum(float(given.values[j, column]) for j in inside) / len(inside)
            assert coarse.rows.values[k, column] == pytest.approx(mean, rel=1e-12, abs=1e-12)
            mean = sum(float(given.sigma[j, column]) for j in inside) / len(inside)
            assert coarse.rows.sigma[k, column] == pytest.approx(mean, rel=1e-12)
        word = 0
        for j in inside:
            word |= int(reasons[j])
        assert coarse.rows.quality[k] == word
    assert len(coarse.rows) == len(set(bins)) - 1


def test_new_rows_only_are_given_to_a_reader_that_has_the_others():
    history = History(3, rows=100)
    given = rows(np.arange(250) / 10)
    seen, level, after = [], -1, 0
    for start in range(0, 250, 10):
        history.append(rows_between(given, start, start + 10))
        view = history.view(5.0, level, after)
        seen += view.rows.time_ns.tolist()
        level, after = view.level, view.after
    assert seen == given.time_ns.tolist()
    assert len(history.view(5.0, level, after).rows) == 0
    assert history.view(5.0).rows.time_ns.tolist() == given.time_ns[-51:].tolist()


def widened(given, inputs):
    """Rows as an outlet hands them to the page, with voltage and current beside the estimates."""
    values, sigma = np.hstack((given.values, inputs)), np.hstack((given.sigma, 0 * inputs))
    return Estimates(given.time_ns, values, sigma, given.quality)


def rows_between(given, start, stop):
    part = slice(start, stop)
    return Estimates(given.time_ns[part], given.values[part], given.sigma[part], given.quality[part])


def test_a_stream_that_begins_again_starts_anew_and_a_small_step_back_is_left_out():
    history = History(3)
    history.append(rows([10.0, 11.0, 12.0]))
    history.append(rows([11.5, 12.5]))
    assert history.view(60.0).rows.time_ns.tolist() == [10**10, 11 * 10**9, 12 * 10**9, 125 * 10**8]
    history.append(rows([0.0, 0.5]))
    assert history.view(60.0).rows.time_ns.tolist() == [0, 5 * 10**8]


# The page


def test_the_page_is_given_rows_events_and_counts(page):
    given = rows([1.0, 1.5, 2.0], [0, int(Quality.STALE), int(Quality.SIMULATED | Quality.WARM_UP)])
    given.values[1, 0] = math.nan
    given.sigma[2, 1] = math.inf
    assert "latest" not in live(page)
    page.publish(given)
    page.event(ALARM)
    page.counts({"samples": 30, "lost": 2, "time_to_limit_s": {"hot": None}})
    found = live(page)
    assert found["time_s"] == [1.0, 1.5, 2.0]
    assert found["values"][1] == given.values[:, 1].tolist() and found["values"][0][1] is None
    assert found["values"][3] == found["values"][4] == [None] * 3  # no voltage and no current has come
    assert found["sigma"][0] == given.sigma[:, 0].tolist() and found["sigma"][1][2] is None
    assert found["doubt"] == [0, 1, 1]
    assert found["latest"]["reasons"] == ["warm_up", "simulated"] and found["latest"]["status"] == "uncertain"
    assert found["counts"] == {"samples": 30, "lost": 2, "time_to_limit_s": {"hot": None}}
    assert found["alarms"] == found["events"] == [{**ALARM, "at": 5000.0}] and found["rows"] == 3
    assert found["latest"]["fresh_at"] == 5000.0 and found["offset_s"] == 4998.0
    page.event({**ALARM, "active": False})
    assert live(page)["alarms"] == [] and len(live(page)["events"]) == 2
    assert live(page, 60, found["level"], found["after"])["time_s"] == []


def test_many_rows_come_in_several_answers(page):
    given = rows(np.arange(4000) / 100)
    page.publish(given)
    found = live(page)
    assert found["time_s"] == (given.time_ns / 1e9).tolist()
    assert np.array_equal(np.array(found["values"][:3]).T, given.values)
    assert np.array_equal(np.array(found["sigma"][:3]).T, given.sigma)


def test_every_reason_has_words():
    assert set(WORDS) == set(Quality) and len(set(WORDS.values())) == len(Quality)


def test_only_its_own_files_and_only_with_the_key(page):
    assert ask(page, "/live")[0] == 403 and ask(page, "/")[0] == 403
    for path in (*FILES, "/about", "/motors"):
        assert ask(page, path, **key(page.url))[0] == 200
    for path in ("/../page.py", "/page.py", "/%2e%2e/page.py", "//etc/passwd", "/history.py"):
        assert ask(page, path, **key(page.url))[0] == 404
    for window in ("much", "nan", "inf", "-inf"):
        assert ask(page, f"/live?window={window}", **key(page.url))[0] == 400
    # Nothing is fetched from elsewhere: the page works on a PC without a network.
    for path in [path for path in FILES if "uPlot" not in path]:
        assert b"http" not in ask(page, path, **key(page.url))[1]


def post(page, path, document):
    headers = {"Content-Type": "application/json", **key(page.url)}
    request = urllib.request.Request(
        page.url.partition("?")[0].rstrip("/") + path, json.dumps(document).encode(), headers, method="POST"
    )
    try:
        with urllib.request.urlopen(request, timeout=LIMIT_S) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_a_limit_set_on_the_page_is_watched_and_told(page):
    asked = {"motor": 0, "quantity": "speed_rad_s", "side": ">", "limit": 150}
    assert post(page, "/limit", asked)[0] == 200
    page.counts(
        {"limits": [{"name": "hot", "column": 1, "heading": "temperature_rise_K", "side": 1, "limit": 90.0}]}
    )
    assert [(limit["name"], limit["limit"], limit.get("own")) for limit in live(page)["limits"]] == [
        ("hot", 90.0, None), ("speed > 150", 150.0, True),
    ]  # fmt: skip
    given = rows(np.arange(6.0))
    given.values[:, 0] = [100, 149, 151, 152, 148, 142]  # off below 142.5, a twentieth of the limit
    page.publish(rows_between(given, 0, 4))
    assert [(event["alarm"], event["timestamp"]) for event in live(page)["alarms"]] == [("speed > 150", 2.0)]
    page.publish(rows_between(given, 4, 6))
    assert live(page)["alarms"] == []
    assert [(event["active"], event["timestamp"]) for event in live(page)["events"]] == [
        (True, 2.0),
        (False, 5.0),
    ]
    assert post(page, "/limit", {"motor": 0, "remove": "speed > 150"})[0] == 200
    assert [limit["name"] for limit in live(page)["limits"]] == ["hot"]


@pytest.mark.parametrize(
    ("path", "document", "said"),
    [("/limit", {**{"quantity": "speed", "side": ">"}, "limit": "much"}, "are numbers"),
     ("/limit", {"quantity": "torque", "side": ">", "limit": 1}, "does not estimate 'torque'"),
     ("/limit", {"quantity": "speed", "side": "=", "limit": 1}, "write QUANTITY>NUMBER"),
     ("/limit", {"quantity": "speed", "side": ">", "limit": math.nan}, "write QUANTITY>NUMBER"),
     ("/limit", {"motor": 7, "remove": "x"}, "there is no motor 7"), ("/limit", [1], "are numbers"),
     ("/record", {}, "are numbers"), ("/record", {"motor": None, "on": True}, "are numbers")],
)  # fmt: skip
def test_what_the_page_may_not_ask_is_said(page, path, document, said):
    status, text = post(page, path, document)
    assert status == 400 and said in text
    assert ask(page, path, **key(page.url))[0] == 404


def test_a_recording_holds_every_row_from_start_to_stop(page):
    given = rows(np.arange(500) / 20, int(Quality.BRIDGED))
    given.values[7, 1] = math.nan
    wide = widened(given, np.arange(1000.0).reshape(500, 2))
    assert ask(page, "/recording.csv", **key(page.url))[0] == 404
    for start, stop in ((0, 100), (100, 300), (300, 400)):
        if start:
            assert post(page, "/record", {"motor": 0, "on": start == 100})[0] == 200
        page.publish(rows_between(wide, start, stop))
    assert live(page)["recording"] == {"on": False, "rows": 200, "there": True}
    table = list(csv.DictReader(ask(page, "/recording.csv", **key(page.url))[1].decode().splitlines()))
    assert [float(row["time_s"]) for row in table] == (given.time_ns[100:300] / 1e9).tolist()
    for k, (heading, sd_heading) in enumerate(HEADINGS):
        assert [float(row[heading]) for row in table] == given.values[100:300, k].tolist()
        assert [float(row[sd_heading]) for row in table] == given.sigma[100:300, k].tolist()
    assert [float(row["current_A"]) for row in table] == np.arange(1000.0).reshape(500, 2)[
        100:300, 1
    ].tolist()
    assert {row["quality"] for row in table} == {str(int(Quality.BRIDGED))}


def test_rows_keep_their_distances_though_the_devices_clock_is_fast():
    wall_s = [5000.0]
    page = MonitorPage(HEADER, wall_clock=lambda: wall_s[0])
    for k in range(10):  # ten times as fast as the wall clock
        page.publish(rows([10.0 * k]))
        wall_s[0] += 1.0
    assert live(page)["offset_s"] == 5000.0
    page.publish(rows([0.0]))  # the stream begins again
    assert live(page)["offset_s"] == 5010.0
    page.close()


def test_several_motors_keep_apart():
    page = MonitorPage(HEADER, name="press")
    saw = page.add(HEADER, "saw")
    page.publish(rows([1.0, 2.0]))
    saw.publish(rows([7.0], seed=1))
    saw.event(ALARM)
    motors = json.loads(ask(page, "/motors", **key(page.url))[1])["motors"]
    assert [(motor["motor"], motor["latest"]["time_s"], motor["alarms"]) for motor in motors] == [
        ("press", 2.0, 0), ("saw", 7.0, 1),
    ]  # fmt: skip
    for number, times in enumerate(([1.0, 2.0], [7.0])):
        found = json.loads(ask(page, f"/live?motor={number}", **key(page.url))[1])
        assert found["time_s"] == times
        about = json.loads(ask(page, f"/about?motor={number}", **key(page.url))[1])
        assert about["motor"] == ("press", "saw")[number]
    assert ask(page, "/live?motor=2", **key(page.url))[0] == 400
    page.close()


def test_the_publisher_serves_this_machine_only(capsys):
    with pytest.raises(DataError, match="this machine only"):
        open_publisher("web://0.0.0.0:9465", HEADER)
    with pytest.raises(DataError, match="no option 'tokenn'"):
        open_publisher("web://127.0.0.1?tokenn=x", HEADER)
    served = open_publisher("web://127.0.0.1?token=&rate=5", HEADER)
    assert capsys.readouterr().err == f"motorlens monitor: {served.url}\n"
    assert ask(served, "/about")[0] == 200
    served.close()


def test_a_key_that_stays_is_in_a_file_of_its_user_and_on_no_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    urls = []
    for _ in range(2):
        served = open_publisher("web://127.0.0.1?key_file=key", HEADER)
        urls.append(served.url.partition("token=")[2])
        assert served.url.partition("token=")[2] not in served.url_for_once()
        served.close()
    assert urls[0] == urls[1] == (tmp_path / "key").read_text().strip()
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    (tmp_path / "key").chmod(0o644)
    for url, said in (
        ("?key_file=key", "chmod 600"),
        ("?key_file=no/key", "No such"),
        ("?token=abc", "key_file=FILE"),
    ):
        with pytest.raises(DataError, match=said):
            open_publisher(f"web://127.0.0.1{url}", HEADER)
    (tmp_path / "key").write_text("short")
    (tmp_path / "key").chmod(0o600)
    with pytest.raises(DataError, match="16 characters"):
        open_publisher("web://127.0.0.1?key_file=key", HEADER)


# A run of its own


@pytest.mark.fit
def test_a_run_shows_what_its_other_publishers_write(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx")
    with WireDevice(1000, 10, count=300) as device:
        command = [
            *MOTORLENS, "monitor", "--source", f"pty://{device.path}", "--sensor", "s.onnx", "--no-browser",
            "--publish", "jsonl:rows.jsonl?rate=20", "--alarm", "speed>-1e9", "--json", "report.json",
        ]  # fmt: skip
        with Program(command) as program:
            opened = type("Page", (), {"url": re.search(r"http://\S+", program.line(of_error=True))[0]})
            device.start_when_open()
            eventually(lambda: device.sent == device.count, "all is sent", program)
            found = eventually(
                lambda: (f := live(opened))["counts"].get("samples") == 3000 and f, "3000 samples", program
            )
            status, _ = ask(opened, "/live")
            assert status == 403
            program.send(signal.SIGINT)
            assert program.ended() == 0, program.told()
    with open("rows.jsonl") as file:
        written = [row for row in map(json.loads, file) if "event" not in row and row["timestamp"] < 3.0]
    assert len(written) == 60
    for row in written:
        k = found["time_s"].index(row["timestamp"])
        for column, (heading, sd_heading) in enumerate(HEADINGS):
            assert found["values"][column][k] == row[heading] and found["sigma"][column][k] == row[sd_heading]
    volts = dict(zip(found["time_s"], found["values"][3], strict=True))
    for k in range(0, 3000, 50):
        assert volts[k / 1000] == 0.13 * float(device.codes[k, 0])
    assert found["counts"]["lost"] == 0 and found["counts"]["device"] == "bench"
    assert [event["alarm"] for event in found["events"]] == ["speed > -1e+09"]
    with open("report.json") as file:
        assert json.load(file)["samples"] == 3000


# Attached to one


def publish_until(publisher, stop, given):
    while not stop.is_set():
        publisher.publish(given())
        publisher.flush()
        time.sleep(0.02)


def test_attached_to_shared_memory_every_row_comes(tmp_path):
    path = tmp_path / "ring"
    writer = open_publisher(f"shm:{path}", HEADER)
    given = rows(np.arange(500) / 100, int(Quality.WARM_UP))
    writer.publish(rows_between(given, 0, 100))
    there = attach(f"shm:{path}")
    assert [output.heading for output in there.header.outputs] == [
        output.heading for output in HEADER.outputs
    ]
    assert there.header.sensor == "bench"
    first = there.read(0.1)
    writer.publish(rows_between(given, 100, 500))
    second = there.read(0.1)
    joined = np.vstack((first.rows.values, second.rows.values))
    assert np.array_equal(joined, given.values) and second.counts == {"published": 500, "missed": 0}
    assert np.array_equal(np.r_[first.rows.time_ns, second.rows.time_ns], given.time_ns)
    assert (second.rows.quality == int(Quality.WARM_UP)).all()
    # The runtime is started again: a new ring in the same place.
    writer.close()
    assert there.read(0.0).rows is None
    again = open_publisher(f"shm:{path}", HEADER)
    again.publish(rows([0.0]))
    found = eventually(lambda: there.read(0.0).rows, "a row of the new ring")
    assert found.time_ns.tolist() == [0]
    there.close()
    again.close()


def test_attached_to_prometheus_it_has_the_newest_row_alarms_and_counts():
    place = free_place()
    publisher = open_publisher(f"prometheus://{place}", HEADER)
    given = rows([1.0, 2.0], int(Quality.BRIDGED))
    given.values[1, 0] = math.nan
    publisher.publish(given)
    publisher.event({**ALARM, "alarm": 'too "hot"'})
    publisher.counts(
        {
            "samples": 20,
            "lost": 3,
            "bad_frames": 1,
            "reconnects": 0,
            "time_to_limit_s": {"a": 12.5, "b": None},
        }
    )
    there = attach(f"http://{place}")
    assert there.header.sensor == "bench" and len(there.header.outputs) == 3
    news = there.read(0.0)
    assert news.rows.time_ns.tolist() == [2 * 10**9] and news.rows.quality.tolist() == [int(Quality.BRIDGED)]
    assert math.isnan(news.rows.values[0, 0]) and news.rows.values[0, 1] == given.values[1, 1]
    assert np.array_equal(news.rows.sigma[0], given.sigma[1])
    assert [(e["alarm"], e["active"]) for e in news.events] == [('too "hot"', True)]
    assert news.counts == {
        "samples": 20, "lost": 3, "bad_frames": 1, "reconnects": 0, "published": 2,
        "time_to_limit_s": {"a": 12.5, "b": None},
    }  # fmt: skip
    again = there.read(0.0)
    assert again.rows is None and again.events == []
    publisher.close()
    assert there.read(0.0).rows is None


def test_attached_to_datagrams_rows_and_events_come_and_rubbish_does_not():
    place = free_place(socket.SOCK_DGRAM)
    given, stop = rows([1.0, 2.0, 3.0], int(Quality.STUCK)), threading.Event()
    publisher = open_publisher(f"udp://{place}", HEADER)
    thread = threading.Thread(target=publish_until, args=(publisher, stop, lambda: given))
    thread.start()
    there = attach(f"udp://{place}")
    stop.set()
    thread.join()
    eventually(lambda: there.read(0.01).rows is None, "the last row")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        host, _, port = place.partition(":")
        for rubbish in RUBBISH:
            out.sendto(rubbish, (host, int(port)))
    publisher.publish(given)
    publisher.event(ALARM)
    time.sleep(0.1)
    news = there.read(1.0)
    assert news.rows.time_ns.tolist() == [4 * 10**9, 10**9, 2 * 10**9, 3 * 10**9]
    assert np.isnan(news.rows.values[0]).all()
    assert np.array_equal(news.rows.values[1:], given.values) and np.array_equal(
        news.rows.sigma[1:], given.sigma
    )
    assert (news.rows.quality[1:] == int(Quality.STUCK)).all() and news.events == [ALARM]
    there.close()
    publisher.close()


@pytest.mark.parametrize(
    ("url", "said"),
    [("shm:/nowhere/ring", "is a runtime publishing with shm: there"), ("http://127.0.0.1:9", "no answer from /metrics"),
     ("udp://127.0.0.1:0", "nothing comes"), ("ftp://x", "unknown scheme 'ftp'")],
)  # fmt: skip
def test_what_cannot_be_attached_to_is_said(url, said):
    with pytest.raises((DeviceError, DataError), match=said):
        attach(url, first_s=0.1)


@pytest.fixture
def ticking(monkeypatch):
    """For the command, a twentieth of a second passes between two looks at the clock, however long a busy machine takes."""
    ticks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: next(ticks) / 20)
    monkeypatch.setattr("motorlens_runtime.commands.monitor.time", clock)


def test_the_command_attaches_and_watches(engine, ticking, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_sensor("s.onnx")
    writer = open_publisher(f"shm:{tmp_path}/ring", HEADER)
    given = rows(np.arange(50) / 10)
    given.values[:, 0] = np.arange(50)
    writer.publish(given)
    arguments = [
        "monitor",
        "--attach",
        f"shm:{tmp_path}/ring",
        "--no-browser",
        "--duration",
        "0.6",
        "--json",
        "m.json",
    ]
    assert main([*arguments, "--sensor", "s.onnx", "--alarm", "speed>30"]) == 0
    writer.close()
    with open("m.json") as file:
        found = json.load(file)
    assert found["counts"]["published"] == 50 and found["counts"]["missed"] == 0
    assert [(event["timestamp"], event["active"]) for event in found["events"]] == [(3.1, True)]
    assert os.listdir(tmp_path).count("m.json") == 1


def test_the_command_follows_several_and_tells_when_one_falls_silent(ticking, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("motorlens_runtime.monitor.follow.LOST_S", 0.2)
    writers = [open_publisher(f"shm:{tmp_path}/{name}", HEADER) for name in ("a", "b")]
    for k, writer in enumerate(writers):
        writer.publish(rows([1.0 + k]))
    arguments = [
        "monitor",
        "--attach",
        f"press=shm:{tmp_path}/a",
        "--attach",
        f"shm:{tmp_path}/b",
        "--no-browser",
    ]
    assert main([*arguments, "--duration", "1", "--json", "m.json"]) == 0
    for writer in writers:
        writer.close()
    with open("m.json") as file:
        found = json.load(file)
    assert [motor["counts"]["published"] for motor in found["motors"]] == [1, 1]
    for k, motor in enumerate(found["motors"]):
        assert [(event["event"], event["timestamp"]) for event in motor["events"]] == [("line_lost", 1.0 + k)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--source", "sim:"], "give --sensor"), (["--attach", "shm:x", "--alarm", "speed>1"], "--alarm needs --sensor"),
     (["--attach", "shm:x", "--publish", "csv:x.csv"], "--publish is for a sensor that runs here"),
     (["--attach", "shm:no-such-ring"], "is a runtime publishing with shm: there")],
)  # fmt: skip
def test_a_mistake_gets_one_line(arguments, said, capsys):
    assert main(["monitor", *arguments, "--no-browser"]) == 1
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1 and error.startswith("motorlens monitor: ")
