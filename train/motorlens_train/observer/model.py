"""The motor's equations as filters and bounds need them: rates and Jacobian, compiled from the physics' own symbols.

The states are those of the motor, effects included, and behind them the load torque, which no sensor shows and which is
therefore a state: a random walk. Friction is in its smooth form. The shaft angle is no state: nothing in voltage and
current at a filter's pace shows it, so effects that need it (cogging, ripple) are left out; their mean is zero.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from motorlens_physics.motor import Motor
from motorlens_physics.symbols import LOAD, SIDE, TIME, named, parameter_keys, parameter_values, trace
from motorlens_train.observer.program import Program, Recorder, record

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Equations:
    """Right-hand sides of a motor's equations in symbols, with numbers for all parameters but `free`.

    Attributes:
        states: names, "load" last.
        rates: dx/dt of each state in SymPy, over `x_NAME`, `u_v`, `u_ambient` and the free parameters.
        voltage: v - R i - ke w + effects, the balance that L di/dt makes good, over the same symbols.
        free: symbols of the parameters that stay symbols, by key.
    """

    states: tuple[str, ...]
    rates: tuple[Any, ...]
    voltage: Any
    free: dict[str, Any]

    @property
    def x(self) -> tuple[Any, ...]:
        """Symbols of the states."""
        return tuple(named(f"x_{name}") for name in self.states)


def without_angle(motor: Motor) -> Motor:
    """The motor without the effects that need the shaft angle."""
    return replace(motor, effects=tuple(effect for effect in motor.effects if "phi" not in effect.states))


def equations(motor: Motor, free: Sequence[str] = ()) -> Equations:
    """The equations of a motor with its effects; `free` are keys such as "R_a0" that stay symbols."""
    motor = without_angle(motor)
    system = trace(motor)
    numbers = dict(zip(parameter_keys(motor), parameter_values(motor), strict=True))
    symbols = dict(zip(system.keys, system.p, strict=True))
    known = {symbols[key]: sp.Float(numbers[key]) for key in system.keys if key not in free}
    known |= {SIDE: sp.Integer(0), TIME: sp.Integer(0), LOAD: named("x_load")}
    rates = [
        sp.sympify(balance).subs(known) / sp.sympify(mass).subs(known)
        for balance, mass in zip(system.balances, system.masses, strict=True)
    ]
    states = (*system.states, "load")
    return Equations(
        states,
        (*rates, sp.Integer(0)),
        sp.sympify(system.balances[0]).subs(known),
        {k: symbols[k] for k in free},
    )


def linearised(motor: Motor) -> tuple[tuple[str, ...], Program]:
    """States (load last) and the program (states, voltage, ambient) -> rates (n) and Jacobian (n n, row by row)."""
    return _linearised(without_angle(motor))


@cache
def _linearised(motor: Motor) -> tuple[tuple[str, ...], Program]:
    system = equations(motor)
    recorder = Recorder()
    symbols = [*system.x, named("u_v"), named("u_ambient")]
    values = dict(zip(symbols, recorder.inputs([str(symbol) for symbol in symbols]), strict=True))
    outputs = [record(rate, values, recorder) for rate in system.rates]
    outputs += [record(sp.diff(rate, x), values, recorder) for rate in system.rates for x in system.x]
    return system.states, recorder.program(outputs)


def along(motor: Motor, states: Sequence[Array], voltage_V: Array, ambient_C: Array) -> Array:
    """Jacobians (N, n, n) along a trajectory; `states` are (N,) each, the load last."""
    _, program = linearised(motor)
    size = len(states)
    results = program(*states, voltage_V, ambient_C)[size:]
    table = [np.broadcast_to(np.asarray(entry, dtype=np.float64), voltage_V.shape) for entry in results]
    return np.stack(table, axis=1).reshape(len(voltage_V), size, size)
