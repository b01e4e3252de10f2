"""Simulation of a motor with all its effects, compiled to machine code for its structure.

One code path serves smooth and real friction. A rotor that turns carries its friction in full (see `symbols.SIDE`); where
its speed passes through zero the step is cut, and the rotor then rests as long as load and stiction can hold it (see
`compile.loop`). With `smooth=True` friction is the effects' smooth form throughout, nothing rests, and the load drives
the rotor either way: a differentiable motor.

Steps adapt inside each sample so that the error of each stays below `tolerance`, relative to the size of the state; an
inrush inside one sample of a second is resolved, and a steady state is passed in one step.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import SimpleNamespace

import numpy as np

from motorlens_physics.compile import Compiled, compiled
from motorlens_physics.compile.types import (
    ACCEPTED,
    ALLOWED,
    IMPOSED_VALUES,
    REJECTED,
    TIED,
    Course,
    Given,
    Variations,
)
from motorlens_physics.effect import Effect
from motorlens_physics.inputs import Array, Inputs, acting_of
from motorlens_physics.motor import Motor
from motorlens_physics.symbols import System, in_order, parameter_values, trace
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import DataError, ModelError

TOLERANCE = 1e-6
# Steps, rejected ones included, that a simulation may try for each sample on average unless its caller says otherwise, and
# how many beside. A sample in which everything settles anew takes 35 or so whatever the time constants
# (`benchmarks/bounded.py`), so a motor that needs more oscillates faster than the samples show.
STEPS_A_SAMPLE, STEPS_BESIDE = 100, 10_000
_NO_MATRIX, _NO_CUBE, _NO_INDEX = np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0, dtype=np.int64)
_NOTHING = Variations(
    S=_NO_MATRIX, kept=_NO_CUBE, matrices=_NO_CUBE, slots=_NO_INDEX, beside=_NO_INDEX, a=_NO_CUBE, g=_NO_CUBE,
    over=_NO_MATRIX, T=_NO_MATRIX,
)  # fmt: skip


@dataclass(frozen=True)
class Trajectory:
    """A simulated run.

    Attributes:
        motor: the motor.
        inputs: what acted on it.
        states: "i" (A), "w" (rad/s), "theta" (K) and those of effects, each (N,), at each sample.
        steps: how many steps were tried, rejected ones included: what it cost.
        shown_V: (N,) voltage at the terminals where anything is imposed on the motor, else None.
    """

    motor: Motor
    inputs: Inputs
    states: Mapping[str, Array]
    steps: int = 0
    shown_V: Array | None = None

    @property
    def voltage_V(self) -> Array:
        """Voltage at the terminals: what drives them, or what open ones and those of a current-controlled drive show."""
        return self.inputs.voltage_V if self.shown_V is None else self.shown_V

    @property
    def current_A(self) -> Array:
        """Armature current."""
        return self.states["i"]

    @property
    def speed_rad_s(self) -> Array:
        """Speed."""
        return self.states["w"]

    @property
    def rise_K(self) -> Array:
        """Rise of the winding above ambient."""
        return self.states["theta"]

    @property
    def temperature_C(self) -> Array:
        """Temperature of the winding."""
        return self.rise_K + self.inputs.ambient_C

    @property
    def resistance_ohm(self) -> Array:
        """Armature resistance."""
        return np.asarray(self.motor.resistance(self.rise_K))


def simulate(
    motor: Motor,
    inputs: Inputs,
    initial: Mapping[str, float] | None = None,
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
    most_steps: int | None = None,
) -> Trajectory:
    """Simulate a motor from its initial state (default: at rest, at ambient temperature) through all samples.

    Args:
        motor: the motor.
        inputs: what acts on it.
        initial: where its states start.
        tolerance: of the error of a step, relative to the size of the states.
        smooth: whether friction is smooth and nothing rests.
        most_steps: how many steps may be tried; by default `STEPS_A_SAMPLE` times the samples and `STEPS_BESIDE`. Whoever
            tries other parameters on one recording gives a multiple of `Trajectory.steps` of those that fit.

    Raises:
        ModelError: a state or parameter that is not finite or not there, or an integration that fails or takes too many
            steps: where, and why.
    """
    system, code = structure(motor, turned=inputs.angle_rad is not None)
    states = initial_states(motor, system, initial)
    return run(system, code, motor, inputs, states, tolerance=tolerance, smooth=smooth, most_steps=most_steps)


def simulate_batch(
    motors: Sequence[Motor],
    inputs: Sequence[Inputs],
    initials: Sequence[Mapping[str, float] | None] | None = None,
    *,
    tolerance: float = TOLERANCE,
    smooth: bool = False,
) -> list[Trajectory]:
    """Simulate many runs on all cores; a single motor, or a single set of inputs, serves for all runs.

    Raises:
        ModelError: as `simulate`.
        DataError: lengths that do not fit together.
    """
    runs = max(len(motors), len(inputs), len(initials or ()))
    starts = initials if initials is not None else [None]
    if any(len(part) not in (1, runs) for part in (motors, inputs, starts)):
        raise DataError(f"batch: {len(motors)} motors, {len(inputs)} inputs and {len(starts)} initial states")
    chosen = [
        (motors[k % len(motors)], inputs[k % len(inputs)], starts[k % len(starts)]) for k in range(runs)
    ]
    for motor in motors:
        structure(motor)

    def one(case: tuple[Motor, Inputs, Mapping[str, float] | None]) -> Trajectory:
        return simulate(*case, tolerance=tolerance, smooth=smooth)

    # Compiled before the threads start.
    first = one(chosen[0])
    return [first, *on_all_cores(one, chosen[1:])]


class Stepper:
    """A motor that is stepped along as its inputs become known: the plant of a live drive."""

    def __init__(
        self, motor: Motor, initial: Mapping[str, float] | None = None, *, tolerance: float = TOLERANCE
    ) -> None:
        """Put the motor into its initial state (default: at rest, at ambient temperature)."""
        self._system, self._motor_code = structure(motor)
        self._x = initial_states(motor, self._system, initial)
        self._parameters = np.array(parameter_values(motor), dtype=np.float64)
        self._acting = np.zeros((2, TIED))
        self._given = Given(np.zeros(2), self._acting, _NO_INDEX, False, self._parameters)
        self._scale = np.maximum(_scales(motor, self._system, np.zeros((1, 3)), self._x), 1e-3)
        self._course = Course(self._x, np.array([np.inf, 0.0, 0.0, 0.0]), tolerance * self._scale, tolerance)
        self._out = np.empty((2, self._x.size))
        self._motor, self._tolerance = motor, tolerance

    @property
    def states(self) -> dict[str, float]:
        """The present states by name."""
        return dict(zip(self._system.states, self._x.tolist(), strict=True))

    def step(self, voltage: float, load: float, ambient: float, dt: float) -> dict[str, float]:
        """Hold the inputs (V, N m, degC) for dt seconds; the states thereafter.

        Raises:
            ModelError: an input that is not finite, or an integration that fails.
        """
        time, course = self._given.time, self._course
        time[0], time[1] = time[1], time[1] + dt
        self._acting[:, :3] = voltage, load, ambient
        self._scale = np.maximum(
            self._scale, _scales(self._motor, self._system, self._acting[:, :3], self._x)
        )
        course.atol[:] = self._tolerance * self._scale
        course.carry[ALLOWED] = STEPS_BESIDE
        failed = self._motor_code(self._given, course, self._out, _NOTHING)
        if failed >= 0:
            inputs = Inputs(time, np.full(2, voltage), np.full(2, load), np.full(2, ambient), held=True)
            exhausted = course.carry[ALLOWED] < 0
            raise ModelError(_failure(self._motor, self._system, inputs, 0, self._x, exhausted))
        return self.states


def structure(
    motor: Motor, candidates: Sequence[Effect] = (), *, forced: bool = False, turned: bool = False
) -> tuple[System, Compiled]:
    """The symbols and the machine code of a motor's structure (see `trace`); parameter values do not matter."""
    own, further = (tuple(map(type, in_order(effects))) for effects in (motor.effects, candidates))
    return _structure(own, further, forced, turned)


def initial_states(motor: Motor, system: System, initial: Mapping[str, float] | None) -> Array:
    """Where the states start, in the system's order; what `initial` does not name starts at its default.

    Raises:
        ModelError: an unknown name, or a value that is not finite.
    """
    defaults = motor.states()
    given = {**defaults, **(initial or {})}
    unknown = [name for name in given if name not in defaults]
    if unknown:
        raise ModelError(f"initial state {unknown[0]!r}: the motor has {', '.join(defaults)}")
    x = np.array([given[name] for name in system.states], dtype=np.float64)
    if not np.isfinite(x).all():
        raise ModelError(f"initial state {system.states[int(np.argmin(np.isfinite(x)))]!r} is not finite")
    return x


def run(
    system: System,
    code: Compiled,
    motor: Motor,
    inputs: Inputs,
    x: Array,
    *,
    tolerance: float,
    smooth: bool,
    candidates: Sequence[Effect] = (),
    variations: Variations = _NOTHING,
    most_steps: int | None = None,
) -> Trajectory:
    """Integrate from the states x; sensitivities are carried along into `variations`.

    Raises:
        ModelError: a parameter that is not finite or not positive where it must be, or an integration that fails.
    """
    parameters = np.array(parameter_values(motor, candidates), dtype=np.float64)
    if not np.isfinite(parameters).all():
        raise ModelError(f"{system.keys[int(np.argmin(np.isfinite(parameters)))]} is not finite")
    for name in ("R_a0", "J", "H"):
        if getattr(motor, name) <= 0:
            raise ModelError(f"{name} = {getattr(motor, name):g}: must be positive")
    acting, imposed = acting_of(inputs)
    largest = x.copy()
    if imposed.size:
        largest[:2] = np.maximum(
            np.abs(x[:2]), np.abs(acting[:, IMPOSED_VALUES : IMPOSED_VALUES + 2]).max(axis=0)
        )
    size = _scales(motor, system, acting, largest)
    samples = inputs.time_s.size
    out = np.empty((samples, x.size + (imposed.size > 0)))
    allowed = STEPS_A_SAMPLE * samples + STEPS_BESIDE if most_steps is None else most_steps
    course = Course(
        x.copy(), np.array([np.inf, 0.0, 0.0, allowed], dtype=np.float64), tolerance * size, tolerance
    )
    out[0, : x.size] = x
    failed = code(Given(inputs.time_s, acting, imposed, smooth, parameters), course, out, variations)
    if failed >= 0:
        raise ModelError(
            _failure(motor, system, inputs, failed, out[failed, : x.size], course.carry[ALLOWED] < 0)
        )
    states = {name: out[:, j] for j, name in enumerate(system.states[: system.of_motor])}
    if inputs.angle_rad is not None:
        states |= {name: inputs.angle_rad for name in motor.states() if name not in states}
    steps = int(course.carry[ACCEPTED] + course.carry[REJECTED])
    return Trajectory(motor, inputs, states, steps, out[:, -1] if imposed.size else None)


def _scales(motor: Motor, system: System, inputs: Array, x: Array) -> Array:
    """The size of each state that counts as small, from what the inputs and the states x can bring about."""
    # A rotor that turns is a source, and so is a current that is imposed.
    volts = max(float(np.max(np.abs(inputs[:, 0]))), motor.ke * abs(x[1]), motor.R_a0 * abs(x[0]))
    torque = float(np.max(np.abs(inputs[:, 1])))
    # A tenth of the locked-rotor current and of the no-load speed, a kelvin, a tenth of a radian and of all else.
    sizes = {
        "i": max(0.1 * volts / motor.R_a0, 0.1 * torque / motor.ke, 0.1 * abs(x[0])),
        "w": max(0.1 * volts / motor.ke, 0.1 * motor.R_a0 * torque / motor.ke**2, 0.1 * abs(x[1])),
        "theta": 1.0,
    }
    return np.array([max(sizes.get(name, 0.1), 1e-6) for name in system.states])


def _failure(motor: Motor, system: System, inputs: Inputs, k: int, x: Array, exhausted: bool) -> str:
    """Where a simulation ended, and why as far as the motor at sample k tells."""
    time = inputs.time_s
    at = ", ".join(f"{name} = {value:.4g}" for name, value in zip(system.states, x, strict=True))
    begin = f"the simulation cannot go on at t = {time[k]:g} s, where {at}"
    span = float(time[min(k + 1, time.size - 1)] - time[k]) or np.inf
    pole = _fastest(motor, inputs, k, dict(zip(system.states, x.tolist(), strict=True)))
    if exhausted and pole is not None and abs(pole.imag) * span > 2 * np.pi:
        return (
            f"{begin}: it takes too many steps, since the motor oscillates there at {abs(pole.imag) / (2 * np.pi):.3g} Hz "
            f"and samples are {span:.3g} s apart; a parameter is out of range for these inputs"
        )
    if exhausted:
        return (
            f"{begin}: it takes too many steps, since too much happens within a sample of {span:.3g} s; "
            "a parameter is out of range for these inputs"
        )
    if pole is not None and pole.real > 0:
        return (
            f"{begin}: the motor grows without bound, by a factor e in {1 / pole.real:.3g} s; "
            "a parameter or an input is out of range"
        )
    return f"{begin}; a parameter or an input is out of range"


def _fastest(motor: Motor, inputs: Inputs, k: int, x: dict[str, float]) -> complex | None:
    """The fastest oscillation of the motor about a state, else what grows fastest, in 1/s; None where neither is told."""
    # A shaft angle that is an input is none of the states: it stands at 0 here.
    at = {**motor.states(), **x}
    u = SimpleNamespace(
        v=inputs.voltage_V[k], load=inputs.load_torque_Nm[k], ambient=inputs.ambient_C[k], t=inputs.time_s[k]
    )
    jacobian = np.zeros((len(x), len(x)))
    try:
        with np.errstate(all="ignore"):
            for c, name in enumerate(x):
                step = 1e-6 * max(abs(x[name]), 1e-3)
                above, below = (
                    motor.rates(SimpleNamespace(**{**at, name: x[name] + sign * step}), u) for sign in (1, -1)
                )
                jacobian[:, c] = [(above[row] - below[row]) / (2 * step) for row in x]
            poles = np.linalg.eigvals(jacobian)
    except (ArithmeticError, ValueError, np.linalg.LinAlgError):
        return None
    return complex(max(poles, key=lambda pole: (abs(pole.imag), pole.real)))


@cache
def _structure(
    effects: tuple[type[Effect], ...], candidates: tuple[type[Effect], ...], forced: bool, turned: bool
) -> tuple[System, Compiled]:
    motor = Motor(effects=tuple(effect() for effect in effects))
    system = trace(motor, [effect() for effect in candidates], forced=forced, turned=turned)
    return system, compiled(system)


__all__ = ["STEPS_A_SAMPLE", "STEPS_BESIDE", "TOLERANCE", "Array", "Inputs", "Stepper", "Trajectory", "initial_states",
           "run", "simulate", "simulate_batch", "structure"]  # fmt: skip
