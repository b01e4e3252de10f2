"""A publisher behind a bounded queue and a thread of its own: slow or dead, it never delays the estimator.

What does not fit is dropped, oldest first, and counted. An error of the publisher is counted and it is tried again with
the next rows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import parse_qsl, urlsplit

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.publish import Header, open_publisher
from motorlens_runtime.worker import Worker

Event = dict[str, Any]

_MAX_ROWS = 1 << 16
_FLUSH_S = 0.2
_FIRST, _NONE = np.zeros(1, dtype=np.intp), np.zeros(0, dtype=np.intp)


class Grid:
    """Picks the first row at or after each instant of a fixed rate; a rate of 0 picks every row.

    Attributes:
        period_ns: between instants, 0: every row.
        instant: the number of the last that was reached, None before the first.
    """

    def __init__(self, rate_Hz: float) -> None:
        self.period_ns = round(1e9 / rate_Hz) if rate_Hz > 0 else 0
        self.instant: int | None = None

    def rows(self, time_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Indices of the rows that are due."""
        if not self.period_ns or not len(time_ns):
            return np.arange(len(time_ns))
        first, last = int(time_ns[0]) // self.period_ns, int(time_ns[-1]) // self.period_ns
        before, self.instant = self.instant, last
        if first == last:
            return _FIRST if first != before else _NONE
        ticks = time_ns // self.period_ns
        new = np.empty(len(ticks), dtype=bool)
        new[0] = first != before
        np.not_equal(ticks[1:], ticks[:-1], out=new[1:])
        return np.flatnonzero(new)


def rows_of(estimates: Estimates, rows: NDArray[np.intp]) -> Estimates:
    """The chosen rows."""
    return Estimates(
        estimates.time_ns[rows], estimates.values[rows], estimates.sigma[rows], estimates.quality[rows]
    )


@dataclass(frozen=True)
class OutletReport:
    """What became of the rows that a publisher was given."""

    url: str
    published: int
    dropped: int
    errors: int
    last_error: str | None


class Outlet:
    """One `--publish URL` with its options `rate` (rows per second) and `decimate` (`last` or `mean`).

    Raises:
        DataError, DeviceError, OSError: it cannot be opened.
    """

    def __init__(self, url: str, header: Header) -> None:
        options = dict(parse_qsl(urlsplit(url).query))
        self._url = url
        self._grid = Grid(_rate(url, options.get("rate", "0")))
        self._reduce = _reducer(url, options.get("decimate", "last"), options.get("rate"))
        self._publisher = open_publisher(url, header)
        self._tell: Callable[[Event], None] | None = getattr(self._publisher, "event", None)
        self._tell_counts: Callable[[Event], None] | None = getattr(self._publisher, "counts", None)
        self._counts: Event | None = None
        self._given_up: str | None = None
        self._takes_inputs = bool(getattr(self._publisher, "takes_inputs", False))
        self._worker: Worker[Estimates | Event] = Worker(
            url, self._publish, _MAX_ROWS, weight=_rows, ends=(BrokenPipeError,), settle=self._settle, every_s=_FLUSH_S,
            gather_s=float(getattr(self._publisher, "gather_s", 0.0)), finish=self._publisher.close,
        )  # fmt: skip

    @property
    def dead(self) -> bool:
        """Whether the reader has gone for good."""
        return self._worker.dead

    def put(self, estimates: Estimates, inputs: NDArray[np.float64] | None = None) -> None:
        """Hand over rows; returns at once.

        Args:
            estimates: N rows.
            inputs: voltage in V and current in A at those rows, (N, 2); None if there are none.
        """
        if self._takes_inputs:
            estimates = _widened(estimates, inputs)
        estimates = self._reduce(self._grid, estimates)
        if len(estimates) and not self.dead:
            self._worker.put(estimates)

    def put_event(self, event: Event) -> None:
        """Hand over an event, to a publisher that has a word for it; returns at once."""
        if self._tell is not None and not self.dead:
            self._worker.put(event)

    def put_counts(self, counts: Event) -> None:
        """Hand over what the service counts, see `Service.counts`, to a publisher that shows it; only the newest waits."""
        if self._tell_counts is not None and not self.dead:
            self._counts = counts
            self._worker.nudge()

    def close(self, patience_s: float = 2.0) -> None:
        """Publish what waits, for `patience_s` at most, and finish."""
        if rows := self._worker.close(patience_s):
            self._given_up = f"did not take its last {rows} rows within {patience_s:g} s"

    def report(self) -> OutletReport:
        """See `OutletReport`."""
        worker = self._worker
        # Some publishers cannot send at once what they are given, and count that themselves.
        lost = worker.lost + int(getattr(self._publisher, "dropped", 0))
        last = self._given_up or (None if worker.error is None else _told(worker.error))
        return OutletReport(self._url, worker.done, lost, worker.errors, last)

    def _publish(self, item: Estimates | Event) -> None:
        if isinstance(item, Estimates):
            self._publisher.publish(item)
        elif self._tell is not None:
            self._tell(item)

    def _settle(self) -> None:
        counts, self._counts = self._counts, None
        if counts is not None and self._tell_counts is not None:
            self._tell_counts(counts)
        self._publisher.flush()


def _told(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]


def _widened(estimates: Estimates, inputs: NDArray[np.float64] | None) -> Estimates:
    """Rows with voltage and current as two more columns, NaN where they are not known, without a deviation."""
    if inputs is None:
        inputs = np.full((len(estimates), 2), np.nan)
    values = np.hstack((estimates.values, inputs))
    return replace(estimates, values=values, sigma=np.hstack((estimates.sigma, np.zeros_like(inputs))))


def _rows(item: Estimates | Event) -> int:
    return len(item) if isinstance(item, Estimates) else 1


def _rate(url: str, text: str) -> float:
    try:
        rate = float(text)
        if not 0 <= rate < 1e9:
            raise ValueError
    except ValueError:
        raise DataError(f"--publish {url}: rate={text} is not a rate in rows per second") from None
    return rate


def _reducer(url: str, name: str, rate: str | None) -> Callable[[Grid, Estimates], Estimates]:
    if name == "last" or rate is None:
        return lambda grid, estimates: rows_of(estimates, grid.rows(estimates.time_ns))
    if name == "mean":
        return _Mean()
    raise DataError(f"--publish {url}: decimate={name}; known: last, mean")


class _Mean:
    """Means over the rows since the previous published one: values and sigmas averaged, reasons joined."""

    def __init__(self) -> None:
        self._held: list[Estimates] = []

    def __call__(self, grid: Grid, estimates: Estimates) -> Estimates:
        picked = grid.rows(estimates.time_ns)
        means = []
        start = 0
        for end in (picked + 1).tolist():
            rows = [*self._held, rows_of(estimates, np.arange(start, end))]
            means.append(_mean(rows))
            self._held, start = [], end
        if start < len(estimates):
            self._held.append(rows_of(estimates, np.arange(start, len(estimates))))
        fields = Estimates.__dataclass_fields__
        if not means:
            return rows_of(estimates, np.zeros(0, dtype=np.intp))
        return Estimates(*(np.concatenate([getattr(mean, name) for mean in means]) for name in fields))


def _mean(parts: list[Estimates]) -> Estimates:
    return Estimates(
        parts[-1].time_ns[-1:],
        np.concatenate([part.values for part in parts]).mean(axis=0, keepdims=True),
        np.concatenate([part.sigma for part in parts]).mean(axis=0, keepdims=True),
        np.bitwise_or.reduce(np.concatenate([part.quality for part in parts]), keepdims=True),
    )
