"""Whether the parameters of the model are constants: each of them against speed, current, temperature, time and travel.

A wrong name can fit well on the whole and yet not be the missing effect: its coefficient then differs between slow and fast,
between early and late, just after a reversal and long after. Every parameter of the model, those of what has been accepted
among them, is let free as a sum of hat functions; what that explains beyond the constant is something the catalogue has not.
Varying-coefficient models: Hastie and Tibshirani (1993), doi:10.1111/j.2517-6161.1993.tb01939.x.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing, inputs_at
from motorlens_physics.estimate.shaft import STANDS
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.hypotheses.curves import hat_functions, knots_of
from motorlens_workbench.hypotheses.effects import equation_of
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

EVERYTHING = ("speed", "current", "temperature", "time", "travel")
SLOW = ("speed", "temperature", "time")
# The equation of every parameter of the textbook, and against what it may vary. The temperature coefficient and the growth
# of cooling with speed may not: R_a0 against temperature and k0 against speed say the same.
TEXTBOOK: Mapping[str, tuple[str, Sequence[str]]] = {
    "R_a0": ("electrical", EVERYTHING), "alpha": ("electrical", ()), "L": ("electrical", EVERYTHING),
    "ke": ("coupling", EVERYTHING), "J": ("mechanical", EVERYTHING), "b": ("mechanical", EVERYTHING),
    "k0": ("thermal", SLOW), "kT": ("thermal", ()), "k_ir": ("thermal", SLOW), "H": ("thermal", SLOW),
}  # fmt: skip
KNOTS = {"speed": 6, "current": 6, "temperature": 5, "time": 8}
# Angles turned since the last reversal, rad: bristles and backlash are used up within a few.
TRAVEL_RAD = np.array([0.0, 0.2, 0.6, 2.0, 6.0, 20.0])


@dataclass(frozen=True)
class Course:
    """One parameter of the model as a free curve of one variable.

    Attributes:
        parameter: of the textbook or of an effect, such as "R_a0" or "coulomb_friction.tau_c".
        equation: where it belongs.
        unit: of the parameter.
        against: "speed" or "current" (absolute), "temperature", "time", or "travel" since the last reversal.
        knots: (k,) in the variable's unit.
    """

    parameter: str
    equation: str
    unit: str
    against: str
    knots: Array

    @property
    def term(self) -> str:
        """What it is the course of."""
        return self.parameter

    @property
    def width(self) -> int:
        """How many columns it has."""
        return len(self.knots)

    @property
    def name(self) -> str:
        """What it is called where hypotheses are listed."""
        return f"{self.parameter} against {self.against}"

    def columns(self, line: Line) -> Array:
        """(N, C, k) what a unit at each knot would change in the channels."""
        return line.of_forcing(self.forcing(line.trajectory))

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return -np.inf, np.inf

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """(k,) the knots, how the parameter differs there in its unit, and the standard deviation of that."""
        return self.knots, coefficient, np.sqrt(np.maximum(np.diagonal(covariance), 0.0))

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit of the parameter at each knot adds to the balances, (N, k) each."""
        hats = hat_functions(self.knots, variables(trajectory)[self.against])
        unit = of_parameter(trajectory, self.parameter)
        return Forcing(hats * unit.voltage[:, None], hats * unit.torque[:, None], hats * unit.heat[:, None])


def variables(trajectory: Trajectory) -> dict[str, Array]:
    """What parameters may vary with, (N,) each; "travel" is the angle turned since the last reversal, rad."""
    return {
        "speed": np.abs(trajectory.speed_rad_s),
        "current": np.abs(trajectory.current_A),
        "temperature": trajectory.rise_K,
        "time": trajectory.inputs.time_s,
        "travel": travel(trajectory.speed_rad_s, trajectory.inputs.time_s),
    }


def travel(speed_rad_s: Array, time_s: Array) -> Array:
    """(N,) angle turned since the last reversal, in rad; where samples are too far apart to tell, as if long after one.

    >>> travel(np.array([1.0, 1.0, -1.0, -1.0]), np.arange(4.0)).tolist()
    [0.0, 1.0, 0.0, 1.0]
    """
    least = STANDS * float(np.max(np.abs(speed_rad_s), initial=1e-12))
    way = np.where(np.abs(speed_rad_s) > least, np.sign(speed_rad_s), 0.0)
    moving = np.flatnonzero(way)
    turned = np.zeros(len(way), dtype=bool)
    turned[moving[1:][way[moving[1:]] != way[moving[:-1]]]] = True
    steps = 0.5 * (np.abs(speed_rad_s[1:]) + np.abs(speed_rad_s[:-1])) * np.diff(time_s)
    if len(moving) and np.median(steps[np.minimum(moving, len(steps) - 1)]) > TRAVEL_RAD[-2]:
        return np.full(len(way), TRAVEL_RAD[-1])
    path = np.concatenate([[0.0], np.cumsum(steps)])
    since = np.maximum.accumulate(np.where(turned, path, 0.0))
    return np.asarray(path - since)


def of_parameter(trajectory: Trajectory, parameter: str) -> Forcing:
    """What a unit more of a parameter adds to the balances along a trajectory, (N,) each."""
    motor, u = trajectory.motor, inputs_at(trajectory)
    x = SimpleNamespace(**trajectory.states)
    value = _value(motor, parameter)
    step = 1e-4 * abs(value) if value else 1e-6
    up, down = (_with(motor, parameter, value + sign * step).rates(x, u) for sign in (1, -1))
    stored = {"i": motor.inductance(x, u), "w": motor.J, "theta": motor.H}
    voltage, torque, heat = (
        np.broadcast_to(stored[name] * (up[name] - down[name]) / (2 * step), u.t.shape) for name in stored
    )
    return Forcing(voltage, torque, heat)


def _value(motor: Motor, parameter: str) -> float:
    owner, _, name = parameter.rpartition(".")
    return float(getattr(motor.effect(owner) if owner else motor, name))


def _with(motor: Motor, parameter: str, value: float) -> Motor:
    owner, _, name = parameter.rpartition(".")
    if not owner:
        return replace(motor, **{name: value})  # type: ignore[arg-type]
    effect = motor.effect(owner)
    assert effect is not None
    return motor.with_effect(replace(effect, **{name: value}))


def parameters_of(file: MotorFile, channels: Sequence[str]) -> dict[str, tuple[str, Sequence[str]]]:
    """The equation of every parameter that may vary, and against what: the textbook's, and what switches each effect.

    Args:
        file: the motor, with the effects accepted so far.
        channels: measured outputs; without the temperature, heat is not looked at.
    """
    parameters: dict[str, tuple[str, Sequence[str]]] = {
        key: (equation, against)
        for key, (equation, against) in TEXTBOOK.items()
        if against and (equation != "thermal" or "temperature" in channels)
    }
    for effect in file.motor.effects:
        switch = effect.switch()
        if switch is not None and not effect.states:
            parameters[f"{effect.name()}.{switch.name}"] = (equation_of(type(effect)), EVERYTHING)
    return parameters


def courses(
    file: MotorFile, trajectories: Sequence[Trajectory], channels: Sequence[str], *, loaded: bool
) -> list[Hypothesis]:
    """Every parameter of a motor against everything that varies in these runs.

    Args:
        file: the motor, with the effects accepted so far.
        trajectories: of every run, from the present model.
        channels: measured outputs; without the temperature, heat is not looked at.
        loaded: whether the load torque was measured. Where it was not, friction or inertia that goes with time, or with the
            warming, may be a load that does, and is not looked at.
    """
    visited = [variables(trajectory) for trajectory in trajectories]
    made = []
    for against in EVERYTHING:
        samples = np.concatenate([one[against] for one in visited])
        if against == "travel":
            reverses = any(np.any(np.diff(one["travel"]) < 0) for one in visited)
            knots = TRAVEL_RAD[: int(np.searchsorted(TRAVEL_RAD, samples.max()))] if reverses else None
        else:
            knots = knots_of(samples, KNOTS[against])
        if knots is None or len(knots) < 3:
            continue
        for key, (equation, allowed) in parameters_of(file, channels).items():
            load_like = not loaded and equation == "mechanical" and against in ("time", "temperature")
            if against in allowed and not load_like:
                made.append(Course(key, equation, file.meaning(key).unit, against, knots))
    return [
        Hypothesis(
            course.name,
            "unnamed",
            course.equation,
            (course,),
            typical=abs(_value(file.motor, course.parameter)),
        )
        for course in made
    ]
