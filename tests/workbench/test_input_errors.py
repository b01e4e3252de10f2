"""Errors of the measured inputs: the noise found on a signal, and least squares freed of the bias it brings."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.denoise import noise_of_input
from motorlens_workbench.diagnosis import base_fit
from motorlens_workbench.evidence import Evidence
from motorlens_workbench.fitting import base_prior, fit, start_model
from motorlens_workbench.input_errors import feigned, without_input_errors
from motorlens_workbench.model import predict
from motorlens_workbench.run import prepare
from motorlens_workbench.screen import all_columns, columns_of, evidence_of, products_with, with_priors

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"


def programme(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Levels with slopes between them."""
    at = np.arange(0, rows, 250)
    levels = rng.uniform(-1, 1, len(at))
    return np.interp(np.arange(rows), np.column_stack([at, at + 210]).ravel(), np.repeat(levels, 2))


@pytest.mark.parametrize("keep", [0.0, 0.9, 0.95])
def test_the_noise_of_an_input_is_found_with_its_colour(keep):
    rng = np.random.default_rng(1)
    rows = 20_000
    lasting = lfilter([1.0], [1.0, -keep], rng.standard_normal(rows)) * np.sqrt(1 - keep**2)
    y = 20 * programme(rng, rows) + 0.05 * rng.standard_normal(rows) + 0.08 * lasting
    found = noise_of_input(y)
    assert np.hypot(found.white, found.lasting) == pytest.approx(np.hypot(0.05, 0.08), rel=0.2)
    if keep:
        assert found.lasting == pytest.approx(0.08, rel=0.25)
        assert found.keep == pytest.approx(keep, abs=0.04)
    else:
        assert found.lasting < 0.01
    drawn = found.draw(np.random.default_rng(2), 200_000)
    assert np.std(drawn) == pytest.approx(np.hypot(found.white, found.lasting), rel=0.05)


@pytest.mark.parametrize(("amplitude", "turns"), [(5.0, 0.0017), (5.0, 0.005), (10.0, 0.01), (5.0, 0.03)])
def test_a_signal_that_swings_is_not_taken_for_noise(amplitude, turns):
    """Noise of 0.05 on a swing of so many turns a sample."""
    rng = np.random.default_rng(1)
    rows = 20_000
    swing = amplitude * np.sin(2 * np.pi * turns * np.arange(rows))
    found = noise_of_input(20 * programme(rng, rows) + swing + 0.05 * rng.standard_normal(rows))
    assert found.lasting == 0.0
    assert 0.045 < found.white < (0.055 if turns <= 0.01 else 0.1)


def test_a_signal_without_noise_has_none():
    assert not noise_of_input(np.repeat([0.0, 3.0, -2.0, 5.0] * 4, 500))


def test_what_is_feigned_is_taken_out_block_by_block():
    rng = np.random.default_rng(3)
    x, e = rng.standard_normal((800, 2)), rng.standard_normal(800)
    stacked = np.column_stack([x, e]).reshape(8, 100, 3)
    evidence = Evidence.of(["a", "b"], np.einsum("bni,bnj->bij", stacked, stacked), np.full(8, 100.0))
    feigned = rng.standard_normal((2, 8, 2))
    clean = evidence.less(feigned)
    mean = feigned.mean(axis=0)
    assert clean.total[:2, 2] == pytest.approx(x.T @ e - mean.sum(axis=0))
    assert clean.total[:2, :2] == pytest.approx(x.T @ x)
    assert clean.blocks[3, 0, 2] == pytest.approx(evidence.blocks[3, 0, 2] - mean[3, 0])
    # The two blocks that are left beside hold how well the mean is known: their squares add up to its variance.
    apart = (feigned[0] - feigned[1]).sum(axis=0)
    assert np.sum(clean.blocks[8:, :2, 2] ** 2, axis=0) == pytest.approx(2 * (apart / 4) ** 2)


@pytest.mark.fit
def test_least_squares_is_freed_of_the_bias_of_a_noisy_voltage():
    """The true parameters are known; the voltage sensor adds noise that never drove the motor."""
    file = read_motor_file(MOTOR)
    rows, time = 6000, np.arange(6000) * 0.002
    before, after = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        inputs = Inputs(time, 30 * programme(rng, rows), np.zeros(rows), np.full(rows, 20.0))
        truth = simulate(file.motor, inputs, smooth=True)
        recording = Recording(
            f"seed {seed}", time,
            {"voltage": inputs.voltage_V + 0.5 * rng.standard_normal(rows), "load_torque": np.zeros(rows),
             "current": truth.current_A + 0.02 * rng.standard_normal(rows),
             "speed": truth.speed_rad_s + 0.05 * rng.standard_normal(rows)},
        )  # fmt: skip
        found, runs = base_fit(file, (prepare(recording, file),))
        assert runs[0].input_noise[0].white == pytest.approx(0.5, rel=0.1)
        columns = all_columns(found, runs, (), (), with_decoys=False)
        evidence = evidence_of(columns, runs, found.whiteners)
        clean = without_input_errors(evidence, found, runs, found.whiteners, (), (), with_decoys=False)
        keys = found.prior.keys
        value, unit = found.model.values()["L"], found.prior.sd["L"]
        move = with_priors(clean, found).solve(keys)[0][keys.index("L")] * unit
        before.append(value / file.values()["L"] - 1)
        after.append((value + move) / file.values()["L"] - 1)
    assert np.sqrt(np.mean(np.square(before))) > 0.04
    assert np.sqrt(np.mean(np.square(after))) < 0.65 * np.sqrt(np.mean(np.square(before)))


@pytest.mark.parametrize("smooth", [False, True])
def test_what_is_feigned_is_what_both_ways_in_full_give(smooth):
    """Against the columns simulated both ways for each draw, of which the code simulates one."""
    file = read_motor_file(MOTOR)
    rows, rng = 6000, np.random.default_rng(1)
    time = np.arange(rows) * 0.002
    inputs = Inputs(time, 30 * programme(rng, rows), np.zeros(rows), np.full(rows, 20.0))
    truth = simulate(file.motor, inputs, smooth=True)
    channels = {
        "voltage": inputs.voltage_V + 0.5 * rng.standard_normal(rows), "load_torque": np.zeros(rows),
        "current": truth.current_A + 0.02 * rng.standard_normal(rows),
        "speed": truth.speed_rad_s + 0.05 * rng.standard_normal(rows),
    }  # fmt: skip
    shown = prepare(Recording("noisy", time, channels), file)
    quiet = shown.quieter()
    run = quiet if smooth else replace(shown, input_noise=quiet.input_noise)
    prior = base_prior(file, [run])
    found = fit(start_model(file, [run]), [run], prior)
    short = feigned(found.model, prior, [run], found.whiteners, (), (), False).mean(axis=0).sum(axis=0)
    true = run.average(predict(found.model, run, 0)[1])
    full = []
    for draw in range(2):
        for sign in (1.0, -1.0):
            moved = run.stirred(draw, sign)
            one = columns_of(found.model, moved, 0, prior.keys, prior.sd, (), (), False)
            left = one.residual + true - moved.average(moved.measured)
            full.append(products_with([one], [left], [run], found.whiteners)[:, :, 0].sum(axis=0))
    wanted = np.mean(full, axis=0)
    # Far within the scatter between draws and ways; and the inductance, which noise that is not smoothed biases most.
    assert (np.abs(short - wanted) < 0.03 * np.std(full, axis=0) + 1e-6).all()
    if not smooth:
        inductance = prior.keys.index("L")
        assert short[inductance] == pytest.approx(wanted[inductance], rel=0.05)


def test_runs_without_noise_on_their_inputs_are_left_alone():
    file = read_motor_file(MOTOR)
    rng = np.random.default_rng(5)
    time = np.arange(2000) * 0.002
    inputs = Inputs(time, 30 * programme(rng, 2000), np.zeros(2000), np.full(2000, 20.0))
    truth = simulate(file.motor, inputs, smooth=True)
    recording = Recording(
        "quiet",
        time,
        {"voltage": inputs.voltage_V, "current": truth.current_A + 0.01 * rng.standard_normal(2000)},
    )
    run = prepare(recording, file)
    assert not run.disturbed
    assert run.stirred(0, 1.0) is run
    noisy = replace(
        run, input_noise=(noise_of_input(programme(rng, 20_000) + 0.1 * rng.standard_normal(20_000)),) * 2
    )
    there, back = noisy.stirred(0, 1.0), noisy.stirred(0, -1.0)
    moved = [one.inputs.load_torque_Nm - run.inputs.load_torque_Nm for one in (there, back)]
    assert np.std(moved[0]) > 0
    assert moved[0] == pytest.approx(-moved[1], abs=1e-9)
