"""The simulation against closed forms, conservation of energy and an integrator that shares nothing with it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
import pytest
from helpers.integrators import scipy_solution
from scipy.linalg import expm

from motorlens_physics.effect import Effect, State, catalogue
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, param
from motorlens_physics.simulation import Inputs, Stepper, simulate, simulate_batch
from motorlens_physics.symbols import trace
from motorlens_runtime.errors import DataError, ModelError

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
STATES = ("i", "w", "theta")


def constant(duration: float, samples: int, volts: float, load: float = 0.0) -> Inputs:
    time = np.linspace(0.0, duration, samples)
    return Inputs(time, np.full(samples, volts), np.full(samples, load), np.full(samples, 20.0), held=True)


def random_voltage(seed: int, samples: int, dt: float, *, held: bool, low: float = -240.0) -> Inputs:
    rng = np.random.default_rng(seed)
    volts = np.repeat(rng.uniform(low, 240.0, samples // 20 + 1), 20)[:samples]
    return Inputs(np.arange(samples) * dt, volts, np.zeros(samples), np.full(samples, 20.0), held)


def exact(motor: Motor, inputs: Inputs, start: tuple[float, float]) -> np.ndarray:
    """Current and speed of a motor with constant resistance, by the matrix exponential over each held sample."""
    a = np.array([[-motor.R_a0 / motor.L, -motor.ke / motor.L], [motor.ke / motor.J, -motor.b / motor.J]])
    x = [np.array(start)]
    for k, dt in enumerate(np.diff(inputs.time_s)):
        drive = np.array([inputs.voltage_V[k] / motor.L, -inputs.load_torque_Nm[k] / motor.J])
        rest = np.linalg.solve(a, -drive)
        x.append(rest + expm(a * dt) @ (x[-1] - rest))
    return np.array(x)


def test_a_constant_resistance_follows_the_matrix_exponential() -> None:
    motor = Motor(alpha=0.0)
    inputs = random_voltage(1, 400, 1e-3, held=True, low=100.0)
    run = simulate(motor, inputs, {"i": 3.0, "w": 120.0}, tolerance=1e-10)
    truth = exact(motor, inputs, (3.0, 120.0))
    np.testing.assert_allclose(run.current_A, truth[:, 0], atol=1e-8 * np.abs(truth[:, 0]).max())
    np.testing.assert_allclose(run.speed_rad_s, truth[:, 1], atol=1e-8 * truth[:, 1].max())


def test_the_step_converges_with_order_four() -> None:
    motor = Motor(alpha=0.0)
    errors = []
    for samples in (11, 21, 41, 81):
        # A tolerance of no bite leaves one step for each sample.
        inputs = constant(0.1, samples, 240.0, 5.0)
        run = simulate(motor, inputs, {"i": 3.0, "w": 120.0}, tolerance=1e9)
        truth = exact(motor, inputs, (3.0, 120.0))
        errors.append(np.abs(run.current_A - truth[:, 0]).max())
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert 3.7 < orders[-1] < 4.6, orders


@pytest.mark.parametrize("stiffness", [0.01, 1.0, 100.0])
def test_any_inductance_is_integrated_to_the_tolerance(stiffness: float) -> None:
    dt = 1e-3
    motor = replace(Motor(alpha=0.0), L=3.5 * dt / stiffness)
    inputs = random_voltage(2, 300, dt, held=True, low=100.0)
    truth = exact(motor, inputs, (3.0, 120.0))
    for tolerance in (1e-4, 1e-6, 1e-8):
        run = simulate(motor, inputs, {"i": 3.0, "w": 120.0}, tolerance=tolerance)
        assert np.abs(run.current_A - truth[:, 0]).max() < 10 * tolerance * np.abs(truth[:, 0]).max()


def test_without_inductance_the_current_is_what_ohm_says() -> None:
    motor = replace(Motor(alpha=0.0), L=0.0)
    inputs = random_voltage(3, 300, 1e-3, held=True, low=100.0)
    run = simulate(motor, inputs, {"w": 120.0}, tolerance=1e-9)
    a = -(motor.ke**2 / motor.R_a0 + motor.b) / motor.J
    w = [120.0]
    for volts in inputs.voltage_V[:-1]:
        rest = -motor.ke * volts / motor.R_a0 / motor.J / a
        w.append(rest + np.exp(a * 1e-3) * (w[-1] - rest))
    np.testing.assert_allclose(run.speed_rad_s, w, rtol=1e-8)
    # The value at a sample still belongs to the voltage held before it.
    np.testing.assert_allclose(
        run.current_A[1:], (inputs.voltage_V[:-1] - motor.ke * np.array(w)[1:]) / 3.5, atol=1e-6
    )


def test_a_vanishing_inductance_approaches_none() -> None:
    inputs = random_voltage(4, 300, 1e-3, held=True, low=100.0)
    none = simulate(replace(Motor(), L=0.0), inputs, {"w": 120.0}, tolerance=1e-9)
    tiny = simulate(replace(Motor(), L=1e-9), inputs, {"w": 120.0}, tolerance=1e-9)
    np.testing.assert_allclose(tiny.speed_rad_s, none.speed_rad_s, rtol=1e-6)
    np.testing.assert_allclose(tiny.rise_K, none.rise_K, rtol=1e-5, atol=1e-9)


@dataclass(frozen=True)
class Bookkeeping(Effect):
    """Integrates what goes in and what comes out; acts on nothing."""

    states: ClassVar[Mapping[str, State]] = {"drawn": State("J", "drawn"), "spent": State("J", "spent")}
    none: float = param(0.0, "1", "nothing", bounds=(0.0, 1.0), prior=1.0, null=0.0)

    def rates(self, m: Any, x: Any, u: Any) -> Mapping[str, Any]:
        return {"drawn": u.v * x.i, "spent": m.resistance(x.theta) * x.i**2 + m.b * x.w**2 + u.load * x.w}


def test_energy_is_conserved() -> None:
    motor = Motor(effects=(Bookkeeping(),))
    inputs = replace(random_voltage(5, 2001, 1e-3, held=True, low=120.0), load_torque_Nm=np.full(2001, 3.0))
    run = simulate(motor, inputs, {"w": 50.0}, tolerance=1e-12)
    stored = 0.5 * (motor.L * run.current_A**2 + motor.J * run.speed_rad_s**2)
    drawn, spent = run.states["drawn"], run.states["spent"]
    assert drawn[-1] > 1000.0
    np.testing.assert_allclose(drawn - spent, stored - stored[0], atol=1e-9 * drawn[-1])


def test_the_motor_of_the_paper_gives_the_figures_of_the_paper() -> None:
    # 60 A at 29 ms, 7.27 A, 221 rad/s and +31 % resistance after 140 min (IJACSA 7(7) 2016, section V).
    inrush = simulate(Motor(), constant(0.5, 5001, 240.0, 6.455))
    assert inrush.current_A.max() == pytest.approx(60.0, abs=0.05)
    assert inrush.inputs.time_s[inrush.current_A.argmax()] == pytest.approx(0.029, abs=0.001)
    warm = simulate(Motor(), constant(8400.0, 8401, 240.0, 6.455))
    assert warm.current_A[-1] == pytest.approx(7.271, abs=0.001)
    assert warm.speed_rad_s[-1] == pytest.approx(221.1, abs=0.05)
    assert warm.resistance_ohm[-1] / warm.resistance_ohm[0] == pytest.approx(1.31, abs=0.001)
    assert warm.temperature_C[-1] == pytest.approx(97.5, abs=0.05)


def test_an_inrush_inside_one_sample_is_resolved() -> None:
    coarse = simulate(Motor(), constant(10.0, 11, 240.0, 6.455), tolerance=1e-8)
    fine = simulate(Motor(), constant(10.0, 10001, 240.0, 6.455), tolerance=1e-8)
    for name in STATES:
        np.testing.assert_allclose(coarse.states[name], fine.states[name][::1000], rtol=1e-6)


EVERYTHING = Motor(effects=tuple(effect.at_null(PLATE) for effect in catalogue().values()))


@pytest.mark.parametrize("name", catalogue())
@pytest.mark.fit
def test_every_effect_agrees_with_scipy(name: str) -> None:
    # One structure holds the whole catalogue and is compiled once; all but one effect are at null.
    effect = catalogue()[name].typical(PLATE)
    held = name < "d"
    inputs = replace(random_voltage(6, 41, 4e-3, held=held), load_torque_Nm=np.linspace(-2.0, 3.0, 41))
    start = {"w": 60.0, "theta": 30.0} | {state: 1.0 for state in effect.states}
    run = simulate(EVERYTHING.with_effect(effect), inputs, start, tolerance=1e-9, smooth=True)
    plain = Motor(effects=(effect,))
    truth = scipy_solution(plain, inputs, start)
    for state, values in truth.items():
        scale = max(np.abs(values).max(), 1e-6)
        np.testing.assert_allclose(run.states[state], values, atol=1e-6 * scale, err_msg=state)
    without = simulate(EVERYTHING, inputs, start, tolerance=1e-9, smooth=True)
    # Slow effects show little in a sixth of a second, but they show.
    moved = [np.abs(run.states[s] - without.states[s]).max() / np.abs(truth[s]).max() for s in STATES]
    assert max(moved) > 1e-8


def test_time_may_be_irregular() -> None:
    rng = np.random.default_rng(7)
    time = np.cumsum(rng.uniform(1e-5, 5e-3, 500))
    volts = 100 + 100 * np.sin(30 * time)
    inputs = Inputs(time, volts, np.zeros(500), np.full(500, 20.0))
    run = simulate(Motor(), inputs, tolerance=1e-9)
    grid = np.linspace(time[0], time[-1], 20001)
    resampled = Inputs(grid, np.interp(grid, time, volts), 0 * grid, 0 * grid + 20.0)
    fine = simulate(Motor(), resampled, tolerance=1e-9)
    np.testing.assert_allclose(run.speed_rad_s, np.interp(time, grid, fine.speed_rad_s), atol=2e-3)


def test_a_batch_gives_what_single_runs_give() -> None:
    motors = [replace(Motor(), ke=ke) for ke in (0.8, 0.9, 1.0)]
    inputs = [random_voltage(seed, 200, 1e-3, held=True) for seed in range(3)]
    starts = [{"theta": 10.0 * k} for k in range(3)]
    for run, motor, own, start in zip(
        simulate_batch(motors, inputs, starts), motors, inputs, starts, strict=True
    ):
        alone = simulate(motor, own, start)
        for name in STATES:
            np.testing.assert_array_equal(run.states[name], alone.states[name])
    assert len(simulate_batch(motors[:1], inputs)) == 3
    with pytest.raises(DataError, match="2 motors, 3 inputs"):
        simulate_batch(motors[:2], inputs)


def test_a_stepper_goes_where_the_simulation_goes() -> None:
    inputs = random_voltage(8, 300, 1e-3, held=True)
    stepper = Stepper(Motor(), {"theta": 5.0})
    rows = [stepper.states]
    for volts in inputs.voltage_V[:-1]:
        rows.append(stepper.step(volts, 0.0, 20.0, 1e-3))
    run = simulate(Motor(), inputs, {"theta": 5.0})
    for name in STATES:
        scale = np.abs(run.states[name]).max()
        np.testing.assert_allclose([row[name] for row in rows], run.states[name], atol=1e-5 * scale)


def test_parameters_are_arguments_of_the_compiled_code() -> None:
    system = trace(Motor(R_a0=1.0))
    assert system == trace(Motor(R_a0=2.0))
    assert {str(p) for p in system.p} == {f"p_{k}" for k in range(10)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"time_s": np.array([0.0, 2.0, 1.0])}, "does not increase at sample 2"),
        ({"voltage_V": np.array([0.0, np.nan, 1.0])}, "voltage_V is not finite at sample 1"),
        ({"ambient_C": np.zeros(2)}, "ambient_C has shape"),
        ({"angle_rad": np.array([0.0, np.inf, 1.0])}, "angle_rad is not finite at sample 1"),
    ],
)
def test_inputs_that_make_no_sense_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    three = np.arange(3.0)
    with pytest.raises(DataError, match=message):
        Inputs(
            **({"time_s": three, "voltage_V": three, "load_torque_Nm": three, "ambient_C": three} | change)
        )


@pytest.mark.parametrize(
    ("motor", "start", "message"),
    [
        (Motor(), {"speed": 1.0}, "initial state 'speed': the motor has i, w, theta"),
        (Motor(), {"w": np.inf}, "'w' is not finite"),
        (Motor(J=0.0), {}, "J = 0: must be positive"),
        (Motor(ke=float("nan")), {}, "ke is not finite"),
    ],
)
def test_motors_that_make_no_sense_are_refused(motor: Motor, start: dict[str, float], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        simulate(motor, constant(1.0, 10, 12.0), start)


def test_a_motor_that_blows_up_is_reported_where_it_does() -> None:
    # Friction that drives: the speed doubles every fraction of a millisecond.
    with pytest.raises(ModelError, match="cannot go on at t = "):
        simulate(replace(Motor(), b=-100.0), constant(10.0, 1001, 240.0), {"w": 1.0})


def test_a_fit_does_not_wait_for_a_motor_that_never_settles() -> None:
    """Teeth that pass by thousands between two samples: the smooth form, which is for fitting, gives up."""
    toothed = Motor().with_effect(catalogue()["cogging_torque"].typical(PLATE))
    rarely = constant(1000.0, 11, 240.0)
    with pytest.raises(ModelError, match="cannot go on at t = "):
        simulate(toothed, rarely, smooth=True)
    assert np.isfinite(simulate(Motor(), rarely, smooth=True).speed_rad_s).all()
    often = constant(1.0, 1001, 240.0)
    assert np.isfinite(simulate(toothed, often, smooth=True).speed_rad_s).all()


@pytest.mark.parametrize("held", [False, True])
def test_what_goes_with_a_shaft_angle_that_is_known_goes_with_that_one(held: bool) -> None:
    """Teeth along an angle that is not the integral of the simulated speed, three a sample, against scipy."""
    toothed = Motor().with_effect(replace(catalogue()["cogging_torque"].typical(PLATE), A=2.0))
    inputs, start = random_voltage(3, 41, 2e-3, held=held, low=100.0), {"w": 150.0}
    angle = 0.8 * np.arange(41) + np.sin(0.3 * np.arange(41))
    known = replace(inputs, angle_rad=angle)
    truth, mine = scipy_solution(toothed, known, start), simulate(toothed, known, start, tolerance=1e-8)
    for name in STATES:
        np.testing.assert_allclose(mine.states[name], truth[name], atol=1e-5 * np.abs(truth[name]).max())
    np.testing.assert_array_equal(mine.states["phi"], angle)
    # Left to itself the shaft stands elsewhere, and the teeth with it.
    free = simulate(toothed, inputs, start)
    assert np.abs(free.speed_rad_s - mine.speed_rad_s).max() > 0.05


def test_each_input_runs_between_samples_in_its_own_way() -> None:
    # The same course on a grid ten times as fine, where what holds is a staircase and what runs linearly is interpolated.
    time = np.arange(60) * 0.05
    rng = np.random.default_rng(5)
    volts, load, ambient = rng.uniform(50, 240, 60), rng.uniform(0, 6, 60), 0 * time + 20.0
    fine = np.linspace(0, time[-1], 59 * 50 + 1)
    at = np.minimum(np.searchsorted(time, fine + 1e-9, side="right") - 1, 59)
    courses = {True: lambda y: y[at], False: lambda y: np.interp(fine, time, y)}
    for held in ((True, False, False), (False, True, False)):
        coarse = simulate(Motor(), Inputs(time, volts, load, ambient, held))
        finely = Inputs(fine, courses[held[0]](volts), courses[held[1]](load), 0 * fine + 20.0, held)
        speed = simulate(Motor(), finely).speed_rad_s[::50]
        np.testing.assert_allclose(coarse.speed_rad_s, speed, atol=0.02)
        other = simulate(Motor(), replace(coarse.inputs, held=not held[0])).speed_rad_s
        assert np.abs(other - speed).max() > 0.2
