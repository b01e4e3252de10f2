"""Limits on estimates, and the time until a limit will be reached, as events that go on and off with hysteresis.

`temperature_rise_K>90,hysteresis=5,hold_s=2` is on above 90 K for two seconds and off below 85 K.
`temperature_rise_K>90,within_s=120` is on when 90 K would be passed within two minutes if things went on as they go.

How things go on: a first-order body under constant loss follows `d theta/dt = (theta_inf - theta) / tau`; with its slope and
tau the rest of the curve is known (the thermal image of IEC 60255-149). The slope comes from a low-pass of window T: for
such a curve observed since a time t, `slope = (theta - lowpass) k / (1 - exp(-k t))` with `k = 1/T - 1/tau`, exactly. An
infinite tau extrapolates the line, which for a body that warms up warns early, never late.

A row whose status is bad or stale says nothing: an alarm stays as it is.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_runtime.errors import DataError
from motorlens_runtime.estimate.estimator import Estimates
from motorlens_runtime.estimate.quality import Quality
from motorlens_runtime.options import Options, nearest
from motorlens_runtime.sensor.specification import Output, Specification

_MUTE = np.uint32(
    Quality.BACKEND_MISMATCH | Quality.NOT_FINITE | Quality.STUCK | Quality.STALE | Quality.LINE_LOST
)
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Event:
    """An alarm went on or off. `value` is the estimate or the seconds left until the limit, `file` says more."""

    alarm: str
    active: bool
    time_ns: int
    value: float
    limit: float
    message: str
    file: str = ""

    def document(self) -> dict[str, Any]:
        """As publishers send it."""
        return {
            "event": "alarm", "alarm": self.alarm, "active": self.active, "timestamp": self.time_ns / 1e9,
            "value": self.value if math.isfinite(self.value) else None, "limit": self.limit, "message": self.message,
            **({"file": self.file} if self.file else {}),
        }  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """Which estimate an alarm watches: column, heading, which side is bad (1 above the limit, -1 below), how many deviations
    are added, and the file that its events name, such as the fleet's page with the history of the motor."""

    column: int
    heading: str
    side: int
    sigmas: float
    file: str = ""

    def of(self, estimates: Estimates) -> tuple[NDArray[np.int64], Array]:
        """Times and values of the rows that say something, turned so that larger is worse, plus `sigmas` deviations."""
        rows = (estimates.quality & _MUTE) == 0
        values = estimates.values[rows, self.column]
        return estimates.time_ns[rows], self.side * values + self.sigmas * estimates.sigma[rows, self.column]


@dataclass(frozen=True)
class Trip:
    """Whether an alarm is on, and since when the condition for going on has held."""

    active: bool = False
    since_ns: int | None = None


class Alarm(Protocol):
    """One alarm; `step` is a pure function of its state."""

    @property
    def name(self) -> str:
        """What events call it."""
        ...

    @property
    def quantity(self) -> Quantity:
        """What it watches."""
        ...

    @property
    def limit(self) -> float:
        """What must not be passed."""
        ...

    def begin(self) -> Any:
        """The state before the first row."""
        ...

    def step(self, state: Any, estimates: Estimates) -> tuple[Any, list[Event]]:
        """The state after the rows, and what happened in them."""
        ...


@dataclass(frozen=True)
class Limit:
    """On when the quantity has been beyond `limit` for `hold_s`, off when it is back by more than `hysteresis`."""

    name: str
    quantity: Quantity
    limit: float
    hysteresis: float
    hold_s: float = 0.0

    def begin(self) -> Trip:
        """Off."""
        return Trip()

    def step(self, state: Trip, estimates: Estimates) -> tuple[Trip, list[Event]]:
        """See `Alarm`."""
        time_ns, worse = self.quantity.of(estimates)
        bound = self.quantity.side * self.limit
        state, changes = _trip(state, time_ns, worse > bound, worse < bound - self.hysteresis, self.hold_s)
        return state, [self._event(row, active, time_ns, worse) for row, active in changes]

    def _event(self, row: int, active: bool, time_ns: NDArray[np.int64], worse: Array) -> Event:
        value = float(self.quantity.side * worse[row])
        side = "above" if (self.quantity.side > 0) == active else "below"
        bound = self.limit if active else self.limit - self.quantity.side * self.hysteresis
        message = f"{self.quantity.heading} is {value:.4g}, {side} {bound:.4g}"
        return Event(self.name, active, int(time_ns[row]), value, self.limit, message, self.quantity.file)


@dataclass(frozen=True)
class Course:
    """State of `TimeToLimit`: the low-pass, when it began, the last row, the seconds left (inf: never), the alarm."""

    lowpass: float = 0.0
    began_ns: int | None = None
    last_ns: int = 0
    last: float = 0.0
    left_s: float = math.inf
    trip: Trip = Trip()


@dataclass(frozen=True)
class TimeToLimit:
    """On when the limit would be reached within `within_s`, off when that is `hysteresis_s` further away.

    `tau_s` is the thermal time constant (inf: straight line), `window_s` the low-pass that finds the slope.
    """

    name: str
    quantity: Quantity
    limit: float
    within_s: float
    hysteresis_s: float
    tau_s: float = math.inf
    window_s: float = 30.0

    def begin(self) -> Course:
        """Nothing seen yet."""
        return Course()

    def step(self, state: Course, estimates: Estimates) -> tuple[Course, list[Event]]:
        """See `Alarm`; looked at once for each call, at its last row."""
        times, worse = self.quantity.of(estimates)
        if not len(times):
            return state, []
        state = self._follow(state, times, worse)
        state = replace(state, left_s=self._left(state, float(worse[-1])))
        now = times[-1:]
        near, far = state.left_s < self.within_s, state.left_s > self.within_s + self.hysteresis_s
        trip, changes = _trip(state.trip, now, np.array([near]), np.array([far]), 0.0)
        return replace(state, trip=trip), [self._event(state, active, int(now[0])) for _, active in changes]

    def _follow(self, state: Course, times: NDArray[np.int64], worse: Array) -> Course:
        """The low-pass after the rows, as one sum."""
        if state.began_ns is None:
            state = Course(float(worse[0]), int(times[0]), int(times[0]), float(worse[0]))
        step_s = np.diff(times, prepend=state.last_ns) * 1e-9
        # Age of each row's contribution at the end; 1 - exp(-dt/T) is the share it takes.
        age_s = (times[-1] - times) * 1e-9
        share = -np.expm1(-step_s / self.window_s) * np.exp(-age_s / self.window_s)
        span_s = (int(times[-1]) - state.last_ns) * 1e-9
        # The mean of the ends of each step, so that a slow publishing rate does not lag by half a step.
        middle = 0.5 * (worse + np.concatenate(((state.last,), worse[:-1])))
        lowpass = state.lowpass * math.exp(-span_s / self.window_s) + float(share @ middle)
        return replace(state, lowpass=lowpass, last_ns=int(times[-1]), last=float(worse[-1]))

    def _left(self, state: Course, worse: float) -> float:
        """Seconds until the limit: 0 when it is passed, inf when it is not approached or too little has been seen."""
        bound = self.quantity.side * self.limit
        if worse >= bound:
            return 0.0
        assert state.began_ns is not None
        age_s = (state.last_ns - state.began_ns) * 1e-9
        if age_s < self.window_s:
            return math.inf
        k = 1 / self.window_s - 1 / self.tau_s
        slope = (worse - state.lowpass) * k / -math.expm1(-k * age_s)
        if slope <= 0:
            return math.inf
        if math.isinf(self.tau_s):
            return (bound - worse) / slope
        final = worse + self.tau_s * slope
        return self.tau_s * math.log((final - worse) / (final - bound)) if final > bound else math.inf

    def _event(self, state: Course, active: bool, time_ns: int) -> Event:
        bound = f"{self.quantity.heading} {'>' if self.quantity.side > 0 else '<'} {self.limit:.4g}"
        left = "is not in sight" if math.isinf(state.left_s) else f"in {state.left_s:.0f} s"
        message = f"{bound} {left} as things go" if state.left_s > 0 else f"{bound} already"
        return Event(self.name, active, time_ns, state.left_s, self.limit, message, self.quantity.file)


class Watch:
    """Several alarms and their states."""

    def __init__(self, alarms: Sequence[Alarm]) -> None:
        self._alarms = [(alarm, alarm.begin()) for alarm in alarms]

    def look(self, estimates: Estimates) -> list[Event]:
        """What happens in these rows, in order of time."""
        events: list[Event] = []
        for index, (alarm, state) in enumerate(self._alarms):
            state, new = alarm.step(state, estimates)
            self._alarms[index] = (alarm, state)
            events += new
        return sorted(events, key=lambda event: event.time_ns)

    def limits(self) -> list[dict[str, Any]]:
        """What is watched: name, column of the estimates, side (1: above is bad) and limit of each alarm."""
        return [
            {
                "name": alarm.name, "column": alarm.quantity.column, "heading": alarm.quantity.heading,
                "side": alarm.quantity.side, "limit": alarm.limit,
            }
            for alarm, _ in self._alarms
        ]  # fmt: skip

    def time_to_limit_s(self) -> dict[str, float]:
        """Seconds left by alarm name, for those that look ahead."""
        return {alarm.name: state.left_s for alarm, state in self._alarms if isinstance(state, Course)}


def parse_alarm(text: str, specification: Specification) -> Alarm:
    """Read `HEADING>NUMBER,key=value,...`; HEADING is an output's column (`temperature_rise_K`) or name (`temperature`).

    Keys: `hysteresis`, `hold_s`, `sigmas` (how many standard deviations are added), `name`, `file` (that events name); with
    `within_s` also `window_s` and `tau_s` (default: the sensor's slowest filter of a loss), and `hysteresis` is in seconds.

    Raises:
        DataError: the text is not understood, or the sensor has no such output.
    """
    where = f"--alarm {text}"
    head, *pairs = text.split(",")
    match = re.fullmatch(r"\s*(\w+)\s*([<>])\s*([-+.\deE]+)\s*", head)
    if match is None:
        raise DataError(f"{where}: write QUANTITY>NUMBER, for example temperature_rise_K>90,hysteresis=5")
    column, output = _output(match[1], specification.outputs, where)
    values = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise DataError(f"{where}: {pair.strip()!r} is no key=value")
        values[key.strip()] = value.strip()
    options = Options(values, where)
    limit = Options({"limit": match[3]}, where).number("limit", None, -1e12, 1e12)
    quantity = Quantity(
        column, output.heading, 1 if match[2] == ">" else -1, options.number("sigmas", 0.0, 0.0, 10.0),
        options.text("file", ""),
    )  # fmt: skip
    alarm: Alarm
    if "within_s" in values:
        within_s = options.number("within_s", None, 1e-3, 1e9)
        tau_s = options.number("tau_s", thermal_time_constant_s(specification), 1e-3, math.inf)
        alarm = TimeToLimit(
            options.text("name", f"{output.name} within {within_s:g} s"), quantity, limit, within_s,
            options.number("hysteresis", within_s / 2, 0.0, 1e9), tau_s,
            options.number("window_s", min(30.0, tau_s / 5), 1e-3, tau_s / 2),
        )  # fmt: skip
    else:
        alarm = Limit(
            options.text("name", f"{output.name} {match[2]} {limit:g}"), quantity, limit,
            options.number("hysteresis", abs(limit) * 0.05, 0.0, 1e12), options.number("hold_s", 0.0, 0.0, 1e9),
        )  # fmt: skip
    options.finish()
    return alarm


def plain_limit(heading: str, side: str, limit: float, outputs: Sequence[Output]) -> Limit:
    """The alarm `HEADING>NUMBER` with a hysteresis of a twentieth of the limit, as `parse_alarm` makes it.

    Raises:
        DataError: there is no such output, the side is neither `>` nor `<`, or the limit is not finite.
    """
    column, output = _output(heading, outputs, f"{heading}{side}{limit:g}")
    if side not in ("<", ">") or not math.isfinite(limit):
        raise DataError(f"{heading}{side}{limit:g}: write QUANTITY>NUMBER or QUANTITY<NUMBER")
    quantity = Quantity(column, output.heading, 1 if side == ">" else -1, 0.0)
    return Limit(f"{output.name} {side} {limit:g}", quantity, limit, abs(limit) * 0.05)


def thermal_time_constant_s(specification: Specification) -> float:
    """The slowest low-pass of a loss that the sensor has: what its training took for the winding's; inf if none."""
    losses = ("current_squared", "power", "voltage_squared", "emf_squared", "emf_power")
    return max((f.tau_s for f in specification.filters if f.signal in losses), default=math.inf)


def _output(name: str, outputs: Sequence[Output], where: str) -> tuple[int, Output]:
    for column, output in enumerate(outputs):
        if name in (output.name, output.heading):
            return column, output
    known = [output.heading for output in outputs]
    raise DataError(f"{where}: the sensor does not estimate {name!r}{nearest(name, known)}")


def _trip(
    state: Trip, time_ns: NDArray[np.int64], on: NDArray[np.bool_], off: NDArray[np.bool_], hold_s: float
) -> tuple[Trip, list[tuple[int, bool]]]:
    """Follow rows; returns the changes as (row, active)."""
    if not (off if state.active else on).any():
        # The usual case: nothing to wait for, and what was waited for has passed.
        return state if state.active or not len(on) else Trip(), []
    changes: list[tuple[int, bool]] = []
    hold_ns = round(hold_s * 1e9)
    for row, now_ns in enumerate(time_ns.tolist()):
        if state.active:
            if off[row]:
                state = Trip()
                changes.append((row, False))
        elif not on[row]:
            state = Trip()
        else:
            since = now_ns if state.since_ns is None else state.since_ns
            state = Trip(now_ns - since >= hold_ns, since)
            if state.active:
                changes.append((row, True))
    return state, changes
