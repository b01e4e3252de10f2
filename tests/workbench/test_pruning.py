"""What a later effect makes needless, and what could replace an effect: on motors whose friction is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.fit import fit, start_model
from motorlens_physics.estimate.model import without_part
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.candidates import shaped
from motorlens_workbench.diagnosis import base_fit
from motorlens_workbench.look import look
from motorlens_workbench.pruning import dispensable, seen_from, simpler
from motorlens_workbench.selection import refit
from motorlens_workbench.steps import Step

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
FILE = read_motor_file(MOTOR)


def effect(name, **values):
    return shaped(catalogue()[name].typical(FILE.rated), **values)


def screened(true, *modelled):
    """Screens of 20 s at 500 Hz of a motor with `true`: from the textbook, and from a model that has `modelled`."""
    rng = np.random.default_rng(2)
    time = np.arange(10_000) * 0.002
    voltage = np.repeat(rng.uniform(-50.0, 50.0, 20), 500)
    load = np.repeat(rng.uniform(0.0, 1.0, 25), 400)
    inputs = Inputs(time, voltage, load, np.full(len(time), 20.0), held=True)
    trajectory = simulate(FILE.motor.with_effect(true), inputs)
    recording = Recording(
        "friction", time,
        {"voltage": voltage, "load_torque": load,
         "current": trajectory.current_A + 0.02 * rng.standard_normal(len(time)),
         "speed": trajectory.speed_rad_s + 0.1 * rng.standard_normal(len(time))},
    )  # fmt: skip
    base, runs = base_fit(FILE, prepare_all([recording], FILE))
    motor = FILE.motor
    for one in modelled:
        motor = motor.with_effect(one)
    file = replace(FILE, motor=motor)
    found = fit(start_model(file, runs), runs, base_prior(file, runs), base.whiteners)
    return look(base, runs), look(found, runs), runs


@pytest.fixture(scope="module")
def both():
    """Coulomb friction alone is true; the model has a drag as well."""
    return screened(
        effect("coulomb_friction", tau_c=0.5), effect("coulomb_friction", tau_c=0.1), effect("quadratic_drag")
    )


@pytest.mark.fit
@pytest.mark.parametrize("first", ["quadratic_drag", "coulomb_friction"])
def test_what_a_later_effect_makes_needless_is_dropped(both, first):
    textbook, now, runs = both
    second = {"quadratic_drag": "coulomb_friction", "coulomb_friction": "quadratic_drag"}[first]
    steps = [Step(textbook.tests[name], now.found, 1000.0, {}, {}) for name in (first, second)]
    spare = dispensable(steps, now, runs)
    if first == "coulomb_friction":
        assert spare is None
        return
    needless, less = spare
    assert needless is steps[0]
    assert not [key for key in less.prior.keys if key.startswith("quadratic_drag")]
    assert less.model.values()["coulomb_friction.tau_c"] == pytest.approx(0.5, rel=0.03)


@pytest.mark.fit
@pytest.mark.parametrize(
    ("true", "given_way"),
    [(effect("coulomb_friction", tau_c=0.5), True), (effect("stribeck_friction", tau_s=1.0), False)],
)
def test_what_claims_more_gives_way_where_a_simpler_rival_does_as_well(true, given_way):
    """The model has friction that falls with speed, and a drag that came later; the rival is friction that does not fall."""
    textbook, now, runs = screened(true, effect("stribeck_friction"), effect("quadratic_drag"))
    test = textbook.tests["coulomb_friction"]
    tried = refit(textbook.found, textbook.evidence, test, runs)
    rivals = {"coulomb_friction": tried}, {"coulomb_friction": test}
    first = Step(
        textbook.tests["stribeck_friction"], now.found, 1000.0, {"coulomb_friction": 50.0}, {}, *rivals
    )
    last = Step(textbook.tests["quadratic_drag"], now.found, 10.0, {}, {})
    swap = simpler([first, last], now, runs)
    if not given_way:
        assert swap is None
        return
    former, step = swap
    assert former is first
    assert step.test is test
    assert step.found.model.values()["coulomb_friction.tau_c"] == pytest.approx(0.5, rel=0.03)
    assert step.losses["stribeck_friction"] == 0.0


@pytest.mark.fit
def test_a_twin_is_one_as_seen_from_the_final_model():
    """Nothing that was recorded tells a constant torque from an offset of the torque sensor; friction turns its sign."""
    textbook, now, _ = screened(effect("constant_torque", tau_0=0.3), effect("constant_torque", tau_0=0.1))
    step = Step(textbook.tests["constant_torque"], now.found, 1000.0, {"coulomb_friction": 400.0}, {})
    seen = seen_from(step, now)
    assert seen.alike["load_torque_sensor_offset"] > 0.9999
    assert seen.losses["load_torque_sensor_offset"] < 1.0
    assert seen.alike["coulomb_friction"] < 0.5
    assert seen.losses["coulomb_friction"] == 400.0


@pytest.mark.fit
def test_a_part_that_leaves_takes_its_start_along():
    _, now, _ = screened(effect("constant_torque", tau_0=0.3), effect("two_node_thermal"))
    model = now.found.model
    assert any("initial.theta_h" in one for one in model.own)
    left = without_part(model, "two_node_thermal")
    assert left.file.motor.effects == ()
    assert {key for one in left.own for key in one} == {key for one in model.own for key in one} - {
        "initial.theta_h"
    }
