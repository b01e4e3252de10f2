"""Tasks on Dask distributed: a cluster on this machine, or one that is there; results as they come, failures in words.

A task is a function of a module and one argument. Dask runs it again where a worker has died; what kills its workers each
time, or raises, fails alone and the rest goes on. One process a worker and one thread each: the libraries below have their
own locks and memory, and numbers come out the same whoever computes them.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from motorlens_runtime.errors import DataError, DeviceError, MotorlensError

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
U = TypeVar("U")

# A task that raised is tried again this often: a disk or a network may have been at fault.
RETRIES = 2
# A task whose workers have died this often is taken to be what kills them.
DEATHS = 3
# A result that has not come from its worker after so long is lost with it.
PATIENCE_S = 30.0
_ONE_THREAD = {
    name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
}


@dataclass(frozen=True)
class Done(Generic[U]):
    """The outcome of one task: its number, and what it returned, or in one line why it failed."""

    number: int
    value: U | None
    failure: str = ""


@contextmanager
def cluster(
    scheduler: str | None = None, workers: int | None = None, memory: str = "auto"
) -> Iterator["Client"]:
    """A client of a cluster.

    Args:
        scheduler: of a cluster that is there, "tcp://host:8786"; None starts one on this machine.
        workers: processes of the cluster that is started; None is one for each core.
        memory: of a worker, as "2GB"; one that needs more is ended, and its task counts as failed after `DEATHS` times.

    Raises:
        DeviceError: nobody answers there.
        ModuleNotFoundError: Dask is not installed.
    """
    import dask
    from distributed import Client, LocalCluster

    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.nanny.pre-spawn-environ": _ONE_THREAD,
        "distributed.worker.daemon": True,
        # One task at a time a worker: when it dies, no other that waits there is blamed.
        "distributed.scheduler.worker-saturation": 1.0,
        # Said in our own words.
        "distributed.admin.log-format": "%(message)s",
        "distributed.logging": {"distributed": "critical", "distributed.scheduler": "critical"},
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout="5s")
            except (OSError, ValueError) as error:
                raise DeviceError(
                    f"--scheduler {scheduler}: no Dask scheduler answers ({error}); start one with `dask scheduler`"
                ) from None
            with client:
                yield client
            return
        from motorlens_physics.threads import cores

        number = workers or cores()
        # The dashboard takes any port that is free, and is only there where bokeh is.
        with (
            LocalCluster(
                n_workers=number, threads_per_worker=1, processes=True, memory_limit=memory, dashboard_address=":0",
                silence_logs=50,
            ) as here,
            Client(here) as client,
        ):  # fmt: skip
            yield client


def worked(
    client: "Client", function: Callable[[T], U], tasks: Sequence[T], *, retries: int = RETRIES
) -> Iterator[Done[U]]:
    """Outcomes of tasks, as they come.

    Args:
        client: see `cluster`.
        function: of a module that the workers can import.
        tasks: its arguments; small ones.
        retries: how often a task that raised is tried again.

    Raises:
        DeviceError: the cluster has gone.
    """
    from distributed import CancelledError, as_completed
    from distributed.scheduler import KilledWorker

    gone = DeviceError("the cluster has gone; call the command again, it goes on where it was")

    def submitted(number: int) -> Any:
        future = client.submit(function, tasks[number], pure=False, retries=retries)
        numbers[future.key] = number
        return future

    numbers: dict[str, int] = {}
    lost = [0] * len(tasks)
    finished = as_completed([submitted(number) for number in range(len(tasks))], raise_errors=False)
    for future in finished:
        number = numbers.pop(future.key)
        if future.status == "cancelled":
            raise gone
        error = future.exception(timeout=PATIENCE_S) if future.status == "error" else None
        if error is None:
            try:
                yield Done(number, future.result(timeout=PATIENCE_S))
            except CancelledError:
                raise gone from None
            except TimeoutError:
                # The worker that held the result died before it was fetched.
                lost[number] += 1
                if lost[number] > DEATHS:
                    yield Done(number, None, f"its result was lost {DEATHS + 1} times")
                else:
                    finished.add(submitted(number))
        elif isinstance(error, KilledWorker):
            yield Done(number, None, f"ended {DEATHS + 1} workers: out of memory? (--memory)")
        elif isinstance(error, MotorlensError | OSError):
            yield Done(number, None, " ".join(str(error).split()))
        else:
            yield Done(number, None, " ".join(f"{type(error).__name__}: {error}".split()))


def here(function: Callable[[T], U], tasks: Sequence[T]) -> Iterator[Done[U]]:
    """The same in this process, one after the other: for a few tasks, and where Dask is not installed."""
    for number, task in enumerate(tasks):
        try:
            yield Done(number, function(task))
        except (MotorlensError, OSError) as error:
            yield Done(number, None, " ".join(str(error).split()))
        except Exception as error:  # one task fails, the rest goes on
            yield Done(number, None, " ".join(f"{type(error).__name__}: {error}".split()))


def single_threaded() -> None:
    """Have the libraries of this process use one thread; of use before they are loaded."""
    for name, one in _ONE_THREAD.items():
        os.environ.setdefault(name, one)


def checked_workers(number: int | None) -> int | None:
    """The number of workers asked for. Raises DataError if it is below 0."""
    if number is not None and number < 0:
        raise DataError(f"--workers {number}: 0 (in this process) or more")
    return number
