"""The real-time profile of a running service: what `--realtime` asks of the system, and what the system said.

The thread that calls it is pinned to one processor and scheduled first in, first out (sched(7)), above everything ordinary.
It waits for data and never spins, so that it stays below the share of a processor that the kernel grants real-time tasks
before it stops them. Processors are asked not to sleep so deeply between two frames that waking takes long, memory is locked
as it is touched, so that nothing waits for the disk. The garbage collector runs only between two blocks, and over what has
been made since the start. Threads and processes begun later are ordinary ones.
"""

import ctypes
import gc
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

PRIORITY = 40
_COLLECT_EVERY_NS = 10_000_000_000
# How long a publisher may keep the interpreter from the hot loop.
_SWITCH_S = 2e-4
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
# As long as it is open, the kernel's idle states keep to the microseconds of wake-up time that were written to it, an int32
# (Documentation/power/pm_qos_interface.rst in the kernel's sources).
CPU_DMA_LATENCY = "/dev/cpu_dma_latency"
_THROTTLE = "/proc/sys/kernel/sched_rt_runtime_us", "/proc/sys/kernel/sched_rt_period_us"


@dataclass(frozen=True)
class Granted:
    """Lines for a person: what was granted, and what was refused with what to do about it."""

    granted: tuple[str, ...]
    refused: tuple[str, ...]


@contextmanager
def realtime(cpu_dma_latency: str = CPU_DMA_LATENCY) -> Iterator[Granted]:
    """Run the calling thread in real time as far as the system lets it, and ordinarily again after.

    Args:
        cpu_dma_latency: the file that keeps processors awake while it is open.
    """
    processors, policy = os.sched_getaffinity(0), os.sched_getscheduler(0)
    priority, switch_s, collecting = os.sched_getparam(0), sys.getswitchinterval(), gc.isenabled()
    granted: list[str] = []
    refused: list[str] = []
    for ask in (_pin, _first_in_first_out, _lock_memory):
        try:
            granted.append(ask())
        except OSError as error:
            refused.append(f"{error.strerror or error}: {_REMEDIES[ask]}")
    awake = None
    try:
        awake = _stay_awake(cpu_dma_latency)
        granted.append("processors stay awake")
    except OSError as error:
        refused.append(f"{error.strerror or error}: {_REMEDIES[_stay_awake]}")
    sys.setswitchinterval(_SWITCH_S)
    gc.disable()
    try:
        yield Granted(tuple(granted), tuple(refused))
    finally:
        if collecting:
            gc.enable()
        sys.setswitchinterval(switch_s)
        if awake is not None:
            os.close(awake)
        _libc().munlockall()
        with suppress(OSError):  # refused now, it was refused before
            os.sched_setscheduler(0, policy & ~os.SCHED_RESET_ON_FORK, priority)
        os.sched_setaffinity(0, processors)


def collecting(stop: Callable[[], bool], clock: Callable[[], int]) -> Callable[[], bool]:
    """`stop`, which is asked between two blocks, with a collection of garbage every ten seconds."""
    due_ns = clock() + _COLLECT_EVERY_NS

    def stop_or_collect() -> bool:
        nonlocal due_ns
        if clock() >= due_ns:
            due_ns = clock() + _COLLECT_EVERY_NS
            gc.collect()
        return stop()

    return stop_or_collect


def _pin() -> str:
    """The last processor: the first one serves most interrupts."""
    processors = os.sched_getaffinity(0)
    if len(processors) == 1:
        return "there is one processor, and nothing to pin to"
    os.sched_setaffinity(0, {max(processors)})
    return f"pinned to processor {max(processors)}"


def _first_in_first_out() -> str:
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
    try:
        share, period = (int(Path(name).read_text()) for name in _THROTTLE)
    except (OSError, ValueError):
        return f"real-time priority {PRIORITY}"
    limit = "without a limit" if share < 0 else f"up to {100 * share / period:.0f} % of a processor"
    return f"real-time priority {PRIORITY}, {limit}"


def _lock_memory() -> str:
    libc = _libc()
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return "memory locked"


def _stay_awake(path: str) -> int:
    """The open file that asks for a wake-up time of zero."""
    file = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(file, (0).to_bytes(4, sys.byteorder))
    except OSError:
        os.close(file)
        raise
    return file


_REMEDIES: dict[Callable[..., object], str] = {
    _pin: "not pinned to one processor",
    _first_in_first_out: f"no real-time priority; LimitRTPRIO={PRIORITY} in the unit, or `ulimit -r {PRIORITY}`, allows it",
    _lock_memory: "memory not locked; LimitMEMLOCK=infinity in the unit, or `ulimit -l unlimited`, allows it",
    _stay_awake: f"processors may sleep deeply; write access to {CPU_DMA_LATENCY} (udev rule of the bundle) allows it",
}


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
