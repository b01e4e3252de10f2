"""From frames to samples: when each was taken, which were lost, what a restart does. Truth is the list that was sent."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.line.framing import (
    Channel,
    Flag,
    Frame,
    Hello,
    Status,
    encode,
    hello_frames,
    samples_frame,
    status_frame,
)

pytestmark = pytest.mark.usefixtures("engine")
SECOND = 1_000_000_000


def hello(rate=(1000, 1), boot=1, simulated=False, **other):
    channels = (
        Channel("voltage", "V", "i2", 0.1, 0.5, -2048, 2047),
        Channel("current", "mA", "i2", 20.0, 0.0, -2048, 2047),
    )
    return Hello("d", boot, rate, channels, simulated=simulated, **other)


class Device:
    """Sends 12-bit codes, `n` in a frame, and keeps what it sent."""

    def __init__(self, rate=(1000, 1), n=10, t0_us=0, boot=1, seed=0, **options):
        self.hello, self.n, self.t0_us = hello(rate, boot, **options), n, t0_us
        self.rng, self.sequence, self.count = np.random.default_rng(seed), 0, 0
        self.codes = []

    def greet(self):
        frames = hello_frames(self.hello, sequence=self.sequence, t0_us=self.stamp_us())
        self.sequence += len(frames)
        return b"".join(frames)

    def stamp_us(self):
        return (
            self.t0_us + round(self.count * 1e6 * self.hello.rate_Hz[1] / self.hello.rate_Hz[0])
        ) & 0xFFFFFFFF

    def frame(self, flags=0):
        codes = self.rng.integers(-2000, 2000, (self.n, 2)).astype(np.int16)
        data = samples_frame(codes, schema=1, sequence=self.sequence, t0_us=self.stamp_us(), flags=flags)
        self.codes.append(codes)
        self.sequence = (self.sequence + 1) & 0xFFFF
        self.count += self.n
        return data


def feed(link, data, cuts=(), now_ns=0):
    edges = [0, *sorted(c for c in cuts if c < len(data)), len(data)]
    parts = [link.feed(data[a:b], now_ns) for a, b in itertools.pairwise(edges)]
    return Samples(
        *(
            np.concatenate([getattr(p, f) for p in parts if len(p)])
            for f in ("time_ns", "voltage_V", "current_A")
        )
    )


def values(codes):
    codes = np.concatenate(codes).astype(float)
    return 0.1 * codes[:, 0] + 0.5, 0.02 * codes[:, 1]


@pytest.mark.fit
@settings(deadline=None, max_examples=60)
@given(
    st.sampled_from([(1000, 1), (20_000, 1), (3000, 1), (15_000, 1), (999, 7), (10_000_000, 10_007)]),
    st.sampled_from([1, 10, 20]), st.integers(0, 2**32 - 1), st.lists(st.integers(0, 8000), max_size=15),
)  # fmt: skip
def test_every_sample_lies_on_the_grid_of_the_rate(rate, n, t0_us, cuts):
    device, link = Device(rate, n, t0_us), open_link()
    data = device.greet() + b"".join(device.frame() for _ in range(100))
    samples = feed(link, data, cuts)
    voltage, current = values(device.codes)
    assert np.allclose(samples.voltage_V, voltage, rtol=0, atol=1e-12)
    assert np.allclose(samples.current_A, current, rtol=0, atol=1e-12)
    exact = [k * SECOND * rate[1] // rate[0] for k in range(100 * n)]  # integers, so exact
    assert (samples.time_ns - samples.time_ns[0]).tolist() == exact
    assert samples.time_ns[0] == t0_us * 1000
    counters = link.counters
    assert (counters.samples, counters.lost_samples, counters.lost_frames, counters.gaps) == (
        100 * n,
        0,
        0,
        0,
    )


def test_the_clock_that_wraps_goes_on():
    device, link = Device(t0_us=2**32 - 50_000), open_link()
    samples = feed(link, device.greet() + b"".join(device.frame() for _ in range(20)))
    assert (np.diff(samples.time_ns) == 1_000_000).all() and link.counters.restarts == 0


@pytest.mark.fit
@settings(deadline=None)
@given(st.sets(st.integers(0, 99), max_size=40), st.lists(st.integers(0, 8000), max_size=15))
def test_what_is_lost_is_counted_and_what_comes_has_its_own_time(lost, cuts):
    device, link = Device(), open_link()
    greeting = device.greet()
    sent = [device.frame() for _ in range(100)]
    kept = [k for k in range(100) if k not in lost]
    if not kept:
        return
    samples = feed(link, greeting + b"".join(sent[k] for k in kept), cuts)
    assert np.array_equal(
        samples.time_ns, np.concatenate([np.arange(10 * k, 10 * k + 10) for k in kept]) * 1_000_000
    )
    assert np.allclose(samples.voltage_V, values([device.codes[k] for k in kept])[0], rtol=0, atol=1e-12)
    inside = [k for k in lost if kept[0] < k < kept[-1]]
    assert link.counters.lost_samples == 10 * len(inside)
    assert link.counters.lost_frames == len([k for k in lost if k < kept[-1]])


def test_repeated_and_late_frames_are_left_out():
    device, link = Device(), open_link()
    greeting, f = device.greet(), [device.frame() for _ in range(6)]
    samples = feed(link, greeting + f[0] + f[1] + f[1] + f[3] + f[2] + f[4] + f[0] + f[5])
    assert np.array_equal(samples.time_ns // 10_000_000, np.repeat([0, 1, 3, 4, 5], 10))
    assert link.counters.late_frames == 3 and link.counters.restarts == 0


def test_samples_before_hello_are_kept_until_it_comes():
    device, link = Device(), open_link()
    early = b"".join(device.frame() for _ in range(30))
    assert len(link.feed(early, 0)) == 0 and link.period_s is None
    samples = feed(link, device.greet() + device.frame())
    assert len(samples) == 310 and np.allclose(samples.voltage_V, values(device.codes)[0], rtol=0, atol=1e-12)


def test_a_restart_goes_on_by_the_host_clock_after_a_rest():
    link, first = open_link(), Device(boot=1, t0_us=9_000_000)
    before = feed(link, first.greet() + first.frame(), now_ns=100 * SECOND)
    second = Device(boot=2, t0_us=500, seed=1)
    after = feed(link, second.greet() + second.frame(Flag.RESTART), now_ns=160 * SECOND)
    assert link.counters.restarts == 1 and link.counters.lost_samples == 0
    assert after.time_ns[1] - before.time_ns[-1] == 60 * SECOND
    assert (after.voltage_V[0], after.current_A[0]) == (0.0, 0.0)  # the rest, one period before
    assert after.time_ns[1] - after.time_ns[0] == 1_000_000
    assert np.allclose(after.voltage_V[1:], values(second.codes)[0], rtol=0, atol=1e-12)
    assert (np.diff(after.time_ns) == 1_000_000).all()


def test_a_restart_whose_hello_was_lost_is_seen_by_its_clock():
    link, first, second = open_link(), Device(t0_us=9_000_000), Device(t0_us=500, seed=1)
    feed(link, first.greet() + first.frame(), now_ns=SECOND)
    after = feed(link, second.frame(), now_ns=2 * SECOND)
    assert link.counters.restarts == 1 and len(after) == 11


def test_flags_say_saturated_and_simulated():
    device, link = Device(simulated=True), open_link()
    codes = np.array([[0, 0], [2047, 0], [0, -2048], [5, 5]], dtype=np.int16)
    data = device.greet() + samples_frame(
        codes, schema=1, sequence=device.sequence, t0_us=0, flags=Flag.SATURATED
    )
    flags = link.feed(data, 0).flags
    assert [bool(f & Quality.SATURATED) for f in flags] == [False, True, True, False]
    assert all(f & Quality.SIMULATED for f in flags)


def test_status_unknown_kinds_and_foreign_schemas_are_counted():
    device, link = Device(), open_link()
    status = Status(1, 2, 3, 4)
    data = device.greet() + status_frame(status, sequence=2, t0_us=0) + encode(Frame(77, 3, 0, b"x"))
    data += samples_frame(np.zeros((3, 2), dtype=np.int16), schema=9, sequence=4, t0_us=0)
    data += encode(Frame(2, 5, 0, b"\1\5short")) + encode(Frame(3, 6, 0, b"short"))
    assert len(link.feed(data, 0)) == 0
    assert link.status == status and link.counters.unknown_frames == 4


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        ((Channel("voltage", "furlong"), Channel("current", "A")), "unknown unit 'furlong'"),
        ((Channel("voltage", "V"),), "no current channel"),
        (
            (Channel("voltage", "V"), Channel("voltage", "mV"), Channel("current", "A")),
            "both look like voltage",
        ),
    ],
)
def test_a_hello_of_no_use_is_a_complaint_and_no_error(channels, words):
    link = open_link()
    for wire in hello_frames(Hello("d", 1, (1000, 1), channels), sequence=0, t0_us=0):
        assert len(link.feed(wire, 0)) == 0
    assert link.hello is None and words in link.complaint


def test_float_channels_and_ambient():
    channels = (
        Channel("current", "A", "f4"),
        Channel("voltage", "V", "f4"),
        Channel("ambient", "degF", "f4"),
        Channel("speed", "rpm", "f4"),
    )
    data = b"".join(hello_frames(Hello("d", 1, (500, 1), channels), sequence=0, t0_us=0))
    rows = np.array([[1.5, 24.0, 212.0, 9.0]], dtype=np.float32)
    samples = open_link().feed(data + samples_frame(rows, schema=1, sequence=2, t0_us=3), 0)
    assert (samples.voltage_V[0], samples.current_A[0], samples.time_ns[0]) == (24.0, 1.5, 3000)
    assert samples.ambient_C[0] == pytest.approx(100.0)


@pytest.mark.fit
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.lists(st.binary(max_size=100), max_size=20))
def test_whatever_comes_time_never_runs_backwards(seed, garbage):
    """Frames of several devices, out of order, repeated, damaged, with clocks that jump, and plain garbage."""
    rng = np.random.default_rng(seed)
    devices = [Device(boot=k, t0_us=int(rng.integers(2**32)), seed=k) for k in range(3)]
    pieces = [*garbage]
    for _ in range(60):
        device = devices[rng.integers(3)]
        device.count += int(rng.choice([0, 0, 0, 5, 100_000, -20]))
        device.count = max(device.count, 0)
        pieces.append(device.greet() if rng.random() < 0.1 else device.frame())
        if rng.random() < 0.2:
            pieces.append(pieces[rng.integers(len(pieces))])
    link, times, now = open_link(), [], 0
    for piece in (pieces[k] for k in rng.permutation(len(pieces))):
        now += int(rng.integers(10**8))
        times.append(link.feed(piece, now).time_ns)
    assert (np.diff(np.concatenate(times)) >= 0).all()


@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(["i2", "f4"]), st.sampled_from([1, 3, 16, 19]), st.booleans(), st.booleans(), st.integers(0, 2**32 - 1)
)  # fmt: skip
def test_frame_by_frame_is_as_all_at_once(kind, n, rails, ambient, seed):
    """The short way of a frame that is expected, and the long way, to the bit and with the same counters."""
    rng = np.random.default_rng(seed)
    limits = (-2048, 2047) if rails else (None, None)
    channels = [
        Channel("voltage", "V", kind, 0.1, 0.5, *limits),
        Channel("current", "mA", kind, 19.7, -3.0, *limits),
        Channel("ambient", "degF", kind, 0.01, 60.0, None, None),
    ][: 3 if ambient else 2]
    frames = hello_frames(Hello("d", 1, (3000, 1), tuple(channels)), sequence=0, t0_us=0)
    for k in range(40):
        codes = rng.integers(-2048, 2048, (n, len(channels)))
        codes[rng.random(codes.shape) < 0.02] = rng.choice([-2048, 2047])
        codes = codes.astype(np.int16 if kind == "i2" else np.float32)
        if kind == "f4" and k == 30:
            codes[0, 0] = np.nan
        flags = Flag.SATURATED if k % 7 == 3 else 0
        stamp = round(1e6 * k * n / 3000)
        frames.append(samples_frame(codes, schema=1, sequence=len(frames), t0_us=stamp, flags=flags))
    single, whole = open_link(), open_link()
    parts = [part for part in (single.feed(frame, 0) for frame in frames) if len(part)]
    together = whole.feed(b"".join(frames), 0)
    for name in Samples.__dataclass_fields__:
        expected = getattr(together, name)
        if expected is None:
            assert all(getattr(part, name) is None for part in parts)
        else:
            got = np.concatenate([getattr(part, name) for part in parts])
            assert got.dtype == expected.dtype and np.array_equal(
                got, expected, equal_nan=expected.dtype.kind == "f"
            ), name
    assert single.counters == whole.counters and single.bad_frames == whole.bad_frames == 0


def faulty_stream(seed, frames):
    """What a bad line brings: frames lost, late, twice, damaged, cut, restarts, rubbish; HELLO now and then. In portions."""
    rng = np.random.default_rng(seed)
    rate = [(1000, 1), (20_000, 1), (3000, 1), (999, 7)][seed % 4]
    device = Device(rate, int(rng.integers(1, 40)), int(rng.integers(0, 2**32)), seed=seed)
    pieces, earlier = [device.greet()], []
    for _ in range(frames):
        data = device.frame(int(rng.choice([0, 0, 0, 0, Flag.SATURATED, Flag.OVERRUN, Flag.RESTART])))
        earlier.append(data)
        what = rng.integers(0, 40)
        if what == 0:
            continue
        if what == 1:
            data = earlier[int(rng.integers(max(len(earlier) - 50, 0), len(earlier)))]
        elif what == 2:
            data = bytearray(data)
            data[int(rng.integers(0, len(data)))] ^= int(1 << rng.integers(0, 8))
        elif what == 3:
            data = data[: int(rng.integers(0, len(data)))]
        elif what == 4:
            data = rng.bytes(int(rng.integers(1, 600))) + data
        elif what == 5:
            device.t0_us, device.count = int(rng.integers(0, 2**32)), 0
            if rng.random() < 0.5:
                device.hello = hello(rate if rng.random() < 0.7 else (500, 1), int(rng.integers(0, 9)))
            data = device.greet() + data
        elif what == 6:
            data = encode(
                Frame(int(rng.integers(0, 9)), device.sequence, 0, rng.bytes(int(rng.integers(0, 241))))
            )
        elif what == 7:
            device.count += int(rng.integers(1, 5000))
        pieces.append(bytes(data))
    stream = b"".join(pieces)
    edges = np.sort(rng.integers(0, len(stream), len(stream) // int(rng.integers(20, 2000))))
    now_ns = 0
    for a, b in itertools.pairwise([0, *edges.tolist(), len(stream)]):
        now_ns += int(rng.integers(0, 30_000_000))
        yield stream[a:b], now_ns


@pytest.mark.fit
@pytest.mark.parametrize("seed", range(8))
def test_a_bad_line_gives_the_same_samples_and_counts_in_python_and_in_the_core(seed):
    from motorlens_runtime.line.link import Link

    python, core = Link(), open_link()
    for data, now_ns in faulty_stream(seed, 4000):
        expected, found = python.feed(data, now_ns), core.feed(data, now_ns)
        assert np.array_equal(found.time_ns, expected.time_ns)
        assert np.array_equal(found.voltage_V, expected.voltage_V)
        assert np.array_equal(found.current_A, expected.current_A)
        if len(expected):
            assert np.array_equal(found.flags, expected.flags)
        assert (core.bad_frames, core.bytes_seen) == (python.bad_frames, python.bytes_seen)
    assert core.counters == python.counters
    counters = python.counters
    assert (
        counters.restarts
        and counters.late_frames
        and counters.gaps
        and counters.unknown_frames
        and python.bad_frames
    )
