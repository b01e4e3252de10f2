"""What takes long, on Dask distributed: a cluster here, or one that is there; results as they come, failures in words.

A task is a function of a module, one argument, and what all tasks share. Dask runs it again where a worker has died; what
kills its workers each time, or raises, fails alone and the rest goes on. One process a worker and one thread each: the
libraries below have their own locks and memory, and numbers come out the same whoever computes them.
"""

import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from motorlens_runtime.errors import DataError, DeviceError, MotorlensError

if TYPE_CHECKING:
    import argparse

    from distributed import Client

T = TypeVar("T")
U = TypeVar("U")

# A task that raised is tried again this often: a disk or a network may have been at fault.
RETRIES = 2
# A task whose workers have died this often is taken to be what kills them.
DEATHS = 3
# A scheduler that has not answered after so long is not there.
ANSWERS_S = 5.0
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


class Work(Protocol):
    """Does tasks: a function of a module of each, and of what they share if that is given; outcomes as they come."""

    def __call__(self, function: Callable[..., U], tasks: Sequence[Any], *shared: Any) -> "Iterator[Done[U]]":
        """See `worked`."""


@contextmanager
def queue(
    scheduler: str | None = None, workers: int | None = None, memory: str = "auto",
    started: Callable[["Client"], None] = lambda client: None,
) -> Iterator[Work]:  # fmt: skip
    """Where tasks are done; a cluster is started when the first are.

    Args:
        scheduler, workers, memory: see `cluster`; 0 workers is this process.
        started: told the client.

    Raises:
        DataError, DeviceError, ModuleNotFoundError: see `cluster`, `checked_workers`.
    """
    checked_workers(workers)
    with ExitStack() as stack:
        clients: list[Client] = []

        def work(function: Callable[..., U], tasks: Sequence[Any], *shared: Any) -> Iterator[Done[U]]:
            if workers == 0 and scheduler is None:
                return here(function, tasks, *shared)
            if not clients:
                clients.append(stack.enter_context(cluster(scheduler, workers, memory)))
                started(clients[0])
            return worked(clients[0], function, tasks, *shared)

        yield work


def add_queue_arguments(parser: "argparse.ArgumentParser", workers: str = "one a core") -> None:
    """Give a command `--scheduler`, `--workers` and `--memory`."""
    parser.add_argument("--scheduler", metavar="tcp://HOST:PORT", help="a Dask cluster that is there")
    parser.add_argument(
        "--workers", type=int, metavar="N", help=f"processes on this machine (default: {workers}; 0: this one)"
    )  # fmt: skip
    parser.add_argument(
        "--memory", default="auto", metavar="SIZE", help="most that a worker may use, as 2GB (default: its share)"
    )  # fmt: skip


def settings() -> Mapping[str, Any]:
    """How Dask is set."""
    return {
        "distributed.scheduler.allowed-failures": DEATHS,
        "distributed.nanny.pre-spawn-environ": _ONE_THREAD,
        "distributed.worker.daemon": True,
        # A hundred looks a second at what a worker does fill its memory, and nobody reads them.
        "distributed.worker.profile.enabled": False,
        # One task at a time a worker: when it dies, no other that waits there is blamed, see `worked`.
        "distributed.scheduler.worker-saturation": 1.0,
        # Said in our own words.
        "distributed.admin.log-format": "%(message)s",
        "distributed.logging": {"distributed": "critical", "distributed.scheduler": "critical"},
    }


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

    with dask.config.set(settings()):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=ANSWERS_S)
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
    client: "Client", function: Callable[..., U], tasks: Sequence[Any], *shared: Any, retries: int = RETRIES
) -> Iterator[Done[U]]:
    """Outcomes of tasks, as they come.

    Args:
        client: see `cluster`.
        function: of a module that the workers can import.
        tasks: its first arguments; small ones.
        shared: further arguments, the same for all; sent to each worker once.
        retries: how often a task that raised is tried again.

    Raises:
        DeviceError: the cluster has gone.
    """
    from distributed import CancelledError, as_completed
    from distributed.comm import CommClosedError
    from distributed.scheduler import KilledWorker

    gone = DeviceError("the cluster has gone; call the command again, it goes on where it was")

    # Not handed over directly: what only workers held would be gone with the last of them.
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Sending large graph")
        sent = [client.submit(_itself, one, pure=False, retries=retries) for one in shared]

    def submitted(number: int) -> Any:
        future = client.submit(function, tasks[number], *sent, pure=False, retries=retries)
        numbers[future.key] = number
        return future

    def fill() -> None:
        # As many as there are threads now: where more wait at a worker, what ends it is not told from what waits behind.
        try:
            room = max(sum(client.nthreads().values()), 1) - len(numbers)
        except (OSError, CommClosedError, TimeoutError):
            raise gone from None
        finished.update([submitted(number) for number in islice(waiting, max(room, 0))])

    numbers: dict[str, int] = {}
    lost = [0] * len(tasks)
    waiting, finished = iter(range(len(tasks))), as_completed(raise_errors=False, loop=client.loop)
    fill()
    for future in finished:
        number = numbers.pop(future.key)
        if future.status == "cancelled":
            raise gone
        fill()
        error = future.exception(timeout=PATIENCE_S) if future.status == "error" else None
        if error is None:
            try:
                yield Done(number, future.result(timeout=PATIENCE_S))
            except (CancelledError, CommClosedError):
                raise gone from None
            except TimeoutError:
                # The worker that held the result died before it was fetched.
                lost[number] += 1
                if lost[number] > DEATHS:
                    yield Done(number, None, f"its result was lost {DEATHS + 1} times")
                else:
                    finished.add(submitted(number))
        elif isinstance(error, KilledWorker):
            ended = error.allowed_failures + 1
            workers = f"{ended} worker{'' if ended == 1 else 's'}"
            yield Done(number, None, f"ended {workers}: out of memory? (--memory)")
        elif isinstance(error, MotorlensError | OSError):
            yield Done(number, None, " ".join(str(error).split()))
        else:
            yield Done(number, None, " ".join(f"{type(error).__name__}: {error}".split()))


def _itself(what: T) -> T:
    return what


def here(function: Callable[..., U], tasks: Sequence[Any], *shared: Any) -> Iterator[Done[U]]:
    """The same in this process, one after the other: for a few tasks, and where Dask is not installed."""
    for number, task in enumerate(tasks):
        try:
            yield Done(number, function(task, *shared))
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
