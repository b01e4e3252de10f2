"""The textbook motor against closed forms: steady states, energy, linear theory; and effects added to it."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace as At
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.effect_contract import MOTOR

from motorlens_physics.effect import Effect, State
from motorlens_physics.effects.brush_voltage_drop import BrushVoltageDrop
from motorlens_physics.effects.cogging_torque import CoggingTorque
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.friction_heat import FrictionHeat
from motorlens_physics.effects.inductance_saturation import InductanceSaturation
from motorlens_physics.effects.iron_loss_torque import IronLossTorque
from motorlens_physics.effects.quadratic_drag import QuadraticDrag
from motorlens_physics.effects.two_node_thermal import TwoNodeThermal
from motorlens_physics.effects.unbalance_torque import UnbalanceTorque
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, parameters
from motorlens_runtime.errors import ModelError


def at(**changes: float) -> At:
    return At(**({"v": 0.0, "load": 0.0, "ambient": 20.0, "t": 0.0} | changes))


def test_the_papers_steady_state():
    """221 rad/s and 80 K after 200 min at 240 V and 6.455 N m (reference values of the fitted preset)."""
    x = At(i=7.2649, w=220.8, theta=80.3)
    voltage, torque, heat = Motor().balances(x, at(v=240.0, load=6.455))
    # Balances close to the rounding of the published figures.
    assert abs(voltage) < 1.5 and abs(torque) < 0.02 and abs(heat) < 12.0
    assert 4.60 < Motor().resistance(80.0) < 4.63  # 3.5 (1 + 0.32) = 4.62 ohm


def test_each_balance_by_hand():
    motor = Motor(R_a0=2.0, L=0.5, ke=0.3, J=0.04, b=0.01, alpha=0.005, k0=3.0, kT=0.02, k_ir=0.0007, H=600.0)
    rates = motor.rates(At(i=4.0, w=50.0, theta=20.0), at(v=30.0, load=0.25))
    # R = 2 (1 + 0.1) = 2.2; (30 - 8.8 - 15) / 0.5; (1.2 - 0.5 - 0.25) / 0.04; (35.2 + 1.75 - 3 (1 + 1) 20) / 600
    assert rates["i"] == pytest.approx(12.4)
    assert rates["w"] == pytest.approx(11.25)
    assert rates["theta"] == pytest.approx(
        (35.2 + 1.75 - 120.0) / 600.0, rel=1e-4
    )  # |w| is rounded off by 1e-3


@pytest.mark.parametrize(
    "i, w, theta", [(3.0, 40.0, 10.0), (-2.0, 80.0, 50.0), (5.0, -60.0, 0.0), (0.0, 0.0, 30.0)]
)
def test_energy_of_the_textbook_motor_closes_up_to_the_iron_loss_it_invents(i, w, theta):
    """v i = d/dt(L i^2/2 + J w^2/2) + load w + b w^2 + R i^2; heat stored and led away exceeds R i^2 by k_ir w^2."""
    u = at(v=17.0, load=0.4)
    rates = MOTOR.rates(At(i=i, w=w, theta=theta), u)
    stored = MOTOR.L * i * rates["i"] + MOTOR.J * w * rates["w"]
    losses = MOTOR.resistance(theta) * i**2
    assert u.v * i == pytest.approx(stored + u.load * w + MOTOR.b * w**2 + losses, rel=1e-12, abs=1e-12)
    cooling = MOTOR.k0 * (1 + MOTOR.kT * abs(w)) * theta
    assert MOTOR.H * rates["theta"] + cooling == pytest.approx(
        losses + MOTOR.k_ir * w**2, rel=1e-3, abs=1e-12
    )


def test_with_the_brake_of_the_iron_loss_and_friction_heat_no_energy_is_made_or_lost():
    motor = MOTOR.with_effect(IronLossTorque(s=1.0)).with_effect(CoulombFriction(tau_c=0.2, w_s=0.1))
    motor = motor.with_effect(QuadraticDrag(c=1e-5)).with_effect(FrictionHeat(s=1.0))
    x, u = At(i=4.0, w=70.0, theta=35.0), at(v=30.0, load=0.3)
    rates = motor.rates(x, u)
    stored = motor.L * x.i * rates["i"] + motor.J * x.w * rates["w"] + motor.H * rates["theta"]
    cooling = motor.k0 * (1 + motor.kT * (np.hypot(x.w, 1e-3) - 1e-3)) * x.theta
    assert u.v * x.i == pytest.approx(stored + u.load * x.w + cooling, rel=1e-12)


def test_linear_theory_of_the_cold_motor():
    """Electrical and mechanical poles are the roots of L J s^2 + (L b + R J) s + R b + ke^2 = 0."""
    motor = replace(MOTOR, alpha=0.0)
    columns = [motor.rates(At(i=i, w=w, theta=0.0), at()) for i, w in ((1.0, 0.0), (0.0, 1.0))]
    matrix = np.array([[c["i"] for c in columns], [c["w"] for c in columns]])
    expected = np.roots([
        MOTOR.L * MOTOR.J, MOTOR.L * MOTOR.b + MOTOR.R_a0 * MOTOR.J, MOTOR.R_a0 * MOTOR.b + MOTOR.ke**2
    ])  # fmt: skip
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(matrix)), np.sort_complex(expected), rtol=1e-10
    )


def test_effects_add_in_any_order():
    brush, friction, node = (
        BrushVoltageDrop(V_b=1.5, i_s=1e-3),
        CoulombFriction(tau_c=0.2),
        TwoNodeThermal(G_h=2.0),
    )
    x, u = At(i=3.0, w=20.0, theta=30.0, theta_h=12.0), at(v=20.0)
    one = MOTOR.with_effect(brush).with_effect(friction).with_effect(node)
    other = MOTOR.with_effect(node).with_effect(brush).with_effect(friction)
    assert one.rates(x, u) == pytest.approx(other.rates(x, u), rel=1e-14)
    plain = MOTOR.rates(x, u)
    assert MOTOR.L * (one.rates(x, u)["i"] - plain["i"]) == pytest.approx(-1.5)
    assert MOTOR.J * (one.rates(x, u)["w"] - plain["w"]) == pytest.approx(-0.2)
    assert MOTOR.H * (one.rates(x, u)["theta"] - plain["theta"]) == pytest.approx(1.5 * 3.0 - 2.0 * 18.0)


def test_a_saturated_inductance_stands_before_the_derivative_and_changes_no_steady_state():
    motor = MOTOR.with_effect(InductanceSaturation(s=0.01))
    motor = motor.with_effect(BrushVoltageDrop(V_b=1.5, i_s=1e-3))
    x = At(i=10.0, w=0.0, theta=0.0)
    assert motor.inductance(x, at()) == pytest.approx(MOTOR.L / 2)  # s i^2 = 1
    assert motor.rates(x, at(v=30.0))["i"] == pytest.approx((30.0 - 17.0 - 1.5) / (MOTOR.L / 2))
    # The drop at ten thousand knees: 1.5 10 / sqrt(10^2 + 0.001^2).
    steady = 17.0 + 1.5 * 10.0 / math.hypot(10.0, 1e-3)
    assert motor.rates(x, at(v=steady))["i"] == pytest.approx(0.0, abs=1e-9)


def test_effects_are_added_replaced_and_taken_away():
    motor = MOTOR.with_effect(CoulombFriction(tau_c=0.1)).with_effect(BrushVoltageDrop(V_b=1.0))
    again = motor.with_effect(CoulombFriction(tau_c=0.2))
    assert [e.name() for e in again.effects] == ["brush_voltage_drop", "coulomb_friction"]
    assert again.effect("coulomb_friction").tau_c == 0.2
    assert again.without_effect("coulomb_friction").without_effect("brush_voltage_drop") == MOTOR
    assert MOTOR.effects == () and MOTOR.effect("coulomb_friction") is None


def test_states_start_where_their_effect_says():
    @dataclass(frozen=True)
    class Warm(Effect):
        states: ClassVar = {"theta_x": State("K", "a warm thing", initial=12.5)}

        def rates(self, m: Any, x: Any, u: Any) -> dict[str, Any]:
            return {"theta_x": 0.0 * x.theta_x}

    assert MOTOR.with_effect(Warm()).states() == {"i": 0.0, "w": 0.0, "theta": 0.0, "theta_x": 12.5}


def test_effects_may_share_the_shaft_angle_but_not_a_name():
    both = MOTOR.with_effect(CoggingTorque(A=0.1)).with_effect(UnbalanceTorque(A=0.2))
    assert list(both.states()) == ["i", "w", "theta", "phi"]
    assert both.rates(At(i=0.0, w=3.0, theta=0.0, phi=0.5), at())["phi"] == 3.0

    @dataclass(frozen=True)
    class Other(Effect):
        states: ClassVar = {"phi": State("1", "flux, not an angle")}

    with pytest.raises(ModelError, match="other brings a state 'phi'"):
        both.with_effect(Other()).states()


def test_a_motor_of_arrays_is_a_batch_of_motors():
    resistances: Any = np.array([1.0, 2.0, 3.0])
    rates = replace(MOTOR, R_a0=resistances).rates(At(i=2.0, w=5.0, theta=10.0), at(v=9.0))
    for k, R in enumerate(resistances):
        assert rates["i"][k] == replace(MOTOR, R_a0=R).rates(At(i=2.0, w=5.0, theta=10.0), at(v=9.0))["i"]


def test_every_parameter_of_the_motor_is_described_and_typical_sizes_are_within_reason():
    """On the paper's plate the typical size is within a factor of ten of the paper's value (bounds aside)."""
    rated = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
    for p in parameters(Motor).values():
        assert len(p.description) > 5 and p.bounds[0] <= p.default <= p.bounds[1]
        assert 0.1 < p.prior * rated.scale(p.of) / p.default < 10, p.name


@pytest.mark.parametrize(
    "of, expected",
    [("1", 1.0), ("voltage", 24.0), ("voltage/current", 12.0), ("torque/speed^2", 0.5 / 1600), ("power/rise", 0.8),
     ("1/current^2", 0.25), ("voltage/current/speed", 0.3), ("torque*speed", 20.0), ("torque/speed/current^2", 0.003125)],
)  # fmt: skip
def test_scales_of_the_rating_plate(of, expected):
    rated = Rated(voltage_V=24.0, current_A=2.0, speed_rad_s=40.0, torque_Nm=0.5, rise_K=60.0)
    assert rated.scale(of) == pytest.approx(expected, rel=1e-14)
