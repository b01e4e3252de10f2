"""The queue's own cost, by tasks that sleep: rate of workers in other processes, and of 64 in simulation; their memory.

By the clock a task costs more where the machine has other things to do; processor time does not know that.
"""

import heapq
import os
import time
from pathlib import Path

import numpy as np
import psutil
from helpers.fleet_tasks import sleeps
from numpy.typing import NDArray

from motorlens_physics.queue import cluster, settings, worked

ROOT = Path(__file__).resolve().parents[2]
# Seconds of a diagnosis, and how far their logarithm scatters, as in `null.py`: what the sizes of its recordings tell of it
# beforehand, and what they do not.
DIAGNOSIS_S, FORESEEN, UNFORESEEN = 6.6, 0.3, 0.6
# Tasks after which a worker has loaded what it needs.
WARM = 200
# Workers of the simulation, and how many draws of the tasks are counted on paper beside the one that is run.
SIMULATED, DRAWS = 64, 200
# Each worker looks at its machine twice and at its loop fifty times a second; of 64 in one process that is a sixth
# of a core, which no machine with a worker of its own spends.
LOOKS = {"distributed.admin.system-monitor.interval": "10s", "distributed.admin.tick.interval": "1s"}


def queue(tasks: int, seconds: float) -> None:
    """Efficiency beside one worker, overhead of a task, and memory, of as many workers as processes."""
    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    alone = 0.0
    for workers in (1, 2):
        with cluster(workers=workers) as client:
            list(worked(client, sleeps, [0.0] * WARM))
            before, begun, spent_before = _memory(client), time.monotonic(), _processor_s()
            failed = sum(bool(one.failure) for one in worked(client, sleeps, [seconds] * tasks))
            spent = time.monotonic() - begun
            rate = tasks / spent
            alone = alone or rate
            each = (spent * workers / tasks - seconds) * 1e3
            processor = (_processor_s() - spent_before) / tasks * 1e3
            print(f"queue: {workers} workers, {tasks} tasks of {seconds:g} s, {failed} failed: "
                  f"efficiency {rate * seconds / workers:.3f}, {rate / (alone * workers):.3f} of one worker's rate times "
                  f"{workers}, {each:.1f} ms a task ({processor:.1f} ms of processor time), "
                  f"memory {before:.0f} to {_memory(client):.0f} MB a worker", flush=True)  # fmt: skip


def simulated(tasks: int, seed: int) -> None:
    """64 workers, threads of this process, on tasks that sleep as long as diagnoses take."""
    import dask
    from distributed import Client, LocalCluster

    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    seconds = _drawn(tasks, seed)
    with (
        dask.config.set({**settings(), **LOOKS}),
        LocalCluster(
            n_workers=SIMULATED, threads_per_worker=1, processes=False, dashboard_address=None, silence_logs=50,
            memory_limit=None,
        ) as here,
        Client(here) as client,
    ):  # fmt: skip
        list(worked(client, sleeps, [0.0] * SIMULATED))
        begun = time.monotonic()
        list(worked(client, sleeps, seconds.tolist()))
        spent = time.monotonic() - begun
    # No order of whole tasks can be faster.
    paper = max(seconds.sum() / SIMULATED, seconds.max())
    print(f"queue, simulated: {SIMULATED} workers, {tasks} tasks of {DIAGNOSIS_S:g} s in the median: {spent:.1f} s, "
          f"on paper {paper:.1f} s, efficiency {seconds.sum() / SIMULATED / spent:.3f} "
          f"(in this order, without a queue's cost: {_efficiency(seconds):.3f})")  # fmt: skip
    draws = np.array([_efficiency(_drawn(tasks, seed + 1 + k)) for k in range(DRAWS)])
    print(
        f"queue, on paper: efficiency {draws.mean():.3f} in the mean of {DRAWS} draws of such tasks, "
        f"{np.quantile(draws, 0.1):.3f} to {np.quantile(draws, 0.9):.3f} in eight of ten"
    )


def _drawn(tasks: int, seed: int) -> NDArray[np.float64]:
    """(tasks,) seconds of tasks in the order of `study.results`: the longest first, as far as that is known."""
    rng = np.random.default_rng(seed)
    foreseen = FORESEEN * rng.standard_normal(tasks)
    seconds = DIAGNOSIS_S * np.exp(foreseen + UNFORESEEN * rng.standard_normal(tasks))
    return np.asarray(seconds[np.argsort(-foreseen)])


def _efficiency(seconds: NDArray[np.float64]) -> float:
    """Of `SIMULATED` workers of which each takes the next task when it is free."""
    ends = [0.0] * SIMULATED
    for task in seconds:
        heapq.heapreplace(ends, ends[0] + task)
    return float(seconds.sum() / SIMULATED / max(ends))


def _processor_s() -> float:
    """Processor time of this process, which is the scheduler too, and of its workers."""
    here = psutil.Process()
    return sum(sum(process.cpu_times()[:2]) for process in (here, *here.children(recursive=True)))


def _memory(client) -> float:
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return float(np.mean([w["metrics"]["memory"] for w in workers])) / 1e6
