"""The rows a live page can show, in memory that does not grow: every row for a while, means over longer and longer bins.

A row of means carries the mean value, the mean standard deviation and all reasons of its rows, as `decimate=mean` does.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.service.outlet import rows_of

# Rows that each level keeps.
ROWS = 6000
# Bins of the coarser levels: a day is 4320 bins of 20 s.
BINS_S = (1.0, 20.0)
BACK_S = 5.0


@dataclass(frozen=True)
class View:
    """Rows for a page.

    Attributes:
        level: 0 is every row, from 1 on means over `BINS_S[level - 1]`.
        first: number of the first row in its level, from 0.
        rows: the rows.
        more: whether there are newer ones still.
    """

    level: int
    first: int
    rows: Estimates
    more: bool

    @property
    def after(self) -> int:
        """Number of the row that comes next."""
        return self.first + len(self.rows)


class History:
    """Rows of K quantities. One writer; readers in other threads see whole rows only if the caller locks."""

    def __init__(self, outputs: int, rows: int = ROWS, bins_s: tuple[float, ...] = BINS_S) -> None:
        self._levels = [_Ring(outputs, rows) for _ in range(1 + len(bins_s))]
        self._means = [_Bins(round(1e9 * bin_s)) for bin_s in bins_s]

    def append(self, rows: Estimates) -> None:
        """Newer rows. What steps back a little (a value repeated while the line was silent) is left out; a stream that
        begins again, `BACK_S` earlier or more, starts everything anew."""
        newest = self._levels[0].newest_ns
        if newest is not None and len(rows):
            if int(rows.time_ns[0]) < newest - round(1e9 * BACK_S):
                for level in self._levels:
                    level.restart()
                for means in self._means:
                    means.restart()
            else:
                rows = rows_of(rows, np.flatnonzero(rows.time_ns > newest))
        if not len(rows):
            return
        self._levels[0].append(rows)
        for means, level in zip(self._means, self._levels[1:], strict=True):
            level.append(means.complete(rows))

    def view(self, window_s: float, level: int = -1, after: int = 0, most: int = ROWS) -> View:
        """The last `window_s` seconds, in the finest level that still holds them all; the oldest `most` rows of them.

        `level` and `after` are what the reader has already: if the level is still the right one, only newer rows are given.
        """
        newest = self._levels[0].newest_ns
        start_ns = -(1 << 62) if newest is None else newest - round(1e9 * window_s)
        chosen = next(
            (k for k, ring in enumerate(self._levels) if ring.reaches(start_ns)), len(self._levels) - 1
        )
        ring = self._levels[chosen]
        first = ring.number_of(start_ns)
        if chosen == level and first <= after <= ring.count:
            first = after
        rows = ring.rows_from(first, most)
        return View(chosen, first, rows, first + len(rows) < ring.count)


class _Ring:
    """The last rows of a level."""

    def __init__(self, outputs: int, rows: int) -> None:
        self._rows = Estimates(
            np.zeros(rows, dtype=np.int64), np.zeros((rows, outputs)), np.zeros((rows, outputs)),
            np.zeros(rows, dtype=np.uint32),
        )  # fmt: skip
        self._oldest = 0
        self.count = 0

    @property
    def newest_ns(self) -> int | None:
        return (
            int(self._rows.time_ns[(self.count - 1) % len(self._rows)]) if self.count > self._oldest else None
        )

    def append(self, rows: Estimates) -> None:
        size = len(self._rows)
        kept = rows_of(rows, np.arange(max(0, len(rows) - size), len(rows)))
        self.count += len(rows)
        at = np.arange(self.count - len(kept), self.count) % size
        for name in Estimates.__dataclass_fields__:
            getattr(self._rows, name)[at] = getattr(kept, name)
        self._oldest = max(self._oldest, self.count - size)

    def restart(self) -> None:
        self._oldest = self.count

    def reaches(self, time_ns: int) -> bool:
        """Whether nothing since `time_ns` has been dropped."""
        if self._oldest == 0 or self.count < self._oldest + len(self._rows):
            return True
        return int(self._rows.time_ns[self._oldest % len(self._rows)]) <= time_ns

    def number_of(self, time_ns: int) -> int:
        """Number of the first row at or after `time_ns`."""
        at = np.arange(self._oldest, self.count) % len(self._rows)
        return self._oldest + int(np.searchsorted(self._rows.time_ns[at], time_ns))

    def rows_from(self, first: int, most: int) -> Estimates:
        return rows_of(self._rows, np.arange(first, min(self.count, first + most)) % len(self._rows))


class _Bins:
    """Means over bins of device time; a bin is complete when a row of a later one comes. Only its sums are held."""

    def __init__(self, bin_ns: int) -> None:
        self._bin_ns = bin_ns
        self._bin: int | None = None
        self._count = 0
        self._sums: tuple[Any, Any, Any] = (0.0, 0.0, np.uint32(0))

    def restart(self) -> None:
        self._bin = None

    def complete(self, rows: Estimates) -> Estimates:
        """Means of the bins that these rows complete."""
        bins = rows.time_ns // self._bin_ns
        starts = np.flatnonzero(np.diff(bins, prepend=bins[0] - 1))
        which, counts = bins[starts], np.diff(starts, append=len(rows))
        values, sigma = np.add.reduceat(rows.values, starts), np.add.reduceat(rows.sigma, starts)
        quality = np.bitwise_or.reduceat(rows.quality, starts)
        if self._bin is not None:
            if self._bin == which[0]:
                counts[0] += self._count
                values[0] += self._sums[0]
                sigma[0] += self._sums[1]
                quality[0] |= self._sums[2]
            else:
                which, counts = np.r_[self._bin, which], np.r_[self._count, counts]
                values, sigma = np.vstack((self._sums[0], values)), np.vstack((self._sums[1], sigma))
                quality = np.r_[self._sums[2], quality].astype(np.uint32)
        self._bin, self._count = int(which[-1]), int(counts[-1])
        self._sums = (values[-1], sigma[-1], quality[-1])
        n = counts[:-1, None]
        return Estimates(
            which[:-1] * self._bin_ns + self._bin_ns // 2, values[:-1] / n, sigma[:-1] / n, quality[:-1]
        )
