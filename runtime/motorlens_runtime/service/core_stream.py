"""From the bytes of a line to estimates in one call of the C core, where its decoder and its estimator are in use.

It is the way that nearly all reads of a line go. What Python has to understand itself, HELLO and all else that is not
SAMPLES, comes out as plain samples and goes the long way round, with the same result.
"""

import ctypes
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.core_estimator import LOOK_EVERY, CoreEstimator, looked_at
from motorlens_runtime.estimate.estimator import Estimates, Estimator
from motorlens_runtime.estimate.gate import Samples
from motorlens_runtime.line.core_link import ROOM, CoreLink
from motorlens_runtime.line.feed import Feed
from motorlens_runtime.line.follower import Estimated
from motorlens_runtime.sensor.backend import TILE
from motorlens_runtime.service.lag import Lag
from motorlens_runtime.service.outlet import Grid

_NO_INSTANT = np.iinfo(np.int64).min
# So many rows can be looked at in one read: a tile begun before it, and those that begin within.
_MOST_LOOKED = (2 + ROOM // LOOK_EVERY) * TILE


def follow(feed: Feed, estimator: Estimator, grid: Grid, lag: Lag) -> None:
    """Have the line's decoder go on to estimates in the same call, if both it and the estimator are the core's."""
    link = feed.decoder
    if not isinstance(link, CoreLink):
        return
    if not (
        isinstance(estimator, CoreEstimator)
        and estimator.takes(feed.ambient_C is not None or link.says_ambient)
    ):
        link.follower = None
    elif not (isinstance(link.follower, CoreStream) and link.follower.estimator is estimator):
        link.follower = CoreStream(link, estimator, grid, lag, feed.ambient_C)


class CoreStream:
    """See `Follower`.

    Args:
        link: the decoder.
        estimator: whose state goes on.
        grid: which samples are evaluated.
        lag: which come too late.
        ambient_C: where the line does not say it; None is not known.
    """

    def __init__(
        self, link: CoreLink, estimator: CoreEstimator, grid: Grid, lag: Lag, ambient_C: float | None
    ) -> None:
        self.estimator, self._grid, self._lag = estimator, grid, lag
        core, sensor = estimator.core, estimator.sensor
        self._take = core.library.motorlens_stream_take
        self._link, self._stream, self._block = link, link.stream, link.stream.block
        self._address = ctypes.addressof(link.stream)
        outputs, features = len(sensor.specification.outputs), len(sensor.specification.features)
        self._by_output = np.empty((2, outputs * ROOM))
        self._values, self._sigma, self._inputs = (np.empty((ROOM, width)) for width in (outputs, outputs, 2))
        self._time_ns, self._rows = np.empty((2, ROOM), dtype=np.int64)
        self._quality = np.empty(ROOM, dtype=np.uint32)
        self._features = np.empty((_MOST_LOOKED, features))
        self._now_ns = 0
        stream, block, table = self._stream, self._block, link.stream.samples
        stream.sensor, stream.state, stream.rows = core.address, estimator.address, self._rows.ctypes.data
        stream.values, stream.sigma = self._values.ctypes.data, self._sigma.ctypes.data
        stream.inputs, stream.time_ns = self._inputs.ctypes.data, self._time_ns.ctypes.data
        stream.instant_ns, stream.ambient_C = grid.period_ns, np.nan if ambient_C is None else ambient_C
        block.look_every, block.look_length = 0 if sensor.checker is None else LOOK_EVERY, TILE
        block.time_ns, block.voltage_V, block.current_A = table.time_ns, table.voltage_V, table.current_A
        block.flags, block.quality, block.features = (
            table.flags,
            self._quality.ctypes.data,
            self._features.ctypes.data,
        )
        block.estimate, block.sigma = (part.ctypes.data for part in self._by_output)

    def take(self, data: bytes, now_ns: int) -> int:
        """See `Follower.take`."""
        stream, instant = self._stream, self._grid.instant
        stream.instant = _NO_INSTANT if instant is None else instant
        stream.late_ns = self._lag.late_ns(now_ns)
        self._now_ns = now_ns
        taken: int = self._take(self._address, data, len(data), now_ns)
        return taken

    def estimated(self) -> Estimated:
        """See `Follower.estimated`. Raises DataError where time runs backwards; the state is then as before."""
        stream, block = self._stream, self._block
        n, m = block.n, block.m
        if stream.backwards:
            at_s = self._samples().time_ns[stream.backwards - 1] * 1e-9
            raise DataError(f"time runs backwards at {at_s:.6f} s")
        self._lag.note(self._now_ns, stream.newest_ns)
        if stream.instant_ns:
            self._grid.instant = stream.instant
        estimates = Estimates(
            self._time_ns[:m].copy(),
            self._values[:m].copy(),
            self._sigma[:m].copy(),
            self._quality[:m].copy(),
        )
        looked = looked_at(self.estimator.count - n, n, self._chosen()) if block.looked else None
        estimates = self.estimator.judged(estimates, looked, self._features[: block.looked])
        return Estimated(
            n,
            stream.first_ns,
            stream.newest_ns,
            estimates,
            self._inputs[:m].copy(),
            self._samples,
            self._chosen,
        )

    def _samples(self) -> Samples:
        samples, ambient_C = self._link.samples(), self._stream.ambient_C
        if samples.ambient_C is None and not np.isnan(ambient_C):
            return replace(samples, ambient_C=np.full(len(samples), ambient_C))
        return samples

    def _chosen(self) -> NDArray[np.intp] | None:
        """Which samples were evaluated, None: all."""
        block = self._block
        return None if block.m == block.n else self._rows[: block.m].copy()
