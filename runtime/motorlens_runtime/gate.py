"""What of a sample is believed: nothing that is not finite or physically absurd reaches the state of the estimator.

A sample that is left out is bridged: the state waits, and the next good sample is one longer step. Everything else is used
and its doubts are said in the quality word. All decisions depend on earlier samples only, never on how samples are grouped.
"""

from dataclasses import dataclass, replace
from math import isfinite
from operator import sub
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.quality import Quality, mark
from motorlens_runtime.specification import Specification

Array = NDArray[np.float64]

# Beyond this many times the trained range, a number is taken for rubbish rather than for an unusual motor.
_ABSURD = 10.0
# A current is stuck when it repeats itself this often after the voltage has moved by this share of its range.
_REPEATS = 64
_MOVE_SHARE = 0.01
_NEVER = np.iinfo(np.int64).max
# Up to so many samples, plain numbers are faster than arrays.
_FEW = 64
_OUTSIDE = np.uint32(Quality.OUTSIDE_ENVELOPE)
# A current above this share of its range is no rest.
_FLOWING_SHARE = 0.05


@dataclass(frozen=True)
class Samples:
    """n instants: `time_ns` int64 that never runs backwards, volts, amperes, degrees Celsius; `flags` are `Quality` bits
    that the source already knows (saturated, simulated, overload)."""

    time_ns: NDArray[np.int64]
    voltage_V: Array
    current_A: Array
    ambient_C: Array | None = None
    flags: NDArray[np.uint32] | None = None

    def __len__(self) -> int:
        return len(self.time_ns)


@dataclass(frozen=True)
class GateState:
    """What the gate remembers: the last good sample, and counters for the slower checks."""

    first_ns: int | None = None
    last_ns: int | None = None
    voltage_V: float = 0.0
    current_A: float = 0.0
    ambient_C: float = 0.0
    bridged_until_ns: int = np.iinfo(np.int64).min
    count: int = 0
    current_since: int = 0  # index of the sample since which the current repeats itself
    first_move: int = _NEVER  # index at which the voltage first moved since then
    dead_since: int = 0  # index since which the voltage is not exactly 0 V under current


@dataclass(frozen=True)
class Gated:
    """n samples ready for the state: `dt_s` 0 where a sample is left out, channels held there, `quality` so far."""

    dt_s: Array
    voltage_V: Array
    current_A: Array
    ambient_C: Array | None
    quality: NDArray[np.uint32]
    used: NDArray[np.bool_]


class Gate:
    """The checks for one sensor fed at one rate. `period_s` is the expected time between samples."""

    def __init__(self, specification: Specification, period_s: float) -> None:
        self._specification = specification
        envelope = specification.envelope
        self._period_ns = round(period_s * 1e9)
        self._slowest_ns, self._fastest_ns = (
            1.01e9 / specification.minimum_rate_Hz,
            0.99e9 / specification.maximum_rate_Hz,
        )
        self._warm_up_ns = round(specification.warm_up_s * 1e9)
        self._voltage_span = envelope.voltage_V[1] - envelope.voltage_V[0]
        self._current_span = envelope.current_A[1] - envelope.current_A[0]
        self._voltage_limit = _ABSURD * max(map(abs, envelope.voltage_V))
        inductance_H = specification.inductance_H
        self._slew_A_ns = (
            3e-9 * max(map(abs, envelope.voltage_V)) / inductance_H if inductance_H > 0 else np.inf
        )
        self._usual_rate = self._slowest_ns >= self._period_ns >= self._fastest_ns
        self._ones = np.ones(_FEW, dtype=bool)
        self._current_limit = _ABSURD * max(map(abs, envelope.current_A))

    def inspect(self, state: GateState, samples: Samples) -> tuple[GateState, Gated]:
        """Judge n samples.

        Raises:
            DataError: time runs backwards, or the ambient temperature is missing and the sensor needs it.
        """
        if self._specification.needs_ambient and samples.ambient_C is None:
            raise DataError(
                "the sensor needs the ambient temperature: give an ambient column, or --ambient DEGREES_C"
            )
        plain = self._plain(state, samples)
        if plain is not None:
            return plain
        time_ns = samples.time_ns
        n = len(time_ns)
        quality = np.zeros(n, dtype=np.uint32) if samples.flags is None else samples.flags.astype(np.uint32)
        finite = np.isfinite(samples.voltage_V) & np.isfinite(samples.current_A)
        if samples.ambient_C is not None and self._specification.needs_ambient:
            finite &= np.isfinite(samples.ambient_C)
        used = (
            finite
            & (np.abs(samples.voltage_V) <= self._voltage_limit)
            & (np.abs(samples.current_A) <= self._current_limit)
        )
        mark(quality, ~finite, Quality.NOT_FINITE)
        mark(quality, ~used, Quality.BRIDGED)
        mark(quality, finite & ~used, Quality.OUTSIDE_ENVELOPE)

        # The last good sample at or before each one; -1 is the one remembered from before.
        good = np.maximum.accumulate(np.where(used, np.arange(n), -1))
        voltage = _held(samples.voltage_V, good, state.voltage_V)
        current = _held(samples.current_A, good, state.current_A)
        ambient = None if samples.ambient_C is None else _held(samples.ambient_C, good, state.ambient_C)
        dt_ns, first_ns = self._steps(state, time_ns, used, good)
        self._judge_time(state, time_ns, dt_ns, used, first_ns, quality)
        self._judge_range(voltage, current, used, quality)
        self._judge_slew(state, current, dt_ns, quality)
        new = self._judge_stuck(state, voltage, current, quality)
        until = self._bridge(state, time_ns, dt_ns, quality)
        if n and good[-1] >= 0:
            last = int(good[-1])
            new = replace(
                new, last_ns=int(time_ns[last]), voltage_V=float(voltage[-1]), current_A=float(current[-1]),
                ambient_C=0.0 if ambient is None else float(ambient[-1]),
            )  # fmt: skip
        new = replace(new, first_ns=first_ns, bridged_until_ns=until, count=state.count + n)
        return new, Gated(dt_ns.astype(np.float64) * 1e-9, voltage, current, ambient, quality, used)

    def _plain(self, state: GateState, samples: Samples) -> tuple[GateState, Gated] | None:
        """The usual case, decided by a handful of numbers: nothing to flag but what the source says; else None.

        What it returns is what the full inspection would; it only costs a tenth.
        """
        n = len(samples.time_ns)
        if not 0 < n <= _FEW or state.last_ns is None or state.first_ns is None:
            return None
        if self._specification.needs_ambient:
            return None
        period_ns, first = self._period_ns, state.last_ns + self._period_ns
        if (
            first < state.bridged_until_ns
            or first - state.first_ns < self._warm_up_ns
            or samples.time_ns.tolist() != list(range(first, first + n * period_ns, period_ns))
        ):
            return None
        voltage, current = samples.voltage_V.tolist(), samples.current_A.tolist()
        if not isfinite(sum(voltage) + sum(current)):
            return None
        lowest, highest, weakest, strongest = min(voltage), max(voltage), min(current), max(current)
        if max(-lowest, highest) > self._voltage_limit or max(-weakest, strongest) > self._current_limit:
            return None
        steps = list(map(sub, current, (state.current_A, *current)))
        if max(map(abs, steps)) > self._slew_limit(period_ns):
            return None
        low, high = min(lowest, state.voltage_V), max(highest, state.voltage_V)
        if high - low > _MOVE_SHARE * self._voltage_span or low <= 0 <= high:
            return None  # a move of the voltage, or a dead one, needs the full account
        changed = [k for k, step in enumerate(steps) if step]
        end = state.count + n
        since, first_move = state.current_since, state.first_move
        if (state.count + changed[0] if changed else end) - 1 - first_move >= _REPEATS:
            return None
        if changed:
            since, first_move = state.count + changed[-1], _NEVER
        new = GateState(
            state.first_ns, first + (n - 1) * period_ns, voltage[-1], current[-1], state.ambient_C, state.bridged_until_ns,
            end, since, first_move, end - 1,
        )  # fmt: skip
        quality = np.zeros(n, dtype=np.uint32) if samples.flags is None else samples.flags.copy()
        envelope = self._specification.envelope
        if not self._usual_rate:
            quality |= _OUTSIDE
        elif (
            lowest < envelope.voltage_V[0]
            or highest > envelope.voltage_V[1]
            or weakest < envelope.current_A[0]
            or strongest > envelope.current_A[1]
        ):
            self._judge_range(samples.voltage_V, samples.current_A, self._ones[:n], quality)
        return new, Gated(
            np.full(n, period_ns * 1e-9), samples.voltage_V, samples.current_A, None, quality, self._ones[:n]
        )

    def _steps(
        self, state: GateState, time_ns: NDArray[np.int64], used: NDArray[np.bool_], good: NDArray[np.intp]
    ) -> tuple[NDArray[np.int64], int | None]:
        """Time of each used sample since the used one before it (the very first: the nominal period), and the first time."""
        dt_ns = np.zeros(len(time_ns), dtype=np.int64)
        index = np.flatnonzero(used)
        first_ns = state.first_ns
        if len(index):
            if state.last_ns is None:
                first_ns = int(time_ns[index[0]])
                before = first_ns - self._specification.first_dt_ns
            else:
                before = state.last_ns
            dt_ns[index] = np.diff(time_ns[index], prepend=before)
        if (dt_ns < 0).any():
            raise DataError(f"time runs backwards at {time_ns[int(np.argmax(dt_ns < 0))] * 1e-9:.6f} s")
        return dt_ns, first_ns

    def _judge_time(
        self, state: GateState, time_ns: NDArray[np.int64], dt_ns: NDArray[np.int64], used: NDArray[np.bool_],
        first_ns: int | None, quality: NDArray[np.uint32],
    ) -> None:  # fmt: skip
        if first_ns is None:
            mark(quality, slice(None), Quality.WARM_UP)
            return
        mark(quality, time_ns - first_ns < self._warm_up_ns, Quality.WARM_UP)
        mark(
            quality,
            used & ((dt_ns > self._slowest_ns) | (dt_ns < self._fastest_ns)),
            Quality.OUTSIDE_ENVELOPE,
        )

    def _judge_range(
        self, voltage: Array, current: Array, used: NDArray[np.bool_], quality: NDArray[np.uint32]
    ) -> None:
        envelope = self._specification.envelope
        inside = (voltage >= envelope.voltage_V[0]) & (voltage <= envelope.voltage_V[1])
        inside &= (current >= envelope.current_A[0]) & (current <= envelope.current_A[1])
        mark(quality, used & ~inside, Quality.OUTSIDE_ENVELOPE)

    def _judge_slew(
        self, state: GateState, current: Array, dt_ns: NDArray[np.int64], quality: NDArray[np.uint32]
    ) -> None:
        """L di/dt cannot exceed the supply and an equal back-EMF; half as much again and 2 % of the range for noise."""
        if self._specification.inductance_H <= 0 or not len(current):
            return
        previous = state.current_A if state.last_ns is not None else current[0]
        step = np.abs(np.diff(current, prepend=previous))
        mark(quality, (dt_ns > 0) & (step > self._slew_limit(dt_ns)), Quality.JUMP)

    def _slew_limit(self, dt_ns: Any) -> Any:
        """Largest credible change of the current in `dt_ns`."""
        return self._slew_A_ns * dt_ns + 0.02 * self._current_span

    def _judge_stuck(
        self, state: GateState, voltage: Array, current: Array, quality: NDArray[np.uint32]
    ) -> GateState:
        """A current that repeats itself while the voltage moves; a voltage of exactly 0 V while current flows.

        A constant voltage under a changing current is what a stiff supply does, and no sign of a fault.
        """
        n = len(voltage)
        if not n:
            return state
        index = state.count + np.arange(n)
        changes = np.diff(current, prepend=state.current_A) != 0
        since = np.maximum.accumulate(np.where(changes, index, state.current_since))
        moved = np.abs(np.diff(voltage, prepend=state.voltage_V)) > _MOVE_SHARE * self._voltage_span
        # The first move of the voltage within each stretch of one current; _NEVER where there is none so far.
        at = np.append(index[moved], _NEVER)
        first = at[np.searchsorted(at, since, side="right")]
        first = np.where(since == state.current_since, np.minimum(first, state.first_move), first)
        stuck = index - first >= _REPEATS
        alive = (voltage != 0) | (np.abs(current) < _FLOWING_SHARE * self._current_span)
        dead_since = np.maximum.accumulate(np.where(alive, index, state.dead_since))
        stuck |= index - dead_since >= _REPEATS
        mark(quality, stuck, Quality.STUCK)
        first_move = int(first[-1]) if first[-1] <= index[-1] else _NEVER
        return replace(
            state, current_since=int(since[-1]), first_move=first_move, dead_since=int(dead_since[-1])
        )

    def _bridge(
        self,
        state: GateState,
        time_ns: NDArray[np.int64],
        dt_ns: NDArray[np.int64],
        quality: NDArray[np.uint32],
    ) -> int:
        """Flag the sample after a gap, and what follows for as long as the gap was, at most the warm-up time."""
        if not len(time_ns):
            return state.bridged_until_ns
        gap = 2 * dt_ns > 3 * self._period_ns
        if state.last_ns is None and dt_ns.any():
            gap[int(np.argmax(dt_ns > 0))] = False  # the first sample follows no gap
        ends = np.where(gap, time_ns + np.minimum(dt_ns, self._warm_up_ns), state.bridged_until_ns)
        until = np.maximum(np.maximum.accumulate(ends), state.bridged_until_ns)
        mark(quality, gap | (time_ns < until), Quality.BRIDGED)
        return int(until[-1])


def _held(values: Array, good: NDArray[np.intp], before: float) -> Array:
    return np.where(good >= 0, values[good], before) if len(values) else values
