"""Many kills at little cost: scheduler, workers and command are forks of this process, and jobs only sleep.

What is killed is what a user's cluster has: Dask's scheduler and workers, and the process that keeps the results. Jobs go
the way of recordings: `study.results`, the queue and the store of `motorlens fleet`. `kills.py` kills the command itself.
"""

import asyncio
import logging
import os
import random
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleet_studies.kills import content

from motorlens_physics.queue import cluster, here, settings, worked
from motorlens_workbench.fleet.manifest import Entry
from motorlens_workbench.fleet.store import Store, digest
from motorlens_workbench.fleet.study import results
from motorlens_workbench.fleet.work import analysed

JOBS, WORKERS = 40, 2
# Seconds that a job takes, after which something is killed, and that anything may take at most.
SLEEPS_S, LIVES_S, MOST_S = 0.05, (0.0, 2.0), 120.0


@dataclass(frozen=True)
class Sleep:
    """A job that takes a moment, and says what follows from its number."""

    number: int
    paths: tuple[Path, ...] = ()

    def key(self) -> str:
        return digest(b"sleep", str(self.number).encode())

    def result(self) -> dict[str, Any]:
        time.sleep(SLEEPS_S)
        return {"number": self.number, "seventh": self.number / 7}


def killed_often(place: Path, kills: int, seed: int) -> None:
    """Kill a worker, the scheduler, or the command at random, until there were so many; then one run in peace."""
    rng = random.Random(seed)
    jobs = [(Entry(f"m{n}", Path(f"{n}.csv"), f"{n}.csv"), Sleep(n)) for n in range(JOBS)]
    results(jobs, Store(place / "peace"), lambda todo: here(analysed, todo), lambda done, of: None)
    done = dict.fromkeys(("a worker", "the scheduler", "the command"), 0)
    begun, ended = 0, 0
    while sum(done.values()) < kills:
        what = rng.choice(list(done))
        begun += 1
        if _run(place, jobs, what, rng):
            done[what] += 1
        if len(content(place / "war")) == JOBS:
            # All is done: begin anew, so that there is something to kill.
            assert content(place / "war") == content(place / "peace")
            ended += 1
            for path in (place / "war").rglob("*.json"):
                path.unlink()
    _run(place, jobs, "", rng)
    same = content(place / "war") == content(place / "peace")
    told = ", ".join(f"{what} {count} times" for what, count in done.items())
    print(f"forks killed with -9 in {begun} runs: {told}; {ended + 1} times all {JOBS} results were there, "
          f"{'the same' if same else 'OTHER'} bytes as in peace")  # fmt: skip


def _run(place: Path, jobs: list[tuple[Entry, Sleep]], what: str, rng: random.Random) -> bool:
    """Do the jobs on a cluster of their own and kill something; whether it was still at work."""
    where = place / "address"
    where.unlink(missing_ok=True)
    scheduler = _forked(lambda: asyncio.run(_scheduler(where)))
    end = time.monotonic() + MOST_S
    while not where.exists() and time.monotonic() < end:
        time.sleep(0.02)
    address = where.read_text()
    others = [scheduler, *(_forked(lambda: asyncio.run(_worker(address))) for _ in range(WORKERS))]
    command = _forked(lambda: _command(place / "war", jobs, address))
    try:
        hit = False
        if what:
            time.sleep(rng.uniform(*LIVES_S))
            victim = {"a worker": others[1], "the scheduler": scheduler, "the command": command}[what]
            hit = os.waitpid(command, os.WNOHANG) == (0, 0)
            if not hit:
                return False
            os.kill(victim, signal.SIGKILL)
        _, status = os.waitpid(command, 0)
        # With one worker fewer all is done; without a scheduler it says so and ends, unless it had just been done.
        allowed = {"": (0,), "a worker": (0,), "the scheduler": (0, 1), "the command": (0, -signal.SIGKILL)}
        assert os.waitstatus_to_exitcode(status) in allowed[what], (what, status)
        return hit
    finally:
        for one in others:
            os.kill(one, signal.SIGKILL)
            os.waitpid(one, 0)


def _forked(does: Callable[[], Any]) -> int:
    """A fork of this process that does something and ends, within `MOST_S`; its number."""
    if child := os.fork():
        return child
    signal.alarm(int(MOST_S))
    # Dask says at length who has gone.
    logging.disable()
    try:
        os._exit(int(does() or 0))
    except BaseException:
        traceback.print_exc()
        os._exit(3)


def _command(out: Path, jobs: list[tuple[Entry, Sleep]], address: str) -> int:
    from motorlens_runtime.errors import DeviceError

    store = Store(out)
    store.clear_halves()
    try:
        with cluster(address) as client:
            results(jobs, store, lambda todo: worked(client, analysed, todo), lambda done, of: None)
    except DeviceError:
        return 1
    return 0


async def _scheduler(where: Path) -> None:
    import dask
    from distributed import Scheduler

    with dask.config.set(settings()):
        async with Scheduler(port=0, dashboard=False) as scheduler:
            half = where.with_suffix(".half")
            half.write_text(scheduler.address)
            half.rename(where)
            await scheduler.finished()


async def _worker(address: str) -> None:
    import dask
    from distributed import Worker

    with dask.config.set(settings()):
        async with Worker(address, nthreads=1) as worker:
            await worker.finished()
