"""The contract that every effect keeps, and effects that break it, each caught."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pint
import pytest
from helpers import effect_contract
from helpers.effect_contract import CONTRACT, MOTOR, PLATES

from motorlens_physics.effect import Effect, State, catalogue
from motorlens_physics.ops import tanh, turning
from motorlens_physics.parameter import param

EFFECTS = catalogue()


@pytest.mark.parametrize("name", EFFECTS)
@pytest.mark.parametrize("check", CONTRACT, ids=lambda check: check.__name__)
def test_contract(check, name):
    check(EFFECTS[name])


def test_every_name_of_the_design_is_in_the_catalogue():
    designed = """brush_voltage_drop inductance_saturation contact_resistance dead_time magnet_temperature armature_reaction
        coulomb_friction stribeck_friction quadratic_drag load_dependent_friction directional_friction
        temperature_dependent_viscosity cogging_torque unbalance_torque iron_loss_torque constant_torque two_node_thermal
        radiation friction_heat hysteresis_iron_loss fan_cooling_exponent ambient_drift""".split()
    assert set(designed) <= set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_what_holds_a_rotor_is_stiction_or_a_torque_without_a_current_that_differs_along_a_turn(name):
    rated = PLATES[0]
    effect = EFFECTS[name].typical(rated)
    u = SimpleNamespace(v=0.0, load=0.5 * rated.torque_Nm, ambient=20.0, t=0.0)
    resting = dict.fromkeys(("i", "w", "theta", *effect.states), 0.0)
    turn = [
        SimpleNamespace(**(resting | ({"phi": angle} if "phi" in resting else {})))
        for angle in np.linspace(0.0, 2 * np.pi, 50)
    ]
    differs = np.ptp([float(effect.torque(MOTOR, x, u)) for x in turn])
    stiction = float(effect.stiction(MOTOR, turn[0], u))
    assert EFFECTS[name].holds() is bool(stiction > 0 or differs > 1e-6 * rated.torque_Nm)


def test_exemptions_from_the_first_law_are_of_effects_that_exist_and_are_few():
    assert set(effect_contract.FIRST_LAW_EXEMPT) <= set(EFFECTS)
    assert len(effect_contract.FIRST_LAW_EXEMPT) <= len(EFFECTS) / 3


# --- broken effects: what a tired author writes; each must fall foul of the named check ------------------------------


@dataclass(frozen=True)
class Good(Effect):
    """A friction that is right, so that the faults below are the only thing wrong with theirs. doi:10.1000/182.

    >>> from types import SimpleNamespace as At
    >>> round(Good(c=0.2, w_s=0.4).torque(None, At(w=-3.0), None), 9)  # 0.2 9 tanh(7.5)
    1.799998899
    """

    excited_by: ClassVar[tuple[str, ...]] = ("coast_down",)

    c: float = param(
        0.0, "N*m*s^2/rad^2", "drag constant", bounds=(0.0, 1e2), prior=0.02, of="torque/speed^2", null=0.0
    )
    w_s: float = param(0.5, "rad/s", "smoothing", bounds=(1e-3, 50.0), prior=0.002, of="speed", fixed=True)

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.c * x.w**2 * tanh(x.w / self.w_s)


@dataclass(frozen=True)
class GoodNode(Effect):
    """A thermal node that is right. ISBN 978-0-471-45728-2.

    >>> from types import SimpleNamespace as At
    >>> GoodNode(G=2.0, G_a=3.0, C=7.0).heat(None, At(theta=60.0, theta_x=10.0), None)  # -2 (60 - 10)
    -100.0
    """

    states: ClassVar[Mapping[str, State]] = {"theta_x": State("K", "rise of the node")}
    excited_by: ClassVar[tuple[str, ...]] = ("duty",)

    G: float = param(0.0, "W/K", "to the winding", bounds=(0.0, 1e3), prior=0.2, of="power/rise", null=0.0)
    G_a: float = param(1.0, "W/K", "to ambient", bounds=(1e-6, 1e3), prior=0.1, of="power/rise")
    C: float = param(100.0, "J/K", "heat capacity", bounds=(1e-3, 1e6), prior=300.0, of="power/rise")

    def heat(self, m: Any, x: Any, u: Any) -> Any:
        return -self.G * (x.theta - x.theta_x)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"theta_x": (self.G * (x.theta - x.theta_x) - self.G_a * x.theta_x) / self.C}


@pytest.mark.parametrize("effect", [Good, GoodNode])
@pytest.mark.parametrize("check", CONTRACT, ids=lambda check: check.__name__)
def test_the_examples_are_sound_before_they_are_broken(check, effect):
    check(effect)


def broken(base: type[Effect], **changes: Any) -> type[Effect]:
    """`base` with something changed: methods, attributes, or (as a field) one parameter."""
    fields = {n: v for n, v in changes.items() if n in base.parameters()}
    body = {
        "__annotations__": dict.fromkeys(fields, float),
        "__doc__": base.__doc__,
        "__module__": base.__module__,
    }
    return dataclass(frozen=True)(type(base.__name__, (base,), body | changes))


def drag(torque: Any, **changes: Any) -> type[Effect]:
    return broken(Good, torque=torque, **changes)


def of_c(**changes: Any) -> Any:
    usual: dict[str, Any] = {"bounds": (0.0, 1e2), "prior": 0.02, "of": "torque/speed^2", "null": 0.0}
    spec = {"default": 0.0, "unit": "N*m*s^2/rad^2", "description": "drag constant"} | usual | changes
    return param(**spec)


FAULTS = {
    "wrong sign": (drag(lambda e, m, x, u: e.c * x.w**2 * tanh(x.w / e.w_s)), "first_law"),
    "unstable at rest": (drag(lambda e, m, x, u: e.c * (x.w**2 + 1.69e4) * tanh(x.w / e.w_s)), "stable_at_rest"),
    "wrong power of speed": (drag(lambda e, m, x, u: -e.c * x.w * tanh(x.w / e.w_s)), "units"),
    "current for speed": (drag(lambda e, m, x, u: -e.c * x.i**2 * tanh(x.w / e.w_s)), "units"),
    "a factor of 2": (drag(lambda e, m, x, u: -2 * e.c * x.w**2 * tanh(x.w / e.w_s)), "worked_number"),
    "wrong unit": (broken(Good, c=of_c(unit="N*m*s/rad")), "units"),
    "unit of another size": (broken(Good, c=of_c(unit="mN*m*s^2/rad^2")), "units"),
    "unit unknown": (broken(Good, c=of_c(unit="Nm*s2/rad2")), "units"),
    "an offset": (drag(lambda e, m, x, u: -e.c * x.w**2 * tanh(x.w / e.w_s) - 1e-9), "zero_at_null"),
    "wrong null": (broken(Good, c=of_c(default=1e-6, null=1e-6)), "zero_at_null"),
    "no null": (broken(Good, c=of_c(null=None)), "shape"),
    "two nulls": (
        broken(Good, w_s=param(0.5, "rad/s", "smoothing", bounds=(1e-3, 50.0), prior=0.002, of="speed", null=0.5)), "shape",
    ),
    "default out of bounds": (broken(Good, c=of_c(bounds=(1e-9, 1e2))), "shape"),
    "typical size out of bounds": (broken(Good, c=of_c(bounds=(0.0, 1e-9))), "shape"),
    "not described": (broken(Good, c=of_c(description="")), "shape"),
    "no scenario": (broken(Good, excited_by=()), "shape"),
    "a kink": (drag(lambda e, m, x, u: -e.c * x.w * abs(x.w)), "symbols_agree"),
    "an if": (drag(lambda e, m, x, u: -e.c * x.w**2 if x.w > 0 else e.c * x.w**2), "batches"),
    "a parameter forgotten": (drag(lambda e, m, x, u: -e.c * x.w * turning(x.w)), "present"),
    "no citation": (broken(Good, __doc__="A drag.\n\n    >>> 1 + 1\n    2\n    "), "reference"),
    "a citation with a slip": (broken(Good, __doc__="A drag. ISBN 978-0-471-45728-3."), "reference"),
    "no number by hand": (broken(Good, __doc__="A drag. doi:10.1000/182."), "worked_number"),
    "heat from nothing": (broken(Good, heat=lambda e, m, x, u: 1.01 * e.c * x.w**3 * tanh(x.w / e.w_s)), "first_law"),
    "one face of ke": (broken(EFFECTS["armature_reaction"], voltage=lambda e, m, x, u: 0.0), "first_law"),
    "heat to nobody's sign": (broken(GoodNode, heat=lambda e, m, x, u: e.G * (x.theta - x.theta_x)), "stable_at_rest"),
    "node that heats itself": (
        broken(GoodNode, rates=lambda e, m, x, u: {"theta_x": (e.G * (x.theta - x.theta_x) + e.G_a * x.theta_x) / e.C}),
        "stable_at_rest",
    ),
    "capacity forgotten": (
        broken(GoodNode, rates=lambda e, m, x, u: {"theta_x": e.G * (x.theta - x.theta_x) - e.G_a * x.theta_x}), "units",
    ),
    "acts through its state at null": (
        broken(GoodNode, heat=lambda e, m, x, u: -e.G * x.theta + e.G_a * x.theta_x), "zero_at_null",
    ),
    "state not declared": (broken(GoodNode, states={}), "states_declared"),
    "state not integrated": (broken(GoodNode, rates=lambda e, m, x, u: {}), "states_declared"),
    "state of the textbook": (
        broken(GoodNode, states={"theta": State("K", "rise")}, rates=lambda e, m, x, u: {"theta": 0 * x.theta}),
        "states_declared",
    ),
    "holds more than it brakes": (broken(Good, stiction=lambda e, m, x, u: e.c * 1e4), "holds_as_it_brakes"),
    "sticks to nothing": (broken(Good, stiction=lambda e, m, x, u: -e.c), "holds_as_it_brakes"),
    "changes its argument": (drag(lambda e, m, x, u: np.multiply(x.w, 0 * x.w, out=x.w) if isinstance(x.w, np.ndarray)
        else -e.c * x.w**2 * tanh(x.w / e.w_s)), "batches"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_the_contract_catches(fault):
    effect, check = FAULTS[fault]
    # Units that pint refuses and truth values that arrays refuse are how those faults show.
    with pytest.raises((AssertionError, pint.PintError, pint.UndefinedUnitError, ValueError)):
        getattr(effect_contract, check)(effect)
