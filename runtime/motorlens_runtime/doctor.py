"""What this PC can hold: how late it wakes, how long a line takes, what an estimate costs, what is plugged in.

Each measurement is short, prints nothing and changes nothing. Times are of this machine at this moment, with whatever else
runs on it; the load beside it is part of the answer.
"""

import contextlib
import os
import platform
import select
import struct
import subprocess
import sys
import time
import tty
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.core_estimator import open_estimator
from motorlens_runtime.line import framing
from motorlens_runtime.line.core_link import open_link
from motorlens_runtime.sensor.sensor import Sensor

RATES_HZ = (100, 1_000, 2_000, 5_000, 10_000, 20_000, 50_000)
# A core that is busier than this has no room for a burst after a stall.
_SHARE = 0.5
# Frames come this often, or once a sample where that is slower; estimates are published this often.
_FRAME_S = 0.001
_ESTIMATES_HZ = 100


@dataclass(frozen=True)
class Spread:
    """Percentiles of a latency in microseconds."""

    p50: float
    p99: float
    worst: float

    @staticmethod
    def of(values_ns: NDArray[np.float64]) -> "Spread":
        """Of latencies (n,) in nanoseconds."""
        p50, p99, worst = np.percentile(values_ns, (50, 99, 100)) / 1000
        return Spread(float(p50), float(p99), float(worst))


def sleep_lateness(seconds: float, period_s: float = 0.001) -> Spread:
    """How late a thread wakes that sleeps until instants of a fixed grid."""
    count = max(round(seconds / period_s), 10)
    late = np.empty(count)
    start = time.monotonic_ns()
    for k in range(count):
        due = start + round((k + 1) * period_s * 1e9)
        remaining = due - time.monotonic_ns()
        if remaining > 0:
            time.sleep(remaining * 1e-9)
        late[k] = max(time.monotonic_ns() - due, 0)
    return Spread.of(late)


_SENDER = """
import os, struct, sys, time
fd, count = int(sys.argv[1]), int(sys.argv[2])
for _ in range(count):
    time.sleep(0.001)
    os.write(fd, struct.pack("<q", time.monotonic_ns()))
"""


def line_latency(seconds: float) -> Spread:
    """Time from a write in another process to its arrival here, through a pseudo-terminal."""
    ours, theirs = os.openpty()
    try:
        tty.setraw(theirs)
        tty.setraw(ours)
        count = max(round(seconds / 0.001), 10)
        late: list[float] = []
        sender = subprocess.Popen(
            [sys.executable, "-S", "-c", _SENDER, str(theirs), str(count)], pass_fds=(theirs,)
        )
        try:
            poll = select.poll()
            poll.register(ours, select.POLLIN)
            rest = b""
            while len(late) < count and poll.poll(5000):
                rest += os.read(ours, 4096)
                now = time.monotonic_ns()
                while len(rest) >= 8:
                    late.append(now - struct.unpack_from("<q", rest)[0])
                    rest = rest[8:]
        finally:
            sender.kill()
            sender.wait()
        return Spread.of(np.array(late or [np.nan]))
    finally:
        os.close(ours)
        os.close(theirs)


@dataclass(frozen=True)
class Cost:
    """What an estimate costs, and which rates that leaves room for.

    `hot_us` and `cold_us`: one sample in, one estimate out, one after the other and after 10 ms of sleep.
    `core_share`: rate in Hz -> share of one core that decoding and estimating take, 100 estimates a second.
    """

    hot_us: float
    cold_us: float
    core_share: dict[int, float]

    @property
    def highest_rate_Hz(self) -> int | None:
        """The highest of `RATES_HZ` that takes at most half a core; None if even the lowest takes more."""
        return max((rate for rate, share in self.core_share.items() if share <= _SHARE), default=None)


def estimate_cost(sensor: Sensor, seconds: float) -> Cost:
    """Measure the runtime's own path, from bytes to estimates, with one sensor."""
    line = _Line(sensor, 1000)
    hot: list[float] = []
    cold: list[float] = []
    for latencies, pause_s in ((hot, 0.0), (cold, 0.01)):
        end = time.monotonic() + seconds / 4
        while time.monotonic() < end or len(latencies) < 10:
            if pause_s:
                time.sleep(pause_s)
            latencies.append(line.step(estimate=True)[0])
    shares = {}
    for rate in RATES_HZ:
        line = _Line(sensor, rate)
        frames_s = rate / line.per_frame
        every = max(round(frames_s / _ESTIMATES_HZ), 1)
        costs: list[float] = []
        end = time.monotonic() + seconds / 2 / len(RATES_HZ)
        while time.monotonic() < end or len(costs) < 5 * every:
            costs.append(line.step(estimate=len(costs) % every == 0)[1])
        shares[rate] = float(np.mean(costs[every:])) * 1e-9 * frames_s
    return Cost(float(np.median(hot)) / 1000, float(np.median(cold)) / 1000, shares)


class _Line:
    """Frames of a made-up drive through link and estimator, a millisecond of samples in each, at least one."""

    def __init__(self, sensor: Sensor, rate_Hz: int) -> None:
        quantities = [("voltage", "V"), ("current", "A")]
        if sensor.specification.needs_ambient:
            quantities.append(("ambient", "C"))
        channels = tuple(framing.Channel(name, unit, scale=0.01) for name, unit in quantities)
        most = framing.samples_per_frame(len(channels))
        self.per_frame = min(max(round(rate_Hz * _FRAME_S), 1), most)
        self._rate_Hz = rate_Hz
        self._link = open_link()
        self._estimator = open_estimator(sensor, 1 / rate_Hz)
        hello = framing.Hello("doctor", 1, (rate_Hz, 1), channels, simulated=True)
        frames = framing.hello_frames(hello, sequence=0, t0_us=0)
        self._link.feed(b"".join(frames), 0)
        self._sequence = len(frames)
        self._codes = np.full((self.per_frame, len(channels)), 100, dtype=np.int16)
        self._sent = 0

    def step(self, estimate: bool) -> tuple[float, float]:
        """Nanoseconds by the clock and of the processor that one frame takes."""
        t0_us = round(self._sent * self.per_frame * 1e6 / self._rate_Hz)
        self._codes[:, 0] = 100 + self._sent % 7
        number = (self._sequence + self._sent) & 0xFFFF
        wire = framing.samples_frame(self._codes, schema=1, sequence=number, t0_us=t0_us & 0xFFFFFFFF)
        rows = np.zeros(1 if estimate else 0, dtype=np.intp)
        started, busy = time.perf_counter_ns(), time.thread_time_ns()
        self._estimator.push(self._link.feed(wire, 0), rows)
        self._sent += 1
        return float(time.perf_counter_ns() - started), float(time.thread_time_ns() - busy)


def serial_ports() -> list[dict[str, Any]]:
    """What is plugged in: device, USB identity, lasting name, and what stands in the way of using it."""
    from serial.tools import list_ports

    ports = []
    for port in sorted(list_ports.comports()):
        usb = None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
        ports.append(
            {
                "device": port.device, "usb": usb, "serial_number": port.serial_number,
                "manufacturer": port.manufacturer, "product": port.product, "lasting_name": _by_id(port.device),
                "readable": os.access(port.device, os.R_OK | os.W_OK), "latency_timer_ms": _latency_timer(port.device),
            }
        )  # fmt: skip
    return ports


def machine() -> dict[str, Any]:
    """Processor, system, load, and what the system allows a real-time program."""
    import resource

    memory_lock, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    with contextlib.suppress(OSError):
        load: float | None = os.getloadavg()[0]
    return {
        "system": f"{platform.system()} {platform.release()}", "machine": platform.machine(),
        "python": platform.python_version(), "cores": len(os.sched_getaffinity(0)), "load": load,
        "governor": _text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "preemption": "realtime" if _text("/sys/kernel/realtime") == "1" else "ordinary",
        "realtime_priority": _may_be_realtime(),
        "memory_lock_kB": None if memory_lock == resource.RLIM_INFINITY else memory_lock // 1024,
        "monotonic_clock_resolution_ns": round(time.get_clock_info("monotonic").resolution * 1e9),
        "clock_set": time.time() > 1.7e9,
    }  # fmt: skip


def advice(found: dict[str, Any]) -> list[str]:
    """What to do about what was found, in one line each; empty if nothing."""
    lines = []
    pc, sleep = found["machine"], found["sleep_us"]
    if not pc["realtime_priority"]:
        lines.append(
            "no permission for real-time priority: run as a service from `motorlens bundle`, or set LimitRTPRIO=50"
        )
    if pc["governor"] == "powersave":
        lines.append(
            "the processor saves power: `cpupower frequency-set -g performance` shortens the wake-up"
        )
    if pc["load"] is not None and pc["load"] > pc["cores"]:
        lines.append(f"other programs keep the processor busy (load {pc['load']:.1f} on {pc['cores']} cores)")
    if sleep["p99"] > 1000:
        lines.append(
            f"1 in 100 wake-ups is {sleep['p99'] / 1000:.1f} ms late: no sample is lost by it, estimates come that late"
        )
    if not pc["clock_set"]:
        lines.append("the clock is not set: heat remembered over a restart is taken as not cooled")
    for port in found["serial_ports"]:
        if not port["readable"]:
            lines.append(
                f"{port['device']}: no permission; sudo usermod -a -G dialout $USER, then log in again"
            )
        if port["latency_timer_ms"] is not None and port["latency_timer_ms"] > 1:
            lines.append(
                f"{port['device']}: delivers every {port['latency_timer_ms']} ms; the runtime sets 1 ms "
                "where it may, the udev rule of a bundle does always"
            )
    return lines


def _may_be_realtime() -> bool:
    """Whether the system would grant FIFO scheduling; tried in a child, so that nothing changes here."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))"
    done = subprocess.run([sys.executable, "-S", "-c", code], stderr=subprocess.DEVNULL, check=False)
    return done.returncode == 0


def _by_id(device: str) -> str | None:
    folder = Path("/dev/serial/by-id")
    with contextlib.suppress(OSError):
        for link in sorted(folder.iterdir()):
            if os.path.realpath(link) == os.path.realpath(device):
                return str(link)
    return None


def _latency_timer(device: str) -> int | None:
    text = _text(f"/sys/bus/usb-serial/devices/{Path(device).name}/latency_timer")
    return int(text) if text and text.isdigit() else None


def _text(path: str) -> str | None:
    try:
        return Path(path).read_text().strip()
    except OSError:
        return None
