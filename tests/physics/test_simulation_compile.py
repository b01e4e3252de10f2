"""The generated code: its cache, its independence of what does not matter, its Jacobian."""

import importlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp

from motorlens_physics import compile as compiling
from motorlens_physics.effect import Effect, catalogue
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.inductance_saturation import InductanceSaturation
from motorlens_physics.effects.quadratic_drag import QuadraticDrag
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, param
from motorlens_physics.simulation import Inputs, simulate, structure
from motorlens_physics.symbols import SIDE, named, trace

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A cache folder of its own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiling, "_folder", compiling._folder.__wrapped__)
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


def test_machine_code_is_kept_beside_the_source() -> None:
    _, code = structure(Motor())
    module = importlib.import_module(code.functions[0].py_func.__module__)
    kept = Path(module.__file__ or "").parent / "__pycache__"
    assert list(kept.glob(f"{module.__name__}.step-*.nbi"))


def test_neither_values_nor_the_order_of_effects_make_another_structure() -> None:
    friction, drag = CoulombFriction(tau_c=0.1), QuadraticDrag(c=1e-5)
    one = structure(Motor(effects=(friction, drag)))
    other = structure(Motor(R_a0=9.0, effects=(replace(drag, c=2e-5), friction)))
    assert one is other
    assert one[0].keys[-3:] == ("coulomb_friction.tau_c", "coulomb_friction.w_s", "quadratic_drag.c")


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
        assert float(sp.N(torque)) == pytest.approx(-side * float(sp.N(system.stiction.subs(at))), rel=1e-12)
    assert float(sp.N((system.balances[row] - bare.balances[row]).subs(SIDE, 0).subs(at))) == 0.0


def _values(effect: Effect) -> list[float]:
    from motorlens_physics.symbols import parameter_values

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
