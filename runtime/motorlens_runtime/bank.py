"""The filter bank: first-order low-passes of the signals, exact over any step, in float64.

`s' = u + (s - u) exp(-dt / tau)`. The recursion is evaluated in blocks of 64 samples by a prefix scan (Hillis and Steele,
Commun. ACM 29(12), 1986) whose blocks are aligned to the sample's index since the start, not to the call. Every operation is
one IEEE multiplication or addition of two array elements, in an order that the index alone decides, so the result is the
same to the last bit however the samples are cut into calls. A matrix product would be as fast and not promise that.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.specification import Specification

BLOCK = 64
_SHIFTS = (1, 2, 4, 8, 16, 32)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BankState:
    """State of S filters: value before the block that is being filled, and the rows in that block so far.

    `carry` (S,), `dt_s` (p,), `drive` (p, S) with p < 64; `count` is the number of samples since the start.
    """

    count: int
    carry: Array
    dt_s: Array
    signals: Array


class FilterBank:
    """S low-passes; `signals` names the signal of each, `tau_s` its time constant."""

    def __init__(self, signals: Sequence[str], tau_s: Sequence[float]) -> None:
        self.signals = tuple(signals)
        self.tau_s = np.array(tau_s, dtype=np.float64)
        self._key = tuple(self.tau_s.tolist())

    def start(self, values: Array | None = None) -> BankState:
        """A fresh state: all filters at zero, or at `values` (S,)."""
        width = len(self.signals)
        carry = np.zeros(width) if values is None else np.array(values, dtype=np.float64).reshape(width)
        return BankState(0, carry, np.zeros(0), np.zeros((0, width)))

    def values(self, state: BankState) -> Array:
        """The filters' values (S,) after the last sample."""
        if not len(state.dt_s):
            return state.carry
        _, filtered = self.advance(
            replace(state, dt_s=state.dt_s[:0], signals=state.signals[:0]), state.dt_s, state.signals
        )
        last: Array = filtered[-1]
        return last

    def advance(self, state: BankState, dt_s: Array, signals: Array) -> tuple[BankState, Array]:
        """Feed n samples.

        Args:
            state: where the filters stand.
            dt_s: (n,) time since the previous sample; 0 leaves the state as it is.
            signals: (n, S) the signal of each filter at the new sample.

        Returns:
            the new state, and the filters' values (n, S) after each sample.
        """
        done = len(state.dt_s)
        rows = done + len(dt_s)
        if not len(dt_s):
            return state, np.zeros((0, len(self.signals)))
        dt = np.concatenate((state.dt_s, dt_s)) if done else dt_s
        drive = np.concatenate((state.signals, signals)) if done else signals
        if rows < BLOCK:
            # The usual case on a live line: everything still fits into the block that is being filled.
            filtered = self._one(state.carry, dt, drive)
            return BankState(state.count + len(dt_s), state.carry, dt, drive), filtered[done:]
        blocks = -(-rows // BLOCK)
        # What fills up the last block comes after every real sample and is cut off again.
        dt_blocks = np.full(blocks * BLOCK, dt[-1])
        dt_blocks[:rows] = dt
        u = np.zeros((blocks * BLOCK, len(self.signals)))
        u[:rows] = drive
        values, carry = self._scan(
            state.carry, dt_blocks.reshape(blocks, BLOCK), u.reshape(blocks, BLOCK, len(self.signals))
        )
        full = rows // BLOCK
        new = BankState(state.count + len(dt_s), carry[full], dt[full * BLOCK :], drive[full * BLOCK :])
        return new, values.reshape(blocks * BLOCK, len(self.signals))[done:rows]

    def _one(self, carry: Array, dt: Array, u: Array) -> Array:
        """Values (n, S) of one unfinished block of n < 64 rows."""
        step = float(dt[0])
        if (dt == step).all():
            levels = _uniform_levels(step, self._key)
            values: Array = _uniform(levels, u[None])[0]
            values += levels.reach[: len(u)] * carry
            return values
        y, reach = _irregular(np.exp(-dt[None, :, None] / self.tau_s), u[None])
        values = y[0]
        values += reach[0] * carry
        return values

    def _scan(self, carry: Array, dt: Array, u: Array) -> tuple[Array, Array]:
        """Values (blocks, 64, S), and the state before each block and after the last, (blocks + 1, S)."""
        uniform = (dt == dt[:, :1]).all(axis=1)
        y = np.empty_like(u)
        reach = np.empty_like(u)  # product of the decays from the start of the block to here
        if not uniform.all():
            y[~uniform], reach[~uniform] = _irregular(
                np.exp(-dt[~uniform][:, :, None] / self.tau_s), u[~uniform]
            )
        for step in np.unique(dt[uniform, 0]).tolist():
            same = uniform & (dt[:, 0] == step)
            levels = _uniform_levels(step, self._key)
            if same.all():
                y, reach = _uniform(levels, u), np.broadcast_to(levels.reach, u.shape)
            else:
                y[same], reach[same] = _uniform(levels, u[same]), levels.reach
        carries = np.empty((len(u) + 1, u.shape[2]))
        carries[0] = carry
        last_reach, last_y = np.ascontiguousarray(reach[:, -1]), np.ascontiguousarray(y[:, -1])
        for block in range(len(u)):
            np.multiply(last_reach[block], carries[block], out=carries[block + 1])
            carries[block + 1] += last_y[block]
        y += reach * carries[:-1, None, :]
        return y, carries


def bank_of(specification: Specification) -> FilterBank:
    """The filter bank that a specification asks for."""
    return FilterBank([f.signal for f in specification.filters], [f.tau_s for f in specification.filters])


def _irregular(decay: Array, u: Array) -> tuple[Array, Array]:
    """Scan of (decay, drive) pairs along axis 1; returns the values from a zero state and the products of the decays."""
    y = (1.0 - decay) * u
    for shift in _SHIFTS:
        if shift >= decay.shape[1]:
            break
        y[:, shift:] += decay[:, shift:] * y[:, :-shift]
        decay[:, shift:] = decay[:, shift:] * decay[:, :-shift]
    return y, decay


@dataclass(frozen=True)
class _Levels:
    """What a scan multiplies with when all steps are alike: `gain` (S,), `factors` (64 - shift, S), `reach` (64, S)."""

    gain: Array
    factors: tuple[Array, ...]
    reach: Array


def _uniform(levels: _Levels, u: Array) -> Array:
    """The same scan when all decays are alike: its factors, computed once by the same operations, are `levels`."""
    y: Array = levels.gain * u
    rows = u.shape[1]
    for shift, factor in zip(_SHIFTS, levels.factors, strict=True):
        if shift >= rows:
            break
        y[:, shift:] += factor[: rows - shift] * y[:, :-shift]
    return y


@lru_cache(maxsize=64)
def _uniform_levels(step: float, tau_s: tuple[float, ...]) -> _Levels:
    decay = np.repeat(np.exp(-step / np.array(tau_s))[None], BLOCK, axis=0)
    gain = 1.0 - decay[0]
    factors = []
    for shift in _SHIFTS:
        factors.append(decay[shift:].copy())
        decay[shift:] = decay[shift:] * decay[:-shift]
    return _Levels(gain, tuple(factors), decay)
