"""Sensitivities against differences of simulations, of scipy's as well as of our own."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.integrators import scipy_solution
from scipy.linalg import expm

from motorlens_physics.effect import catalogue
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.inductance_saturation import InductanceSaturation
from motorlens_physics.effects.quadratic_drag import QuadraticDrag
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.motor import Motor
from motorlens_physics.parameter import Rated, parameters
from motorlens_physics.sensitivity import linearise, linearise_and_differentiate, sensitivities
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.errors import ModelError

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
KEYS = tuple(parameters(Motor))
STATES = ("i", "w", "theta")


def drive(seed: int, samples: int, *, low: float = -240.0, held: bool = True) -> Inputs:
    rng = np.random.default_rng(seed)
    volts = np.repeat(rng.uniform(low, 240.0, samples // 50 + 1), 50)[:samples]
    load = np.full(samples, 2.0 if low > 0 else 0.0)
    return Inputs(np.arange(samples) * 2e-3, volts, load, np.full(samples, 20.0), held)


def difference(
    above: dict[str, np.ndarray], below: dict[str, np.ndarray], step: float
) -> dict[str, np.ndarray]:
    return {name: (above[name] - below[name]) / step for name in STATES}


def assert_close(
    mine: dict[str, np.ndarray], truth: dict[str, np.ndarray], tolerance: float, what: str
) -> None:
    for name in STATES:
        scale = np.abs(truth[name]).max()
        np.testing.assert_allclose(mine[name], truth[name], atol=tolerance * scale, err_msg=f"{what}: {name}")


@pytest.mark.parametrize("key", KEYS)
def test_parameters_agree_with_differences_of_scipy(key: str) -> None:
    motor, inputs, start = Motor(), drive(1, 51, low=100.0, held=False), {"w": 80.0, "theta": 40.0}
    step = 1e-4 * getattr(motor, key)
    above, below = (
        scipy_solution(replace(motor, **{key: getattr(motor, key) + s * step}), inputs, start)
        for s in (1, -1)
    )
    _, mine = sensitivities(motor, inputs, start, [key], tolerance=1e-8)
    assert_close(mine[key], difference(above, below, 2 * step), 1e-4, key)


@pytest.mark.parametrize("key", ["ke", "J", "commutation_ripple.eps", "commutation_ripple.p"])
def test_along_a_shaft_angle_that_is_known_they_agree_with_differences_of_scipy(key: str) -> None:
    """A parameter that turns the motor faster does not move the teeth."""
    ripple = replace(catalogue()["commutation_ripple"].typical(PLATE), eps=0.03, N=8.0, p=0.7)
    motor, start = Motor().with_effect(ripple), {"w": 150.0, "theta": 40.0}
    inputs = replace(drive(1, 51, low=100.0, held=False), angle_rad=0.3 * np.arange(51.0))

    def moved(by: float) -> Motor:
        owner, _, name = key.rpartition(".")
        if not owner:
            return replace(motor, **{name: getattr(motor, name) + by})
        return Motor().with_effect(replace(ripple, **{name: getattr(ripple, name) + by}))

    step = 1e-2 if "." in key else 1e-4 * getattr(motor, key)
    above, below = (scipy_solution(moved(s * step), inputs, start) for s in (1, -1))
    _, mine = sensitivities(motor, inputs, start, [key], tolerance=1e-8)
    assert set(mine[key]) == set(STATES)
    assert_close(mine[key], difference(above, below, 2 * step), 1e-4, key)
    _, one_pass, linear = linearise_and_differentiate(motor, inputs, start, [key], tolerance=1e-8)
    assert linear.states == STATES
    assert_close(one_pass[key], mine[key], 1e-9, key)


@pytest.mark.fit
@pytest.mark.parametrize(
    "key", [*KEYS, "coulomb_friction.tau_c", "initial.theta", "initial.i", "input.load_torque"]
)
@pytest.mark.parametrize("smooth", [True, False], ids=["smooth", "real"])
def test_friction_that_stops_and_holds_is_differentiated_through(key: str, smooth: bool) -> None:
    motor = Motor(effects=(CoulombFriction(tau_c=0.6),))
    inputs, start = drive(2, 1500), {"theta": 10.0, "w": 30.0, "i": 1.0}
    inputs = replace(inputs, voltage_V=0.02 * inputs.voltage_V)
    run, mine = sensitivities(motor, inputs, start, [key], tolerance=1e-8, smooth=smooth)
    if not smooth:
        assert (run.speed_rad_s == 0).sum() > 50
        assert (np.diff(np.sign(run.speed_rad_s)) != 0).sum() > 5

    def moved(sign: int) -> dict[str, np.ndarray]:
        changed, acting, at = motor, inputs, dict(start)
        owner, _, name = key.rpartition(".")
        if owner == "initial":
            at[name] += sign * step
        elif owner == "input":
            acting = replace(inputs, load_torque_Nm=inputs.load_torque_Nm + sign * step)
        elif owner:
            changed = Motor(effects=(CoulombFriction(tau_c=0.6 + sign * step),))
        else:
            changed = replace(motor, **{key: getattr(motor, key) + sign * step})
        return dict(simulate(changed, acting, at, tolerance=1e-11, smooth=smooth).states)

    # Weak parameters take a larger step to stand out of the tolerance.
    steps = {
        "initial": 1e-3,
        "input": 1e-5,
        "b": 1e-3 * motor.b,
        "kT": 0.1 * motor.kT,
        "k_ir": 0.1 * motor.k_ir,
    }
    step = steps.get(key.partition(".")[0], 1e-5 * (0.6 if "." in key else getattr(motor, key)))
    assert_close(mine[key], difference(moved(1), moved(-1), 2 * step), 2e-3, key)


NULLS = {name: effect.at_null(PLATE) for name, effect in catalogue().items()}
EVERYTHING = Motor(effects=tuple(NULLS.values()))
# Terms that turn over within a fraction of the step that the motor without them needs.
SHARP = {"brush_voltage_drop": 0.05, "dead_time": 0.05, "cogging_torque": 0.05, "stribeck_friction": 0.05}


@pytest.fixture(scope="module")
def candidates() -> tuple[Inputs, dict[str, dict[str, np.ndarray]]]:
    inputs = drive(3, 1500)
    _, responses = sensitivities(
        Motor(),
        inputs,
        {"theta": 20.0, "w": 20.0},
        ["R_a0"],
        list(NULLS.values()),
        tolerance=1e-7,
        smooth=True,
    )
    return inputs, responses


@pytest.mark.fit
@pytest.mark.parametrize("name", NULLS)
def test_every_candidate_at_its_null_agrees_with_a_difference(
    name: str, candidates: tuple[Inputs, dict[str, dict[str, np.ndarray]]]
) -> None:
    inputs, responses = candidates
    switch = NULLS[name].switch()
    # Small enough to be a derivative, large enough to stand out of the tolerance.
    typical = getattr(catalogue()[name].typical(PLATE), switch.name)
    step = 1e-3 * (typical - switch.null)

    def moved(share: float) -> dict[str, np.ndarray]:
        effect = replace(NULLS[name], **{switch.name: switch.null + share * step})
        changed = EVERYTHING.with_effect(effect)
        return dict(
            simulate(changed, inputs, {"theta": 20.0, "w": 20.0}, tolerance=1e-11, smooth=True).states
        )

    here, there, further = moved(0.0), moved(1.0), moved(2.0)
    # One-sided of second order: many switches have no other side.
    truth = {s: (4 * there[s] - 3 * here[s] - further[s]) / (2 * step) for s in STATES}
    assert_close(responses[f"{name}.{switch.name}"], truth, SHARP.get(name, 5e-3), name)


def test_candidates_leave_the_motor_as_it_is() -> None:
    inputs = drive(4, 500)
    alone = simulate(Motor(), inputs)
    run, responses = sensitivities(Motor(), inputs, None, [], [NULLS["two_node_thermal"], NULLS["radiation"]])
    assert list(run.states) == ["i", "w", "theta"]
    assert set(responses) == {"two_node_thermal.G_h", "radiation.G_r"}
    for name in STATES:
        np.testing.assert_allclose(run.states[name], alone.states[name], rtol=1e-5, atol=1e-6)


@pytest.mark.fit
@pytest.mark.parametrize(
    "motor",
    [Motor(), Motor(effects=(QuadraticDrag(c=1e-5),)), Motor(effects=(InductanceSaturation(s=0.02),))],
    ids=["plain", "drag", "saturating"],
)
@pytest.mark.parametrize("held", [True, False], ids=["held", "linear"])
def test_forcings_respond_as_small_changes_of_the_inputs(motor: Motor, held: bool) -> None:
    inputs = drive(5, 800, low=60.0, held=held)
    rng = np.random.default_rng(6)
    volts, torque = rng.standard_normal((2, 800))
    run, linear = linearise(motor, inputs, {"w": 50.0}, tolerance=1e-8)
    for forcing, change in (
        ({"voltage_V": volts[:, None]}, {"voltage_V": inputs.voltage_V + 1e-3 * volts}),
        ({"torque_Nm": torque[:, None]}, {"load_torque_Nm": inputs.load_torque_Nm - 1e-3 * torque}),
    ):
        mine = linear.respond(**forcing, held=held)
        changed = simulate(motor, replace(inputs, **change), {"w": 50.0}, tolerance=1e-11)
        before = simulate(motor, inputs, {"w": 50.0}, tolerance=1e-11)
        truth = difference(dict(changed.states), dict(before.states), 1e-3)
        assert_close({name: y[:, 0] for name, y in mine.items()}, truth, 3e-3, str(forcing.keys()))
    np.testing.assert_array_equal(
        run.speed_rad_s, simulate(motor, inputs, {"w": 50.0}, tolerance=1e-8).speed_rad_s
    )


@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("held", [True, False], ids=["held", "linear"])
def test_a_state_released_goes_on_as_a_run_that_starts_there(state: str, held: bool) -> None:
    motor, inputs, first = Motor(effects=(QuadraticDrag(c=1e-5),)), drive(5, 800, low=60.0, held=held), 300
    run, linear = linearise(motor, inputs, {"w": 50.0}, tolerance=1e-8)
    mine = {name: y[:, 1] for name, y in linear.released(state, [500, first]).items()}
    tail = replace(
        inputs,
        **{
            name: getattr(inputs, name)[first:]
            for name in ("time_s", "voltage_V", "load_torque_Nm", "ambient_C")
        },
    )
    there = {name: float(values[first]) for name, values in run.states.items()}
    _, truth = sensitivities(motor, tail, there, [f"initial.{state}"], tolerance=1e-8)
    for name in STATES:
        assert (mine[name][:first] == 0).all()
    assert_close({name: mine[name][first:] for name in STATES}, truth[f"initial.{state}"], 3e-3, state)


@pytest.mark.parametrize("sample_s", [1e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 30.0])
@pytest.mark.parametrize(
    ("inductance", "inertia", "off"),
    [(1.0, 1.0, 2e-3), (1e-3, 1.0, 2e-3), (1.5, 0.13, 4e-3), (20.0, 0.1, 2e-2)],
    ids=["creeps", "creeps, no inductance", "oscillates", "rings"],
)
def test_a_steady_motor_is_linearised_as_the_matrix_exponential_says(
    sample_s: float, inductance: float, inertia: float, off: float
) -> None:
    # Where nothing changes, a step of the simulation is as long as a sample, however many time constants that is.
    motor = Motor(alpha=0.0)
    motor = replace(motor, L=inductance * motor.L, J=inertia * motor.J)
    speed = 200.0 / (motor.ke + motor.R_a0 * motor.b / motor.ke)
    start = {"w": speed, "i": motor.b * speed / motor.ke}
    constant = np.ones(4)
    inputs = Inputs(sample_s * np.arange(4.0), 200.0 * constant, 0.0 * constant, 20.0 * constant, held=False)
    trajectory, linear = linearise(motor, inputs, start)
    assert np.allclose(trajectory.states["w"], speed, rtol=1e-9)
    # States i and w, a forcing of either balance, and how far the sample has gone, in units that are as large.
    units = np.sqrt([motor.L, motor.J])
    circuit = np.array(
        [[-motor.R_a0 / motor.L, -motor.ke / motor.L], [motor.ke / motor.J, -motor.b / motor.J]]
    )
    scaled = units[:, None] * circuit / units
    for balance in range(2):
        rates = np.zeros((4, 4))
        rates[:2, :2], rates[balance, 2], rates[2, 3] = scaled * sample_s, 1.0, 1.0
        exact = expm(rates)
        ours = linear.matrices[1, :2, :2] * units[:, None] / units
        np.testing.assert_allclose(ours, exact[:2, :2], atol=off)
        # In units of what a forcing that holds would do to its own state.
        size = sample_s / units[balance]
        first, last = (linear.matrices[1, :2, at + balance] * units / size for at in (3, 6))
        reach = np.abs(exact[:2, 2]).max()
        np.testing.assert_allclose(first, exact[:2, 2] - exact[:2, 3], atol=off * reach)
        np.testing.assert_allclose(last, exact[:2, 3], atol=off * reach)


def test_one_pass_gives_what_two_give() -> None:
    motor, inputs = Motor(effects=(QuadraticDrag(c=1e-5),)), drive(5, 300, low=60.0)
    keys = ["ke", "initial.theta", "quadratic_drag.c"]
    run, derivatives, linear = linearise_and_differentiate(motor, inputs, {"w": 50.0}, keys)
    assert list(derivatives) == keys
    _, alone = sensitivities(motor, inputs, {"w": 50.0}, keys)
    other, matrices = linearise(motor, inputs, {"w": 50.0})
    np.testing.assert_array_equal(linear.matrices, matrices.matrices)
    for name in STATES:
        np.testing.assert_array_equal(run.states[name], other.states[name])
        for key in keys:
            np.testing.assert_array_equal(derivatives[key][name], alone[key][name])


def test_a_constant_heat_warms_as_the_thermal_equation_says() -> None:
    # A motor at rest: H ds/dt = 1 - k0 s.
    motor = Motor()
    time = np.linspace(0.0, 9000.0, 901)
    rest = Inputs(time, 0 * time, 0 * time, 0 * time + 20.0)
    _, linear = linearise(motor, rest)
    response = linear.respond(heat_W=np.ones((901, 1)))
    by_hand = (1 - np.exp(-motor.k0 / motor.H * time)) / motor.k0
    np.testing.assert_allclose(response["theta"][:, 0], by_hand, rtol=1e-6, atol=1e-9)
    assert (response["w"] == 0).all()


@pytest.mark.parametrize(
    ("keys", "candidates", "message"),
    [
        (["R"], [], "'R': the parameter is not there; there are R_a0"),
        (["stribeck_friction.w_s"], [], "is fixed"),
        (["initial.phi"], [], "the motor's states are i, w, theta"),
        ([], [CoulombFriction()], "'coulomb_friction' is in the motor already"),
    ],
)
def test_keys_that_are_not_there_are_refused(
    keys: list[str], candidates: list[CoulombFriction], message: str
) -> None:
    motor = Motor(effects=(CoulombFriction(tau_c=0.1), StribeckFriction(tau_s=0.1)))
    with pytest.raises(ModelError, match=message):
        sensitivities(motor, drive(7, 50), None, keys, candidates)


def test_forcings_of_the_wrong_length_are_refused() -> None:
    _, linear = linearise(Motor(), drive(8, 50))
    with pytest.raises(ModelError, match=r"\(50, m\)"):
        linear.respond(voltage_V=np.zeros((49, 1)))
