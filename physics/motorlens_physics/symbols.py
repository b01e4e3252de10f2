"""The equations of a motor as symbols: its methods evaluated once on SymPy symbols, and derivatives thereof.

`trace` gives M dx/dt = f(x, u, p) with the mass M = diag(L, J, H, 1, ...), so that L may be zero. An inductance that
depends on the state is moved to the right-hand side as the ratio L / L(x).

Real friction is a set: at rest it may be anything between its two limits. Beside the smooth tanh(w / width) of the
effects, the symbols carry `side`: +1 or -1 for a rotor that turns, whose friction then has its full size at once
(tanh(w / width + 20 side), which is `side` to the last bit), and 0 for the smooth form.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import SimpleNamespace
from typing import Any

import sympy as sp

from motorlens_physics.effect import Effect
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import parameters

# tanh(20) is 1 to the last bit of a float64.
_SATURATED = 20
INPUTS = ("v", "load", "ambient", "angle")
# Keys of sensitivities to a constant that is added to an input.
INPUT_KEYS = ("input.voltage", "input.load_torque", "input.ambient")
# The inductance, inertia and heat capacity that stand before the derivatives of the three textbook states.
MASSES = {"i": "L", "w": "J", "theta": "H"}


def named(name: str) -> Any:
    """The real symbol of that name."""
    return sp.Symbol(name, real=True)


SIDE = named("side")
TIME = named("u_t")
LOAD = named("u_load")


@dataclass(frozen=True)
class System:
    """A motor's equations in symbols.

    Attributes:
        states: names; symbol `x_NAME` each. The states of the motor come first, then those only candidates bring.
        keys: parameter keys in the order of the argument vector; symbol `p_K` each.
        balances: right-hand side of each state's equation, before division by its mass.
        stiction: torque that holds a resting rotor from turning to a `SIDE`, in N m.
        per_volt: what the electrical balance has, before division by L, of a volt more: L over the inductance as it is.
        of_motor: how many of `states` are the motor's own.
        forcings: for each of `forcing_keys`, what enters the motor's own balances per unit of it; empty if not asked for.
    """

    states: tuple[str, ...]
    keys: tuple[str, ...]
    balances: tuple[Any, ...]
    stiction: Any
    per_volt: Any
    of_motor: int
    forcings: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    @property
    def x(self) -> tuple[Any, ...]:
        """Symbols of the states."""
        return tuple(named(f"x_{name}") for name in self.states)

    @property
    def masses(self) -> tuple[Any, ...]:
        """What stands before the derivative of each state."""
        p = dict(zip(self.keys, self.p, strict=True))
        return tuple(p[MASSES[name]] if name in MASSES else sp.Integer(1) for name in self.states)

    @property
    def p(self) -> tuple[Any, ...]:
        """Symbols of the parameters."""
        return tuple(named(f"p_{k}") for k in range(len(self.keys)))


def trace(
    motor: Motor, candidates: Sequence[Effect] = (), *, forced: bool = False, turned: bool = False
) -> System:
    """The equations of a motor, and the forcings of its sensitivities.

    A candidate stands in the equations at its null: its states run along, driven by the motor, and it acts on nothing;
    the forcing of its switch says how it would.

    Args:
        motor: the structure; its parameters' values do not matter.
        candidates: effects that the motor lacks.
        forced: whether to derive the forcings, of all parameters of the motor that are not fixed and all switches.
        turned: whether the shaft angle is an input; otherwise it is a state, the integral of the speed.
    """
    motor, candidates = replace(motor, effects=in_order(motor.effects)), in_order(candidates)
    keys = parameter_keys(motor, candidates)
    symbol = {key: named(f"p_{k}") for k, key in enumerate(keys)}
    whole = _symbolic(replace(motor, effects=(*motor.effects, *candidates)), symbol)
    own, every = states_of(motor, turned=turned), states_of(whole, turned=turned)
    states = tuple(dict.fromkeys((*own, *every)))
    x = SimpleNamespace(
        **{name: named(f"x_{name}" if name in states else "u_angle") for name in whole.states()}
    )
    u = SimpleNamespace(**{name: named(f"u_{name}") for name in (*INPUTS, "t")})

    voltage, torque, heat = (sp.sympify(balance) for balance in whole.balances(x, u))
    per_volt = sp.Integer(1)
    if whole.inductance(x, u) != symbol["L"]:
        per_volt = 1 / sp.cancel(whole.inductance(x, u) / symbol["L"])
        voltage = voltage * per_volt
    rates = whole.rates(x, u)
    balances = [voltage, torque, heat, *(sp.sympify(rates[name]) for name in states[3:])]

    at_null = {symbol[switch_key(effect)]: sp.Float(effect.switch().null) for effect in candidates}
    of_motor = len(own)
    variable = symbol | {key: named(f"u_{name}") for key, name in zip(INPUT_KEYS, INPUTS, strict=False)}
    forcings = {
        key: tuple(sp.diff(f, variable[key]).subs(at_null) for f in balances[:of_motor])
        for key in (forcing_keys(motor, candidates) if forced else ())
    }
    balances = [f.subs(at_null) for f in balances]
    for state, mass in MASSES.items() if forced else ():
        # The mass stands before the derivative: d(M x')/dM adds -x'. Without inductance there is no such derivative.
        row, m = states.index(state), symbol[mass]
        rate = sp.Piecewise((balances[row] / m, m > 0), (0, True)) if mass == "L" else balances[row] / m
        forcings[mass] = tuple(f - rate if r == row else f for r, f in enumerate(forcings[mass]))
    stiction = sum((effect.stiction(whole, x, u) for effect in whole.effects), start=sp.Integer(0))
    stiction, per_volt = (sp.sympify(one).subs(at_null) for one in (stiction, per_volt))
    return System(states, keys, tuple(balances), stiction, per_volt, of_motor, forcings)


def states_of(motor: Motor, *, turned: bool) -> tuple[str, ...]:
    """Names of a motor's states; its shaft angle is none where that is `turned` by what is known of it."""
    angles = {name for effect in motor.effects for name, s in effect.states.items() if s.kind == "angle"}
    return tuple(name for name in motor.states() if not (turned and name in angles))


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects by name: the order in which they were added to a motor makes no other structure of it."""
    return tuple(sorted(effects, key=lambda effect: effect.name()))


def switch_key(effect: Effect) -> str:
    """The key of the parameter that switches an effect on."""
    return f"{effect.name()}.{effect.switch().name}"


def forcing_keys(motor: Motor, candidates: Sequence[Effect] = ()) -> tuple[str, ...]:
    """What has sensitivities: parameters of the motor that are not fixed, offsets of inputs, candidates' switches."""
    own = [name for name, parameter in parameters(motor).items() if not parameter.fixed]
    for effect in in_order(motor.effects):
        own += [f"{effect.name()}.{name}" for name, p in effect.parameters().items() if not p.fixed]
    return (*own, *INPUT_KEYS, *(switch_key(effect) for effect in in_order(candidates)))


def parameter_keys(motor: Motor, candidates: Sequence[Effect] = ()) -> tuple[str, ...]:
    """Keys of all parameters of a motor and further effects, in the order of `parameter_values`."""
    parts = (*in_order(motor.effects), *in_order(candidates))
    return (*parameters(motor), *(f"{part.name()}.{name}" for part in parts for name in part.parameters()))


def parameter_values(motor: Motor, candidates: Sequence[Effect] = ()) -> list[float]:
    """The values that belong to `parameter_keys`."""
    parts = (*in_order(motor.effects), *in_order(candidates))
    return [getattr(part, name) for part in (motor, *parts) for name in parameters(part)]


def _symbolic(motor: Motor, symbol: Mapping[str, Any]) -> Motor:
    """The motor with symbols for parameters and sharp friction."""
    parts = []
    for effect in motor.effects:
        values = {name: symbol[f"{effect.name()}.{name}"] for name in effect.parameters()}
        parts.append(_sharpened(replace(effect, **values)))
    own = {f.name: symbol[f.name] for f in fields(motor) if f.name in symbol}
    return replace(motor, effects=tuple(parts), **own)


def _sharpened(effect: Effect) -> Effect:
    """The effect with friction of full size as soon as the rotor turns, see `SIDE`."""

    class Sharp(type(effect)):  # type: ignore[misc]
        def torque(self, m: Any, x: Any, u: Any) -> Any:
            torque = sp.sympify(super().torque(m, x, u))
            return torque if self.stiction(m, x, u) == 0 else _sharp(torque, x.w)

        def stiction(self, m: Any, x: Any, u: Any) -> Any:
            return _sharp(sp.sympify(super().stiction(m, x, u)), x.w)

    Sharp.__name__ = type(effect).__name__
    return Sharp(**{f.name: getattr(effect, f.name) for f in fields(effect)})


def _sharp(torque: Any, w: Any) -> Any:
    """A torque of full size to a `SIDE`, whatever the speed w within which it builds up."""

    def turns(term: Any) -> bool:
        return isinstance(term, sp.tanh) and term.has(w) and term.args[0].subs(w, 0) == 0

    return torque.replace(turns, lambda term: sp.tanh(term.args[0] + _SATURATED * SIDE))
