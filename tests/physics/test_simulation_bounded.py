"""Every simulation ends: within a number of steps, or in an error that says where and why."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from motorlens_physics.effect import catalogue
from motorlens_physics.effects.cogging_torque import CoggingTorque
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.parameter import parameters
from motorlens_physics.scenario import MOST_ROWS, ROWS_OF_ITS_OWN, grid, scenarios
from motorlens_physics.sensitivity import sensitivities
from motorlens_physics.simulation import STEPS_A_SAMPLE, STEPS_BESIDE, Inputs, Stepper, simulate
from motorlens_runtime.errors import ModelError

TIMES = 20


def noisy(period_s: float, volts: float, load: float) -> Inputs:
    rng = np.random.default_rng(0)
    time = np.arange(400) * period_s
    return Inputs(
        time,
        volts * np.sin(np.arange(400) / 50) + 0.02 * volts * rng.standard_normal(400),
        load * (0.2 + rng.standard_normal(400)),
        np.full(400, 20.0),
    )


RECORDED = {
    "1 kHz": noisy(1e-3, 240.0, 1.0),
    "10 Hz": noisy(0.1, 240.0, 1.0),
    "near standstill at 1 Hz": noisy(1.0, 5.0, 0.5),
}


def drawn(owner: Any, rng: np.random.Generator) -> dict[str, float]:
    return {name: float(rng.uniform(*p.bounds)) for name, p in parameters(owner).items() if not p.fixed}


@pytest.mark.parametrize("smooth", [False, True], ids=["real", "smooth"])
@pytest.mark.parametrize("recording", RECORDED)
def test_parameters_anywhere_within_their_bounds_cost_no_more_than_twenty_times_the_nominal(
    recording: str, smooth: bool
) -> None:
    inputs, rng = RECORDED[recording], np.random.default_rng(1)
    nominal = simulate(Motor(), inputs, smooth=smooth).steps
    assert inputs.time_s.size - 1 <= nominal <= 40 * inputs.time_s.size
    simulated = 0
    for effect in (None, *catalogue().values()):
        own = () if effect is None else (effect(**drawn(effect, rng)),)
        motor = replace(Motor(), **drawn(Motor, rng), effects=own)
        try:
            run = simulate(motor, inputs, smooth=smooth, most_steps=TIMES * nominal)
        except ModelError as error:
            assert "cannot go on at t = " in str(error)
            continue
        simulated += 1
        assert run.steps <= TIMES * nominal
        assert all(np.isfinite(y).all() for y in run.states.values())
    assert simulated >= 0.9 * len(catalogue())


def resonant() -> Motor:
    """Armature and rotor swing at ke / sqrt(L J) / 2 pi = 15.9 kHz, damped in R / 2 L = 0.1/s."""
    return Motor(R_a0=2e-4, L=1e-3, ke=1.0, J=1e-7, b=0.0)


@pytest.mark.parametrize("smooth", [False, True], ids=["real", "smooth"])
def test_a_motor_that_oscillates_faster_than_the_samples_is_refused_in_words(smooth: bool) -> None:
    time = np.arange(2000.0)
    inputs = Inputs(time, np.where(time % 2, 10.0, 0.0), 0 * time, 0 * time + 20.0, held=True)
    with pytest.raises(ModelError, match=r"oscillates there at 1\.59e\+04 Hz and samples are 1 s apart"):
        simulate(resonant(), inputs, smooth=smooth)
    with pytest.raises(ModelError, match="too many steps"):
        sensitivities(resonant(), inputs, None, ["J"], smooth=smooth, most_steps=5000)


def test_the_budget_is_what_is_tried() -> None:
    inputs = RECORDED["10 Hz"]
    needed = simulate(Motor(), inputs).steps
    assert simulate(Motor(), inputs, most_steps=needed).steps == needed
    with pytest.raises(ModelError, match="too much happens within a sample"):
        simulate(Motor(), inputs, most_steps=needed - 1)
    run, _ = sensitivities(Motor(), inputs, None, ["J"])
    assert run.steps == needed
    assert needed < STEPS_A_SAMPLE * inputs.time_s.size


def test_an_angle_that_races_within_a_sample_is_refused_in_words() -> None:
    motor = Motor(effects=(CoggingTorque(A=5.0, N=12.0),))
    with pytest.raises(ModelError, match=r"too much happens within a sample of 1 s"):
        simulate(motor, noisy(1.0, 240.0, 1.0))


def test_a_drive_is_stepped_within_a_budget_each_time() -> None:
    stepper = Stepper(resonant())
    for _ in range(3):
        stepper.step(10.0, 0.0, 20.0, 1e-3)
    with pytest.raises(ModelError, match="oscillates there"):
        stepper.step(10.0, 0.0, 20.0, 0.01 * STEPS_BESIDE)


@pytest.mark.parametrize("name", scenarios())
@pytest.mark.parametrize(
    "absurd",
    [{"b": 0.0, "J": 1e4, "ke": 1e3}, {"L": 1e-9, "R_a0": 1e3}, {"L": 0.0}, {"J": 1e-9, "R_a0": 1e-4}, {"H": 1e8}],
    ids=lambda values: ",".join(values),
)  # fmt: skip
def test_what_is_planned_from_fitted_values_is_bounded_before_it_is_allocated(
    name: str, absurd: dict[str, float]
) -> None:
    file = read_motor_file("models/motors/mellah2016.toml").with_values(absurd)
    plan = scenarios()[name]().plan(file, np.random.default_rng(0))
    rows = sum(phase.inputs.time_s.size for phase in plan.phases)
    assert 10 < rows <= 2 * ROWS_OF_ITS_OWN + 10


def test_a_length_beyond_all_memory_is_refused_in_words() -> None:
    assert grid(1.0, 1e-3).size == 1001
    with pytest.raises(ModelError, match=r"1e\+04 s sampled every 0.0001 s would have 1e\+08 rows"):
        grid(1e4, 1e-4)
    for period in (0.0, float("nan"), 0.5 / MOST_ROWS):
        with pytest.raises(ModelError, match="rows"):
            grid(1.0, period)
