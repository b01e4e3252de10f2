"""Long recordings are begun in pieces: the end must be where a search of all samples ends, and where the truth is."""

import dataclasses

import numpy as np
import pytest
from helpers import plain_motor
from helpers.plain_motor import RATED, TYPICAL, recorded

from motorlens_physics.estimate import estimate as estimation
from motorlens_physics.estimate.estimate import Estimate, estimate, near, one_step_ahead
from motorlens_physics.estimate.fit import minimise, start_model
from motorlens_physics.estimate.pieces import as_found
from motorlens_physics.estimate.points import at, first_point, shown_at
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording

PLATE = Rated(
    voltage_V=RATED["voltage"], current_A=RATED["current"], speed_rad_s=RATED["speed"],
    torque_Nm=RATED["load_torque"], rise_K=RATED["temperature"],
)  # fmt: skip
FILE = MotorFile("plate", Motor(), PLATE)
ROWS, LATE = 10_000, 7


def two_runs() -> tuple[Run, ...]:
    """One of many samples, its speed late, and one of few; both held, noisy; the motor a fifth from its file."""
    motor = {key: value * (1.2 if k % 2 else 0.85) for k, (key, value) in enumerate(TYPICAL.items())}
    rng, made = np.random.default_rng(6), []
    for rows, late in ((ROWS, LATE), (1500, 0)):
        time, channels = recorded(motor, plain_motor.Test(0.002, rows, 250, True, 0.004), rng)
        channels["speed"] = np.concatenate(
            [np.repeat(channels["speed"][:1], late), channels["speed"][: rows - late]]
        )
        made.append(Recording(f"{rows} samples", time, channels))
    return prepare_all(made, FILE)


@pytest.mark.long
@pytest.mark.fit
def test_pieces_lead_where_all_samples_lead(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = two_runs()
    pieces = estimate(FILE, runs)
    monkeypatch.setattr(estimation, "PIECE", 10 * ROWS)
    whole = estimate(FILE, runs)

    def told(found: Estimate) -> tuple[object, ...]:
        return (
            found.converged,
            found.fit.model.held,
            [dict(run.late) for run in found.runs],
            [len(run) for run in found.runs],
        )

    assert told(pieces) == told(whole)
    assert pieces.runs[0].late == {"speed": LATE} and pieces.fit.model.held[0][:2] == (True, True)
    keys, sd = whole.fit.prior.keys, np.sqrt(np.diagonal(whole.fit.covariance))
    ends, meant = (np.array([found.fit.model.values()[key] for key in keys]) for found in (pieces, whole))
    # Both stop within a twentieth of a deviation of where their noise leads, which is found anew.
    assert np.abs((ends - meant) / sd).max() < 0.15
    np.testing.assert_allclose(np.sqrt(np.diagonal(pieces.fit.covariance)), sd, rtol=0.05)
    # Going on from an end, it ends there.
    again = estimate(FILE, whole.runs, begin=whole.fit.model)
    stays = np.array([again.fit.model.values()[key] for key in keys])
    assert told(again) == told(whole) and np.abs((stays - meant) / sd).max() < 0.15


@pytest.mark.fit
def test_a_trial_is_weighed_as_the_point_it_is_compared_with() -> None:
    runs = two_runs()[1:]
    prior, model = base_prior(FILE, runs), start_model(FILE, runs)
    tempered = dataclasses.replace(at(model, first_point(model, runs), prior), inflation=3.0)
    assert at(model, tempered, prior).cost == pytest.approx(tempered.cost, rel=1e-9)


def test_what_a_point_makes_of_its_own_errors_is_its_slope_and_its_cost() -> None:
    # Two ways to the same sums: of all columns and errors at once, and of those of another point, here of itself.
    runs = two_runs()
    model, prior = start_model(FILE, runs), base_prior(FILE, runs)
    point = dataclasses.replace(at(model, first_point(model, runs), prior), inflation=3.0)
    products, overlap = point.products_in(point)
    _, slope = point.normal()
    assert products == pytest.approx(slope, rel=1e-9, abs=1e-9 * float(np.abs(slope).max()))
    assert overlap == pytest.approx(point.cost, rel=1e-9)


def test_a_step_that_nothing_follows_makes_no_piece_lively() -> None:
    # From rest to rest: the change alone is in a piece that ends with it, and the answer to it in none of its samples.
    time = np.arange(4000) * 1e-3
    volts = np.where(time < 2.0, 0.0, 100.0)
    run = prepare_all(
        [Recording("step", time, {"voltage": volts, "speed": np.where(time < 2.0, 0.0, 1.0)})], FILE
    )[0]
    piece = run.liveliest(1000, FILE.motor)
    assert piece.start < 2000 < piece.stop - FILE.motor.response_s / 1e-3


def test_a_piece_is_the_liveliest_part_and_starts_where_its_samples_say() -> None:
    rows = 1000
    time, still = np.arange(rows) * 1e-3, np.full(rows, 100.0)
    volts = still + np.where((time >= 0.7) & (time < 0.8), 50.0 * np.sin(200 * time), 0.0)
    speed, current = np.linspace(0, 100, rows), np.linspace(3, 1, rows)
    recording = Recording(
        "still", time, {"voltage": volts, "current": current, "speed": speed, "temperature": still}
    )
    run = prepare_all([recording], FILE)[0]
    rows_of = run.liveliest(200, FILE.motor)
    assert 600 <= rows_of.start <= 700 and rows_of.stop == rows_of.start + 200
    piece = run.part(rows_of, FILE)
    assert len(piece.measured) == 200 and piece.every == 1
    assert piece.start["w"] == speed[rows_of.start + 1] and piece.start["i"] == current[rows_of.start + 1]
    assert piece.start["theta"] == 100.0 - PLATE_AMBIENT
    # What was found of the piece is taken over, once.
    late = dataclasses.replace(
        piece.delayed("speed", 3), inputs=dataclasses.replace(piece.inputs, held=(True, False, False))
    )
    like = as_found(run, late)
    assert (
        like.late == {"speed": 3}
        and like.inputs.hold == (True, False, False)
        and as_found(like, late).late == like.late
    )


PLATE_AMBIENT = PLATE.ambient_C


@pytest.mark.fit
def test_a_fit_goes_on_where_its_corrections_were_made_far_away() -> None:
    # From pieces to all samples the way is 730 standard deviations; it ended 2.5 before the minimum.
    rng = np.random.default_rng([1159, 20])
    truth = plain_motor.scattered(rng)
    time, channels = recorded(truth, plain_motor.Test(0.1, 12_000, 150, False, 0.002), rng)
    file = MotorFile("plate", Motor(**TYPICAL), PLATE)
    found = estimate(file, prepare_all([Recording("10 Hz", time, channels)], file))
    value, sd = found.fit.model.values(), found.fit.sd()
    assert found.converged
    assert all(abs(value[key] - truth[key]) < 3 * sd[key] for key in truth)


@pytest.mark.fit
def test_one_step_ahead_is_nearly_the_cost_where_a_search_ends() -> None:
    """Of the model itself, and of one whose ke is held 2 % off, which a search beside the same noise ends."""
    runs = two_runs()[1:]
    prior, begin = base_prior(FILE, runs), start_model(FILE, runs)
    found = near(runs, prior, begin)
    begin = dataclasses.replace(begin, held=found.model.held)
    ended = found.cost + prior.penalty(found.model.values())
    ahead = one_step_ahead(found, runs, prior, begin)
    assert ahead == pytest.approx(ended, rel=0.01)

    off = begin.with_values({"ke": 1.02 * found.model.values()["ke"]})
    rest = prior.only([key for key in prior.keys if key != "ke"])
    start = at(found.model.with_values({"ke": off.values()["ke"]}), found, rest)
    other, _, left = minimise(
        start,
        rest,
        lambda model: at(model, found, rest),
        lambda model: shown_at(model, found),
        rounds=50,
        enough=0.1,
    )
    more = other.cost + rest.penalty(other.model.values()) - ended
    assert left < 0.1 and more > 100
    assert one_step_ahead(found, runs, rest, off) - ahead == pytest.approx(more, rel=0.2)
