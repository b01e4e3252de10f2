"""How inputs ran between samples, of recordings by an integrator of its own in which it is known."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import AMBIENT_C, RATED, TYPICAL, simulated

from motorlens_physics.estimate import between_samples, timing
from motorlens_physics.estimate.between_samples import as_they_ran, otherwise
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.fit import NEAR, fit, start_model
from motorlens_physics.estimate.points import weighed
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.timing import ROUGHLY, Timing, same
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import ModelError

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
SAMPLES, PERIOD_S, NOISE = 1800, 0.005, 0.003
TIME = np.arange(SAMPLES) * PERIOD_S


def drives(kind: str) -> np.ndarray:
    """(N,) volts."""
    if kind == "steps":
        return np.repeat(np.random.default_rng(5).uniform(-240, 240, SAMPLES // 100), 100)
    if kind == "triangle":
        return 192 * (2 * np.abs(2 * ((TIME / 2.3) % 1) - 1) - 1)
    return 168 * np.sin(2 * np.pi * TIME / 2.2)


def fitted(kind: str, held: bool, seed: int) -> Estimate:
    """The estimate from a recording with noise on all channels."""
    voltage, rng = drives(kind), np.random.default_rng(seed)
    states = simulated(
        TYPICAL, voltage, np.zeros(SAMPLES), plain_motor.Test(PERIOD_S, SAMPLES, 1, held, NOISE)
    )
    shown = {"voltage": voltage, "current": states[:, 0], "speed": states[:, 1]}
    channels = {q: y + NOISE * RATED[q] * rng.standard_normal(SAMPLES) for q, y in shown.items()}
    file = MotorFile("plate", Motor(), PLATE)
    recording = Recording(f"{kind}.csv", TIME, {**channels, "ambient": np.full(SAMPLES, AMBIENT_C)})
    return estimate(file, prepare_all([recording], file))


@pytest.mark.fit
@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("kind", ["steps", "triangle"])
def test_how_the_voltage_ran_is_told_where_it_turns_at_once(kind: str, held: bool) -> None:
    for seed in (1, 2):
        found = fitted(kind, held, seed)
        assert found.fit.model.held[0][0] == held and found.otherwise[0] < 0.05


@pytest.mark.fit
@pytest.mark.parametrize("held", [True, False])
def test_the_deviations_allow_for_what_a_sinusoid_does_not_tell(held: bool) -> None:
    """Held or half a sample late are the same on it, but for the inertia, by 0.2 %: four to eight deviations of one way."""
    right, off = 0, []
    for seed in range(6):
        found = fitted("sinusoid", held, seed)
        value, sd = found.fit.model.values(), found.fit.sd()
        right += found.fit.model.held[0][0] == held
        assert found.fit.model.held[0][0] == held or found.otherwise[0] > 0.02
        off += [(value[key] - TYPICAL[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")]
        assert sd["J"] < 0.004 * TYPICAL["J"]
    # More often told right than wrong.
    assert right > 3
    assert np.abs(off).max() < 3.5 and np.mean(np.abs(off) < 2) > 0.85


@pytest.mark.fit
def test_what_is_open_is_how_far_the_ways_lead_apart_and_not_how_far_both_lead() -> None:
    """From a resistance that is five deviations off, either way leads back."""
    found = fitted("sinusoid", True, 1)
    prior, sd = found.fit.prior, found.fit.sd()["R_a0"]
    noises = [run.noise for run in found.runs if run.noise is not None]
    off = found.fit.model.with_values({"R_a0": found.fit.model.values()["R_a0"] + 5 * sd})
    point = weighed(off, found.runs, noises, [run.there for run in found.runs], prior.keys)
    (chance,), spread = otherwise(point, prior)
    k = prior.keys.index("R_a0")
    assert chance > 0.2 and 0 < spread[k, k] < sd**2


@pytest.mark.fit
def test_a_motor_that_oscillates_within_a_sample_is_not_taken_for_its_alias() -> None:
    """Current and speed follow within a sample of 0.1 s; so does a motor of a sixth of the inertia that rings once in it.

    Fitted to inputs that ran otherwise, the estimate stands nearer that one: held, it begins from there, and anew.
    """
    rng = np.random.default_rng([310729, 300])
    motor = plain_motor.scattered(rng)
    time, channels = plain_motor.recorded(motor, plain_motor.Test(0.1, 2000, 150, True, 0.03), rng)
    channels["ambient"] = AMBIENT_C + 0.03 * RATED["temperature"] * rng.standard_normal(len(time))
    known = {key: Knowledge(0.3 / np.sqrt(3) * value, "plate") for key, value in TYPICAL.items()}
    file = MotorFile("plate", Motor(**TYPICAL), PLATE, knowledge=known)
    found = estimate(file, prepare_all([Recording("slow.csv", time, channels)], file))
    assert found.converged and found.fit.model.held[0][:2] == (True, True)
    values, sd = found.fit.model.values(), found.fit.sd()
    assert max(abs(values[key] - motor[key]) / sd[key] for key in ("R_a0", "L", "ke", "J", "b")) < 3
    assert sd["J"] < 0.05 * motor["J"], "told, not merely wide"


@pytest.mark.fit
@pytest.mark.parametrize("held", [True, False])
def test_inputs_did_not_run_as_no_motor_can_be_simulated(monkeypatch, held: bool) -> None:
    """A motor that rings at 500 Hz between samples a second apart ended an estimate, that of inputs that ran otherwise."""
    found = fitted("steps", held, 1)
    prior = found.fit.prior
    noises = [run.noise for run in found.runs if run.noise is not None]
    point = weighed(found.fit.model, found.runs, noises, [run.there for run in found.runs], prior.keys)
    simulate, able = between_samples.sensitivities_of, {held}

    def simulated_if_able(model, run, r, keys):
        if run.inputs.hold[0] not in able:
            raise ModelError("it takes too many steps")
        return simulate(model, run, r, keys)

    monkeypatch.setattr(between_samples, "sensitivities_of", simulated_if_able)
    for (run,) in as_they_ran(point, prior):
        assert run.inputs.hold[0] is held and not run.late
    (chance,), spread = otherwise(point, prior)
    assert chance == 0 and not spread.any()
    # Along the other one it must have run that one.
    able.symmetric_difference_update({True, False})
    for (run,) in as_they_ran(point, prior):
        assert run.inputs.hold[0] is not held
    able.clear()
    assert all(run is point.parts[0].run for (run,) in as_they_ran(point, prior))


@pytest.mark.fit
def test_two_rough_fits_are_the_same_if_both_are_near_one_minimum() -> None:
    """Least squares lead to the same from the motor file as from where that ends; what is farther off is another."""
    found = fitted("steps", True, 1)
    runs = [run.as_recorded for run in found.runs]
    began, went_on = (
        fit(model, runs, found.fit.prior, rounds=NEAR, enough=ROUGHLY)
        for model in (start_model(found.fit.model.file, runs), found.fit.model)
    )
    assert same(began, went_on) and same(went_on, began)
    values, sd = began.model.values(), began.sd()
    for deviations, alike in ((1.9, True), (2.1, False)):
        # Along a parameter's own deviation beside the others, where all of them go along.
        at = began.prior.keys.index("J")
        along = began.covariance[at] / sd["J"]
        moved = {
            key: values[key] + deviations * step for key, step in zip(began.prior.keys, along, strict=True)
        }
        assert same(began, replace(began, model=began.model.with_values(moved))) == alike
    assert not same(began, replace(began, left=1.1 * ROUGHLY))


@pytest.mark.fit
@pytest.mark.parametrize(("alike", "minimised"), [(True, 1), (False, 2)])
def test_a_way_is_fitted_to_the_end_once_where_both_begins_lead_to_the_same(
    monkeypatch: pytest.MonkeyPatch, alike: bool, minimised: int
) -> None:
    """And either way it is told as well how the voltage ran."""
    to_the_end, asked = Timing._from, []
    monkeypatch.setattr(timing, "same", lambda one, other: alike)
    monkeypatch.setattr(Timing, "_from", lambda *a: asked.append(1) or to_the_end(*a))
    assert fitted("steps", True, 1).fit.model.held[0][0]
    # The first is that with which all begins.
    assert len(asked) == 1 + minimised
