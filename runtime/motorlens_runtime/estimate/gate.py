"""What of a sample is believed: nothing that is not finite or physically absurd reaches the state of the estimator.

A sample that is left out is bridged: the state waits, and the next good sample is one longer step. Everything else is used
and its doubts are said in the quality word. All decisions depend on earlier samples only, never on how samples are grouped.
"""

from dataclasses import dataclass, replace
from math import ceil, floor, isfinite

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.features import Channels
from motorlens_runtime.estimate.quality import Quality, mark
from motorlens_runtime.records import record
from motorlens_runtime.sensor.specification import Specification

Array = NDArray[np.float64]

# Beyond this many times the trained range, a number is taken for rubbish rather than for an unusual motor.
_ABSURD = 10.0
# A current is stuck when it repeats itself this often after the voltage has moved by this share of its range.
_REPEATS = 64
_MOVE_SHARE = 0.01
_NEVER = np.iinfo(np.int64).max
# Up to so many samples, plain numbers are faster than arrays.
_FEW = 64
_WARM_UP, _BRIDGED, _OUTSIDE, _JUMP, _STUCK, _COLD = map(
    int,
    (
        Quality.WARM_UP, Quality.BRIDGED, Quality.OUTSIDE_ENVELOPE, Quality.JUMP, Quality.STUCK, Quality.ASSUMED_COLD,
    ),
)  # fmt: skip
# A current above this share of its range is no rest.
_FLOWING_SHARE = 0.05


@record(frozen=True)
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


@record(frozen=True)
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
    remembered: bool = False  # whether the heat of an earlier run was there at the start


@record(frozen=True)
class Gated(Channels):
    """n samples ready for the state: `dt_s` 0 where a sample is left out, channels held there, `quality` so far."""

    dt_s: Array
    quality: NDArray[np.uint32]
    used: NDArray[np.bool_]


@dataclass(frozen=True)
class GateLimits:
    """What the gate compares with, for one sensor.

    Attributes:
        warm_up_ns, cold_ns, first_dt_ns: as in `Specification`.
        slowest_ns, fastest_ns: steps beyond these are not those the sensor was trained on.
        range: least and most voltage in V and current in A of the envelope.
        absurd_V, absurd_A: beyond these a number is rubbish.
        move_V: what counts as a move of the voltage.
        flowing_A: below this the motor may be at rest.
        noise_A, slew_A_ns: the current may change by so much, and by so much more a nanosecond.
    """

    warm_up_ns: int
    cold_ns: int
    first_dt_ns: int
    slowest_ns: int
    fastest_ns: int
    range: tuple[float, float, float, float]
    absurd_V: float
    absurd_A: float
    move_V: float
    flowing_A: float
    noise_A: float
    slew_A_ns: float
    repeats: int = _REPEATS


def limits_of(specification: Specification) -> GateLimits:
    """The limits that a specification asks for."""
    envelope, inductance_H = specification.envelope, specification.inductance_H
    most_V, most_A = max(map(abs, envelope.voltage_V)), max(map(abs, envelope.current_A))
    current_span_A = envelope.current_A[1] - envelope.current_A[0]
    return GateLimits(
        warm_up_ns=round(specification.warm_up_s * 1e9), cold_ns=specification.cold_ns,
        first_dt_ns=specification.first_dt_ns,
        slowest_ns=floor(1.01e9 / specification.minimum_rate_Hz), fastest_ns=ceil(0.99e9 / specification.maximum_rate_Hz),
        range=(*envelope.voltage_V, *envelope.current_A),
        absurd_V=_ABSURD * most_V, absurd_A=_ABSURD * most_A,
        move_V=_MOVE_SHARE * (envelope.voltage_V[1] - envelope.voltage_V[0]),
        flowing_A=_FLOWING_SHARE * current_span_A, noise_A=0.02 * current_span_A,
        # L di/dt cannot exceed the supply and an equal back-EMF; half as much again and 2 % of the range for noise.
        slew_A_ns=3e-9 * most_V / inductance_H if inductance_H > 0 else np.inf,
    )  # fmt: skip


class Gate:
    """The checks for one sensor fed at one rate. `period_s` is the expected time between samples."""

    def __init__(self, specification: Specification, period_s: float) -> None:
        self._specification = specification
        limits = limits_of(specification)
        self._longest_ns = 3 * round(period_s * 1e9) // 2  # a longer step is a gap
        self._slowest_ns, self._fastest_ns = limits.slowest_ns, limits.fastest_ns
        self._warm_up_ns, self._cold_ns = limits.warm_up_ns, limits.cold_ns
        self._range, self._move_V, self._flowing_A = limits.range, limits.move_V, limits.flowing_A
        self._noise_A, self._slew_A_ns = limits.noise_A, limits.slew_A_ns
        self._voltage_limit, self._current_limit = limits.absurd_V, limits.absurd_A
        self._ones = np.ones(_FEW, dtype=bool)

    def inspect(self, state: GateState, samples: Samples) -> tuple[GateState, Gated]:
        """Judge n samples.

        Raises:
            DataError: time runs backwards, or the ambient temperature is missing and the sensor needs it.
        """
        if self._specification.needs_ambient and samples.ambient_C is None:
            raise DataError(
                "the sensor needs the ambient temperature: give an ambient column, or --ambient DEGREES_C"
            )
        alone = self._one_by_one(state, samples)
        if alone is not None:
            return alone
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

        # The last good sample at or before each one; -1 is the one remembered from before. None: each is its own.
        good = None if used.all() else np.maximum.accumulate(np.where(used, np.arange(n), -1))
        voltage = _held(samples.voltage_V, good, state.voltage_V)
        current = _held(samples.current_A, good, state.current_A)
        ambient = None if samples.ambient_C is None else _held(samples.ambient_C, good, state.ambient_C)
        dt_ns, first_ns = self._steps(state, time_ns, used)
        self._judge_time(state, time_ns, dt_ns, used, first_ns, quality)
        self._judge_range(voltage, current, used, quality)
        self._judge_slew(state, current, dt_ns, used, quality)
        new = self._judge_stuck(state, voltage, current, quality)
        until = self._bridge(state, time_ns, dt_ns, quality)
        last = n - 1 if good is None else int(good[-1])
        if last >= 0:
            new = replace(
                new, last_ns=int(time_ns[last]), voltage_V=float(voltage[-1]), current_A=float(current[-1]),
                ambient_C=0.0 if ambient is None else float(ambient[-1]),
            )  # fmt: skip
        new = replace(new, first_ns=first_ns, bridged_until_ns=until, count=state.count + n)
        return new, Gated(voltage, current, ambient, dt_ns.astype(np.float64) * 1e-9, quality, used)

    def _one_by_one(self, state: GateState, samples: Samples) -> tuple[GateState, Gated] | None:
        """What `inspect` finds, in plain numbers: for few samples a tenth of the time. None where it is not for these
        checks: many samples, the first one, one to be left out, a gap."""
        last_ns, first_ns, count = state.last_ns, state.first_ns, state.count
        if last_ns is None or first_ns is None or not 0 < len(samples) <= _FEW:
            return None
        if self._specification.needs_ambient and not isfinite(sum(samples.ambient_C.tolist())):  # type: ignore[union-attr]
            return None
        absurd_V, absurd_A, longest_ns = self._voltage_limit, self._current_limit, self._longest_ns
        slew_A_ns, move_V, flowing_A = self._slew_A_ns, self._move_V, self._flowing_A
        least_V, most_V, least_A, most_A = self._range
        fastest_ns, slowest_ns, warm_ns = self._fastest_ns, self._slowest_ns, first_ns + self._warm_up_ns
        cold_ns = first_ns + (0 if state.remembered else self._cold_ns)
        voltage_V, current_A, since, first_move, dead_since = (
            state.voltage_V, state.current_A, state.current_since, state.first_move, state.dead_since,
        )  # fmt: skip
        steps, words = [], []
        for time_ns, volts, amperes in zip(
            samples.time_ns.tolist(), samples.voltage_V.tolist(), samples.current_A.tolist(), strict=True
        ):
            dt_ns = time_ns - last_ns
            # Written so that NaN does not pass either.
            if not (
                0 < dt_ns <= longest_ns
                and -absurd_V <= volts <= absurd_V
                and -absurd_A <= amperes <= absurd_A
            ):
                return None
            word = _WARM_UP if time_ns < warm_ns else 0
            if time_ns < cold_ns:
                word |= _COLD
            if time_ns < state.bridged_until_ns:
                word |= _BRIDGED
            if not (
                fastest_ns <= dt_ns <= slowest_ns
                and least_V <= volts <= most_V
                and least_A <= amperes <= most_A
            ):
                word |= _OUTSIDE
            if amperes != current_A:
                since, first_move = count, _NEVER
                if abs(amperes - current_A) > slew_A_ns * dt_ns + self._noise_A:
                    word |= _JUMP
            elif first_move == _NEVER and abs(volts - voltage_V) > move_V:
                first_move = count
            if volts != 0 or abs(amperes) < flowing_A:
                dead_since = count
            if count - first_move >= _REPEATS or count - dead_since >= _REPEATS:
                word |= _STUCK
            steps.append(dt_ns * 1e-9)
            words.append(word)
            last_ns, voltage_V, current_A, count = time_ns, volts, amperes, count + 1
        ambient = samples.ambient_C
        new = GateState(
            first_ns, last_ns, voltage_V, current_A, 0.0 if ambient is None else float(ambient[-1]), state.bridged_until_ns,
            count, since, first_move, dead_since, state.remembered,
        )  # fmt: skip
        if samples.flags is None or any(words):
            quality = np.array(words, dtype=np.uint32)
            if samples.flags is not None:
                quality |= samples.flags
        else:
            quality = samples.flags.copy()
        return new, Gated(
            samples.voltage_V, samples.current_A, ambient, np.array(steps), quality, self._ones[: len(words)]
        )

    def _steps(
        self, state: GateState, time_ns: NDArray[np.int64], used: NDArray[np.bool_]
    ) -> tuple[NDArray[np.int64], int | None]:
        """Time of each used sample since the used one before it (the very first: the nominal period), and the first time."""
        times_ns, first_ns = time_ns[used], state.first_ns
        dt_ns = np.zeros(len(time_ns), dtype=np.int64)
        if len(times_ns):
            if state.last_ns is None:
                first_ns = int(times_ns[0])
                before = first_ns - self._specification.first_dt_ns
            else:
                before = state.last_ns
            dt_ns[used] = np.diff(times_ns, prepend=before)
        if (dt_ns < 0).any():
            raise DataError(f"time runs backwards at {time_ns[int(np.argmax(dt_ns < 0))] * 1e-9:.6f} s")
        return dt_ns, first_ns

    def _judge_time(
        self, state: GateState, time_ns: NDArray[np.int64], dt_ns: NDArray[np.int64], used: NDArray[np.bool_],
        first_ns: int | None, quality: NDArray[np.uint32],
    ) -> None:  # fmt: skip
        cold_ns = 0 if state.remembered else self._cold_ns
        if first_ns is None:
            mark(quality, slice(None), Quality.WARM_UP | Quality.ASSUMED_COLD if cold_ns else Quality.WARM_UP)
            return
        mark(quality, time_ns - first_ns < self._warm_up_ns, Quality.WARM_UP)
        if cold_ns:
            mark(quality, time_ns - first_ns < cold_ns, Quality.ASSUMED_COLD)
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
        self, state: GateState, current: Array, dt_ns: NDArray[np.int64], used: NDArray[np.bool_],
        quality: NDArray[np.uint32],
    ) -> None:  # fmt: skip
        if self._specification.inductance_H <= 0 or not len(current):
            return
        step = np.abs(np.diff(current, prepend=state.current_A))
        if state.last_ns is None and used.any():
            step[int(np.argmax(used))] = (
                0.0  # before the first sample used there is no current to have jumped from
            )
        mark(quality, (dt_ns > 0) & (step > self._slew_A_ns * dt_ns + self._noise_A), Quality.JUMP)

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
        moved = np.abs(np.diff(voltage, prepend=state.voltage_V)) > self._move_V
        # The first move of the voltage within each stretch of one current; _NEVER where there is none so far.
        at = np.append(index[moved], _NEVER)
        first = at[np.searchsorted(at, since, side="right")]
        first = np.where(since == state.current_since, np.minimum(first, state.first_move), first)
        stuck = index - first >= _REPEATS
        alive = (voltage != 0) | (np.abs(current) < self._flowing_A)
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
        gap = dt_ns > self._longest_ns
        if state.last_ns is None and dt_ns.any():
            gap[int(np.argmax(dt_ns > 0))] = False  # the first sample follows no gap
        ends = np.where(gap, time_ns + np.minimum(dt_ns, self._warm_up_ns), state.bridged_until_ns)
        until = np.maximum(np.maximum.accumulate(ends), state.bridged_until_ns)
        mark(quality, gap | (time_ns < until), Quality.BRIDGED)
        return int(until[-1])


def _held(values: Array, good: NDArray[np.intp] | None, before: float) -> Array:
    return values if good is None else np.where(good >= 0, values[good], before)
