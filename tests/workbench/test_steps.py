"""Which effects count beside each other, and when a curve without a name stands against them: both sides of each rule."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.estimate.fit import fit, start_model
from motorlens_physics.estimate.prior import Prior, base_prior
from motorlens_physics.estimate.run import prepare
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.sensor_model import sensor_catalogue
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench import selection, verdict
from motorlens_workbench.candidates import Candidate
from motorlens_workbench.evidence import Score
from motorlens_workbench.steps import AMONG, among, imperfections, likely

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.mark.parametrize(
    ("alike", "loss", "gain", "mends"),
    [
        (0.95, 500.0, 50.0, True),  # nearly a copy, worth little beside it
        (0.95, 500.0, 150.0, False),  # worth more than a tenth
        (0.5, 5.0, 50.0, True),  # as good in its place
        (0.5, 500.0, 50.0, False),  # another thing
    ],
)
def test_what_mends_the_shape_of_an_effect_is_no_second_one(alike, loss, gain, mends):
    step = SimpleNamespace(
        alike={"brush_voltage_drop": alike}, losses={"brush_voltage_drop": loss}, gain=1000.0
    )
    now = SimpleNamespace(tests={"brush_voltage_drop": SimpleNamespace(gain=gain)})
    assert imperfections([step], now) == (["brush_voltage_drop"] if mends else [])


@pytest.mark.parametrize(
    ("statistic", "gain", "alike", "rival"),
    [
        (80.0, 100.0, 0.0, True),  # nearly as significant
        (60.0, 100.0, 0.6, True),  # of the same thing
        (60.0, 100.0, 0.3, False),
        (20.0, 500.0, 0.8, True),  # nearly a copy, less evenly
        (40.0, 1100.0, 0.0, True),  # explains more, less evenly
        (20.0, 1100.0, 0.0, False),  # so unevenly that it is another thing
    ],
)
def test_who_is_refitted_beside_the_best(statistic, gain, alike, rival, monkeypatch):
    monkeypatch.setattr(selection, "likeness", lambda left, one, other: alike)
    best = SimpleNamespace(statistic=100.0, gain=1000.0)
    other = SimpleNamespace(statistic=statistic, gain=gain)
    found = selection.rivals(None, {"best": best, "other": other}, best)
    assert found == ([best, other] if rival else [best])


def bend_of(gain: float, best: float = 20.0, against: str = "speed") -> SimpleNamespace:
    return SimpleNamespace(gain=gain, best=best, curve=SimpleNamespace(against=against))


@pytest.mark.parametrize(
    ("steps", "left", "whole", "far", "against"),
    [
        ([], [70.0], [], False, None),  # a curve without a name must explain eight thousandths
        ([], [90.0], [], False, 90.0),
        ([1000.0], [115.0], [900.0], False, None),
        ([1000.0], [135.0], [900.0], False, 135.0),
        ([600.0, 300.0, 100.0], [60.0], [1200.0], False, 60.0),  # after three names less is enough
        ([600.0, 400.0], [60.0], [1200.0], False, None),
        ([600.0, 400.0], [60.0], [1300.0], False, 1300.0),  # one curve instead of two names
        ([1000.0], [], [900.0], True, 900.0),  # speed or temperature is still far off
    ],
)
def test_a_curve_stands_against_the_names(steps, left, whole, far, against, monkeypatch):
    monkeypatch.setattr(verdict, "unsettled", lambda first, now, runs: far)
    monkeypatch.setattr(verdict, "cornered", lambda fitted: False)
    found = SimpleNamespace(
        steps=[SimpleNamespace(gain=gain) for gain in steps],
        left=[bend_of(gain) for gain in left],
        whole=[bend_of(gain) for gain in whole],
        first=None,
        last=SimpleNamespace(samples=10_000.0, found=None),
        runs=(),
    )
    bend = verdict.structure(found)
    assert (bend.gain if bend else None) == against


@pytest.mark.parametrize(
    ("variable", "gain", "best", "against"),
    [
        ("travel", 25.0, 110.0, True),
        ("travel", 15.0, 110.0, False),
        ("travel", 25.0, 100.0, False),
        ("time", 25.0, 110.0, False),
    ],
)
def test_friction_that_goes_with_the_travel_stands_against_a_name_from_a_smaller_share(
    variable, gain, best, against
):
    found = SimpleNamespace(
        steps=[SimpleNamespace(gain=1000.0)], left=[bend_of(gain, best, variable)], whole=[],
        last=SimpleNamespace(samples=10_000.0), runs=[],
    )  # fmt: skip
    assert (verdict.structure(found) is not None) == against


@pytest.mark.parametrize(
    ("coarse", "gain", "named"), [(False, 90.0, True), (True, 150.0, False), (True, 170.0, True)]
)
def test_a_curve_must_stand_out_of_a_coarse_converter(coarse, gain, named):
    found = SimpleNamespace(
        steps=[], left=[bend_of(gain)], whole=[], last=SimpleNamespace(samples=10_000.0),
        runs=[SimpleNamespace(coarse=False), SimpleNamespace(coarse=coarse)],
    )  # fmt: skip
    assert (verdict.structure(found) is not None) == named


@pytest.mark.parametrize(
    ("gain", "best", "seen"),
    [(30.0, 50.0, True), (20.0, 50.0, False), (30.0, 40.0, False), (70.0, 46.0, False)],
)
def test_a_sharp_curve_without_a_name_may_explain_less(gain, best, seen):
    found = SimpleNamespace(
        steps=[], left=[bend_of(gain, best)], whole=[], last=SimpleNamespace(samples=10_000.0),
        runs=[],
    )  # fmt: skip
    assert (verdict.structure(found) is not None) == seen


@pytest.mark.parametrize(("blocks", "rather"), [(1.0, False), (4.0, True), (60.0, True)])
def test_what_hardly_a_block_of_time_bears_is_rather_chance(blocks, rather):
    """A statistic of 45, by Student's t: near certain with many blocks, met by chance in one of fifty with one."""
    one = np.ones((1, 1))
    tested = Score(("it#0.0",), one[0], one, 45.0, 1.0, 45.0, blocks, 1.0, one)
    typical = selection.Test(SimpleNamespace(), 0, tested, 1.0, True, 1.0)
    assert likely(typical, 40) == rather


def test_what_was_accepted_beside_an_effect_is_none_of_its_group():
    losses = {
        "current_sensor_lag": 0.0,
        "unbalance_torque": 3.0,
        "inductance_saturation": 5.0,
        "radiation": 500.0,
    }
    step = SimpleNamespace(
        test=SimpleNamespace(
            candidate=SimpleNamespace(name="current_sensor_lag"), score=SimpleNamespace(inflation=1.0)
        ),
        losses=losses, alike={}, gain=100.0,
    )  # fmt: skip
    alone = verdict.group_of(step, ("current_sensor_lag",))
    beside = verdict.group_of(step, ("current_sensor_lag", "unbalance_torque"))
    assert alone == ("current_sensor_lag", "unbalance_torque", "inductance_saturation")
    assert beside == ("current_sensor_lag", "inductance_saturation")


@pytest.mark.parametrize(("share", "said"), [(1.0, False), (0.7, False), (0.5, True), (1.5, True)])
def test_a_parameter_fitted_far_from_the_motor_file_is_pointed_out(share, said):
    """R_a0 known to a tenth: 3 and 5 standard deviations."""
    file = read_motor_file(MOTOR)
    prior = Prior({"R_a0": file.motor.R_a0}, {"R_a0": 0.1 * file.motor.R_a0}, {"R_a0": (0.0, 100.0)})
    model = SimpleNamespace(file=file, values=lambda: {"R_a0": share * file.motor.R_a0})
    sentences = verdict.far_off(SimpleNamespace(model=model, prior=prior))
    assert len(sentences) == said
    if said:
        assert (
            sentences[0].startswith("R_a0 is fitted 5.0 standard deviations from the motor file")
            and "ohm" in sentences[0]
        )


@pytest.mark.parametrize("housing_K", [12.0, 38.0])
def test_how_warm_the_housing_was_is_found(housing_K):
    """A motor switched on warm, after a short run (its housing is cold) or a long one."""
    file = read_motor_file(MOTOR)
    file = replace(file, motor=file.motor.with_effect(catalogue()["two_node_thermal"].typical(file.rated)))
    time = np.arange(0.0, 1500.0, 0.5)
    rng = np.random.default_rng(3)
    inputs = Inputs(time, np.full(len(time), 60.0), np.zeros(len(time)), np.full(len(time), 20.0))
    truth = simulate(file.motor, inputs, {"w": 60.0, "theta": 40.0, "theta_h": housing_K}, smooth=True)
    channels = {
        "voltage": inputs.voltage_V, "ambient": inputs.ambient_C, "load_torque": inputs.load_torque_Nm,
        "current": truth.current_A + 0.05 * rng.standard_normal(len(time)),
        "speed": truth.speed_rad_s + 0.5 * rng.standard_normal(len(time)),
        "temperature": 20.0 + truth.rise_K + 0.1 * rng.standard_normal(len(time)),
    }  # fmt: skip
    run = prepare(Recording("warm", time, channels), file)
    prior = base_prior(file, [run])
    started = start_model(file, [run])
    assert started.own[0]["initial.theta_h"] == pytest.approx(0.8 * 40.0, abs=0.5)
    # The motor is known, the start is not.
    own = Prior(
        *({k: v for k, v in part.items() if "@" in k} for part in (prior.centre, prior.sd, prior.bounds))
    )
    found = fit(started, [run], own)
    at, width = found.model.values()["initial.theta_h@0"], found.sd()["initial.theta_h@0"]
    assert abs(at - housing_K) < 4 * width and 0.0 < width < 2.0


@pytest.mark.parametrize(
    ("key", "value", "corner"),
    [
        ("R_a0", 3.6, False),
        ("R_a0", "low", True),  # a twentieth of the motor file's
        ("magnet_temperature.beta", 0.002, False),
        ("magnet_temperature.beta", "high", True),  # five times what the strongest magnets lose
        ("iron_loss_torque.s", "high", False),  # the whole of a share is a natural limit
        ("current_sensor_gain.gain", 1.1, False),
        ("current_sensor_gain.gain", "low", True),  # a tenth of what flows
    ],
)
def test_values_that_no_motor_has_are_a_corner(key, value, corner):
    file = read_motor_file(MOTOR)
    name = key.partition(".")[0]
    if name in catalogue():
        file = replace(file, motor=file.motor.with_effect(catalogue()[name].typical(file.rated)))
    elif name in sensor_catalogue():
        file = replace(file, sensors=(sensor_catalogue()[name].typical(file.rated),))
    time = np.arange(100) * 0.01
    channels = {"voltage": np.full(100, 20.0), "current": np.ones(100), "speed": np.ones(100)}
    runs = [prepare(Recording("any", time, channels), file)]
    prior = base_prior(file, runs)
    bound = dict(zip(("low", "high"), prior.bounds[key], strict=True))
    model = start_model(file, runs).with_values({key: bound.get(value, value)})
    assert selection.cornered(SimpleNamespace(model=model, prior=prior)) == corner


@pytest.mark.parametrize(
    ("accepted", "equation", "counts"),
    [
        ("load_torque", "mechanical", True),
        ("load_torque", "thermal", False),  # what warms shows in the temperature alone
        ("thermal", "temperature", True),
        ("temperature", "coupling", False),
    ],
)
def test_the_imperfection_of_an_effect_shows_where_the_effect_does(accepted, equation, counts):
    first, later = (Candidate("any", "effect", what, ()) for what in (accepted, equation))
    step = SimpleNamespace(test=SimpleNamespace(candidate=first), gain=50_000.0)
    assert among([step], later) == (AMONG * 50_000.0 if counts else 0.0)


@pytest.mark.parametrize("nearest", [0.3, 0.9])
def test_no_scale_falls_below_its_share_in_one_step(nearest):
    """A thermal capacity ten times too large: its linear step is far too long."""
    file = read_motor_file(MOTOR)
    time = np.arange(0.0, 1200.0, 2.0)
    inputs = Inputs(time, np.full(len(time), 60.0), np.full(len(time), 5.0), np.full(len(time), 20.0))
    truth = simulate(file.motor, inputs, {"w": 60.0}, smooth=True)
    channels = {"voltage": inputs.voltage_V, "ambient": inputs.ambient_C, "load_torque": inputs.load_torque_Nm,
                "temperature": 20.0 + truth.rise_K}  # fmt: skip
    run = prepare(Recording("warm", time, channels), file)
    true = file.motor.H
    prior = Prior({"H": true}, {"H": 100 * true}, {"H": (1e-3, 1e9)})
    started = start_model(file, [run]).with_values({"H": 10 * true})
    once = fit(started, [run], prior, rounds=1, nearest=nearest).model.values()["H"]
    assert once == pytest.approx(nearest * 10 * true, rel=1e-9)
    found = fit(started, [run], prior, rounds=40, nearest=nearest).model.values()["H"]
    assert found == pytest.approx(true, rel=0.02)
