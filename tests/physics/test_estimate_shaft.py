"""What goes with the shaft angle: samples of it against an integration in full, and the angle where none was recorded."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.hidden import plant
from helpers.nameless import nameless
from scipy.integrate import solve_ivp

from motorlens_physics.effect import Effect, State, catalogue
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.forcing import between_samples
from motorlens_physics.estimate.model import predict, sensitivities_of, with_effect
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.shaft import followed
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.ops import cos, exp
from motorlens_physics.parameter import param
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.hypotheses.curves import Curve

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


@pytest.mark.parametrize(("lag", "advance"), [(0.35, 3.6), (5.0, 1.8), (50.0, 0.8), (5.0, -4.5)])
def test_a_lag_driven_by_the_samples_answers_as_to_the_phasor(lag, advance):
    """T x' = u - x integrated by scipy, with cos(w t) and with its samples times the factor, joined by lines."""
    factor = between_samples(np.array([advance]), lag)[0]
    at = np.arange(40)
    samples = np.real(factor * np.exp(1j * advance * at))
    # Begun on the answer that cos(w t) has in the long run, both have nothing to forget.
    first = np.real(1 / (1 + 1j * advance * lag))

    def rates(t, x):
        drive = np.interp(t, at, samples)
        return [(drive - x[0]) / lag, (np.cos(advance * t) - x[1]) / lag]

    both = solve_ivp(rates, (0, 39), [first, first], t_eval=at, max_step=0.02, rtol=1e-7, atol=1e-9).y
    assert np.abs(both[0] - both[1]).max() < 2e-3 * max(np.abs(both[1]).max(), 1e-2)
    # Without the factor it is off by far.
    assert abs(factor - 1) > 0.02


@pytest.fixture(scope="module")
def turning():
    """20 s at 500 Hz of a motor with a ripple of 3 %, and the file that lacks it and is 3 % off in ke and R."""
    file = read_motor_file(MOTOR)
    ripple = replace(catalogue()["commutation_ripple"].typical(file.rated), eps=0.03, N=4.0, p=0.7)
    time = np.arange(10_000) * 0.002
    rng = np.random.default_rng(0)
    voltage = np.repeat(rng.uniform(0.3, 0.6, 20), 500) * file.rated.voltage_V
    inputs = Inputs(time, voltage, np.full(len(time), 1.0), np.full(len(time), 20.0), held=True)
    true = simulate(file.motor.with_effect(ripple), inputs)
    channels = {
        "voltage": voltage, "load_torque": inputs.load_torque_Nm,
        "current": true.current_A + 0.01 * rng.standard_normal(len(time)),
        "speed": true.speed_rad_s + 0.2 * rng.standard_normal(len(time)),
    }  # fmt: skip
    wrong = {"ke": 1.03 * file.motor.ke, "R_a0": 0.97 * file.motor.R_a0}
    return replace(file.with_values(wrong), name="wrong"), Recording("turning", time, channels), true, ripple


@pytest.mark.fit
def test_the_angle_is_followed_where_the_simulated_one_is_turns_ahead(turning):
    file, recording, true, _ = turning
    run = prepare_all([recording], file)[0]
    model = replace(start_model(file, [run]), held=((True, True, True),))
    trajectory, shown = predict(model, run, 0)
    found = followed(run, trajectory, shown)
    assert found.shaft is not None
    simulated = np.concatenate([[0.0], np.cumsum(trajectory.speed_rad_s[:-1] * 0.002)])
    assert np.abs(simulated - true.states["phi"]).max() > 6.0
    assert np.abs(found.shaft - true.states["phi"]).max() < 0.1


def test_what_the_ripple_changes_follows_from_the_shaft_as_followed(turning):
    """What the ripple changes, against the integration in full with the angle as a state."""
    file, recording, true, ripple = turning
    run = prepare_all([recording], file)[0]
    right = start_model(read_motor_file(MOTOR), [run])
    plain = replace(right, held=((True, True, True),))
    trajectory, shown = predict(plain, run, 0)
    known = followed(run, trajectory, shown)
    with_it = with_effect(plain, ripple)
    change = predict(with_it, known, 0)[1] - predict(plain, known, 0)[1]
    truth = np.column_stack([true.current_A, true.speed_rad_s]) - predict(plain, run, 0)[1]
    for c in range(2):
        expected, found = truth[500:, c], change[500:, c]
        # An angle off by 0.05 rad is a phase off by 0.2.
        assert np.std(found - expected) < 0.2 * np.std(expected)
        assert 0.98 < np.std(found) / np.std(expected) < 1.02


def test_detents_faster_than_the_samples_leave_no_torque_behind():
    """The shaft sweeps over the speed at which every sample meets the next detent, against the integration in full."""
    file = read_motor_file(MOTOR)
    time = np.arange(10_000) * 0.002
    fast = np.pi / 0.002 / 24 * file.motor.ke
    inputs = Inputs(
        time, fast * (1 + 0.3 * np.sin(2 * np.pi * time / 5)), np.zeros(len(time)), np.full(len(time), 20.0)
    )
    detents = replace(catalogue()["cogging_torque"].typical(file.rated), A=0.5, N=24.0)
    true = simulate(file.motor.with_effect(detents), inputs)
    channels = {"voltage": inputs.voltage_V, "speed": true.speed_rad_s, "angle": true.states["phi"]}
    run = prepare_all([Recording("sweep", time, channels)], file)[0]
    plain = start_model(file, [run])
    change = predict(with_effect(plain, detents), run, 0)[1] - predict(plain, run, 0)[1]
    truth = true.speed_rad_s - simulate(file.motor, inputs).speed_rad_s
    # Samples that alternate in sign, joined by lines, would be four times what there truly is.
    assert np.std(change[1000:, 0] - truth[1000:]) < 0.01 * np.std(truth[1000:])
    assert np.abs(truth[1000:]).max() > 0.01


@pytest.mark.parametrize("held", [False, True])
def test_a_phase_of_nought_has_a_derivative(turning, held):
    """What a change of the phase does to what is shown, against the difference of two simulations."""
    file, recording, _, ripple = turning
    run = prepare_all([recording], file)[0]
    plain = replace(start_model(file, [run]), held=((held, held, held),))
    known = followed(run, *predict(plain, run, 0))
    key = "commutation_ripple.p"
    model = with_effect(plain, replace(ripple, p=0.0))
    found = sensitivities_of(model, known, 0, [key])[2][:, :, 0]
    ahead, behind = (predict(model.with_values({key: step}), known, 0)[1] for step in (0.05, -0.05))
    expected = (ahead - behind) / 0.1
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()
    assert np.abs(expected).max() > 0.1


@dataclass(frozen=True)
class Rub(Effect):
    """The rotor rubs at one place of the revolution, at 2 rad."""

    states: ClassVar[Mapping[str, State]] = {"phi": State("rad", "shaft angle", kind="angle")}
    A: float = param(0.0, "N*m", "torque there", bounds=(0.0, 10.0), prior=1.0, null=0.0)

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return -self.A * exp(8.0 * (cos(x.phi - 2.0) - 1.0))

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"phi": x.w}


@pytest.mark.fit
def test_a_rub_at_one_angle_is_drawn_against_the_angle():
    file = read_motor_file(MOTOR)
    time = np.arange(10_000) * 0.002
    rng = np.random.default_rng(1)
    voltage = np.repeat(rng.uniform(20.0, 50.0, 10), 1000)
    inputs = Inputs(time, voltage, np.full(len(time), 0.5), np.full(len(time), 20.0), held=True)
    true = simulate(file.motor.with_effect(Rub(0.4)), inputs)
    channels = {
        "voltage": voltage, "load_torque": inputs.load_torque_Nm,
        "current": true.current_A + 0.01 * rng.standard_normal(len(time)),
        "speed": true.speed_rad_s + 0.1 * rng.standard_normal(len(time)),
    }  # fmt: skip
    term = nameless(file, Recording("rub", time, channels))
    assert term is not None
    shape = term.entry.shape
    assert isinstance(shape, Curve) and shape.against == "angle"
    knots, value, _ = shape.values(term.coefficient, term.covariance)
    course = value - np.median(value)
    # Its mean over a revolution passes for friction; the pit at 2 rad is 0.4 N m deep.
    assert abs(knots[np.argmin(course)] - 2.0) < 0.3
    assert -0.5 < course.min() < -0.3
    away = np.abs(knots - 2.0) > 1.2
    assert np.abs(course[away]).max() < 0.1


@dataclass(frozen=True)
class LoadedRub(Rub):
    """The same in proportion to the load, and less when warm: it reads inputs and states beside the angle."""

    def torque(self, m: Any, x: Any, u: Any) -> Any:
        return super().torque(m, x, u) * u.load / (1.0 + 0.01 * x.theta)


def test_a_recorded_angle_is_used_without_a_current_too():
    """What the effect changes, against the integration in full; the current was not recorded."""
    file = read_motor_file(MOTOR)
    time = np.arange(5000) * 0.002
    inputs = Inputs(time, np.full(len(time), 40.0), np.full(len(time), 0.5), np.full(len(time), 20.0))
    effect = LoadedRub(0.8)
    true = simulate(file.motor.with_effect(effect), inputs)
    channels = {
        "voltage": inputs.voltage_V, "load_torque": inputs.load_torque_Nm,
        "speed": true.speed_rad_s, "angle": true.states["phi"],
    }  # fmt: skip
    run = prepare_all([Recording("angle", time, channels)], file)[0]
    plain = start_model(file, [run])
    change = predict(with_effect(plain, effect), run, 0)[1] - predict(plain, run, 0)[1]
    truth = true.speed_rad_s - simulate(file.motor, inputs).speed_rad_s
    settled = slice(1000, None)
    assert np.std(change[settled, 0] - truth[settled]) < 1e-4 * np.std(truth[settled])
    assert np.std(truth[settled]) > 0.01


@pytest.mark.fit
@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.long) for k in (1, 2))])
def test_a_ripple_about_half_the_sampling_rate_is_no_skew_and_bends_nothing(seed):
    """Eight ripples a revolution at 140 to 240 rad/s, 500 samples a second; the plant is an integrator of its own."""
    file = read_motor_file(MOTOR)
    rng, time = np.random.default_rng(seed), np.arange(6000) * 0.002
    truth = {
        name: getattr(file.motor, name) * (1 + 0.03 * rng.standard_normal()) for name in ("L", "ke", "J", "b")
    }
    slow = {name: getattr(file.motor, name) for name in ("alpha", "k0", "kT", "k_ir", "H")}
    p = plant.vector(R=1.03 * file.motor.R_a0, **truth, **slow, ripple=0.03, ripple_N=8.0, ripple_p=0.7)
    inputs = np.zeros((len(time), plant.INPUTS))
    corners = np.arange(0.0, 12.1, 0.3)
    inputs[:, plant.VOLTAGE] = np.interp(time, corners, rng.uniform(140.0, 240.0, len(corners)))
    inputs[:, plant.LOAD] = 1.0
    inputs[:, plant.FLUX] = 1.0
    states = plant.simulate(0.002, inputs, plant.rest(), p, substeps=40)
    assert np.mean(8.0 * states[:, plant.W] * 0.002 > np.pi) > 0.2
    channels = {
        "voltage": inputs[:, plant.VOLTAGE], "load_torque": inputs[:, plant.LOAD], "angle": states[:, plant.PHI],
        "current": states[:, plant.I] + 0.02 * rng.standard_normal(len(time)),
        "speed": states[:, plant.W] + 0.2 * rng.standard_normal(len(time)),
    }  # fmt: skip
    ripple = replace(catalogue()["commutation_ripple"].typical(file.rated), eps=0.02, N=8.0, p=0.0)
    rippling = replace(file, motor=file.motor.with_effect(ripple))
    found = estimate(rippling, prepare_all([Recording("fast", time, channels)], rippling)).fit
    sd = dict(zip(found.prior.keys, np.sqrt(np.diagonal(found.covariance)), strict=True))
    value = found.model.values()
    expected = {
        "commutation_ripple.eps": 0.03, "commutation_ripple.p": 0.7, "ke": truth["ke"], "J": truth["J"], "L": truth["L"],
        "skew.current@0": 0.0, "skew.speed@0": 0.0,
    }  # fmt: skip
    for key, right in expected.items():
        assert abs(value[key] - right) < 4 * sd[key], key
    assert sd["commutation_ripple.eps"] < 3e-4 and sd["commutation_ripple.p"] < 0.02
    assert sd["skew.current@0"] < 5e-5
