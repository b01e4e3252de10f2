"""Hardware in the loop, with the hardware on a pseudo-terminal: counts and bits are gates, latencies are reported.

    python benchmarks/hil.py [--quick] [--sensor S.onnx] [--realtime] [--rate HZ] [--only loops|faults|day]

1. Loopback at 1, 10 and 20 kHz, 60 s each, every sample evaluated (or `--rate` of them a second): no sample lost, none
   invented, live equals replay bit for bit.
2. Faults in 10^7 frames: nothing wrong accepted, every undamaged frame received, bounded memory.
3. 24 h at 1 kHz in simulated time: memory flat, state at its closed form.

Exit status 1 if a gate fails. The device runs in a process of its own and stamps each frame as it writes it.
"""

import argparse
import gc
import os
import pty
import resource
import select
import subprocess
import sys
import tempfile
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from hil_faults import injected

from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.line.feed import open_feed
from motorlens_runtime.line.framing import Channel, Hello, hello_frames, samples_frame
from motorlens_runtime.line.sources import open_source, split
from motorlens_runtime.sensor.sensor import load_sensor
from motorlens_runtime.service.outlet import Grid, OutletReport
from motorlens_runtime.service.realtime import PRIORITY, realtime
from motorlens_runtime.service.service import Service, Settings

ROOT = Path(__file__).resolve().parents[1]
LOOPS = ((1000, 1), (10_000, 10), (20_000, 20))
SCALES = {"voltage": ("V", 0.13), "current": ("A", 0.037)}


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="5 s a loop, 10^5 frames, one simulated hour")
    parser.add_argument("--sensor", default=str(ROOT / "models" / "sensors" / "mellah2016.onnx"))
    parser.add_argument(
        "--realtime", action="store_true", help="the loops with the profile of run --realtime"
    )
    parser.add_argument(
        "--rate", type=float, default=0.0, help="evaluations a second; 0 (default) is every sample"
    )
    parser.add_argument("--only", choices=("loops", "faults", "day"), help="one part of it")
    parser.add_argument("--device", nargs=4, type=str, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.device:
        rate, n, seconds, stamps = arguments.device
        if arguments.realtime:
            # It stands for hardware, which keeps its own time.
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY + 10))
        return device(int(rate), int(n), float(seconds), stamps)
    gates = []
    if arguments.only in (None, "loops"):
        for rate, n in LOOPS:
            seconds = 5.0 if arguments.quick else 60.0
            gates += loop(arguments.sensor, rate, n, seconds, arguments.realtime, arguments.rate)
    if arguments.only in (None, "faults"):
        gates += injected(10**5 if arguments.quick else 10**7)
    if arguments.only in (None, "day"):
        gates += simulated_day(arguments.sensor, 1 if arguments.quick else 24)
    failed = [name for name, passed in gates if not passed]
    print(
        f"{len(gates) - len(failed)} of {len(gates)} gates passed"
        + "".join(f"; FAILED: {name}" for name in failed)
    )
    return 1 if failed else 0


def codes_of(count: int) -> np.ndarray:
    """What the device measures: a square wave of voltage, a wavy current, noise of a few codes."""
    k = np.arange(count)
    noise = np.random.default_rng(0).normal(size=(count, 2))
    return np.round(
        np.column_stack([1500 * np.sign(np.sin(k / 3000)), 400 + 300 * np.sin(k / 1700)]) + 2 * noise
    ).astype(np.int16)


def hello_of(rate: int) -> Hello:
    channels = tuple(
        Channel(name, unit, "i2", scale, 0.0, -2048, 2047) for name, (unit, scale) in SCALES.items()
    )
    return Hello("hil", 1, (rate, 1), channels, simulated=True)


def device(rate: int, n: int, seconds: float, stamps: str) -> int:
    """Print the port, wait for a reader, send in real time, write when each frame was sent."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)  # before it is said: a port that someone holds is not opened
    print(name, flush=True)
    hello = hello_of(rate)
    codes, frames = codes_of(int(seconds * rate)), int(seconds * rate) // n
    poll = select.poll()
    poll.register(master, select.POLLIN)
    while any(event & select.POLLHUP for _, event in poll.poll(0)):
        time.sleep(0.01)
    time.sleep(0.5)
    writable = select.poll()
    writable.register(master, select.POLLOUT)
    os.set_blocking(master, False)
    gc.disable()
    sequence, sent = 0, np.zeros(frames, dtype=np.int64)
    start = time.monotonic()
    for k in range(frames):
        data = b""
        if k * n % (2 * rate) == 0:
            pieces = hello_frames(hello, sequence=sequence, t0_us=round(1e6 * k * n / rate))
            sequence += len(pieces)
            data = b"".join(pieces)
        rows = codes[k * n : (k + 1) * n]
        data += samples_frame(
            rows, schema=1, sequence=sequence & 0xFFFF, t0_us=round(1e6 * k * n / rate) & 0xFFFFFFFF
        )
        sequence += 1
        time.sleep(max(0.0, start + (k + 1) * n / rate - time.monotonic()))
        sent[k] = time.monotonic_ns()
        while data:
            events = writable.poll(5000)
            if not events or events[0][1] & select.POLLHUP:
                return 1  # nobody reads any more
            with suppress(BlockingIOError):  # poll says so even where only a part of it fits
                data = data[os.write(master, data) :]
    np.save(stamps, sent)
    sys.stdin.read()  # hold the port until the other side is done
    return 0


class Probe:
    """An outlet that keeps what it is given, and when."""

    dead = False

    def __init__(self) -> None:
        self.parts: list[tuple[int, Estimates]] = []

    def report(self) -> OutletReport:
        return OutletReport("probe", len(self.parts), 0, 0, None)

    def put(self, estimates: Estimates, inputs: object = None) -> None:
        self.parts.append((time.monotonic_ns(), estimates))

    def put_counts(self, counts: dict[str, object]) -> None:
        pass


@contextmanager
def device_of(
    rate: int, n: int, seconds: float, profile: bool
) -> Iterator[tuple[str, Callable[[], np.ndarray]]]:
    """A device in a process of its own: its port, and a function that ends it and gives when each frame was sent."""
    with tempfile.TemporaryDirectory() as folder:
        stamps = str(Path(folder) / "stamps.npy")
        command = [sys.executable, __file__, "--device", str(rate), str(n), str(seconds), stamps]
        command += ["--realtime"] if profile else []
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None and process.stdin is not None

        def end() -> np.ndarray:
            process.stdin.close()
            process.wait()
            process.stdout.close()
            return np.load(stamps)

        yield process.stdout.readline().strip(), end


def bare_line(rate: int, n: int, profile: bool) -> str:
    """What the line and the machine take by themselves: a loop that only reads, on the same frames for two seconds."""
    frames, hellos = 2 * rate // n, len(hello_frames(hello_of(rate), sequence=0, t0_us=0))
    arrived = np.zeros(frames)
    with device_of(rate, n, 2.0, profile) as (port, end), ExitStack() as stack:
        line = open_source(*split(f"pty://{port}"))
        if profile:
            stack.enter_context(realtime())
        seen, cpu, started = -hellos, time.process_time(), time.monotonic()
        while seen < frames and time.monotonic() < started + 20:
            zeros = (line.read(0.05) or b"").count(0)
            arrived[max(seen, 0) : max(seen + zeros, 0)] = time.monotonic_ns()
            seen += zeros
        cpu = (time.process_time() - cpu) / (time.monotonic() - started)
        line.close()
        latency = (arrived - end()) / 1000
    p50, p99 = np.percentile(latency, [50, 99])
    return f"reading alone {p50:.0f} us median, {p99:.0f} us 99 %, {100 * cpu:.1f} % of a core"


def loop(
    sensor_path: str, rate: int, n: int, seconds: float, profile: bool, evaluated_Hz: float
) -> list[tuple[str, bool]]:
    """One loopback; prints its figures and returns its gates."""
    sensor = load_sensor(sensor_path)
    alone = bare_line(rate, n, profile)
    with device_of(rate, n, seconds, profile) as (port, end):
        probe = Probe()
        feed = open_feed(f"pty://{port}?dialect=frames", {}, None, 0.0, time.monotonic_ns)
        service = Service(feed, sensor, [probe], None, Settings(evaluated_Hz), time.monotonic_ns)  # type: ignore[list-item]
        gc.collect()
        gc.freeze()
        said = "ordinary priority"
        with ExitStack() as stack:
            if profile:
                answer = stack.enter_context(realtime())
                said = ", ".join((*answer.granted, *answer.refused))
            cpu, started = time.process_time(), time.monotonic()
            deadline, grid = started + seconds + 20, Grid(evaluated_Hz)
            sampled_ns = np.arange(int(seconds * rate)) * 10**9 // rate
            last_ns = int(sampled_ns[grid.rows(sampled_ns)][-1])
            service.run(lambda: done(probe, last_ns) or time.monotonic() > deadline)
            cpu = (time.process_time() - cpu) / (time.monotonic() - started)
        report = service.report()
        feed.close()
        sent = end()
    got = joined([estimates for _, estimates in probe.parts])
    out = np.concatenate([np.full(len(estimates), at) for at, estimates in probe.parts])
    latency = (out - sent[got.time_ns * rate // (10**9 * n)]) / 1000
    p50, p99, p999 = np.percentile(latency, [50, 99, 99.9])
    count = int(seconds * rate)
    same = equal_to_replay(sensor, rate, count, got, evaluated_Hz)
    often = f"{evaluated_Hz:g} evaluations a second" if evaluated_Hz else "every sample evaluated"
    print(
        f"{rate / 1000:g} kHz x {n} a frame, {often}, "
        f"{seconds:g} s, {said}: {report['samples']} samples, {report['lost']} lost, "
        f"frame to estimate {p50:.0f} us median, {p99:.0f} us 99 %, {p999:.0f} us 99.9 %, {latency.max():.0f} us worst; "
        f"{100 * cpu:.1f} % of a core; {alone}; load of the machine {os.getloadavg()[0]:.1f}",
        flush=True,
    )
    name = f"{rate} Hz"
    return [
        (f"{name}: all samples", report["samples"] == count and report["lost"] == 0),
        (f"{name}: no damaged frames", report["feed"]["bad_frames"] == 0 and report["feed"]["gaps"] == 0),
        (f"{name}: live equals replay", same),
    ]


def done(probe: Probe, last_ns: int) -> bool:
    """Whether the last estimate has come."""
    return bool(probe.parts) and int(probe.parts[-1][1].time_ns[-1]) >= last_ns


def equal_to_replay(sensor, rate: int, count: int, got: Estimates, evaluated_Hz: float) -> bool:
    """Whether the estimates are bit for bit those of one call over all samples that the device sent."""
    codes = codes_of(count).astype(np.float64)
    values = [scale * codes[:, column] + 0.0 for column, (_, scale) in enumerate(SCALES.values())]
    time_ns = np.arange(count) * 10**9 // rate
    samples = Samples(time_ns, *values, flags=np.full(count, Quality.SIMULATED, dtype=np.uint32))
    rows = Grid(evaluated_Hz).rows(time_ns)
    expected = open_estimator(sensor, 1 / rate).push(samples, rows)
    # Whether the PC kept up is not in the samples.
    got = replace(got, quality=got.quality & ~np.uint32(Quality.OVERLOAD))
    return all(np.array_equal(getattr(got, f), getattr(expected, f)) for f in Estimates.__dataclass_fields__)


def joined(parts: list[Estimates]) -> Estimates:
    return Estimates(
        *(np.concatenate([getattr(part, f) for part in parts]) for f in Estimates.__dataclass_fields__)
    )


def simulated_day(sensor_path: str, hours: int) -> list[tuple[str, bool]]:
    """`hours` at 1 kHz as fast as it goes: memory and the slowest filter of `current_squared` against its closed form."""
    sensor = load_sensor(sensor_path)
    estimator = open_estimator(sensor, 1e-3)
    n = 1000
    voltage, row = np.full(n, 100.0), np.array([n - 1])
    last = len(sensor.specification.filters) - 1
    slow = max(
        range(last + 1),
        key=lambda k: (sensor.specification.filters[k].signal == "current_squared", sensor.bank.tau_s[k]),
    )
    signal, tau = sensor.specification.filters[slow].signal, sensor.bank.tau_s[slow]
    exact, seconds = 0.0, 3600 * hours
    started = time.process_time()
    for second in range(seconds):
        amperes = 8.0 if second // 1800 % 2 == 0 else 2.0
        samples = Samples(second * 10**9 + np.arange(n) * 10**6, voltage, np.full(n, amperes))
        estimator.push(samples, row)
        value = amperes**2 if signal == "current_squared" else np.nan
        exact = value + (exact - value) * np.exp(-1.0 / tau)
        if second == seconds // 10:
            gc.collect()
            before = resident_kB()
    gc.collect()
    grown = resident_kB() - before
    error = (
        abs(sensor.bank.values(estimator.state.bank)[slow] / exact - 1)
        if signal == "current_squared"
        else np.nan
    )
    print(
        f"{hours} h at 1 kHz in simulated time: memory {grown:+d} kB, slowest filter of current_squared ({tau:g} s) off "
        f"its closed form by {error:.1e}, {seconds * n / (time.process_time() - started) / 1e6:.2f} million samples a second"
    )
    return [("memory flat within 1 MB", abs(grown) <= 1024), ("state exact to 1e-9", not error > 1e-9)]


def resident_kB() -> int:
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() // 1024


if __name__ == "__main__":
    sys.exit(main())
