"""What can be said of an effect or a sensor model: its equation, parameters, references and curves, from its own code.

Nothing here is written by hand for one effect: the equation is the method evaluated on symbols, the curve the same method
evaluated on numbers.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.motor import Motor
from motorlens_physics.ops import SPEED_ROUNDING
from motorlens_physics.parameter import Parameter, Rated, parameters
from motorlens_physics.sensor_model import SensorModel

Array = NDArray[np.float64]

# Left-hand sides of the balances, and the units of what enters them.
LEFT = {"inductance": "L", "voltage": "L di/dt", "torque": "J dw/dt", "heat": "H dtheta/dt"}
UNIT = {"inductance": "H", "voltage": "V", "torque": "N*m", "heat": "W"}
EQUATIONS = ("electrical", "coupling", "mechanical", "thermal")
# The plate of the motor that `Motor()` is: Mellah, Hemsas and Taleb (2016).
PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
CITATION = re.compile(
    r"doi:10\.\d{4,}/[^\s,;]*[^\s,;.:]|ISBN \d{3}-[\d-]{9,}\d|arXiv:\d{4}\.\d{4,5}|NASA TN [A-Z]-\d+"
    r"|(?:IEC|ISO|IEEE Std|JCGM) \d[\d-]+(?::\d{4})?"
)


@dataclass(frozen=True)
class Curve:
    """One term of an effect against one quantity: `y` in `y_unit` over `x` in `x_unit`; `at` says where the others stand."""

    term: str
    x_name: str
    x_unit: str
    y_unit: str
    x: Array
    y: Array
    at: str = ""


def equation_of(effect: type[Effect]) -> str:
    """Which equation an effect belongs to, by the methods it defines: one of `EQUATIONS`.

    One that enters the electrical and the mechanical balance belongs to their coupling.
    """
    defines = {method for method in LEFT if getattr(effect, method) is not getattr(Effect, method)}
    if {"voltage", "torque"} <= defines:
        return "coupling"
    if defines & {"voltage", "inductance"}:
        return "electrical"
    return "mechanical" if "torque" in defines else "thermal"


def expressions(effect: type[Effect]) -> dict[str, Any]:
    """The terms of an effect and the rates of its states as SymPy expressions, by left-hand side; zero terms left out."""
    e, m, x, u = _symbols(effect)
    terms = {LEFT[method]: getattr(e, method)(m, x, u) for method in LEFT}
    terms |= {f"d{name}/dt": rate for name, rate in e.rates(m, x, u).items()}
    return {left: _readable(sp.sympify(term)) for left, term in terms.items() if term != 0}


def equations(effect: type[Effect]) -> list[str]:
    """The equations of an effect as text: what it adds to each balance, and the rates of its states."""
    return [
        f"{left} {'=' if left.removeprefix('d').partition('/')[0] in effect.states else '+='} {text(expression)}"
        for left, expression in expressions(effect).items()
    ]


def text(expression: Any) -> str:
    """An expression on one line, powers with ^."""
    return str(sp.sstr(expression)).replace("**", "^").replace("Abs(w)", "|w|").replace("1.0*", "")


def summary(thing: type) -> str:
    """The first sentence of a docstring: what it is."""
    first = (thing.__doc__ or "").strip().partition("\n\n")[0]
    return " ".join(first.split())


def description(thing: type) -> str:
    """A docstring without its worked number."""
    lines = (line.strip() for line in (thing.__doc__ or "").partition(">>>")[0].splitlines())
    return "\n".join(lines).strip()


def references(thing: type) -> list[str]:
    """The identifiers of the works that a docstring cites: DOI, ISBN, arXiv number or standard."""
    return CITATION.findall(thing.__doc__ or "")


def size(parameter: Parameter, rated: Rated) -> str:
    """The typical size of a parameter for a plate, such as "0.19 N*m" or "1 +- 0.03" around a null that is not zero."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    if parameter.null:
        return f"{parameter.null:g} +- {parameter.sd(rated):.3g}{unit}"
    return f"{parameter.typical(rated):.3g}{unit}"


def sensor_equation(model: SensorModel) -> str:
    """What the sensor shows of y, as text; empty for a model that only simulates."""
    if model.switch() is None:
        return ""
    on_symbols: dict[str, Any] = {name: sp.Symbol(name) for name in model.parameters()}
    shown = replace(model, **on_symbols).read(sp.Symbol("y"), sp.Symbol("dy/dt"))
    return f"shown = {text(shown)}"


def curves(effect: Effect, rated: Rated, motor: Motor | None = None) -> list[Curve]:
    """Each term of an effect against the first quantity it depends on, from full reverse to full ahead.

    Args:
        effect: at the size to be drawn.
        rated: the plate; what is not on the abscissa has its rated value, states of the effect that are rises half of it.
        motor: textbook parameters (default: the paper's).
    """
    motor = motor or Motor()
    points = _rated_points(effect, rated)
    return [
        _curve(effect, method, points, motor)
        for method in LEFT
        if expressions(type(effect)).get(LEFT[method]) is not None
    ]


def _curve(
    effect: Effect, method: str, points: Mapping[str, tuple[float, float, str]], motor: Motor
) -> Curve:
    free = {symbol.name for symbol in expressions(type(effect))[LEFT[method]].free_symbols}
    # What depends on nothing is drawn over speed.
    axis = next((name for name in points if name in free), "w")
    low, high, unit = points[axis]

    def evaluate(values: Array) -> Array:
        at = {name: values if name == axis else top for name, (_, top, _) in points.items()}
        x = SimpleNamespace(**{name: at[name] for name in ("i", "w", "theta", *effect.states)})
        u = SimpleNamespace(v=at["v"], load=at["T_load"], ambient=at["T_a"] - 273.15, t=0.0)
        return np.broadcast_to(getattr(effect, method)(motor, x, u), values.shape)

    values = np.linspace(low, high, 401)
    y = evaluate(values)
    # A term that lives near rest only is drawn there.
    while np.max(np.abs(y[np.abs(values) > high / 2])) < 0.05 * np.max(np.abs(y)) and high - low > 1e-6:
        low, high = low / 3, high / 3
        values = np.linspace(low, high, 401)
        y = evaluate(values)
    others = [f"{name} = {top:.4g} {its}" for name, (_, top, its) in points.items() if name in free - {axis}]
    return Curve(
        LEFT[method], axis, unit, UNIT[method], values, np.asarray(y, dtype=np.float64), ", ".join(others)
    )


def _rated_points(effect: Effect, rated: Rated) -> dict[str, tuple[float, float, str]]:
    """Quantity to (lowest, highest and nominal, unit), in the order in which they are preferred as abscissa."""
    turn = 2 * np.pi / getattr(effect, "N", 1.0)
    own = {
        name: (0.0, rated.rise_K / 2 if state.unit == "K" else 1.0, state.unit)
        for name, state in effect.states.items()
        if name != "phi"
    }
    return {
        "phi": (-turn, turn, "rad"),
        "w": (-rated.speed_rad_s, rated.speed_rad_s, "rad/s"),
        "i": (-rated.current_A, rated.current_A, "A"),
        "theta": (0.0, rated.rise_K, "K"),
        "v": (-rated.voltage_V, rated.voltage_V, "V"),
        **own,
        "T_load": (-rated.torque_Nm, rated.torque_Nm, "N*m"),
        "T_a": (273.15, 273.15 + rated.ambient_C, "K"),
    }


def _symbols(effect: type[Effect]) -> tuple[Effect, Motor, Any, Any]:
    def named(p: Parameter) -> Any:
        return sp.Symbol(p.name, positive=True) if p.bounds[0] >= 0 else sp.Symbol(p.name, real=True)

    values: dict[str, Any] = {name: named(p) for name, p in effect.parameters().items()}
    # Where effect and motor use the same letter, the motor's carries its owner's name.
    base: dict[str, Any] = {
        name: sp.Symbol(f"{name}_motor" if name in values else name, positive=True)
        for name in parameters(Motor)
    }
    x = SimpleNamespace(**{name: sp.Symbol(name, real=True) for name in ("i", "w", "theta", *effect.states)})
    ambient = sp.Symbol("T_a", positive=True) - sp.Float(273.15)
    u = SimpleNamespace(
        v=sp.Symbol("v", real=True), load=sp.Symbol("T_load", real=True), ambient=ambient, t=sp.Symbol("t")
    )
    return effect(**values), Motor(**base), x, u


def _readable(expression: Any) -> Any:
    """|w| for its smooth form: the rounding is far below what is drawn or read."""
    tiny = {number: sp.Integer(0) for number in expression.atoms(sp.Float) if abs(number) <= SPEED_ROUNDING}
    return expression.xreplace(tiny)
