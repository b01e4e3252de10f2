"""Shapes under which an effect is looked for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.hysteresis_iron_loss import HysteresisIronLoss
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.motor_file import read_motor_file
from motorlens_workbench.hypotheses.effects import shapes


def test_a_friction_is_looked_for_as_one_that_it_may_stand_in_the_place_of() -> None:
    """Hysteresis brakes as Coulomb friction does: where the torque alone is seen, no width may part them."""
    file = read_motor_file("mellah2016")
    there = CoulombFriction(tau_c=0.3, w_s=7.7)
    able = [
        part for (part,) in shapes(HysteresisIronLoss, replace(file, motor=file.motor.with_effect(there)))
    ]
    w = np.linspace(-30, 30, 61)
    expected = there.torque(None, SimpleNamespace(w=w), None) / there.tau_c
    alike = [
        bool(np.allclose(part.torque(None, SimpleNamespace(w=w), None) / part.k_h, expected, rtol=1e-12))
        for part in able
    ]
    assert alike.count(True) == 1
    assert len(able) == 1 + len(list(shapes(HysteresisIronLoss, file)))


def test_coulomb_friction_is_looked_for_as_the_stribeck_friction_that_it_may_be_taken_for() -> None:
    """Below its speed the one brakes as the other: no width of the smoothing may part them either."""
    file = read_motor_file("mellah2016")
    there = StribeckFriction(tau_s=0.3, w_k=500.0, w_s=0.7)
    w = np.linspace(-5, 5, 41)
    expected = there.torque(None, SimpleNamespace(w=w), None) / there.tau_s
    for motor, alike in ((file.motor, 0), (file.motor.with_effect(there), 1)):
        able = [part for (part,) in shapes(CoulombFriction, replace(file, motor=motor))]
        torques = [part.torque(None, SimpleNamespace(w=w), None) / part.tau_c for part in able]
        assert [bool(np.allclose(torque, expected, rtol=1e-3)) for torque in torques].count(True) == alike
