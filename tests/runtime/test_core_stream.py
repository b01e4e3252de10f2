"""Bytes to estimates in one call of the core, against the long way round: the same rows, words, recording, and bits."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.sensor_files import write_sensor

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.core_estimator import LOOK_EVERY
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.line.framing import (
    Channel,
    Flag,
    Hello,
    Status,
    hello_frames,
    samples_frame,
    status_frame,
)
from motorlens_runtime.line.link import Link
from motorlens_runtime.sensor.core_library import core
from motorlens_runtime.sensor.sensor import load_sensor, scales
from motorlens_runtime.service.service import Service, Settings

ONE_ENGINE = "it sets the core beside Python"

pytestmark = pytest.mark.skipif(core().library is None, reason=f"no C core: {core().reason}")
QUANTITIES = {"voltage": ("V", 0.1), "current": ("mA", 20.0), "ambient": ("C", 0.01)}


def hello_of(quantities, rate=(1000, 1), boot=1):
    channels = tuple(
        Channel(name, QUANTITIES[name][0], "i2", QUANTITIES[name][1], 0.0, -2048, 2047) for name in quantities
    )
    return Hello("d", boot, rate, channels)


def wire(seed, quantities, frames=900):
    """What a line gives, in reads of any size, and when each came: with HELLO and STATUS among the frames, lost and damaged
    ones, a restart, another rate, and a host that was late for once."""
    rng, sequence, t0_us, now_ns = np.random.default_rng(seed), 0, 0, 5_000_000_000
    hello, reads, waiting = hello_of(quantities), [], b""
    for k in range(frames):
        if k % 60 == 0:
            hello = hello_of(quantities, (2000, 1) if k == 480 else hello.rate_Hz, 2 if k >= 660 else 1)
            pieces = hello_frames(hello, sequence=sequence, t0_us=t0_us)
            waiting, sequence = waiting + b"".join(pieces), sequence + len(pieces)
        if k == 100:
            waiting += status_frame(Status(1, 2, 3, 4), sequence=sequence, t0_us=t0_us)
            sequence += 1
        n = int(rng.integers(1, 30))
        codes = (
            rng.normal([1000, 400, 2000], [5, 5, 1], (n, 3)).round()[:, : len(quantities)].astype(np.int16)
        )
        codes[rng.random(n) < 0.01, 0] = 2047
        t0_us = 0 if k == 660 else t0_us
        flags = Flag.RESTART if k == 660 else 0
        frame = samples_frame(codes, schema=1, sequence=sequence & 0xFFFF, t0_us=t0_us, flags=flags)
        sequence, took_us = sequence + 1, n * 1_000_000 * hello.rate_Hz[1] // hello.rate_Hz[0]
        t0_us, now_ns = t0_us + took_us, now_ns + took_us * 1000
        fate = rng.random()
        if fate < 0.02:
            frame = frame[:7] + b"\x01" + frame[8:]
        if fate > 0.02 and fate < 0.04:
            continue
        waiting += frame
        held = 700 <= k < 750
        if not held and rng.random() < 0.7:
            cut = len(waiting) if rng.random() < 0.7 else int(rng.integers(1, len(waiting) + 1))
            reads.append((waiting[:cut], now_ns + int(rng.integers(0, 2_000_000))))
            waiting = waiting[cut:]
    return reads


class Line:
    """A feed of these reads."""

    live, down, device = True, None, "bench"

    def __init__(self, reads, decoder, ambient_C):
        self.reads, self.decoder, self.ambient_C = iter(reads), decoder, ambient_C
        self.arrival_ns, self.period_s, self.followed = 0, None, 0

    def read(self, timeout_s):
        data, self.arrival_ns = next(self.reads, (None, self.arrival_ns))
        if data is None:
            return None
        samples = self.decoder.followed(data, self.arrival_ns)
        self.period_s = self.decoder.period_s
        if isinstance(samples, Estimated):
            self.followed += 1
            return samples
        if self.ambient_C is not None and samples.ambient_C is None:
            samples = replace(samples, ambient_C=np.full(len(samples), self.ambient_C))
        return samples

    def report(self):
        return {}


class Kept:
    """An outlet and a recorder that keep what they are given."""

    dead = False

    def __init__(self):
        self.columns = {}

    def keep(self, **columns):
        for name, values in columns.items():
            self.columns.setdefault(name, []).append(values)

    def put(self, rows, inputs=None):
        if inputs is None:
            ambient = np.full(len(rows), np.nan) if rows.ambient_C is None else rows.ambient_C
            self.keep(
                taken_ns=rows.time_ns,
                volts=rows.voltage_V,
                amperes=rows.current_A,
                ambient=ambient,
                flags=rows.flags,
            )
        else:
            self.keep(
                time_ns=rows.time_ns, values=rows.values, sigma=rows.sigma, words=rows.quality, inputs=inputs
            )

    def put_counts(self, counts):
        pass

    def report(self):
        return SimpleNamespace()

    def joined(self):
        return {name: np.concatenate(parts) for name, parts in self.columns.items()}


def served(sensor, reads, decoder, rate_Hz, ambient_C=None):
    kept, line = Kept(), Line(reads, decoder, ambient_C)
    service = Service(line, sensor, [kept], kept, Settings(rate_Hz), lambda: line.arrival_ns)
    service.run(lambda: False)
    return kept.joined(), line, service


@pytest.mark.parametrize(
    ("quantities", "given_C"),
    [(("voltage", "current"), None), (("voltage", "current"), 20.0), (tuple(QUANTITIES), None)],
)
@pytest.mark.parametrize("rate_Hz", [0, 90.0])
def test_one_call_gives_what_the_long_way_round_gives(tmp_path, quantities, given_C, rate_Hz):
    write_sensor(tmp_path / "s.onnx", ambient=given_C is not None or "ambient" in quantities)
    sensor, reads = load_sensor(tmp_path / "s.onnx", "core"), wire(3, quantities)
    short, line, service = served(sensor, reads, open_link(), rate_Hz, given_C)
    long, beside, _ = served(sensor, reads, Link(), rate_Hz, given_C)
    assert beside.followed == 0 and line.followed > 0.6 * len(reads)
    assert (
        line.decoder.counters == beside.decoder.counters
        and line.decoder.bad_frames == beside.decoder.bad_frames > 0
    )
    assert short.keys() == long.keys()
    for name in short:
        assert np.array_equal(short[name], long[name], equal_nan=True), name
    words = np.bitwise_or.reduce(short["words"])
    assert all(words & bit for bit in (Quality.OVERLOAD, Quality.BRIDGED, Quality.SATURATED))
    assert service.estimator.count == len(short["taken_ns"])
    python, _, _ = served(load_sensor(tmp_path / "s.onnx", "numpy"), reads, Link(), rate_Hz, given_C)
    scale = scales(sensor.specification)
    for name in ("time_ns", "words", "inputs"):
        assert np.array_equal(python[name], short[name], equal_nan=True), name
    for name in ("values", "sigma"):
        assert np.max(np.abs(python[name] - short[name]) / scale) < 1e-12


def test_the_second_backend_looks_at_the_same_rows(tmp_path):
    """One that differs from the first tile on is seen there in both."""
    write_sensor(tmp_path / "s.onnx")
    sensor = load_sensor(tmp_path / "s.onnx", "core")
    reads, truth, seen = wire(1, ("voltage", "current"), 1400), sensor.checker, []
    assert truth is not None

    class Other:
        name = "other"

        def evaluate(self, features):
            seen.append(features.copy())
            estimate, sigma = truth.evaluate(features)
            return estimate + 1e3 * (sum(map(len, seen)) > 2), sigma

    sensor = replace(sensor, checker=Other())
    found = []
    for decoder in (open_link(), Link()):
        seen.clear()
        result, _, _ = served(sensor, reads, decoder, 0)
        found.append((result["words"], np.concatenate(seen)))
    words = found[0][0]
    assert len(words) > LOOK_EVERY and np.array_equal(words, found[1][0])
    assert np.array_equal(found[0][1], found[1][1])
    wrong = words & Quality.BACKEND_MISMATCH > 0
    assert wrong[LOOK_EVERY:].any() and not wrong[:LOOK_EVERY].any()


def test_without_ambient_temperature_it_says_so(tmp_path):
    write_sensor(tmp_path / "s.onnx", ambient=True)
    sensor = load_sensor(tmp_path / "s.onnx", "core")
    with pytest.raises(DataError, match="ambient temperature"):
        served(sensor, wire(1, ("voltage", "current")), open_link(), 0)
