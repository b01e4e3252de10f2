"""What every effect must keep, as functions that raise AssertionError: the catalogue is held to it, broken effects fail.

Each check takes an effect class. Numbers come from a motor whose parameters are all different, so that one in the place
of another shows.
"""

import doctest
import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pint
import sympy

from motorlens_physics.describe import CITATION
from motorlens_physics.effect import Effect
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, parameters

MOTOR = Motor(
    R_a0=1.7, L=0.013, ke=0.31, J=0.0071, b=0.0023, alpha=0.0039, k0=2.9, kT=0.0053, k_ir=0.0017, H=830.0
)
# A toy gear motor, a spindle and the paper's machine: three decades of everything.
PLATES = (
    Rated(voltage_V=48.0, current_A=5.0, speed_rad_s=130.0, torque_Nm=1.3, rise_K=70.0),
    Rated(voltage_V=3.0, current_A=0.15, speed_rad_s=10.0, torque_Nm=0.02, rise_K=30.0),
    Rated(voltage_V=24.0, current_A=8.0, speed_rad_s=600.0, torque_Nm=0.25, rise_K=90.0),
    Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0),
)
TERMS = {"voltage": "V", "torque": "N*m", "heat": "W", "inductance": "H", "stiction": "N*m"}
TEXTBOOK_STATES = {"i": "A", "w": "rad/s", "theta": "K"}
INPUTS = {"v": "V", "load": "N*m", "ambient": "K", "t": "s"}

Point = tuple[Any, Any]
# Effects that an energy balance of their own terms alone does not bind: why, and what binds them instead at a point.
FIRST_LAW_EXEMPT: Mapping[str, tuple[str, Callable[[Mapping[str, float], Any, Any, Any], bool]]] = {
    "coasting_bridge": (
        "u.v is the commanded voltage: current flows in the on time only, and drawn power is not v i",
        lambda terms, e, x, u: (
            (abs(u.v) > e.V_bus or abs(terms["voltage"]) <= abs(MOTOR.ke * x.w))
            and terms["torque"] == terms["heat"] == 0
        ),
    ),
    "constant_torque": (
        "an external load may drive",
        lambda terms, e, x, u: terms["voltage"] == terms["heat"] == 0,
    ),
    "cogging_torque": (
        "conservative: what it takes on the way out of a detent it returns on the way in",
        lambda terms, e, x, u: terms["heat"] == 0 and abs(_mean_over_turn(e, x, u)) < 1e-12,
    ),
    "unbalance_torque": (
        "conservative: gravity",
        lambda terms, e, x, u: terms["heat"] == 0 and abs(_mean_over_turn(e, x, u)) < 1e-12,
    ),
    "temperature_dependent_viscosity": (
        "returns part of the textbook's viscous friction, never more",
        lambda terms, e, x, u: 0 <= x.w * terms["torque"] <= MOTOR.b * x.w**2 and terms["heat"] == 0,
    ),
    "friction_heat": (
        "returns power that friction took elsewhere, never more",
        lambda terms, e, x, u: (
            0 <= terms["heat"] <= MOTOR.with_effect(e).friction_power(x, u)
            and terms["torque"] == terms["voltage"] == 0
        ),
    ),
    "fan_cooling_exponent": (
        "changes the cooling, which must stay cooling",
        lambda terms, e, x, u: terms["heat"] <= MOTOR.k0 * (1 + MOTOR.kT * abs(x.w)) * x.theta,
    ),
    "iron_heat_delay": (
        "stores heat: with the core as warm as it gets, all arrives",
        lambda terms, e, x, u: (
            abs(e.heat(MOTOR, SimpleNamespace(**{**vars(x), "p": MOTOR.k_ir * x.w**2}), u)) < 1e-12
            and _conserves(e, x, u)
        ),
    ),
    "ambient_drift": (
        "the surroundings may be warmer than recorded: winding at their temperature is in balance",
        lambda terms, e, x, u: (
            abs(terms["heat"] - MOTOR.k0 * (1 + MOTOR.kT * (np.hypot(x.w, 1e-3) - 1e-3)) * e.d * x.z) < 1e-9
        ),
    ),
}


def shape(effect: type[Effect]) -> None:
    """One switch; typical and null instances within bounds on every plate; everything described."""
    declared = effect.parameters()
    assert sum(p.null is not None for p in declared.values()) == 1, "exactly one switch"
    for p in declared.values():
        assert len(p.description) > 3, f"{p.name} is not described"
        assert p.bounds[0] <= p.default <= p.bounds[1], f"default of {p.name} is out of bounds"
        assert p.prior > 0, f"prior of {p.name}"
        if p.null is not None:
            assert p.default == p.null and p.bounds[0] <= p.null <= p.bounds[1], f"null of {p.name}"
            assert not p.fixed, "a switch is what is calibrated"
        for rated in PLATES:
            size = p.prior * rated.scale(p.of)
            assert p.bounds[0] < size + (p.null or 0) <= p.bounds[1], (
                f"typical {p.name} = {size} is out of bounds"
            )
            assert getattr(effect.typical(rated), p.name) == p.typical(rated)
    for rated in PLATES:
        switch = effect.switch()
        assert getattr(effect.at_null(rated), switch.name) == switch.null
    assert effect.excited_by, "no scenario excites it"


def reference(effect: type[Effect]) -> None:
    """The docstring cites something that can be found."""
    assert CITATION.search(effect.__doc__ or ""), "no DOI, ISBN, arXiv number or standard in the docstring"
    for isbn in re.findall(r"ISBN ([\d-]+)", effect.__doc__ or ""):
        digits = [int(digit) for digit in isbn if digit != "-"]
        checksum = sum(digits[::2]) + 3 * sum(digits[1::2])
        assert len(digits) == 13 and checksum % 10 == 0, f"ISBN {isbn} has a wrong digit"


def worked_number(effect: type[Effect]) -> None:
    """The docstring works a number by hand, and the code agrees."""
    names = vars(sys.modules[effect.__module__]) | {effect.__name__: effect}
    examples = doctest.DocTestFinder(recurse=False).find(effect, effect.__name__, globs=names)
    runner = doctest.DocTestRunner(verbose=False)
    attempted = 0
    for example in examples:
        # The report goes into the error instead of onto the screen.
        report: list[str] = []
        result = runner.run(example, out=report.append)
        assert result.failed == 0, "".join(report)
        attempted += result.attempted
    assert attempted > 1, "no number worked by hand in the docstring"


def units(effect: type[Effect]) -> None:
    """The same code on quantities with units gives volts, newton metres, watts, henries, and state units per second.

    The numbers must be those of the plain call: a parameter in mN*m has the right dimension and the wrong size.
    """
    registry: Any = pint.get_application_registry()
    e = plain = effect.typical(PLATES[0])
    with_units: dict[str, Any] = {
        n: registry.Quantity(getattr(e, n), p.unit) for n, p in effect.parameters().items()
    }
    e = replace(e, **with_units)
    base: dict[str, Any] = {
        n: registry.Quantity(getattr(MOTOR, n), p.unit) for n, p in parameters(MOTOR).items()
    }
    motor = replace(MOTOR, **base, effects=(e,))
    x, u = _point(effect, np.random.default_rng(7))
    expected = _terms(plain, x, u, replace(MOTOR, effects=(plain,))) | dict(plain.rates(MOTOR, x, u))
    state_units = TEXTBOOK_STATES | {name: state.unit for name, state in effect.states.items()}
    x = SimpleNamespace(**{n: registry.Quantity(getattr(x, n), unit) for n, unit in state_units.items()})
    u = SimpleNamespace(**{n: registry.Quantity(getattr(u, n), unit) for n, unit in INPUTS.items()})
    terms = {term: (getattr(e, term)(motor, x, u), unit) for term, unit in TERMS.items()}
    rates = {name: (rate, f"({state_units[name]})/s") for name, rate in e.rates(motor, x, u).items()}
    for term, (value, unit) in (terms | rates).items():
        if isinstance(value, float | int) and value == 0:
            continue  # the effect has no part in this balance
        quantity = value if isinstance(value, registry.Quantity) else registry.Quantity(value, "")
        assert quantity.is_compatible_with(unit), f"{term} is in {quantity.units}, not {unit}"
        np.testing.assert_allclose(
            quantity.to(unit).magnitude, expected[term], rtol=1e-9, err_msg=f"{term} in {unit}"
        )


def zero_at_null(effect: type[Effect]) -> None:
    """With the switch at null every term is exactly zero in every state, whatever the shape."""
    rng = np.random.default_rng(3)
    for rated in PLATES:
        null = effect.at_null(rated)
        for _ in range(20):
            x, u = _point(effect, rng)
            terms = _terms(null, x, u)
            assert all(value == 0 for value in terms.values()), f"at null: {terms}"


def present(effect: type[Effect]) -> None:
    """At its typical size an effect does something, and its states follow: no parameter is without consequence."""
    rng = np.random.default_rng(4)
    points = [_point(effect, rng) for _ in range(5)]
    e = effect.typical(PLATES[0])

    def everything(e: Effect) -> list[float]:
        return [v for x, u in points for v in (*_terms(e, x, u).values(), *e.rates(MOTOR, x, u).values())]

    assert any(_terms(e, x, u)[term] != 0 for x, u in points for term in TERMS), "it does nothing"
    for name, p in effect.parameters().items():
        low, high = p.bounds
        changed: dict[str, Any] = {name: min(max(1.1 * getattr(e, name) + 1e-3, low), high)}
        if changed[name] == getattr(e, name):
            changed[name] = 0.9 * getattr(e, name)
        assert everything(replace(e, **changed)) != everything(e), f"{name} changes nothing"


def first_law(effect: type[Effect]) -> None:
    """It takes power or gives none, and heats with no more than it takes."""
    rng = np.random.default_rng(5)
    for rated in PLATES:
        e = effect.typical(rated)
        for _ in range(30):
            x, u = _point(effect, rng)
            # Heat that flows between nodes is no source: all nodes at one temperature.
            for name, state in effect.states.items():
                if state.unit == "K":
                    setattr(x, name, x.theta)
            terms = _terms(e, x, u)
            if effect.name() in FIRST_LAW_EXEMPT:
                why, bound = FIRST_LAW_EXEMPT[effect.name()]
                assert bound(terms, e, x, u), f"{why}: {terms}"
                continue
            electrical, mechanical = x.i * terms["voltage"], x.w * terms["torque"]
            rounding = 1e-12 * (abs(electrical) + abs(mechanical) + abs(terms["heat"]))
            assert electrical + mechanical <= rounding, f"makes energy: {terms} at {x}"
            assert terms["heat"] <= -(electrical + mechanical) + rounding, (
                f"heat from nothing: {terms} at {x}"
            )


def stable_at_rest(effect: type[Effect]) -> None:
    """No eigenvalue of the motor with the effect, at rest and ambient temperature, has a positive real part."""
    for rated in PLATES:
        motor = MOTOR.with_effect(effect.typical(rated))
        names = tuple(motor.states())
        symbols = {name: sympy.Symbol(name, real=True) for name in names}
        x, u = SimpleNamespace(**symbols), SimpleNamespace(v=0.0, load=0.0, ambient=20.0, t=0.0)
        rates = motor.rates(x, u)
        matrix = sympy.Matrix([sympy.sympify(rates[name]) for name in names]).jacobian(list(symbols.values()))
        at_rest = {symbols[name]: value for name, value in motor.states().items()}
        values = np.array(matrix.subs(at_rest).evalf(), dtype=float)
        assert np.all(np.isfinite(values)), "no derivative at rest"
        eigenvalues = np.linalg.eigvals(values)
        assert np.max(eigenvalues.real) <= 1e-9 * np.max(np.abs(eigenvalues)), f"unstable: {eigenvalues}"


def batches(effect: type[Effect]) -> None:
    """Arrays of motors, parameters and states give what one call each gives."""
    rng = np.random.default_rng(6)
    size = 5
    points = [_point(effect, rng) for _ in range(size)]
    one = [replace(effect.typical(rated), **_spread(effect, rated, rng)) for rated in (PLATES * 2)[:size]]
    motors = [replace(MOTOR, ke=MOTOR.ke * (1 + 0.1 * k)) for k in range(size)]
    many: dict[str, Any] = {name: np.array([getattr(e, name) for e in one]) for name in effect.parameters()}
    ke: Any = np.array([motor.ke for motor in motors])
    x = SimpleNamespace(**{n: np.array([getattr(p[0], n) for p in points]) for n in vars(points[0][0])})
    u = SimpleNamespace(**{n: np.array([getattr(p[1], n) for p in points]) for n in vars(points[0][1])})
    batch, motor = replace(one[0], **many), replace(MOTOR, ke=ke)
    together = _terms(batch, x, u, motor) | dict(batch.rates(motor, x, u))
    for k in range(size):
        alone = _terms(one[k], *points[k], motors[k]) | dict(one[k].rates(motors[k], *points[k]))
        # A friction of one direction is, in the other, no more than the rounding of its size.
        rounding = np.finfo(np.float64).eps * abs(getattr(one[k], effect.switch().name))
        for term, value in alone.items():
            np.testing.assert_allclose(
                np.broadcast_to(together[term], size)[k], value, rtol=1e-13, atol=rounding, err_msg=term
            )


def symbols_agree(effect: type[Effect]) -> None:
    """Evaluated on symbols and then on numbers, every term has the value of the plain call, and smooth derivatives."""
    rng = np.random.default_rng(8)
    e, (x, u) = effect.typical(PLATES[0]), _point(effect, rng)
    names = {**{f"e_{n}": getattr(e, n) for n in effect.parameters()}, **vars(x), **vars(u)}
    symbol = {name: sympy.Symbol(name, real=True) for name in names}
    on_symbols: dict[str, Any] = {n: symbol[f"e_{n}"] for n in effect.parameters()}
    s = replace(e, **on_symbols)
    sx, su = (SimpleNamespace(**{n: symbol[n] for n in vars(point)}) for point in (x, u))
    numbers = _terms(e, x, u) | dict(e.rates(MOTOR, x, u))
    for term, expression in (_terms(s, sx, su) | dict(s.rates(MOTOR, sx, su))).items():
        expression = sympy.sympify(expression)
        value = float(expression.subs({symbol[n]: v for n, v in names.items()}))
        np.testing.assert_allclose(value, numbers[term], rtol=1e-12, atol=1e-300, err_msg=term)
        for name in names:
            slope = sympy.diff(expression, symbol[name])
            kinks = slope.atoms(sympy.Derivative, sympy.sign, sympy.Abs, sympy.Piecewise, sympy.DiracDelta)
            assert not kinks, f"{term} has a kink in {name}: {kinks}"


def states_declared(effect: type[Effect]) -> None:
    """The states it declares are those it integrates, with names that the textbook does not use."""
    assert not set(effect.states) & set(TEXTBOOK_STATES), "a state of the textbook"
    x, u = _point(effect, np.random.default_rng(9))
    try:
        rates = effect.typical(PLATES[0]).rates(MOTOR, x, u)
    except AttributeError as error:
        raise AssertionError(f"reads a state that it does not declare: {error}") from None
    assert set(rates) == set(effect.states), "declared and integrated states differ"
    for state in effect.states.values():
        assert len(state.description) > 3, "a state is not described"


def holds_as_it_brakes(effect: type[Effect]) -> None:
    """The torque that holds a resting rotor is the one that brakes it as soon as it turns."""
    x, u = _point(effect, np.random.default_rng(10))
    e = effect.typical(PLATES[0])
    x.w = 0.0
    if e.stiction(MOTOR, x, u) == 0:
        return
    narrow: dict[str, Any] = {"w_s": 1e-3}
    for side in (-1, 1):
        x.w = side * 0.02
        sharp = replace(e, **narrow)
        hold = sharp.stiction(MOTOR, x, u)
        assert hold >= 0, "friction that pushes"
        np.testing.assert_allclose(sharp.torque(MOTOR, x, u), -side * hold, rtol=1e-3)


CONTRACT: tuple[Callable[[type[Effect]], None], ...] = (
    shape, reference, worked_number, units, zero_at_null, present, first_law, stable_at_rest, batches, symbols_agree,
    states_declared, holds_as_it_brakes,
)  # fmt: skip


def _point(effect: type[Effect], rng: np.random.Generator) -> Point:
    """Random states and inputs, no two alike; the winding above ambient."""
    x = SimpleNamespace(
        i=float(rng.uniform(-8, 8)), w=float(rng.uniform(-200, 200)), theta=float(rng.uniform(5, 80)),
        **{name: float(rng.uniform(0.1, 0.9)) for name in effect.states},
    )  # fmt: skip
    u = SimpleNamespace(
        v=float(rng.uniform(-40, 40)),
        load=float(rng.uniform(-1, 1)),
        ambient=float(rng.uniform(5, 35)),
        t=3.0,
    )
    return x, u


def _terms(e: Effect, x: Any, u: Any, motor: Motor = MOTOR) -> dict[str, Any]:
    return {term: getattr(e, term)(motor, x, u) for term in TERMS}


def _spread(effect: type[Effect], rated: Rated, rng: np.random.Generator) -> dict[str, float]:
    """Typical values, each 5 % or so off, so that no two members of a batch are alike."""
    factor = {name: float(rng.uniform(0.9, 1.0)) for name in effect.parameters()}
    return {name: p.typical(rated) * factor[name] for name, p in effect.parameters().items()}


def _mean_over_turn(e: Any, x: Any, u: Any) -> float:
    around = SimpleNamespace(**{**vars(x), "phi": np.linspace(0, 2 * np.pi, 360, endpoint=False)})
    return float(np.mean(e.torque(MOTOR, around, u)))


def _conserves(e: Any, x: Any, u: Any) -> bool:
    """heat + d/dt(tau s p) is zero: what does not arrive is stored."""
    stored = e.tau * e.s * e.rates(MOTOR, x, u)["p"]
    return bool(abs(e.heat(MOTOR, x, u) + stored) < 1e-12)
