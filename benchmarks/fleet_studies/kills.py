"""Runs in which a worker, the scheduler or all of it is killed at random, against one in peace: the same bytes."""

import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
from fleet_studies.plant import fleet, make_file
from helpers.plain_fleet import World

# Seconds that a run lives before it is killed, once there is what is to be killed; and that anything may take at most.
LIVES, MOST = (0.0, 12.0), 300.0


def killed(place: Path, kills: int, seed: int) -> None:
    """Kill a worker, the scheduler, or everything, in turn; each time the command is called again if it is gone."""
    World(4, 3, samples=300, dwell=50).write(place / "plant", seed)
    make, rng = make_file(place / "make.toml"), random.Random(seed)
    fleet(place / "plant", make, place / "peace", "--workers", "1")
    done = dict.fromkeys(("a worker", "the scheduler", "everything"), 0)
    early = 0
    while sum(done.values()) < kills:
        what = list(done)[sum(done.values()) % len(done)]
        if _hit(what, place, make, rng):
            done[what] += 1
        else:
            # It ended before: begin anew, so that there is something to do.
            early += 1
            for result in (place / "war" / "results").rglob("*.json"):
                result.unlink()
        print(f"{sum(done.values())} of {kills} kills", file=sys.stderr, flush=True)
    fleet(place / "plant", make, place / "war", "--workers", "1")
    same = content(place / "peace") == content(place / "war")
    told = ", ".join(f"{what} {count} times" for what, count in done.items())
    print(
        f"killed with -9: {told} ({early} runs ended before): {'the same' if same else 'OTHER'} bytes as in peace"
    )


def _hit(what: str, place: Path, make: Path, rng: random.Random) -> bool:
    """Run the command and kill something of it at random; whether it still ran. The scheduler is a process of its own."""
    words = _module(
        "motorlens_runtime", "fleet", str(place / "plant"), "--motor", str(make), "-o", str(place / "war")
    )
    others: list[subprocess.Popen] = []
    if what == "the scheduler":
        others, address = _cluster(place)
        words += ["--scheduler", address]
    else:
        words += ["--workers", "1"]
    program = _started(words)
    try:
        if what == "a worker":
            _worker(program)
        with contextlib.suppress(subprocess.TimeoutExpired):
            program.wait(rng.uniform(*LIVES))
        if program.poll() is not None:
            return False
        if what == "the scheduler":
            others[0].kill()
            # It says that the cluster has gone, and ends.
            return program.wait(MOST) == 1
        if what == "a worker":
            worker = _worker(program)
            if worker is None:
                return False
            worker.kill()
            # It goes on, and ends as if nothing had been.
            return program.wait(MOST) == 0
        os.killpg(program.pid, signal.SIGKILL)
        return True
    except psutil.NoSuchProcess:
        return False
    finally:
        for one in (program, *others):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(one.pid, signal.SIGKILL)
            one.wait(MOST)


def _worker(program: subprocess.Popen) -> psutil.Process | None:
    """A worker of a run, as soon as there is one; None if the run ends before."""
    end = time.monotonic() + MOST
    while program.poll() is None and time.monotonic() < end:
        for child in psutil.Process(program.pid).children(recursive=True):
            if "spawn_main" in " ".join(child.cmdline()):
                return child
        time.sleep(0.2)
    return None


def _cluster(place: Path) -> tuple[list[subprocess.Popen], str]:
    """A scheduler and a worker as a user starts them, and the scheduler's address."""
    where = place / "scheduler.json"
    where.unlink(missing_ok=True)
    told = ["--no-dashboard", "--scheduler-file", str(where)]
    scheduler = _started(_module("distributed.cli.dask_scheduler", "--port", "0", *told))
    worker = _started(_module("distributed.cli.dask_worker", "--nthreads", "1", *told))
    end = time.monotonic() + MOST
    while not where.exists() and time.monotonic() < end:
        time.sleep(0.2)
    return [scheduler, worker], json.loads(where.read_text())["address"]


def _module(*words: str) -> list[str]:
    return [sys.executable, "-m", *words]


def _started(words: list[str]) -> subprocess.Popen:
    # A session of its own, so that all that it starts can be ended with it.
    return subprocess.Popen(
        words, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def content(out: Path) -> dict[str, bytes]:
    """All that a run has written, but the page, which names its folder."""
    return {
        str(p.relative_to(out)): p.read_bytes()
        for p in out.rglob("*")
        if p.is_file() and p.name != "index.html"
    }
