"""The generated code: its cache, its independence of what does not matter, its Jacobian."""

import ctypes
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numba import float64, njit

from motorlens_physics import compile as compiling
from motorlens_physics.compile.native import native
from motorlens_physics.effect import Effect, catalogue
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.inductance_saturation import InductanceSaturation
from motorlens_physics.effects.quadratic_drag import QuadraticDrag
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, param
from motorlens_physics.simulation import Inputs, simulate, structure
from motorlens_physics.symbols import SIDE, named, parameter_values, trace
from motorlens_runtime.errors import ModelError

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A cache folder of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiling, "cache_folder", compiling.cache_folder.__wrapped__)
    monkeypatch.setattr(compiling, "_load", compiling._load.__wrapped__)
    return tmp_path / "motorlens"


def test_generated_source_is_written_once(fresh: Path) -> None:
    assert compiling._load("answer = 42\n").answer == 42
    (path,) = fresh.glob("*.py")
    stamp = path.stat().st_mtime_ns
    assert compiling._load("answer = 42\n").answer == 42
    assert path.stat().st_mtime_ns == stamp
    assert compiling._load("answer = 43\n").answer == 43
    assert len(list(fresh.glob("*.py"))) == 2
    assert not list(fresh.glob("*.tmp"))


def test_a_cache_that_cannot_be_written_is_done_without(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, fresh: Path
) -> None:
    blocked = tmp_path / "a file, not a folder"
    blocked.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert compiling._load("answer = 44\n").answer == 44


def test_machine_code_of_a_structure_is_kept(fresh: Path) -> None:
    source = compiling.source(trace(Motor(), forced=True))
    fresh.mkdir()
    native(source, compiling._SIGNATURES, fresh)
    (path,) = fresh.glob("*.o")
    stamp = path.stat().st_mtime_ns
    native(source, compiling._SIGNATURES, fresh)
    assert path.stat().st_mtime_ns == stamp
    assert not list(fresh.glob("*.tmp"))


@pytest.mark.fit
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("effects", [(), tuple(catalogue().values())])
def test_machine_code_does_what_its_source_says_in_python(
    effects: tuple[type[Effect], ...], turned: bool, tmp_path: Path
) -> None:
    motor = Motor(effects=tuple(effect.typical(PLATE) for effect in effects))
    system = trace(motor, forced=True, turned=turned)
    source = compiling.source(system)
    python: dict[str, Any] = {"math": math, "np": np}
    exec(source, python)
    machine = native(source, compiling._SIGNATURES, tmp_path)
    call = njit(_call)
    n, rng = len(system.states), np.random.default_rng(0)
    p = np.array(parameter_values(motor))
    columns = len(system.forcings)
    for _ in range(20):
        x = np.array([5.0, 100.0, 30.0, *np.ones(n - 3)]) * rng.normal(size=n)
        found = []
        for functions in (python, machine):
            out, a, g = np.zeros(3 * n + 7), np.zeros((n, n + 1)), np.zeros((n, columns))
            jacobians, over = np.zeros((3, n, n + 1)), np.eye(n, 4 * n)
            names = ("step", "rest", "balance", "linear", "stiffness", "transfer")
            (_call if functions is python else call)(
                *(functions[name] for name in names), x, p, out, a, g, np.arange(columns), jacobians, over
            )  # fmt: skip
            found.append(np.concatenate([out, a.ravel(), g.ravel(), over.ravel()]))
        np.testing.assert_allclose(found[1], found[0], rtol=1e-10, atol=1e-10 * np.max(np.abs(found[0])))


def _call(step, rest, balance, linear, stiffness, transfer, x, p, out, a, g, slots, jacobians, over):  # type: ignore[no-untyped-def]
    n, u = x.size, np.array([200.0, 3.0, 20.0, 0.4, 50.0, -1.0, 0.1, 90.0, 5.0, 7.0, 0.0, 0.0, 0.0])
    step(x, p, 0.5, u, 1e-3, 1.0, 1.0, out[:n], out[n : 2 * n], out[2 * n : 3 * n])
    rests = rest(x, p, 0.5, u, 0.1)
    out[3 * n], out[3 * n + 1], out[3 * n + 2], out[3 * n + 3] = rests[0], rests[1], rests[2], rests[3]
    out[3 * n + 4], out[3 * n + 5] = balance(x, p, 0.5, u, 0.1, 0.0)
    linear(x, p, 0.5, u, 0.1, -1.0, slots, a, g)
    for k in range(3):
        linear(x, p, 0.5, u, 0.05 * k, 1.0, slots, jacobians[k], g)
    out[3 * n + 6] = stiffness(p, 1e-3, 1.0, jacobians)
    transfer(p, 1e-3, 1.0, jacobians, 0.0, 0.3, over)
    transfer(p, 1e-3, 1.0, jacobians, 0.3, 1.0, over)


def test_what_is_understood_of_python_means_the_same_in_machine_code(tmp_path: Path) -> None:
    source = """
def both(a, b):
    return a - b, a ** 3 + b ** -2

def strange(a, b):
    c, d = both(a, b)
    c *= 2
    e = (c if a > b and a > 0 else -c) + min(a, b, 0.5) - max(a, b) + abs(a) * np.sign(b)
    return e / d * math.pi + math.atan2(a, b) + a ** 0 + abs(b) ** 0.5 + (1 if a >= 0 or b < 0 else 2)
"""
    python: dict[str, Any] = {"math": math, "np": np}
    exec(source, python)
    strange = native(source, {"strange": float64(float64, float64)}, tmp_path)["strange"]
    call = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_double)(strange.__wrapper_address__())
    for a, b in np.random.default_rng(1).normal(size=(50, 2)):
        assert call(a, b) == pytest.approx(python["strange"](a, b), rel=1e-12)


@pytest.mark.parametrize(
    "line",
    ["for k in x: pass", "y = [1.0]", "y = x @ x", "y = math.nosuch(a)", "y = print(a)", "y = x[0, 3:12]"],
)
def test_what_is_not_understood_is_refused_by_name(line: str, tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"nosuch|print|for k|\[1\.0\]|x @ x|3:12"):
        native(f"def f(a, x):\n    {line}\n    return a\n", {"f": float64(float64, float64[::1])}, tmp_path)


def test_neither_values_nor_the_order_of_effects_make_another_structure() -> None:
    friction, drag = CoulombFriction(tau_c=0.1), QuadraticDrag(c=1e-5)
    one = structure(Motor(effects=(friction, drag)))
    other = structure(Motor(R_a0=9.0, effects=(replace(drag, c=2e-5), friction)))
    assert one is other
    assert one[0].keys[-3:] == ("coulomb_friction.tau_c", "coulomb_friction.w_s", "quadratic_drag.c")


@pytest.mark.fit
def test_sources_do_not_depend_on_the_process() -> None:
    motor = Motor(effects=tuple(effect() for effect in catalogue().values()))
    assert compiling.source(trace(motor)) == compiling.source(trace(motor))


@pytest.mark.parametrize("name", [n for n, e in catalogue().items() if "stiction" in vars(e)])
def test_what_holds_at_rest_is_the_friction_of_a_rotor_that_just_turns(name: str) -> None:
    # Real friction: the torque just above rest is the largest that holds.
    effect = catalogue()[name].typical(PLATE)
    system = trace(Motor(effects=(effect,)))
    bare = trace(Motor())
    values = {key: value for key, value in zip(system.keys, _values(effect), strict=True)}
    at = dict(zip(system.p, values.values(), strict=True)) | {
        named("x_i"): 2.0, named("x_w"): 0, named("x_theta"): 20.0, named("u_v"): 24.0, named("u_load"): 1.0,
        named("u_ambient"): 20.0, named("u_t"): 0.0,
    }  # fmt: skip
    row = system.states.index("w")
    for side in (1, -1):
        torque = (system.balances[row] - bare.balances[row]).subs(SIDE, side).subs(at)
        hold = float(sp.N(system.stiction.subs(SIDE, side).subs(at)))
        assert float(sp.N(torque)) == pytest.approx(-side * hold, rel=1e-12)
    assert float(sp.N((system.balances[row] - bare.balances[row]).subs(SIDE, 0).subs(at))) == 0.0


def _values(effect: Effect) -> list[float]:
    return parameter_values(Motor(effects=(effect,)))


def test_an_inductance_that_saturates_still_may_vanish() -> None:
    effect = InductanceSaturation.typical(PLATE)
    time = np.linspace(0.0, 0.2, 201)
    inputs = Inputs(time, np.full(201, 100.0), 0 * time, 0 * time + 20.0, held=True)
    none = simulate(Motor(L=0.0, effects=(effect,)), inputs, {"w": 50.0})
    plain = simulate(Motor(L=0.0), inputs, {"w": 50.0})
    np.testing.assert_allclose(none.current_A[1:], plain.current_A[1:], rtol=1e-9)


@dataclass(frozen=True)
class Clipped(Effect):
    """A torque that stops growing: its derivative has corners."""

    c: float = param(0.0, "N*m", "size", bounds=(0.0, 10.0), prior=1.0, null=0.0)

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        z = x.w / 100.0
        return -self.c * (sp.Min(z, 1) if hasattr(z, "free_symbols") else np.minimum(z, 1))


def test_an_effect_with_a_corner_compiles() -> None:
    time = np.linspace(0.0, 5.0, 501)
    inputs = Inputs(time, np.full(501, 240.0), 0 * time, 0 * time + 20.0, held=True)
    run = simulate(Motor(effects=(Clipped(c=2.0),)), inputs)
    fully = simulate(Motor(), replace(inputs, load_torque_Nm=np.full(501, 2.0)))
    assert run.speed_rad_s[-1] == pytest.approx(fully.speed_rad_s[-1], rel=1e-5)
