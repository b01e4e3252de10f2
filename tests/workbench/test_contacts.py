"""A loose contact: spells of more resistance in a motor solved in closed form; not noise, steps, or spikes of a sensor."""

import numpy as np
import pytest
from helpers.changing import MOTOR, drive, textbook
from helpers.hidden import known

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import Recording, read_recording
from motorlens_workbench.hypotheses.contact import contacts, deviation, robust
from motorlens_workbench.hypotheses.line import Line

DT, N = 0.002, 8000


def spells(rng, share, mean_s=0.03):
    """(N,) whether the contact is bad: exponential spells of either kind."""
    bad, at, state = np.zeros(N, dtype=bool), 0, False
    while at < N:
        length = 1 + int(rng.exponential((mean_s if state else mean_s * (1 / share - 1)) / DT))
        bad[at : at + length] = state
        at, state = at + length, not state
    return bad


def recorded(name, resistance, spikes_V, noise):
    rng = np.random.default_rng(8)
    voltage = 150 * np.repeat(rng.uniform(-1, 1, N // 800), 800)
    load = np.repeat(rng.uniform(-8, 8, N // 400), 400)
    current, speed = drive(voltage, load, DT, resistance=resistance)
    struck = rng.random(N) < 0.02
    channels = {
        "voltage": voltage + spikes_V * struck * np.sign(rng.standard_normal(N)),
        "load_torque": load,
        "current": current + 0.05 * noise * rng.standard_normal(N),
        "speed": speed + 0.5 * noise * rng.standard_normal(N),
    }
    return Recording(name, np.arange(N) * DT, channels)


def lines(*resistances, spikes_V=0.0, noise=1.0):
    return lines_of(
        read_motor_file(MOTOR),
        [recorded(f"run {r}", one, spikes_V, noise) for r, one in enumerate(resistances)],
    )


def lines_of(file, recordings):
    found = estimate(file, tuple(prepare(recording, file) for recording in recordings))
    return [Line.of(found.fit.model, run, r, found.fit.prior.keys) for r, run in enumerate(found.runs)]


def contact(resistance=1.0, **shares):
    return contacts(lines(resistance, **shares))


@pytest.mark.fit
@pytest.mark.parametrize(("more", "share"), [pytest.param(0.3, 0.15, marks=pytest.mark.long), (1.0, 0.08)])
def test_spells_are_found_with_their_size_and_share(more, share):
    bad = spells(np.random.default_rng(1), share)
    ((shape,),) = [one.shapes for one in contact(1.0 + more * bad)]
    assert shape.by == pytest.approx(more * textbook()["R_a0"], rel=0.3)
    assert shape.share == pytest.approx(bad.mean(), rel=0.5)
    # It is shown as it is: either bad or good.
    shown = shape.shown[1] / (more * textbook()["R_a0"])
    assert np.mean((shown > 0.25) & (shown < 0.6)) < 0.25


@pytest.mark.long
@pytest.mark.fit
def test_no_speed_need_be_measured(tmp_path):
    """Of a controlled drive of which only voltage and current are known."""
    made = known("dev-0171", tmp_path)
    (hidden,) = made.truth["hidden"]
    assert hidden["name"] == "loose_connector" and made.truth["case"]["channels"] == "voltage_current"
    recordings = [read_recording(path) for path in made.recordings]
    ((shape,),) = [one.shapes for one in contacts(lines_of(read_motor_file(made.motor), recordings))]
    assert 0.7 < shape.by / hidden["size"] < 1.1


@pytest.mark.fit
def test_spells_of_several_recordings_count_together():
    few = [
        np.convolve(np.isin(np.arange(N), 900 + k + 1000 * np.arange(6)), np.ones(20))[:N] for k in (0, 400)
    ]
    both = lines(*(1.0 + 3.0 * bad for bad in few))
    assert all(contacts([one]) == [] for one in both)
    ((shape,),) = [one.shapes for one in contacts(both)]
    assert [r for r, *_ in shape.missing] == [0, 1]
    for (_, time, missing), bad in zip(shape.missing, few, strict=True):
        lost = np.interp(np.arange(N) * DT, time, np.abs(missing))
        assert np.sum(lost * bad) > 0.6 * np.sum(lost) > 0


@pytest.mark.fit
@pytest.mark.parametrize(
    "shares",
    [
        {},
        {"noise": 10.0},
        pytest.param({"resistance": np.where(np.arange(N) > N // 2, 1.3, 1.0)}, marks=pytest.mark.long),
        {"spikes_V": 40.0},
        # As often less as more: that is no contact.
        pytest.param(
            {
                "resistance": 1.0
                + 0.3 * spells(np.random.default_rng(1), 0.1)
                - 0.3 * spells(np.random.default_rng(2), 0.1)
            },
            marks=pytest.mark.long,
        ),
    ],
)
def test_what_is_no_contact_is_not_called_one(shares):
    assert contact(**shares) == []


@pytest.mark.long
@pytest.mark.fit
@pytest.mark.parametrize("case", ["dev-0189", "dev-0238"])
def test_a_sensor_that_lags_is_no_contact(tmp_path, case):
    """Of speed, and of current: what it lacks goes with the current while the shaft gathers speed."""
    made = known(case, tmp_path)
    found = lines_of(read_motor_file(made.motor), [read_recording(path) for path in made.recordings])
    assert contacts(found) == []


@pytest.mark.parametrize("samples", [60, 200])
def test_a_run_too_short_says_nothing(samples):
    time = np.arange(samples) * DT
    channels = {name: np.sin(20 * time) for name in ("voltage", "current", "speed")}
    file = read_motor_file(MOTOR)
    run = prepare(Recording("short", time, channels), file)
    assert contacts([Line.of(start_model(file, [run]), run, 0, ())]) == []


def test_a_robust_fit_ignores_what_stands_out():
    rng = np.random.default_rng(5)
    terms = np.column_stack([np.ones(400), rng.standard_normal(400)])
    noise = rng.standard_normal(400)
    outliers = np.where(rng.random(400) < 0.1, 50.0, 0.0)
    y = terms @ [3.0, -2.0] + 0.2 * noise + outliers
    error = robust(terms, y)
    clean = outliers == 0
    assert np.sqrt(np.mean((error - 0.2 * noise)[clean] ** 2)) < 0.08
    assert np.all(error[~clean] > 45)
    assert 0.17 < deviation(error, y) < 0.27


def test_a_current_that_has_decayed_to_nothing_explains_nothing():
    """After minutes it is too small a number to divide by."""
    drop = np.random.default_rng(6).standard_normal(61)
    error = robust(np.full((61, 1), 1.5e-323), drop)
    assert np.array_equal(error, drop)
