"""The generator of recordings with hidden effects: its integrator against scipy's, its energy, its statistics."""

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.hidden import draw, generate, generate_again, information, motors, plant, world
from helpers.hidden import effects as hidden_effects
from scipy.integrate import solve_ivp

pytestmark = pytest.mark.fit

MOTOR = motors.MOTORS["servo_24V"]
# One of everything that is smooth while the rotor turns one way.
SMOOTH = {
    "brush_V": 0.5, "brush_i": 0.5, "dead_V": 0.3, "dead_i": 0.8, "L_sat": 2e-3, "L_speed": 5e-4, "K_B": 2e-4,
    "reaction": 5e-4, "magnet_k": 0.002, "magnet_tau": 50.0, "tau_c": 0.02, "tau_s": 0.02, "w_k": 20.0, "drag": 3e-7,
    "mu": 0.05, "tau_d": 0.01, "kappa": 0.01, "cog": 0.02, "cog_p": 0.4, "unbalance": 0.02, "iron_brake": 0.8,
    "tau_0": 0.01, "stray": 1e-6, "node_G": 0.3, "node_k": 0.4, "node_H": 900.0, "radiation": 0.1, "friction_heat": 0.4,
    "hysteresis": 0.01, "fan_n": 0.7, "fan_w": 308.0, "bump": 0.03, "bump_w": 120.0, "bump_width": 15.0,
    "bounce_R": 0.2, "bounce_w": 200.0, "run_in": 0.03, "run_in_tau": 0.7, "supply_R": 0.05, "coasting": 0.2,
    "bus_V": 24.0, "ripple": 0.03, "delay": 0.4, "delay_tau": 3.0,
}  # fmt: skip


def _inputs(n: int) -> np.ndarray:
    """Voltage up and halfway down, a load, a warming room, a bad contact and a weakening field; all linear pieces."""
    t = np.linspace(0, 1, n)
    return np.column_stack([
        np.interp(t, [0, 0.2, 0.6, 1], [6, 24, 24, 12]), np.interp(t, [0, 0.3, 0.4, 1], [0, 0, 0.4, 0.2]),
        10 * t, np.interp(t, [0, 0.5, 0.6, 1], [0, 0, 0.2, 0.1]), 1 - 0.05 * t,
    ])  # fmt: skip


@pytest.mark.parametrize(
    "hidden",
    [
        {},
        SMOOTH,
        {"shaft_k": 5.0, "shaft_c": 0.5, "shaft_gap": 0.1, "shaft_share": 0.4},
        {"bristle_k": 0.05, "bristle_tau": 0.03},
    ],
    ids=["textbook", "everything", "backlash", "presliding"],
)
def test_agrees_with_lsoda(hidden: dict[str, float]) -> None:
    p = plant.vector(**MOTOR.textbook, **hidden)
    dt, inputs = 1e-3, _inputs(1001)
    x0 = plant.rest(30.0, 20.0, 15.0)
    x0[plant.W] = 20.0
    ours = plant.simulate(dt, inputs, x0, p, substeps=64)
    grid = np.arange(len(inputs)) * dt

    def right_hand_side(t: float, x: np.ndarray) -> np.ndarray:
        out = np.zeros(plant.STATES)
        u = np.array([np.interp(t, grid, inputs[:, k]) for k in range(plant.INPUTS)])
        plant.rates(x, u, t, 1, False, p, out)
        return out

    theirs = solve_ivp(
        right_hand_side, (0, grid[-1]), x0, "LSODA", t_eval=grid, rtol=1e-9, atol=1e-10, max_step=dt / 2
    ).y.T
    assert (ours[:, plant.W] > 1.0).all()  # one way only: LSODA knows no stiction
    scale = np.abs(theirs).max(axis=0) + 1e-9
    # A backlash has corners that cost both integrators their order.
    tolerance = 1e-5 if "shaft_gap" in hidden else 1e-6
    worst = np.abs((ours - theirs) / scale).max(axis=0)
    assert worst.max() < tolerance, worst


def test_order_of_convergence_is_three() -> None:
    p = plant.vector(**MOTOR.textbook, drag=3e-7, reaction=5e-4)
    x0 = plant.rest()
    x0[plant.W] = 20.0
    inputs = _inputs(401)
    runs = [plant.simulate(2.5e-3, inputs, x0, p, k)[:, plant.I] for k in (16, 32, 64, 512)]
    coarse, middle, fine = (np.abs(run - runs[-1]).max() for run in runs[:3])
    assert 6.5 < coarse / middle < 9.5 and 6.5 < middle / fine < 9.5


@pytest.mark.parametrize(
    ("name", "size", "shape", "left", "left_by_four"),
    [
        ("commutation_ripple", 0.03, {"ripple_N": 6.0, "ripple_p": 0.4}, 0.0003, 0.04),
        ("cogging_torque", 0.0005, {"cog_N": 12.0, "cog_p": 0.4}, 0.0001, 0.1),
        ("unbalance_torque", 0.0005, {}, 0.015, 0.02),
    ],
)
def test_what_goes_with_the_angle_is_followed_as_fast_as_a_shaft_turns(
    monkeypatch: pytest.MonkeyPatch,
    name: str,
    size: float,
    shape: dict[str, float],
    left: float,
    left_by_four: float,
) -> None:
    """Against steps that are much shorter, as a share of what it does: four steps a sample are too few for a ripple."""
    case = world.Case(id="ripple", seed=4, motor="gear_12V", kind="single", records="fast", small=True)
    (record,) = world.records_of(case)
    few = slice(3500, 5000)  # in which it turns fastest
    assert record.drive.reference is None
    drive = replace(record.drive, voltage=record.drive.voltage[few], load=record.drive.load[few])
    record = replace(record, drive=drive, disturbance=record.disturbance[few])

    def current(hidden: list[world.Sized], steps: int | None) -> np.ndarray:
        with monkeypatch.context() as here:
            if steps is not None:
                here.setattr(world, "substeps", lambda *of: steps)
            states, inputs = world.run_truth(case, record, world.specimen(case), hidden)
        return states[:: (len(states) - 1) // (len(inputs) - 1), plant.I]

    hidden = [world.Sized(name, size, shape)]
    exact = current(hidden, 160)
    of_it = float(np.std(exact - current([], 160)))
    assert np.std(current(hidden, None) - exact) < left * of_it
    assert np.std(current(hidden, 4) - exact) > left_by_four * of_it


def test_a_rotor_stops_when_closed_form_says_and_stays() -> None:
    tau_c, j, b = 0.02, MOTOR.textbook["J"], MOTOR.textbook["b"]
    p = plant.vector(**(MOTOR.textbook | {"ke": 1e-9}), tau_c=tau_c)
    x0 = plant.rest()
    x0[plant.W] = 200.0
    inputs = np.zeros((1001, plant.INPUTS))
    inputs[:, plant.FLUX] = 1
    w = plant.simulate(1e-3, inputs, x0, p, 2)[:, plant.W]
    stop = j / b * np.log(1 + b * 200.0 / tau_c)
    t = np.arange(1001) * 1e-3
    expected = np.where(t < stop, (200.0 + tau_c / b) * np.exp(-b / j * t) - tau_c / b, 0.0)
    assert 0.2 < stop < 0.8
    np.testing.assert_allclose(w, expected, atol=2e-6)
    assert (w[t > stop] == 0).all()


def test_a_rotor_breaks_away_when_the_torque_exceeds_the_friction_and_not_before() -> None:
    tau_c = 0.05
    textbook = MOTOR.textbook | {"alpha": 0.0}
    p = plant.vector(**textbook, tau_c=tau_c)
    t = np.arange(4001) * 1e-3
    inputs = np.zeros((4001, plant.INPUTS))
    inputs[:, plant.VOLTAGE], inputs[:, plant.FLUX] = 0.5 * t, 1
    states = plant.simulate(1e-3, inputs, plant.rest(), p, 2)
    moving = t[np.argmax(states[:, plant.W] > 0)]
    # On a voltage ramp the current of a resting motor trails by L/R.
    expected = tau_c / textbook["ke"] * textbook["R"] / 0.5 + textbook["L"] / textbook["R"]
    assert expected <= moving <= expected + 2e-3
    assert (states[t < expected - 1e-3, plant.W] == 0).all()


def test_energy_in_is_energy_stored_and_lost() -> None:
    """First law for electrical and mechanical energy, with every loss on the right; quadrature by Simpson's rule."""
    from scipy.integrate import simpson

    hidden = {
        "brush_V": 0.5, "K_B": 2e-4, "tau_c": 0.02, "drag": 3e-7, "stray": 1e-6, "reaction": 5e-4, "hysteresis": 0.01,
        "ripple": 0.02, "iron_brake": 1.0,
    }  # fmt: skip
    p = plant.vector(**MOTOR.textbook, **hidden)
    inputs = _inputs(20_001)
    inputs[:, [plant.AMBIENT, plant.SERIES]] = 0
    x0 = plant.rest()
    x0[plant.W] = 20.0
    dt = 5e-5
    states = plant.simulate(dt, inputs, x0, p, 1)
    i, w, theta = states[:, plant.I], states[:, plant.W], states[:, plant.THETA]
    m = MOTOR.textbook
    power_in = inputs[:, plant.VOLTAGE] * i - inputs[:, plant.LOAD] * w
    loss = (
        (m["R"] * (1 + m["alpha"] * theta) + 2e-4 * w) * i**2 + 0.5 * i**2 / np.sqrt(i**2 + 0.05**2) + 0.03 * w
        + (m["b"] + m["k_ir"]) * w**2 + 3e-7 * w**3 + 1e-6 * (i * w) ** 2
    )  # fmt: skip
    stored = np.array([0.5 * m["L"] * i[k] ** 2 + 0.5 * m["J"] * w[k] ** 2 for k in (0, -1)])
    put_in, lost = simpson(power_in, dx=dt), simpson(loss, dx=dt)
    assert put_in > 20
    assert abs(put_in - lost - (stored[1] - stored[0])) < 1e-6 * put_in


def test_a_lag_settles_as_the_differential_equation_says() -> None:
    t = np.arange(400) * 1e-3
    ramp = np.maximum(t - 0.1, 0) * 50
    tau = 7e-3
    expected = np.where(t > 0.1, 50 * (t - 0.1 - tau * (1 - np.exp(-(t - 0.1) / tau))), 0.0)
    np.testing.assert_allclose(world.lagged(ramp, 1e-3, tau), expected, atol=1e-9)


def test_detectable_size_is_found_by_an_independent_fit_as_often_as_its_power_says() -> None:
    """Least squares of a thousand noisy records: an effect of the detectable size exceeds the threshold in 95 %."""
    rng = np.random.default_rng(5)
    column, base = rng.standard_normal(500), rng.standard_normal((500, 3))
    left = column - base @ np.linalg.lstsq(base, column, rcond=None)[0]
    size = information.POWER / np.linalg.norm(left)
    found = 0
    for _ in range(1000):
        y = size * column + base @ rng.standard_normal(3) + rng.standard_normal(500)
        fit, *_ = np.linalg.lstsq(np.column_stack([base, column]), y, rcond=None)
        found += abs(fit[-1]) * np.linalg.norm(left) > information.POWER - 1.645
    assert 930 <= found <= 968


def test_autoregression_whitens_a_coloured_noise() -> None:
    from scipy.signal import lfilter

    rng = np.random.default_rng(2)
    noise = lfilter([1.0], [1.0, -0.95], rng.standard_normal(50_000))
    coefficients, sd = information.autoregression(noise)
    white = lfilter(coefficients, [1.0], noise)[100:]
    assert abs(sd - 1) < 0.02
    assert abs(np.corrcoef(white[1:], white[:-1])[0, 1]) < 0.02


def test_twins_are_recognised_as_twins_and_strangers_are_not() -> None:
    case = world.Case("x", 11, "servo_24V", "single", records="both", small=True)
    known = information.Information(case)
    offset = world.Sized("load_torque_sensor_offset", 0.01)
    gain = world.Sized("current_sensor_gain", 0.03)
    brush = world.Sized("brush_voltage_drop", 0.3, {"brush_i": 0.16})
    assert known.judge([offset], [offset])[0].group() == ["constant_torque"]
    family = {f"{channel}_sensor_gain" for channel in ("voltage", "speed", "load_torque")}
    assert set(known.judge([gain], [gain])[0].group()) == family
    judged = known.judge([brush], [brush])[0]
    assert judged.group() == [] and judged.energy > 100


def test_detectable_size_grows_with_the_noise() -> None:
    sizes = []
    for noise in (0.01, 0.03):
        case = world.Case("x", 12, "gear_12V", "single", records="fast", noise=noise, small=True)
        effect = world.Sized("constant_torque", 1e-5)
        judged = information.Information(case).judge([effect], [effect])[0]
        sizes.append(1e-5 / np.sqrt(judged.energy))
    assert 1.5 < sizes[1] / sizes[0] < 3.5


KEY = Path(__file__).resolve().parents[2] / "benchmarks" / "hidden_effects" / "subset-key.jsonl"


@pytest.mark.parametrize(
    "name", ["subset-0024", "subset-0030", "subset-0031", "subset-0037", "subset-0038", "subset-0047"]
)
def test_the_recordings_hold_what_the_key_says(name: str, tmp_path: Path) -> None:
    """Generalised least squares on the files, with the generator's columns: the multiple of the hidden size is one."""
    truth = next(
        t for t in map(json.loads, KEY.read_text(encoding="utf-8").splitlines()) if t["case"]["id"] == name
    )
    made = generate_again(truth, tmp_path)
    hidden = tuple((told, factor) for told, factor in truth["case"]["hidden"])
    case = world.Case(**(truth["case"] | {"hidden": hidden}))
    known = information.Information(case)
    (told,) = truth["hidden"]
    null = 1.0 if told["name"].endswith("_gain") else 0.0  # the size of a gain is its distance from one
    sized = world.Sized(told["name"], told["size"] - null, told["shape"])
    left = []
    for half, record in zip(known.records, world.records_of(case), strict=True):
        path = next(p for p in made.recordings if p.stem == ("slow" if record.slow else "fast"))
        with path.open(encoding="utf-8") as file:
            names = file.readline().strip().split(",")
            columns = dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))
        left.append(half.left_by_textbook({c: columns[h] for c, h in world.HEADINGS.items() if h in columns}))
    y = np.concatenate(left)
    x = np.column_stack([known.base, known.column(sized)])
    information_matrix = x.T @ x + np.diag(np.r_[known.prior(), 0.0])
    multiple = float(np.linalg.solve(information_matrix, x.T @ y)[-1])
    sd = float(np.sqrt(np.linalg.inv(information_matrix)[-1, -1]))
    assert abs(sd * np.sqrt(told["energy"]) - 1) < 0.3
    assert abs(multiple - 1) < 4 * sd + 0.1


def test_the_same_case_gives_the_same_files_and_another_seed_others(tmp_path: Path) -> None:
    case = next(
        case for case in draw("subset", 60, small=True) if case.kind == "none" and case.records == "fast"
    )
    one, two = (generate(case, tmp_path / name) for name in "ab")
    assert one.recordings[0].read_bytes() == two.recordings[0].read_bytes()
    from dataclasses import replace

    other = generate(replace(case, seed=case.seed + 1), tmp_path / "c")
    assert other.recordings[0].read_bytes() != one.recordings[0].read_bytes()


def test_a_plan_holds_every_effect_and_the_shares_asked_for() -> None:
    cases = draw("test", 1200)
    kinds = [case.kind for case in cases]
    assert [kinds.count(kind) for kind in ("none", "pair", "outside")] == [300, 180, 180]
    singles = {hidden for case in cases if case.kind == "single" for hidden in case.hidden}
    names = (*hidden_effects.CATALOGUE, *hidden_effects.SENSOR_NAMES)
    assert singles == {(name, factor) for name in names for factor in (1.0, 3.0, 10.0)}
    assert {name for case in cases if case.kind == "outside" for name, _ in case.hidden} == set(
        hidden_effects.OUTSIDE
    )
    assert not {case.seed for case in cases} & {case.seed for case in draw("dev", 400)}


def test_the_generator_imports_nothing_of_ours() -> None:
    for path in Path(information.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any(name.startswith("motorlens") for name in names), f"{path}: {names}"
