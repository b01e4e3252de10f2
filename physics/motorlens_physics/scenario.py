"""Scenarios: the tests an engineer would run, planned from the rating plate and performed on a simulated motor.

A scenario is one frozen dataclass in one file of `scenarios/`, found because it is there. Its `plan` says what is
done to the motor; `perform` does it, and `measure` adds what sensors and noise make of it.
"""

import importlib
import pkgutil
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from motorlens_physics.conditions import Shaft, Terminal
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Array, Recording
from motorlens_physics.sensor_model import SensorModel
from motorlens_physics.simulation import Inputs, Trajectory, simulate
from motorlens_runtime.errors import DataError, ModelError

# A test may have this many rows, some 700 MB of channels: what is planned from fitted values is bounded before it is begun.
MOST_ROWS = 10_000_000
# A test that chooses its own sampling period has at most this many: five times what the plans ask for of usual motors.
ROWS_OF_ITS_OWN = 200_000


@dataclass(frozen=True)
class Phase:
    """A stretch of a test: what is applied, and what terminals and shaft are tied to (see `Inputs`)."""

    inputs: Inputs


@dataclass(frozen=True)
class Plan:
    """Phases one after another, from an initial state (see `Motor.states`)."""

    phases: tuple[Phase, ...]
    initial: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Scenario:
    """Base of all scenarios. `duration_s` and `period_s` 0 mean: as the motor's time constants ask for."""

    duration_s: float = 0.0
    period_s: float = 0.0

    @classmethod
    def name(cls) -> str:
        """The name on the command line: that of the class in lower case with underscores."""
        return re.sub(r"(?<!^)(?=[A-Z])", "_", cls.__name__).lower()

    def plan(self, file: MotorFile, rng: np.random.Generator) -> Plan:
        """What to do to this motor.

        Raises:
            ModelError: a motor whose time constants make the test too long to be performed.
        """
        raise TypeError(f"{type(self).__name__} has no plan")

    def times(self, duration_s: float, period_s: float, start_s: float = 0.0) -> Array:
        """Evenly spaced times at the period that was asked for, or else at this one, as far as the rows allow.

        Raises:
            ModelError: as `grid`.
        """
        return grid(duration_s, self.period_s or max(period_s, duration_s / ROWS_OF_ITS_OWN), start_s)


def scenarios() -> dict[str, type[Scenario]]:
    """All scenarios by name; the folder `scenarios/` is the list."""
    from motorlens_physics import scenarios as folder

    found: dict[str, type[Scenario]] = {}
    for info in pkgutil.iter_modules(folder.__path__):
        module = importlib.import_module(f"{folder.__name__}.{info.name}")
        for thing in vars(module).values():
            if (
                isinstance(thing, type)
                and issubclass(thing, Scenario)
                and thing.__module__ == module.__name__
            ):
                found[thing.name()] = thing
    return dict(sorted(found.items()))


def chosen_scenario(name: str, duration_s: float, rate_Hz: float) -> Scenario:
    """The scenario that a command line asks for; 0 leaves duration or rate to the scenario.

    Raises:
        DataError: no such scenario, or a negative number.
    """
    known = scenarios()
    if name not in known:
        raise DataError(f"--scenario {name}: unknown; known: {', '.join(known)}")
    if min(duration_s, rate_Hz) < 0:
        raise DataError("--duration and --rate are positive numbers")
    return known[name](duration_s, 1 / rate_Hz if rate_Hz else 0.0)


@dataclass(frozen=True)
class TimeConstants:
    """How fast a motor is, in seconds: L/R, R J/ke^2 (Leonhard, Control of Electrical Drives, 3rd ed., ch. 6), H/k0."""

    electrical_s: float
    mechanical_s: float
    thermal_s: float


def time_constants(motor: Motor) -> TimeConstants:
    """The three time constants of a motor, from the textbook part of its model."""
    return TimeConstants(motor.L / motor.R_a0, motor.R_a0 * motor.J / motor.ke**2, motor.H / motor.k0)


def perform(
    file: MotorFile,
    scenario: Scenario,
    rng: np.random.Generator,
    *,
    terminal: Terminal | None = None,
    shaft: Shaft | None = None,
) -> Recording:
    """Run a scenario on a motor and record everything truly, sensors and noise left out.

    Channels: voltage, current, speed, temperature (winding), resistance, load torque, ambient, the shaft angle where an
    effect of the motor keeps one, and what terminals and shaft are tied to where that is not a voltage and nothing.

    Args:
        file: the motor.
        scenario: the test.
        rng: for what is random in it.
        terminal: what the terminals are tied to throughout, in place of what the test says, see `tied`.
        shaft: likewise.

    Raises:
        ModelError: a motor that cannot be simulated, or a test too long for it.
    """
    plan = scenario.plan(file, rng)
    state: Mapping[str, float] = plan.initial
    pieces = []
    for phase in plan.phases:
        trajectory = simulate(file.motor, tied(phase.inputs, file, terminal, shaft), state)
        state = {name: float(values[-1]) for name, values in trajectory.states.items()}
        # The last sample of a phase is the first of the next one.
        pieces.append(_channels(file.motor, trajectory, keep_last=phase is plan.phases[-1]))
    joined = {q: np.concatenate([piece[q] for piece in pieces]) for q in pieces[0]}
    for quantity in ("terminal", "shaft"):
        if not joined[quantity].any():
            del joined[quantity]
    return Recording(scenario.name(), joined.pop("time"), joined)


def measure(
    recording: Recording,
    sensors: tuple[SensorModel, ...],
    noise: Mapping[str, float],
    rng: np.random.Generator,
) -> Recording:
    """What the sensors show of a true recording: sensor models applied, then white Gaussian noise.

    Args:
        recording: the truth.
        sensors: models applied in their order; a channel without one is ideal.
        noise: channel to standard deviation in the channel's unit.
        rng: where the noise comes from.
    """
    channels = dict(recording.channels)
    for sensor in sensors:
        if sensor.channel in channels:
            channels[sensor.channel] = sensor.record(recording.time_s, channels[sensor.channel], rng)
    for channel in sorted(noise):
        if channel in channels:
            channels[channel] = channels[channel] + noise[channel] * rng.standard_normal(len(recording))
    return replace(recording, channels=channels)


def parse_noise(arguments: Sequence[str], plate: Rated) -> dict[str, float]:
    """Turn `--noise` arguments into channel to standard deviation: `current=0.05`, `speed=1%`, or `0.5%` for all.

    Raises:
        DataError: an unknown channel, or no number.
    """
    scales = {
        "voltage": plate.voltage_V, "current": plate.current_A, "speed": plate.speed_rad_s,
        "temperature": plate.rise_K, "load_torque": plate.torque_Nm,
    }  # fmt: skip
    noise: dict[str, float] = {}
    for argument in arguments:
        channel, equals, size = argument.rpartition("=")
        try:
            share = float(size.removesuffix("%")) / 100 if size.endswith("%") else None
            sd = float(size) if share is None else 0.0
        except ValueError:
            raise DataError(f"--noise {argument}: write current=0.05 or 0.5%") from None
        if equals and channel not in scales:
            raise DataError(f"--noise {argument}: unknown channel; known: {', '.join(scales)}")
        if not equals and share is None:
            raise DataError(
                f"--noise {argument}: say of which channel ({channel or 'current'}=...), or a share such as 0.5%"
            )
        for name in [channel] if equals else scales:
            noise[name] = sd if share is None else share * scales[name]
    return noise


def grid(duration_s: float, period_s: float, start_s: float = 0.0) -> Array:
    """Evenly spaced times from `start_s`, both ends included.

    Raises:
        ModelError: more than `MOST_ROWS`, or a length that is no number.
    """
    bounded(duration_s, period_s)
    return np.asarray(start_s + period_s * np.arange(round(duration_s / period_s) + 1), dtype=np.float64)


def bounded(duration_s: float, period_s: float) -> None:
    """Refuse a test of more than `MOST_ROWS` before anything is allocated for it.

    Raises:
        ModelError: it would have more, or its length is no number.
    """
    rows = duration_s / period_s if period_s > 0 else np.inf
    if not rows <= MOST_ROWS:
        raise ModelError(
            f"a test of {duration_s:.3g} s sampled every {period_s:.3g} s would have {rows:.3g} rows, more than "
            f"{MOST_ROWS:,}; ask for a shorter duration or a lower rate, or look at the motor's J, b, L and R_a0"
        )


def constant(time_s: Array, voltage_V: float, load_torque_Nm: float, ambient_C: float) -> Inputs:
    """Inputs that do not change."""
    ones = np.ones_like(time_s)
    return Inputs(time_s, voltage_V * ones, load_torque_Nm * ones, ambient_C * ones, held=True)


def steps(time_s: Array, at_s: Array, values: Array) -> Array:
    """A staircase on a time grid: `values[k]` from `at_s[k]` on."""
    return np.asarray(values[np.searchsorted(at_s, time_s, side="right") - 1])


def tied(
    inputs: Inputs, file: MotorFile, terminal: Terminal | None = None, shaft: Shaft | None = None
) -> Inputs:
    """These inputs with the terminals or the shaft tied throughout to something else.

    A current-controlled drive follows the voltages of the inputs in proportion, rated voltage as rated current; a machine
    that turns the shaft does likewise with rated speed.
    """
    share = inputs.voltage_V / file.rated.voltage_V
    if terminal is not None:
        current = file.rated.current_A * share if terminal == Terminal.CURRENT else None
        inputs = replace(inputs, terminal=np.full(inputs.time_s.size, terminal), current_A=current)
    if shaft is not None:
        speed = file.rated.speed_rad_s * share if shaft == Shaft.TURNED else None
        inputs = replace(inputs, shaft=np.full(inputs.time_s.size, shaft), speed_rad_s=speed)
    return inputs


def _channels(motor: Motor, trajectory: Trajectory, keep_last: bool) -> dict[str, Array]:
    inputs, states = trajectory.inputs, dict(trajectory.states)
    voltage, current, load = trajectory.voltage_V, trajectory.current_A, inputs.load_torque_Nm
    speed = trajectory.speed_rad_s
    if inputs.shaft is not None:
        # The load is what a lock bears.
        load = np.where(inputs.shaft == Shaft.LOCKED, motor.ke * current, load)
    # A brake that holds a resting rotor takes up the motor's torque, no more.
    resting = (speed == 0) & (load != 0)
    load = np.where(resting, np.clip(motor.ke * current, -np.abs(load), np.abs(load)), load)
    channels: dict[str, Any] = {
        "time": inputs.time_s,
        "voltage": voltage,
        "current": current,
        "speed": speed,
        "temperature": trajectory.temperature_C,
        "resistance": motor.resistance(trajectory.rise_K),
        "load_torque": load,
        "ambient": inputs.ambient_C,
    }
    if "phi" in states:
        channels["angle"] = states["phi"]
    nothing = np.zeros(inputs.time_s.size)
    channels["terminal"] = nothing if inputs.terminal is None else inputs.terminal
    channels["shaft"] = nothing if inputs.shaft is None else inputs.shaft
    return {q: np.asarray(y, dtype=np.float64)[: None if keep_last else -1] for q, y in channels.items()}
