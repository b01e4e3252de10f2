"""The queue's own cost, by tasks that sleep: rate of workers in other processes, and of 64 in simulation; their memory."""

import os
import time
from pathlib import Path

import numpy as np
from helpers.fleet_tasks import sleeps

from motorlens_physics.queue import cluster, worked

ROOT = Path(__file__).resolve().parents[2]
# Seconds of a diagnosis: the median of `hidden_effects.py --quick`, and how far its logarithm scatters.
DIAGNOSIS_S, SCATTER = 10.0, 0.5
# Workers of the simulation, and how many times faster it runs than they would.
SIMULATED, FASTER = 64, 10.0


def queue(tasks: int, seconds: float) -> None:
    """Efficiency beside one worker, overhead of a task, and memory, of as many workers as processes."""
    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    alone = 0.0
    for workers in (1, 2):
        with cluster(workers=workers) as client:
            list(worked(client, sleeps, [0.0] * workers))
            before, begun = _memory(client), time.monotonic()
            failed = sum(bool(one.failure) for one in worked(client, sleeps, [seconds] * tasks))
            spent = time.monotonic() - begun
            rate = tasks / spent
            alone = alone or rate
            each = (spent * workers / tasks - seconds) * 1e3
            print(f"queue: {workers} workers, {tasks} tasks of {seconds:g} s, {failed} failed: "
                  f"efficiency {rate * seconds / workers:.3f}, {rate / (alone * workers):.3f} of one worker's rate times "
                  f"{workers}, {each:.1f} ms a task, memory {before:.0f} to {_memory(client):.0f} MB a worker",
                  flush=True)  # fmt: skip


def simulated(tasks: int, seed: int) -> None:
    """64 workers, threads of this process, on tasks that sleep as long as diagnoses take, some times faster.

    So much faster the scheduler's own cost weighs as much more: what is shown is a lower bound.
    """
    from distributed import Client, LocalCluster

    os.environ["PYTHONPATH"] = str(ROOT / "tests")
    seconds = DIAGNOSIS_S / FASTER * np.exp(SCATTER * np.random.default_rng(seed).standard_normal(tasks))
    with (
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
    print(f"queue, simulated: {SIMULATED} workers, {tasks} tasks of {DIAGNOSIS_S:g} s in the median, {FASTER:g} times "
          f"faster: {spent:.1f} s, on paper {paper:.1f} s, efficiency {seconds.sum() / SIMULATED / spent:.3f}")  # fmt: skip


def _memory(client) -> float:
    workers = client.scheduler_info(n_workers=-1)["workers"].values()
    return float(np.mean([w["metrics"]["memory"] for w in workers])) / 1e6
