"""The filter bank: first-order low-passes of the signals, exact over any step, in float64.

`s' = u + (s - u) exp(-dt / tau)`. Samples are taken in blocks of 64, aligned to the sample's index since the start, not to
the call. Within a block the recursion `y' = a y + (1 - a) u` starts from zero, the decays `r' = a r` from one, and the value
is `y + r s` with s the value before the block: so many blocks are computed side by side. Every operation is one IEEE
multiplication or addition of two array elements, in an order that the index alone decides, so the result is the same to the
last bit however the samples are cut into calls. A matrix product would be as fast and not promise that.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.estimate.decay import decay
from motorlens_runtime.records import record
from motorlens_runtime.sensor.specification import Specification, signals_of

BLOCK = 64
# As many blocks side by side as keep the work in the cache.
_BLOCKS_AT_ONCE = 64

Array = NDArray[np.float64]


@record(frozen=True)
class BankState:
    """State of S filters after `count` samples: the values (S,) `before` the block that is being filled, and `within` it
    (2, S) the response from zero and its reach, the product of the decays: what becomes of the values before."""

    count: int
    before: Array
    within: Array


class FilterBank:
    """S low-passes.

    Args:
        signals: the name of the signal of each.
        tau_s: its time constant.
        inputs: the row of `advance`'s signals that each filters; None is one row for each.
    """

    def __init__(
        self, signals: Sequence[str], tau_s: Sequence[float], inputs: NDArray[np.intp] | None = None
    ) -> None:
        self.signals = tuple(signals)
        self.tau_s = np.array(tau_s, dtype=np.float64)
        self._inputs = np.arange(len(self.signals)) if inputs is None else inputs
        # A live line keeps its step; one cache for each bank, so that the step alone is the key.
        self._decay = lru_cache(maxsize=64)(self._decay_over)
        self._reach = lru_cache(maxsize=16)(self._reach_of)

    def start(self, values: Array | None = None) -> BankState:
        """A fresh state: all filters at zero, or at `values` (S,)."""
        width = len(self.signals)
        before = np.zeros(width) if values is None else np.array(values, dtype=np.float64).reshape(width)
        return BankState(0, before, _fresh(width))

    def values(self, state: BankState) -> Array:
        """The filters' values (S,) after the last sample."""
        inside, reach = state.within
        result: Array = inside + reach * state.before
        return result

    def advance(
        self, state: BankState, dt_s: Array, signals: Array, rows: NDArray[np.intp] | None = None
    ) -> tuple[BankState, Array]:
        """Feed n samples.

        Args:
            state: where the filters stand.
            dt_s: (n,) time since the previous sample; 0 leaves the state as it is.
            signals: (U, n) at the new samples.
            rows: (m,) indices in rising order of the samples whose values are asked for; None is all.

        Returns:
            the new state, and the filters' values (S, m) after each of those samples.
        """
        n = len(dt_s)
        first = min(-state.count % BLOCK, n)
        blocks = (n - first) // BLOCK
        if not blocks:
            return self._one_by_one(state, dt_s, signals, range(n) if rows is None else rows.tolist())
        values = np.empty((len(self.signals), n))
        state, values[:, :first] = self._one_by_one(state, dt_s[:first], signals[:, :first], range(first))
        for start in range(first, first + blocks * BLOCK, _BLOCKS_AT_ONCE * BLOCK):
            end = min(start + _BLOCKS_AT_ONCE * BLOCK, first + blocks * BLOCK)
            state = self._side_by_side(state, dt_s[start:end], signals[:, start:end], values[:, start:end])
        end = first + blocks * BLOCK
        state, values[:, end:] = self._one_by_one(state, dt_s[end:], signals[:, end:], range(n - end))
        return state, values if rows is None else values[:, rows]

    def _one_by_one(
        self, state: BankState, dt_s: Array, signals: Array, rows: Sequence[int]
    ) -> tuple[BankState, Array]:
        """The recursion as it stands, for the few samples of a live line."""
        values = np.empty((len(self.signals), len(rows)))
        if not len(dt_s):
            return state, values
        steps, place, before = dt_s.tolist(), state.count % BLOCK, state.before
        within = state.within.copy()
        inside, reach = within
        gained = signals.take(self._inputs, axis=0).T
        if steps.count(steps[0]) == len(steps):
            kept, gain = self._decay(steps[0])
            decays, gained = [kept] * len(steps), gain * gained
        else:
            pairs = [self._decay(step) for step in steps]
            decays, gained = [kept for kept, _ in pairs], np.array([gain for _, gain in pairs]) * gained
        asked, column = [*rows, -1], 0
        for k, kept in enumerate(decays):
            if place:
                within *= kept
                inside += gained[k]
            else:
                inside[:], reach[:] = gained[k], kept[1]
            place += 1
            if k == asked[column]:
                values[:, column] = inside + reach * before
                column += 1
            if place == BLOCK:
                before = inside + reach * before
                within, place = _fresh(len(before)), 0
                inside, reach = within
        return BankState(state.count + len(steps), before, within), values

    def _side_by_side(self, state: BankState, dt_s: Array, signals: Array, values: Array) -> BankState:
        """Whole blocks, the recursion of all of them in step; writes `values` (S, blocks * 64)."""
        width, blocks = len(self.signals), len(dt_s) // BLOCK
        # Time within the block comes first, so that each step of the recursion is one stretch of memory.
        inputs = np.ascontiguousarray(signals.reshape(len(signals), blocks, BLOCK).transpose(2, 0, 1))
        y = inputs.take(self._inputs, axis=1)
        if (dt_s == dt_s[0]).all():
            kept, gain = self._decay(float(dt_s[0]))
            y *= gain[:, None]
            decays: Any = (np.repeat(kept[0][:, None], blocks, axis=1),) * BLOCK
            reach = self._reach(float(dt_s[0]))[:, :, None]
        else:
            dt = dt_s.reshape(blocks, BLOCK).T
            steps, which = np.unique(dt, return_inverse=True)  # a few lengths make up most lines
            each = decay(-steps / self.tau_s[:, None])[:, which.reshape(dt.shape)].transpose(1, 0, 2)
            y *= 1.0 - each
            decays = each
            reach = each.copy()
            for k in range(1, BLOCK):
                reach[k] *= reach[k - 1]
        part = np.empty((width, blocks))
        for k in range(1, BLOCK):
            np.multiply(decays[k], y[k - 1], out=part)
            step = y[k]
            step += part
        before = np.empty((blocks + 1, width))
        before[0] = state.before
        reached = np.ascontiguousarray(np.broadcast_to(reach[-1], (width, blocks)).T)
        inside = np.ascontiguousarray(y[-1].T)
        for block in range(blocks):
            np.multiply(reached[block], before[block], out=before[block + 1])
            before[block + 1] += inside[block]
        earlier = np.ascontiguousarray(before[:-1].T)
        for k in range(0, BLOCK, 8):
            y[k : k + 8] += reach[k : k + 8] * earlier
        np.copyto(values.reshape(width, blocks, BLOCK), y.transpose(1, 2, 0))
        return BankState(state.count + len(dt_s), before[-1].copy(), _fresh(width))

    def _decay_over(self, step: float) -> tuple[Array, Array]:
        """The decay over a step, (2, S): response and reach decay alike; and what is left of one, (S,)."""
        kept = decay(-step / self.tau_s)
        return np.array((kept, kept)), 1.0 - kept

    def _reach_of(self, step: float) -> Array:
        """Products of the decays from the start of a block, (64, S)."""
        kept, _ = self._decay(step)
        return np.multiply.accumulate(np.repeat(kept[:1], BLOCK, axis=0), axis=0)


def bank_of(specification: Specification) -> FilterBank:
    """The filter bank that a specification asks for."""
    filters, used = specification.filters, signals_of(specification)
    inputs = np.array([used.index(f.signal) for f in filters], dtype=np.intp)
    return FilterBank([f.signal for f in filters], [f.tau_s for f in filters], inputs)


def _fresh(width: int) -> Array:
    """Before the first sample of a block."""
    return np.array((np.zeros(width), np.ones(width)))
