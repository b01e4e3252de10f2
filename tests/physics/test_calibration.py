"""Calibration: what went in comes out, with deviations that hold, and what cannot be told is said."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.integrators import scipy_solution

from motorlens_physics.datasheet import from_datasheet, parse_datasheet
from motorlens_physics.effects.coulomb_friction import CoulombFriction
from motorlens_physics.effects.stribeck_friction import StribeckFriction
from motorlens_physics.estimate.calibrate import Calibration, calibrate
from motorlens_physics.estimate.prior import TAKEN
from motorlens_physics.estimate.report import _confounded
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated, read_motor_file, write_motor_file
from motorlens_physics.parameter import Rated, parameters
from motorlens_physics.recording import Recording
from motorlens_physics.sensors.gain import SensorGain
from motorlens_physics.simulation import Inputs, simulate
from motorlens_runtime.errors import DataError, ModelError

pytestmark = pytest.mark.fit

PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)
NOISE = {"current": 0.05, "speed": 0.5, "temperature": 0.3}
KEYS = tuple(parameters(Motor))


def scattered(motor: Motor, rng: np.random.Generator, share: float = 0.3) -> Motor:
    return replace(motor, **{key: getattr(motor, key) * rng.uniform(1 - share, 1 + share) for key in KEYS})


def record(
    motor: Motor,
    rng: np.random.Generator,
    *,
    dt: float,
    samples: int,
    hold: int,
    channels: tuple[str, ...] = tuple(NOISE),
    load: bool = True,
    start: dict[str, float] | None = None,
    name: str = "bench.csv",
) -> Recording:
    """A duty of random voltages and loads, measured with noise."""
    time = np.arange(samples) * dt
    blocks = -(-samples // hold)
    volts = np.repeat(rng.uniform(-240.0, 240.0, blocks), hold)[:samples]
    # No more than half of what would stall the motor: a measured load is taken as the torque that acts, also at rest.
    carried = np.minimum(
        rng.uniform(0.0, 6.0, blocks), 0.5 * motor.ke * np.abs(volts[::hold][:blocks]) / motor.R_a0
    )
    torque = np.repeat(carried, hold)[:samples] * np.sign(volts) * load
    run = simulate(motor, Inputs(time, volts, torque, np.full(samples, 20.0), held=True), start)
    truth = {"current": run.current_A, "speed": run.speed_rad_s, "temperature": run.temperature_C}
    measured = {c: truth[c] + NOISE[c] * rng.standard_normal(samples) for c in channels}
    known = {"voltage": volts} | ({"load_torque": torque} if load else {})
    return Recording(name, time, known | measured)


def errors(found: Calibration, truth: MotorFile) -> dict[str, float]:
    """How many deviations off each value is."""
    return {key: (found.value[key] - truth.values()[key]) / found.sd[key] for key in found.keys}


@pytest.fixture(scope="module")
def fleet() -> list[tuple[Calibration, MotorFile]]:
    """Six motors, each somewhere within 30 % of the one in the file, on a fast and a slow recording."""
    found = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        truth = scattered(Motor(), rng)
        fast = record(truth, rng, dt=2e-3, samples=3000, hold=250)
        slow = record(truth, rng, dt=2.0, samples=2500, hold=100, name="soak.csv")
        file = MotorFile("plate", Motor(), PLATE)
        found.append((calibrate(file, [fast, slow], KEYS, held=True), replace(file, motor=truth)))
    return found


def test_ten_parameters_are_recovered_within_their_deviations(
    fleet: list[tuple[Calibration, MotorFile]],
) -> None:
    off = np.array([list(errors(found, truth).values()) for found, truth in fleet])
    assert all(found.converged for found, _ in fleet)
    # 60 normal deviates: beyond 2 lie 2.7 on average and 8 at most once in 250.
    assert (np.abs(off) > 2).sum() <= 7
    assert np.abs(off).max() < 5
    # Nor are the deviations too wide: the root mean square is one.
    assert 0.6 < np.sqrt(np.mean(off**2)) < 1.4


def test_channels_weigh_themselves(fleet: list[tuple[Calibration, MotorFile]]) -> None:
    for found, _ in fleet:
        for sizes in found.residual_rms:
            assert sizes == pytest.approx(NOISE, rel=0.08)
        for residuals in found.residuals:
            assert np.std(residuals["speed"]) == pytest.approx(0.5, rel=0.08)


def test_a_recording_counts_once_however_often_it_is_calibrated_on(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    keys = ("R_a0", "L", "ke", "J", "b")
    truth = replace(Motor(), **{key: getattr(Motor(), key) * rng.uniform(0.7, 1.3) for key in keys})
    first, second = (
        record(truth, rng, dt=2e-3, samples=1500, hold=100, name=name) for name in ("a.csv", "b.csv")
    )
    file = MotorFile("plate", Motor(), PLATE, knowledge={"ke": Knowledge(0.3, "rating plate")})

    def calibrated(before: MotorFile, recording: Recording) -> Calibration:
        found = calibrate(before, [recording], keys, held=True)
        write_motor_file(found.file, tmp_path / "motor.toml")
        return replace(found, file=read_motor_file(tmp_path / "motor.toml"))

    once = calibrated(file, first)
    twice = calibrated(once.file, first)
    assert not once.findings.once
    (said,) = twice.findings.once
    assert said.startswith("R_a0, L, ke, J, b: the motor file learnt them")
    for key in keys:
        # It begins where it began, beside what was known then.
        assert twice.value[key] == pytest.approx(once.value[key], abs=1e-3 * once.sd[key])
        assert twice.sd[key] == pytest.approx(once.sd[key], rel=1e-3)
    # Another recording, of other steps, adds to what the first told: about half of the variance is left.
    both = calibrated(twice.file, second)
    assert not both.findings.once
    for key in keys:
        assert 0.4 < both.sd[key] / once.sd[key] < 0.9
        assert abs(both.value[key] - getattr(truth, key)) < 4 * both.sd[key]
    known = both.file.knowledge["ke"]
    assert known.source == "calibrated on a.csv, b.csv"
    assert known.prior == Stated(Motor().ke, 0.3, "rating plate")
    # With the first it begins anew.
    again = calibrated(both.file, first)
    assert again.sd["R_a0"] == pytest.approx(once.sd["R_a0"], rel=0.02)


def test_the_file_says_what_was_found(fleet: list[tuple[Calibration, MotorFile]], tmp_path: Path) -> None:
    found, _ = fleet[0]
    assert not found.unidentified
    # Nothing was stated of it, so that it may have been off by 40 %.
    began = Stated(Motor().ke, 0.4 * Motor().ke, TAKEN)
    source = "calibrated on bench.csv, soak.csv"
    assert found.file.knowledge["ke"] == Knowledge(found.sd["ke"], source, prior=began)
    write_motor_file(found.file, tmp_path / "new.toml")
    again = read_motor_file(tmp_path / "new.toml")
    assert again.values()["ke"] == found.value["ke"]
    assert again.knowledge["ke"] == found.file.knowledge["ke"]


def test_the_data_may_come_from_another_integrator() -> None:
    rng = np.random.default_rng(11)
    truth = Motor(R_a0=4.1, ke=0.85, J=0.025)
    time = np.arange(400) * 2e-3
    volts = np.repeat(rng.uniform(80.0, 240.0, 8), 50)
    inputs = Inputs(time, volts, 0 * time, 0 * time + 20.0)
    states = scipy_solution(truth, inputs, {"w": 60.0})
    recording = Recording(
        "scipy",
        time,
        {
            "voltage": volts,
            "current": states["i"] + 0.01 * rng.standard_normal(400),
            "speed": states["w"] + 0.1 * rng.standard_normal(400),
        },
    )
    file = MotorFile("plate", Motor(), PLATE)
    found = calibrate(file, [recording], ["R_a0", "ke", "J", "L", "b"])
    assert found.held == (False,)
    assert max(map(abs, errors(found, replace(file, motor=truth)).values())) < 4
    assert found.value["ke"] == pytest.approx(0.85, rel=1e-3)


def test_what_the_channels_do_not_show_stays_at_its_prior_and_is_said() -> None:
    rng = np.random.default_rng(12)
    truth = Motor(ke=0.8)
    cold = record(truth, rng, dt=2e-3, samples=1500, hold=150, channels=("current", "speed"))
    file = MotorFile("plate", Motor(), PLATE, knowledge={"H": Knowledge(200.0, "guess")})
    found = calibrate(file, [cold], ["ke", "k0", "H"], held=True)
    assert set(found.unidentified) == {"k0", "H"}
    assert "H: these recordings do not tell it" in found.unidentified["H"]
    assert "it stays at 1.8e+04 J/K" in found.unidentified["H"]
    assert found.file.values()["H"] == 18e3
    assert found.file.knowledge["H"] == Knowledge(200.0, "guess")
    assert found.value["ke"] == pytest.approx(0.8, rel=1e-3)


def test_a_prior_counts_as_much_as_it_says() -> None:
    # Voltage and speed alone give no scale of torque: R_a0/s, L/s, s J and s b are as good, whatever s.
    rng = np.random.default_rng(13)
    recording = record(Motor(), rng, dt=2e-3, samples=1500, hold=150, channels=("speed",), load=False)
    keys = ["R_a0", "L", "J", "b", "ke"]
    # At 0.35 ohm only a twentieth of what was known before is told, which counts as nothing.
    for sd in (0.035, 0.7):
        file = MotorFile("plate", Motor(), PLATE, knowledge={"R_a0": Knowledge(sd, "")})
        found = calibrate(file, [recording], keys, held=True)
        # The others are known to a factor of e^0.5, which says a little of s too.
        told = 1 / np.sqrt((3.5 / sd) ** 2 + 3 / 0.5**2)
        assert found.sd["R_a0"] == pytest.approx(3.5 * told, rel=0.1)
    assert any("R_a0, L and J:" in sentence for sentence in found.confounded)


def test_an_unmeasured_load_is_fitted_when_asked_for() -> None:
    rng = np.random.default_rng(14)
    time = np.arange(2000) * 2e-3
    volts = np.repeat(rng.uniform(100.0, 240.0, 10), 200)
    run = simulate(Motor(), Inputs(time, volts, 0 * time + 3.0, 0 * time + 20.0, held=True))
    recording = Recording(
        "loaded",
        time,
        {
            "voltage": volts,
            "current": run.current_A + 0.05 * rng.standard_normal(2000),
            "speed": run.speed_rad_s + 0.5 * rng.standard_normal(2000),
        },
    )
    file = MotorFile("plate", Motor(), PLATE)
    found = calibrate(file, [recording], ["R_a0", "ke", "J"], held=True, fit_load=True)
    assert found.own[0]["load"] == pytest.approx(3.0, abs=0.02)
    assert found.value["J"] == pytest.approx(Motor().J, rel=5e-3)


def test_a_hot_start_is_found_from_the_current() -> None:
    rng = np.random.default_rng(15)
    hot = record(
        Motor(), rng, dt=1e-3, samples=3000, hold=300, channels=("current", "speed"), start={"theta": 40.0}
    )
    file = MotorFile("plate", Motor(), PLATE)
    found = calibrate(file, [hot], ["J"], held=True)
    assert found.own[0]["initial.theta"] == pytest.approx(40.0, abs=1.0)


def test_outliers_hardly_matter() -> None:
    rng = np.random.default_rng(16)
    clean = record(Motor(ke=0.85), rng, dt=2e-3, samples=2000, hold=200)
    spikes = dict(clean.channels)
    spikes["speed"] = spikes["speed"].copy()
    hit = rng.choice(2000, 60, replace=False)
    spikes["speed"][hit] += 80.0
    spikes["current"] = np.where(np.arange(2000) % 97 == 0, np.nan, spikes["current"])
    file = MotorFile("plate", Motor(), PLATE)
    found = calibrate(file, [replace(clean, channels=spikes)], ["R_a0", "ke", "J"], held=True)
    assert max(map(abs, errors(found, replace(file, motor=Motor(ke=0.85))).values())) < 4
    assert found.value["ke"] == pytest.approx(0.85, rel=1e-3)


def test_a_slow_torque_that_nobody_measured_widens_the_deviations() -> None:
    # A slow random torque carries the free run away; it is found as such, and the constants come out all the same.
    rng = np.random.default_rng(18)
    n = 2000
    time = np.arange(n) * 2e-3
    volts = np.repeat(rng.uniform(-60.0, 60.0, n // 100), 100)
    disturbance = np.cumsum(0.02 * rng.standard_normal(n))
    free = Motor(ke=0.05, R_a0=1.0, L=0.002, J=0.002, b=1e-6)
    run = simulate(free, Inputs(time, volts, disturbance * 0.05, 0 * time + 20.0, held=True), {"w": 500.0})
    channels = {
        "voltage": volts,
        "current": run.current_A + 0.05 * rng.standard_normal(n),
        "speed": run.speed_rad_s + 0.5 * rng.standard_normal(n),
    }
    start = MotorFile("plate", replace(free, ke=0.06, R_a0=1.2), Rated(60.0, 5.0, 1000.0, 0.25))
    found = calibrate(start, [Recording("drifting", time, channels)], ["R_a0", "ke", "J"], held=True)
    assert found.value["ke"] == pytest.approx(0.05, rel=0.02)
    assert max(map(abs, errors(found, replace(start, motor=free)).values())) < 4


def test_what_is_known_exactly_is_not_fitted() -> None:
    rng = np.random.default_rng(23)
    recording = record(Motor(), rng, dt=2e-3, samples=1000, hold=100)
    file = MotorFile("plate", Motor(ke=0.9), PLATE, knowledge={"ke": Knowledge(0.0, "measured")})
    assert "ke" not in calibrate(file, [recording], held=True).keys
    with pytest.raises(ModelError, match="states it exactly"):
        calibrate(file, [recording], ["ke"], held=True)


def test_sensors_and_effects_are_fitted_like_the_motor() -> None:
    rng = np.random.default_rng(19)
    truth = Motor(effects=(CoulombFriction(tau_c=0.3),))
    recording = record(truth, rng, dt=2e-3, samples=3000, hold=300)
    shown = {**recording.channels, "current": 1.04 * recording.channels["current"]}
    file = MotorFile(
        "plate", Motor(effects=(CoulombFriction(tau_c=0.1),)), PLATE, sensors=(SensorGain("current"),)
    )
    keys = ["coulomb_friction.tau_c", "current_sensor_gain.gain", "b"]
    found = calibrate(file, [replace(recording, channels=shown)], keys, held=True)
    assert found.value["current_sensor_gain.gain"] == pytest.approx(
        1.04, abs=4 * found.sd["current_sensor_gain.gain"]
    )
    assert found.value["coulomb_friction.tau_c"] == pytest.approx(
        0.3, abs=4 * found.sd["coulomb_friction.tau_c"]
    )
    assert found.sd["coulomb_friction.tau_c"] < 0.01


def test_a_datasheet_gives_the_motor_it_describes() -> None:
    # 24 V, 2 A, 1.2 ohm, 300 rad/s: ke = 21.6/300; no load at 0.15 A: w0 = 23.82/ke, b = ke 0.15 / w0.
    file = from_datasheet(
        "servo", voltage_V=24.0, current_A=2.0, speed_rad_s=300.0, resistance_ohm=1.2, no_load_current_A=0.15
    )
    assert file.motor.ke == pytest.approx(0.072)
    assert file.motor.b == pytest.approx(0.072 * 0.15 / (23.82 / 0.072))
    time = np.linspace(0.0, 5.0, 501)
    rated = Inputs(time, 24.0 + 0 * time, file.rated.torque_Nm + 0 * time, 20.0 + 0 * time)
    run = simulate(replace(file.motor, alpha=0.0), rated)
    assert run.current_A[-1] == pytest.approx(2.0, rel=1e-3)
    assert run.speed_rad_s[-1] == pytest.approx(300.0, rel=1e-3)
    # The rated losses bring about the rated rise.
    motor = file.motor
    losses = motor.resistance(60.0) * 2.0**2 + motor.k_ir * 300.0**2
    assert losses / (motor.k0 * (1 + motor.kT * 300.0)) == pytest.approx(60.0)
    assert all(file.knowledge[key].sd and file.knowledge[key].source for key in KEYS)


def test_a_datasheet_is_understood_in_its_own_units() -> None:
    arguments = [
        "voltage_V=24",
        "current_mA=2000",
        "speed_rpm=3000",
        "resistance_ohm=1.2",
        "no_load_current_mA=150",
    ]
    assert parse_datasheet(arguments) == pytest.approx(
        {
            "voltage_V": 24.0,
            "current_A": 2.0,
            "speed_rad_s": 100 * np.pi,
            "resistance_ohm": 1.2,
            "no_load_current_A": 0.15,
        }
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["voltage_V"], "write NAME=NUMBER"),
        (["voltage_V=24"], "lacks current_A, speed_rad_s"),
        (["colour_V=24"], "colour_V: unknown"),
    ],
)
def test_a_datasheet_that_makes_no_sense_is_refused(arguments: list[str], message: str) -> None:
    with pytest.raises(DataError, match=message):
        parse_datasheet(arguments)


def test_a_datasheet_no_motor_can_have_is_refused() -> None:
    sheet = {
        "voltage_V": 24.0,
        "current_A": 2.0,
        "speed_rad_s": 300.0,
        "resistance_ohm": 15.0,
        "no_load_current_A": 0.1,
    }
    with pytest.raises(ModelError, match="15 ohm times 2 A is 30 V"):
        from_datasheet("wrong", **sheet)
    with pytest.raises(ModelError, match="the no-load current, 3 A"):
        from_datasheet("wrong", **(sheet | {"resistance_ohm": 1.0, "no_load_current_A": 3.0}))


def test_what_cannot_be_calibrated_is_refused() -> None:
    rng = np.random.default_rng(22)
    recording = record(Motor(), rng, dt=2e-3, samples=100, hold=50)
    file = MotorFile("plate", Motor(effects=(StribeckFriction(),)), PLATE)
    with pytest.raises(ModelError, match="cannot fit 'R': plate has R_a0"):
        calibrate(file, [recording], ["R"])
    with pytest.raises(ModelError, match="stated by choice"):
        calibrate(file, [recording], ["stribeck_friction.w_s"])
    only_voltage = replace(recording, channels={"voltage": recording.channels["voltage"]})
    with pytest.raises(DataError, match="only inputs are recorded"):
        calibrate(file, [only_voltage], ["R_a0"])
    with pytest.raises(DataError, match="5 samples are too few"):
        calibrate(file, [recording.part(slice(0, 5))], ["R_a0"])


def test_what_a_brief_recording_finds_is_believed_as_far_as_the_make_says():
    """It tells ke well; motors of the make differ by 2 %, and recordings as brief lead 4 % away: a fifth is believed."""
    motor, away = Motor(), 0.04
    brief = record(
        replace(motor, ke=1.05 * motor.ke), np.random.default_rng(5), dt=2e-3, samples=400, hold=100
    )
    make = MotorFile("make", motor, PLATE)
    plain = replace(make, knowledge={"ke": Knowledge(np.hypot(0.02, away) * motor.ke, "population")})
    known = {"ke": Knowledge(0.02 * motor.ke, "population", away * motor.ke)}
    found, whole = (calibrate(file, [brief]) for file in (replace(make, knowledge=known, brief_s=1.0), plain))
    assert whole.file.motor.ke == pytest.approx(1.05 * motor.ke, rel=0.01)
    share = 0.02**2 / (0.02**2 + away**2)
    assert found.file.motor.ke - motor.ke == pytest.approx(share * (whole.file.motor.ke - motor.ke), rel=1e-3)
    # As uncertain as one of its make is whose recording led so far away, and no longer said to be led away.
    told = found.file.knowledge["ke"]
    assert told.sd == found.sd["ke"] == pytest.approx(0.02 * motor.ke * np.sqrt(1 - share), rel=0.02)
    assert told.brief_sd == 0.0
    # Of what the make says nothing, the recording is believed.
    assert found.file.motor.R_a0 == pytest.approx(whole.file.motor.R_a0, rel=1e-3)


def test_what_is_tied_to_several_is_named_with_the_closest() -> None:
    # Half the sum of four independent ones and a little: told alone ten times worse, and tied to each by no more than 0.6.
    sums = np.column_stack([np.eye(5)[:, 0] * 0.1 + 0.5 * np.array([0, 1, 1, 1, 1.1]), np.eye(5)[:, 1:]])
    fit = SimpleNamespace(prior=SimpleNamespace(keys=tuple("abcde")), covariance=sums.T @ sums)
    (sentence,) = _confounded(fit, tuple("abcde"), {})  # type: ignore[arg-type]
    assert sentence.startswith("a and e: these recordings tell them only together")
    assert _confounded(fit, tuple("bcde"), {}) == ()  # type: ignore[arg-type]


def test_of_two_that_are_each_the_others_closest_it_is_said_once() -> None:
    # Sums of sixty independent ones, of which they share forty: told alone twenty times worse, and correlated by two thirds.
    of_each = np.eye(80)
    first, second = (np.sum(of_each[part], axis=0) / np.sqrt(60) for part in (slice(0, 60), slice(20, 80)))
    rows = np.block([[np.vstack([first, second]), 0.05 * np.eye(2)], [of_each, np.zeros((80, 2))]])
    keys = ("a", "b", *(f"c{k}" for k in range(80)))
    fit = SimpleNamespace(prior=SimpleNamespace(keys=keys), covariance=rows @ rows.T)
    (sentence,) = _confounded(fit, keys, {})  # type: ignore[arg-type]
    assert sentence.startswith("a and b: these recordings tell them only together (each is 20 times")
