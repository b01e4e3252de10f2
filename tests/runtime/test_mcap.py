"""MCAP logs, read back with the format's own library."""

import json
import math

import numpy as np
import pytest

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.sensor.specification import Output

stream_reader = pytest.importorskip("mcap.stream_reader", reason="the extra `mcap` is not installed")

HEADER = Header("s", "1.0", "ab" * 32, (Output("speed", "rad/s", 1.0),))


def rows(first, n, quality=0):
    number = np.arange(first, first + n)
    values = number[:, None] / 3.0
    return Estimates(number * 1_000_000, values, values / 8, np.full(n, quality, dtype=np.uint32))


def messages(data):
    """(topic, time, document) of the whole messages in the beginning of a file."""
    import io

    channels, found = {}, []
    try:
        for record in stream_reader.StreamReader(io.BytesIO(data)).records:
            kind = type(record).__name__
            if kind == "Channel":
                channels[record.id] = record.topic
            elif kind == "Message":
                found.append((channels[record.channel_id], record.log_time, json.loads(record.data)))
    except Exception:  # the library stumbles over a cut record in several ways; what came before counts
        pass
    return found


def test_rows_and_events_come_back(tmp_path):
    from mcap.reader import make_reader

    path = tmp_path / "log.mcap"
    publisher = open_publisher(f"mcap:{path}", HEADER)
    publisher.publish(rows(1, 3))
    publisher.event({"alarm": "hot", "active": True})
    bad = rows(4, 1, Quality.NOT_FINITE)
    bad.values[0, 0] = math.nan
    publisher.publish(bad)
    publisher.close()
    with path.open("rb") as file:
        reader = make_reader(file)
        found = [
            (c.topic, m.log_time, json.loads(m.data))
            for s, c, m in reader.iter_messages(log_time_order=False)
        ]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert [topic for topic, _, _ in found] == ["estimates"] * 3 + ["events", "estimates"]
    assert [time for _, time, _ in found] == [1_000_000, 2_000_000, 3_000_000, 3_000_000, 4_000_000]
    assert found[1][2] == {
        "timestamp": 0.002,
        "speed_rad_s": 2 / 3.0,
        "speed_sd_rad_s": 2 / 24.0,
        "quality": 0,
    }
    assert found[3][2] == {"alarm": "hot", "active": True}
    assert found[4][2]["speed_rad_s"] is None and found[4][2]["reasons"] == ["not_finite"]
    assert not metadata or metadata["motorlens"]["sha256"] == "ab" * 32


def test_a_log_cut_anywhere_gives_its_whole_messages(tmp_path):
    path = tmp_path / "log.mcap"
    publisher = open_publisher(f"mcap:{path}", HEADER)
    publisher.publish(rows(1, 30))
    publisher.flush()
    data = path.read_bytes()
    whole = messages(data)
    assert len(whole) == 30  # flushed, not closed: all is there
    publisher.close()
    counts = [len(messages(data[:cut])) for cut in range(0, len(data), 41)]
    assert counts == sorted(counts) and counts[0] == 0 and counts[-1] >= 29
