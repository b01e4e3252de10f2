"""Terminals that are driven, open, shorted or current-controlled; a shaft that is free, locked or turned."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from motorlens_physics.conditions import Shaft, Terminal, code, codes
from motorlens_physics.effects.brush_voltage_drop import BrushVoltageDrop
from motorlens_physics.effects.coasting_bridge import CoastingBridge
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.inductance_saturation import InductanceSaturation
from motorlens_physics.effects.supply_resistance import SupplyResistance
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.parameter import parameters
from motorlens_physics.recording import Recording, inputs_of, read_recording, under, write_recording
from motorlens_physics.scenario import perform, scenarios
from motorlens_physics.sensitivity import linearise, sensitivities
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.cli import main
from motorlens_runtime.errors import DataError
from motorlens_runtime.files.words import WORDS

# Without the heat, whose effect on R no closed form has.
COLD = Motor(alpha=0.0)


def inputs(seconds: float, samples: int, volts: float = 0.0, *, held: bool = False, **tied: object) -> Inputs:
    time = np.linspace(0.0, seconds, samples)
    constant = {name: np.full(samples, value) for name, value in tied.items()}
    return Inputs(
        time, np.full(samples, volts), 0 * time, 0 * time + 20.0, held,
        constant.get("terminal"), constant.get("shaft"), constant.get("current_A"), constant.get("speed_rad_s"),
    )  # fmt: skip


@pytest.mark.parametrize("smooth", [False, True])
def test_an_open_armature_coasts_down_exponentially_and_shows_its_back_emf(smooth: bool) -> None:
    motor, given = COLD, inputs(30.0, 61, 150.0, terminal=Terminal.OPEN)
    keys = ["b", "J", "ke", "R_a0", "L", "input.voltage", "initial.w"]
    run, slope = sensitivities(motor, given, {"w": 200.0, "i": 5.0}, keys, tolerance=1e-9, smooth=smooth)
    t, w = given.time_s, 200.0 * np.exp(-motor.b / motor.J * given.time_s)
    assert (run.current_A == 0).all()
    np.testing.assert_allclose(run.speed_rad_s, w, rtol=1e-7)
    np.testing.assert_allclose(run.voltage_V, motor.ke * w, rtol=1e-7)
    for key, by_hand in {
        "b": -t / motor.J * w,
        "J": motor.b * t / motor.J**2 * w,
        "initial.w": w / 200.0,
        "ke": 0 * t,
        "R_a0": 0 * t,
        "L": 0 * t,
        "input.voltage": 0 * t,
    }.items():
        np.testing.assert_allclose(slope[key]["w"], by_hand, rtol=1e-5, atol=1e-9, err_msg=key)
        of_voltage = motor.ke * by_hand + (w if key == "ke" else 0.0)
        np.testing.assert_allclose(slope[key]["v"], of_voltage, rtol=1e-5, atol=1e-9, err_msg=key)
        assert (slope[key]["i"] == 0).all()


@pytest.mark.parametrize("inductance", [0.034, 0.0])
def test_the_current_of_a_locked_rotor_rises_in_its_time_constant(inductance: float) -> None:
    motor, given = replace(COLD, L=inductance), inputs(0.05, 51, 24.0, shaft=Shaft.LOCKED)
    run, slope = sensitivities(motor, given, {"w": 50.0}, ["R_a0", "L", "ke", "initial.w"], tolerance=1e-9)
    t, final = given.time_s[1:], 24.0 / motor.R_a0
    x = motor.R_a0 * t / motor.L if motor.L else np.full(t.size, np.inf)
    assert (run.speed_rad_s == 0).all()
    np.testing.assert_allclose(run.current_A[1:], final * (1 - np.exp(-x)), rtol=1e-7)
    assert (run.voltage_V == 24.0).all()
    if motor.L:
        np.testing.assert_allclose(slope["L"]["i"][1:], -final * x / motor.L * np.exp(-x), rtol=1e-5)
    by_R = -final / motor.R_a0 * (1 - np.exp(-x) - (x * np.exp(-x) if motor.L else 0.0))
    np.testing.assert_allclose(slope["R_a0"]["i"][1:], by_R, rtol=1e-5)
    for key in ("ke", "initial.w"):
        assert all((slope[key][state] == 0).all() for state in ("i", "w", "v"))


def test_a_shorted_armature_brakes_in_the_mechanical_time_constant() -> None:
    motor = replace(COLD, L=0.0, b=0.0)
    # The voltage on record is that of a sensor nobody should believe.
    given = inputs(0.5, 51, 99.0, terminal=Terminal.SHORTED)
    run, slope = sensitivities(motor, given, {"w": 100.0}, ["R_a0", "input.voltage"], tolerance=1e-9)
    rate = motor.ke**2 / motor.R_a0 / motor.J
    w = 100.0 * np.exp(-rate * given.time_s)
    np.testing.assert_allclose(run.speed_rad_s, w, rtol=1e-6)
    np.testing.assert_allclose(run.current_A[1:], -motor.ke / motor.R_a0 * w[1:], rtol=1e-6)
    np.testing.assert_allclose(slope["R_a0"]["w"], rate * given.time_s / motor.R_a0 * w, rtol=1e-4, atol=1e-9)
    assert (run.voltage_V == 0).all()
    assert (slope["input.voltage"]["w"] == 0).all()


@pytest.mark.parametrize("inductance", [0.034, 0.0])
def test_a_current_controlled_drive_gives_the_voltage_it_takes(inductance: float) -> None:
    motor, time = replace(COLD, L=inductance), np.linspace(0.0, 2.0, 201)
    given = replace(inputs(2.0, 201, terminal=Terminal.CURRENT, current_A=0.0), current_A=3.0 * time)
    keys = ["R_a0", "L", "ke", "J", "input.current", "input.load_torque"]
    run, slope = sensitivities(replace(motor, b=0.0), given, {"w": 10.0}, keys, tolerance=1e-9)
    w = 10.0 + motor.ke / motor.J * 1.5 * time**2
    np.testing.assert_allclose(run.current_A, 3.0 * time, atol=1e-12)
    np.testing.assert_allclose(run.speed_rad_s, w, rtol=1e-8)
    np.testing.assert_allclose(
        run.voltage_V, motor.R_a0 * 3.0 * time + motor.ke * w + 3.0 * motor.L, rtol=1e-8
    )
    gained = motor.ke / motor.J * time
    for key, by_hand in {
        "R_a0": (0 * time, 3.0 * time),
        "ke": ((w - 10.0) / motor.ke, w + w - 10.0),
        "J": (-(w - 10.0) / motor.J, -motor.ke * (w - 10.0) / motor.J),
        "input.current": (gained, motor.R_a0 + motor.ke * gained),
        "input.load_torque": (-time / motor.J, -motor.ke * time / motor.J),
    }.items():
        np.testing.assert_allclose(slope[key]["w"], by_hand[0], rtol=1e-6, atol=1e-9, err_msg=key)
        np.testing.assert_allclose(slope[key]["v"], by_hand[1], rtol=1e-6, atol=1e-9, err_msg=key)
    if motor.L:
        np.testing.assert_allclose(slope["L"]["v"], 3.0, rtol=1e-9)


def test_a_shaft_that_is_turned_makes_a_generator() -> None:
    time = np.linspace(0.0, 0.2, 401)
    speed = 100.0 * np.sin(30.0 * time)
    given = replace(inputs(0.2, 401, shaft=Shaft.TURNED, speed_rad_s=0.0), speed_rad_s=speed)
    run, slope = sensitivities(COLD, given, None, ["input.speed", "J"], tolerance=1e-9)
    np.testing.assert_allclose(run.speed_rad_s, speed, atol=1e-9)
    # L di/dt = -R i - ke 100 sin(a t)
    R, L, a = COLD.R_a0, COLD.L, 30.0
    by_hand = (
        -COLD.ke
        * 100.0
        / (R**2 + (a * L) ** 2)
        * (R * np.sin(a * time) - a * L * np.cos(a * time) + a * L * np.exp(-R / L * time))
    )
    np.testing.assert_allclose(run.current_A, by_hand, atol=3e-4 * np.abs(by_hand).max())
    np.testing.assert_allclose(
        slope["input.speed"]["i"], -COLD.ke / R * (1 - np.exp(-R / L * time)), atol=1e-6
    )
    assert (slope["J"]["i"] == 0).all()


def test_an_imposed_current_is_a_source_behind_a_resistance_that_dwarfs_the_armature() -> None:
    """Norton's source, as `--driven` of the workbench builds it, is the second implementation."""
    rng = np.random.default_rng(0)
    current = 4.0 + 2.0 * np.repeat(rng.standard_normal(51), 10)[:501].cumsum() / 10
    given = replace(
        inputs(5.0, 501, terminal=Terminal.CURRENT, current_A=0.0),
        current_A=current,
        load_torque_Nm=np.full(501, 1.0),
    )
    exact = simulate(Motor(), given)
    resistance = 1e8
    fed = replace(Motor(), L=resistance * 1e-6, effects=(SupplyResistance(R_s=resistance),))
    source = simulate(fed, replace(given, terminal=None, voltage_V=resistance * current), {"i": current[0]})
    np.testing.assert_allclose(source.speed_rad_s, exact.speed_rad_s, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(source.rise_K, exact.rise_K, rtol=1e-4, atol=1e-6)


# Driven, open, shorted, current-controlled and driven again; free, locked, free and turned meanwhile.
SWITCHED = Inputs(
    np.arange(1001) * 2e-3,
    np.full(1001, 120.0),
    np.where(np.arange(1001) < 700, 0.5, 0.2),
    np.full(1001, 20.0),
    True,
    np.repeat([0, 1, 2, 3, 0, 0], [200, 150, 150, 200, 150, 151]),
    np.repeat([0, 1, 0, 2], [730, 70, 100, 101]),
    5.0 + np.sin(np.arange(1001) / 20),
    np.linspace(0.0, 60.0, 1001),
)
FULL = Motor(
    effects=(CoulombFriction(tau_c=0.4), BrushVoltageDrop(V_b=2.0, i_s=0.5), InductanceSaturation(s=0.002))
)


def test_a_sample_shows_what_is_so_from_then_on() -> None:
    run = simulate(FULL, SWITCHED)
    terminal, shaft = SWITCHED.terminal, SWITCHED.shaft
    assert terminal is not None and shaft is not None
    assert SWITCHED.current_A is not None and SWITCHED.speed_rad_s is not None
    assert (run.current_A[terminal == Terminal.OPEN] == 0).all()
    assert run.current_A[199] > 1.0
    np.testing.assert_array_equal(
        run.current_A[terminal == Terminal.CURRENT], SWITCHED.current_A[terminal == Terminal.CURRENT]
    )
    assert (run.speed_rad_s[shaft == Shaft.LOCKED] == 0).all()
    assert run.speed_rad_s[729] > 1.0
    turned = shaft == Shaft.TURNED
    np.testing.assert_allclose(run.speed_rad_s[turned], SWITCHED.speed_rad_s[turned], rtol=1e-12)
    assert (run.voltage_V[terminal == Terminal.SHORTED] == 0).all()
    assert (run.voltage_V[terminal == Terminal.DRIVEN] == 120.0).all()


def test_a_part_of_the_samples_is_simulated_as_in_the_whole() -> None:
    whole = simulate(FULL, SWITCHED, tolerance=1e-9)
    first = 450
    state = {name: float(y[first]) for name, y in whole.states.items()}
    part = simulate(FULL, SWITCHED.part(slice(first, 900)), state, tolerance=1e-9)
    for name in ("i", "w", "theta"):
        np.testing.assert_allclose(part.states[name], whole.states[name][first:900], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(part.voltage_V[1:-1], whole.voltage_V[first + 1 : 899], rtol=1e-5, atol=1e-4)


def test_energy_is_conserved_between_the_switches() -> None:
    motor = Motor(k_ir=0.0, effects=(CoulombFriction(tau_c=0.4),))
    fine = np.arange(20001) * 1e-4
    at = np.minimum((np.arange(20001) // 20), 1000)
    assert SWITCHED.terminal is not None and SWITCHED.shaft is not None and SWITCHED.current_A is not None
    given = Inputs(
        fine, SWITCHED.voltage_V[at], SWITCHED.load_torque_Nm[at], SWITCHED.ambient_C[at], False,
        SWITCHED.terminal[at], np.minimum(SWITCHED.shaft[at], Shaft.LOCKED), 5.0 + np.sin(fine * 25.0),
    )  # fmt: skip
    run = simulate(motor, given, tolerance=1e-9)
    i, w = run.current_A, run.speed_rad_s
    lost = run.resistance_ohm * i**2 + motor.b * w**2 + 0.4 * np.abs(w) + given.load_torque_Nm * w
    stored = 0.5 * motor.L * i**2 + 0.5 * motor.J * w**2
    assert given.terminal is not None and given.shaft is not None
    tied = given.terminal + 10 * given.shaft
    edges = [0, *(np.flatnonzero(np.diff(tied)) + 1), fine.size - 1]
    assert len(edges) == 9
    for first, last in pairwise(edges):
        # The last sample of a stretch belongs to the next.
        part = slice(first, last)
        volts = run.voltage_V[part]
        taken = np.trapezoid(volts * i[part] - lost[part], fine[part])
        gained = stored[last - 1] - stored[first]
        turnover = np.trapezoid(np.abs(volts * i[part]) + lost[part], fine[part]) + np.abs(gained)
        assert abs(taken - gained) < 2e-4 * max(turnover, 1e-3), (first, last)


KEYS = [
    *parameters(Motor), "coulomb_friction.tau_c", "brush_voltage_drop.V_b", "inductance_saturation.s",
    "initial.w", "initial.theta", "input.voltage", "input.load_torque", "input.current", "input.speed",
]  # fmt: skip
STEPS = {"kT": 1e-2, "k_ir": 1e-3, "alpha": 1e-5, "k0": 1e-2, "H": 10.0, "inductance_saturation.s": 1e-6}


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize("smooth", [False, True], ids=["real", "smooth"])
def test_sensitivities_through_all_switches_agree_with_differences(key: str, smooth: bool) -> None:
    start = {"w": 20.0, "theta": 30.0}
    _, slope = sensitivities(FULL, SWITCHED, start, [key], tolerance=1e-9, smooth=smooth)
    step = STEPS.get(key, 1e-5 * max(getattr(FULL, key, 1.0), 1e-3))

    def moved(sign: int) -> dict[str, np.ndarray]:
        owner, _, name = key.rpartition(".")
        motor, given, initial = FULL, SWITCHED, dict(start)
        change = sign * step
        if owner == "initial":
            initial[name] += change
        elif owner == "input":
            channel = {
                "voltage": "voltage_V", "load_torque": "load_torque_Nm", "current": "current_A", "speed": "speed_rad_s",
            }[name]  # fmt: skip
            given = replace(given, **{channel: getattr(given, channel) + change})
        elif owner:
            effect = motor.effect(owner)
            assert effect is not None
            motor = motor.with_effect(replace(effect, **{name: getattr(effect, name) + change}))
        else:
            motor = replace(motor, **{key: getattr(motor, key) + change})
        run = simulate(motor, given, initial, tolerance=1e-12, smooth=smooth)
        return {**run.states, "v": run.voltage_V}

    above, below = moved(1), moved(-1)
    for state in ("i", "w", "theta", "v"):
        truth = (above[state] - below[state]) / (2 * step)
        scale = max(np.abs(truth).max(), 1e-9)
        np.testing.assert_allclose(slope[key][state], truth, atol=3e-3 * scale, err_msg=state)


@pytest.mark.fit
def test_forcings_respond_through_all_switches_as_small_changes_do() -> None:
    torque = np.random.default_rng(3).standard_normal(1001)
    _, linear = linearise(FULL, SWITCHED, {"w": 20.0}, tolerance=1e-9, smooth=True)
    response = linear.respond(torque_Nm=torque[:, None], held=True)
    runs = [
        simulate(
            FULL, replace(SWITCHED, load_torque_Nm=SWITCHED.load_torque_Nm - 1e-4 * sign * torque), {"w": 20.0},
            tolerance=1e-12, smooth=True,
        )
        for sign in (1, -1)
    ]  # fmt: skip
    for state in ("i", "w", "theta"):
        truth = (runs[0].states[state] - runs[1].states[state]) / 2e-4
        np.testing.assert_allclose(response[state][:, 0], truth, atol=3e-3 * np.abs(truth).max())


def test_a_voltage_that_an_effect_depends_on_is_solved_for() -> None:
    motor = replace(COLD, effects=(CoastingBridge(s=0.5, V_bus=300.0, v_r=0.1),))
    run = simulate(motor, inputs(1.0, 11, terminal=Terminal.CURRENT, current_A=2.0), {"w": 100.0})
    v, w = run.voltage_V, run.speed_rad_s
    size = np.sqrt(v**2 + 0.01) - 0.1
    np.testing.assert_allclose(
        v + 0.5 * (1 - size / 300.0) * COLD.ke * w, COLD.R_a0 * 2.0 + COLD.ke * w, rtol=1e-9
    )


def test_words_and_numbers_are_the_same_everywhere() -> None:
    for kind, words in ((Terminal, WORDS["terminal"]), (Shaft, WORDS["shaft"])):
        assert tuple(member.name.lower() for member in kind) == words
        assert [code(kind, word, "") for word in words] == list(range(len(words)))
        assert [code(kind, str(k), "") for k in range(len(words))] == list(range(len(words)))
    with pytest.raises(DataError, match=r"--terminal: 'opened'; known: driven \(0\), open \(1\)"):
        code(Terminal, "opened", "--terminal")
    with pytest.raises(DataError, match="x, sample 1: '7'"):
        codes(Shaft, [0.0, 7.0], "x")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"terminal": np.full(1001, 5)}, "inputs: terminal, sample 0: '5'"),
        ({"shaft": np.zeros(7)}, r"shaft has shape \(7,\)"),
        ({"current_A": None}, "terminal is current, but current_A is not given"),
        ({"speed_rad_s": None}, "shaft is turned, but speed_rad_s is not given"),
    ],
)
def test_conditions_that_cannot_be_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        replace(SWITCHED, **change)


def test_a_recording_says_what_its_motor_was_tied_to(tmp_path: Path) -> None:
    file = read_motor_file("models/motors/mellah2016.toml")
    truth = perform(file, scenarios()["coast_down"](), np.random.default_rng(0))
    path = tmp_path / "coast.csv"
    write_recording(truth, path)
    given = inputs_of(read_recording(path), 20.0)
    assert given.terminal is not None
    assert given.shaft is None
    assert set(given.terminal) == {Terminal.DRIVEN, Terminal.OPEN}
    again = simulate(file.motor, replace(given, held=True))
    np.testing.assert_allclose(again.speed_rad_s, truth.channels["speed"], rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(again.voltage_V, truth.channels["voltage"], rtol=1e-4, atol=1e-3)
    path.write_text(
        "time_s,voltage_V,current_A,terminal,shaft\n0,0,0,open,free\n1,1,2,CURRENT,locked\n2,1,3,3,1\n"
    )
    words = read_recording(path)
    np.testing.assert_array_equal(words.channels["terminal"], [1, 3, 3])
    np.testing.assert_array_equal(words.channels["shaft"], [0, 1, 1])
    assert not any("terminal" in note for note in words.notes)
    path.write_text("time_s,voltage_V,terminal\n0,0,open\n1,1,closed\n2,1,0\n")
    with pytest.raises(DataError, match="'closed' is not a number"):
        read_recording(path)
    path.write_text("time_s,voltage_V,terminal\n0,0,open\n1,1,\n2,1,0\n")
    with pytest.raises(DataError, match="write one of driven, open, shorted, current in each row"):
        read_recording(path)


def test_an_option_ties_a_whole_recording() -> None:
    time = np.arange(5.0)
    recording = Recording("r", time, {"voltage": time, "current": time})
    given = inputs_of(under(recording, "current", "locked"), 25.0)
    assert given.current_A is not None and given.terminal is not None and given.shaft is not None
    np.testing.assert_array_equal(given.current_A, time)
    assert (given.terminal == Terminal.CURRENT).all() and (given.shaft == Shaft.LOCKED).all()
    assert inputs_of(under(recording), 25.0).terminal is None
    with pytest.raises(DataError, match=r"speed is imposed \(turned\), but was not recorded"):
        inputs_of(under(recording, shaft="turned"), 25.0)


def test_the_command_ties_a_test_to_what_is_asked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "r.csv")
    motor = "models/motors/mellah2016.toml"
    asked = ["simulate", motor, "--scenario", "duty", "--duration", "5", "-o", out]
    assert main([*asked, "--terminal", "current", "--shaft", "locked"]) == 0
    recording = read_recording(out)
    assert (recording.channels["terminal"] == 3).all() and (recording.channels["speed"] == 0).all()
    drop = recording.channels["resistance"] * recording.channels["current"]
    still = np.abs(np.diff(recording.channels["current"])) < 1e-9
    steady = np.r_[False, still[1:] & still[:-1], False]
    np.testing.assert_allclose(
        recording.channels["voltage"][steady][1:], drop[steady][1:], rtol=1e-3, atol=1e-6
    )
    assert main([*asked, "--terminal", "loose"]) == 1
    assert (
        "--terminal: 'loose'; known: driven (0), open (1), shorted (2), current (3)"
        in capsys.readouterr().err
    )
