"""Innovations, smoothed disturbances and scores against dense covariance matrices; noise levels against what was put in."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from motorlens_physics.estimate.estimate import COARSE
from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.innovations import (
    StateSpace,
    disturbances,
    in_blocks,
    innovations,
    read,
    spread,
    sums,
)
from motorlens_physics.estimate.model import TOLERANCE, predict, sensitivities_of
from motorlens_physics.estimate.noise import first_noise
from motorlens_physics.estimate.noise_likelihood import likelier
from motorlens_physics.estimate.prepare import prepare
from motorlens_physics.motor import Motor
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.parameter import Rated
from motorlens_physics.recording import Recording
from motorlens_physics.simulation import Inputs, simulate

SAMPLES, CHANNELS = 12, 2
PLATE = Rated(voltage_V=240.0, current_A=7.27, speed_rad_s=221.0, torque_Nm=6.455, rise_K=80.0)


SPACES = [(3, False, ()), (4, False, ()), (3, True, ()), (4, True, ()), (3, True, (2,)), (3, True, (0, 2))]


@pytest.fixture(scope="module", params=SPACES, ids=str)
def space(request: pytest.FixtureRequest) -> StateSpace:
    """Three disturbances: one held, one linear, one slow; a sample missing; an uncertain start. Or besides coloured noise.

    Of the voltage, which runs linearly, and of the second channel, whose state is the last; and inputs that change
    somewhere in some samples. Those that are silent, which stand before others, have no variance.
    """
    states, lasting, silent = request.param
    rng = np.random.default_rng(0)
    keeps = np.zeros((SAMPLES - 1, 3))
    keeps[:, 2] = 0.9
    noise = np.abs(rng.standard_normal((SAMPLES, CHANNELS))) + 0.1
    noise[4, 1] = np.inf
    found = StateSpace(
        0.4 * rng.standard_normal((SAMPLES - 1, states, states + 6)), np.array([0, 1]), np.array([0, 1, 1]),
        np.full((2, 2), -1), np.zeros(2), np.array([True, False, True]), keeps, np.array([0.5, 0.8, 0.3]), noise,
        np.array([0.2, *np.zeros(states - 1)]),
    )  # fmt: skip
    if not lasting:
        return found
    variance = np.array([0.5, 0.8, 0.3, 0.4, 0.7])
    variance[list(silent)] = 0.0
    return replace(
        found, shows=np.array([0, states - 1]), balances=np.array([0, 1, 1, 0, -1]), drifts=np.array([[-1, -1], [4, -1]]),
        holds=np.array([True, False, True, False, True]), variance=variance,
        keeps=np.column_stack([keeps, np.full(SAMPLES - 1, 0.6), np.linspace(0.5, 0.8, SAMPLES - 1)]),
        jumps=np.where(np.isin(np.arange(SAMPLES - 1)[:, None], [(2, 7), (7, 4)]), [1.7, 0.9], 0.0),
    )  # fmt: skip


def response(space: StateSpace, start: np.ndarray, forcing: np.ndarray) -> np.ndarray:
    """(N * C,) what the channels show of a start (n,) and disturbances (N, D): written out sample by sample."""
    x, shown = np.asarray(start, dtype=np.float64), []
    for k in range(SAMPLES):
        drift = [sum(forcing[k, d] for d in own if d >= 0) for own in space.drifts]
        shown.append((x[space.shows].T + drift).T)
        if k + 1 < SAMPLES:
            phi, now, then = np.split(space.matrices[k], [len(x), len(x) + 3], axis=1)
            first, last = np.zeros(3), np.zeros(3)
            for d, balance in enumerate(space.balances):
                if balance < 0:
                    continue
                first[balance] += forcing[k, d]
                last[balance] += forcing[k if space.holds[d] else k + 1, d]
            x = phi @ x + now @ first + then @ last
    return np.concatenate(shown)


def lacked(space: StateSpace, k: int, column: int) -> np.ndarray:
    """(N * C,) what the channels show of a volt that sample k lacked at its begin or end: a column of its matrix."""
    x, shown = np.zeros(len(space.start)), [np.zeros(CHANNELS)] * (k + 1)
    for j in range(k, SAMPLES - 1):
        x = space.matrices[j, :, : len(x)] @ x + space.matrices[j, :, column] * (j == k)
        shown.append(x[space.shows])
    return np.concatenate(shown)


class Dense:
    """The covariance of all samples at once."""

    def __init__(self, space: StateSpace) -> None:
        sensors = space.noise.ravel()
        self.use = np.isfinite(sensors)
        self.news: list[tuple[int, int, float, np.ndarray]] = []
        self.parts = []
        for d in range(len(space.balances)):
            part = np.zeros((SAMPLES * CHANNELS,) * 2)
            for k in range(SAMPLES):
                forcing = np.zeros((SAMPLES, len(space.balances)))
                forcing[k:, d] = np.cumprod(np.concatenate([[1.0], space.keeps[k:, d]]))
                seen = response(space, np.zeros(len(space.start)), forcing)
                fresh = space.variance[d] * (1 - space.keeps[k - 1, d] ** 2 if k else 1.0)
                part += fresh * np.outer(seen, seen)
                self.news.append((k, d, fresh, seen[self.use]))
            self.parts.append(part[np.ix_(self.use, self.use)])
        start = response(space, np.eye(len(space.start))[0], np.zeros((SAMPLES, len(space.balances))))[
            self.use
        ]
        self.whole = sum(self.parts) + space.start[0] * np.outer(start, start) + np.diag(sensors[self.use])
        for k, which in np.argwhere(space.jumps):
            for column in (len(space.start) + which, len(space.start) + 3 + which):
                seen = space.jumps[k, which] * lacked(space, k, column)[self.use]
                self.whole += np.outer(seen, seen)
        self.inverse = np.linalg.inv(self.whole)


@pytest.mark.fit
def test_whitened_products_and_the_determinant_are_those_of_the_covariance(space: StateSpace) -> None:
    dense, y = Dense(space), np.random.default_rng(1).standard_normal((SAMPLES, CHANNELS, 2))
    filtered = innovations(space, y)
    white, plain = filtered.white.reshape(-1, 2), y.reshape(-1, 2)[dense.use]
    np.testing.assert_allclose(white.T @ white, plain.T @ dense.inverse @ plain, rtol=1e-10)
    scale = filtered.scale.ravel()[dense.use]
    assert 2 * np.log(scale).sum() == pytest.approx(np.linalg.slogdet(dense.whole)[1], rel=1e-12)


def test_sums_by_blocks_are_those_of_all_samples_together(space: StateSpace) -> None:
    dense, y = Dense(space), np.random.default_rng(5).standard_normal((SAMPLES, CHANNELS, 4))
    plain = y.reshape(-1, 4)[dense.use]
    together = plain.T @ dense.inverse @ plain
    for blocks in (1, 5, 40):
        found = sums(space, innovations(space, y[:, :, 3:]), y[:, :, :3], blocks)
        assert found.scores.shape == (min(blocks, SAMPLES), 3)
        np.testing.assert_allclose(found.gram, together[:3, :3], rtol=1e-9)
        np.testing.assert_allclose(found.scores.sum(axis=0), together[:3, 3], rtol=1e-9)
        assert found.squares == pytest.approx(together[3, 3], rel=1e-10)


@pytest.mark.fit
def test_smoothed_disturbances_are_their_conditional_means(space: StateSpace) -> None:
    dense, y = Dense(space), np.random.default_rng(2).standard_normal((SAMPLES, CHANNELS, 1))
    seen = disturbances(space, innovations(space, y))[0]
    expected, plain = np.zeros((SAMPLES, len(space.balances))), y.ravel()[dense.use]
    for k, d, fresh, shown in dense.news:
        # What is new at a sample remains in part.
        remains = np.cumprod(np.concatenate([[1.0], space.keeps[k:, d]]))
        expected[k:, d] += fresh * (shown @ dense.inverse @ plain) * remains
    np.testing.assert_allclose(seen, expected, atol=1e-12)


def test_scores_are_the_slopes_of_the_likelihood(space: StateSpace) -> None:
    dense, y = Dense(space), np.random.default_rng(3).standard_normal((SAMPLES, CHANNELS, 1))
    _, of_inputs, of_channels = disturbances(space, innovations(space, y))
    weighted = dense.inverse @ y.ravel()[dense.use]
    for d, part in enumerate(dense.parts):
        if space.variance[d] == 0:
            assert not of_inputs[:, d].any()
            continue
        slope = part / space.variance[d]
        assert of_inputs[:, d] == pytest.approx(
            [weighted @ slope @ weighted, np.trace(dense.inverse @ slope)], rel=1e-10
        )
    for c in range(CHANNELS):
        mine = (np.arange(SAMPLES * CHANNELS) % CHANNELS == c)[dense.use]
        assert of_channels[:, :, c].sum(axis=1) == pytest.approx(
            [weighted[mine] @ weighted[mine], np.trace(dense.inverse[np.ix_(mine, mine)])], rel=1e-10
        )


def test_what_disturbances_bring_about_is_the_covariance_without_the_sensors(space: StateSpace) -> None:
    everywhere = replace(space, noise=np.ones((SAMPLES, CHANNELS)))
    brought = np.diagonal(Dense(everywhere).whole).reshape(SAMPLES, CHANNELS) - 1.0
    np.testing.assert_allclose(spread(space), brought.mean(axis=0), rtol=1e-10)


def noisy(held: bool, size: float, *, dithered: bool = False) -> tuple[Recording, MotorFile]:
    """Steps of voltage and load, measured with noise; `dithered`: the noise on the voltage was truly applied."""
    rng = np.random.default_rng(4)
    rows = 4000
    time = np.arange(rows) * 1e-3
    volts = np.repeat(rng.uniform(-200.0, 200.0, rows // 250), 250)
    load = np.repeat(rng.uniform(0.0, 6.0, rows // 250), 250) * np.sign(volts)
    on_volts, on_load = 0.48 * size * rng.standard_normal(rows), 0.013 * size * rng.standard_normal(rows)
    applied = volts + on_volts * dithered
    truth = simulate(Motor(), Inputs(time, applied, load, np.full(rows, 20.0), held=held))
    shown = {
        "voltage": volts + on_volts,
        "load_torque": load + on_load,
        "current": truth.current_A + 0.015 * size * rng.standard_normal(rows),
        "speed": truth.speed_rad_s + 0.44 * size * rng.standard_normal(rows),
    }
    return Recording("noisy", time, shown), MotorFile("plate", Motor(), PLATE)


@pytest.mark.parametrize("tolerance", [COARSE, TOLERANCE])
@pytest.mark.parametrize("period_s", [1e-3, 0.1, 1.0])
def test_noise_is_believed_down_to_well_above_what_simulations_are_off_by(
    period_s: float, tolerance: float
) -> None:
    """The oracle is the same simulation a million times as exact, of steps from 30 samples to the next."""
    rng, rows = np.random.default_rng(1), 3000
    volts = np.repeat(rng.uniform(-200.0, 200.0, rows // 30), 30)
    load = np.repeat(rng.uniform(0.0, 6.0, rows // 30), 30) * np.sign(volts)
    noise = rng.standard_normal((2, rows))
    shown = {"voltage": volts, "load_torque": load, "current": noise[0], "speed": noise[1]}
    file = MotorFile("plate", Motor(), PLATE)
    run = prepare(Recording("steps", np.arange(rows) * period_s, shown), file)
    model = start_model(file, [run])
    _, exact = predict(replace(model, tolerance=1e-10), run, 0)
    run = replace(run, measured=exact)
    error = predict(replace(model, tolerance=tolerance), run, 0)[1] - exact
    floor = np.sqrt(first_noise(run, error, PLATE.torque_Nm, tolerance).floor)
    assert np.all(20 * np.sqrt(np.mean(error**2, axis=0)) < floor)
    assert np.all(floor < 1e-3 * np.sqrt(np.mean(exact**2, axis=0)))


def levels(held: bool, size: float, *, dithered: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations found at the true motor: of current and speed; of voltage, load and the slow torque."""
    recording, file = noisy(held, size, dithered=dithered)
    run = prepare(recording, file).holding((held, held, held))
    run = replace(run, start={"i": 0.0, "w": 0.0, "theta": 0.0})
    model = replace(start_model(file, [run]), held=((held, held, held),))
    _, shown, _, linear = sensitivities_of(model, run, 0, ())
    error = run.measured - shown
    noise = first_noise(run, error, PLATE.torque_Nm, TOLERANCE)
    found, _ = likelier(noise, run, linear, error, run.there, 60)
    return np.sqrt(found.of_sensors(run)), np.sqrt(found.disturbances)


@pytest.mark.parametrize("held", [True, False])
@pytest.mark.parametrize("size", [0.2, 1.0, 5.0])
def test_noise_levels_are_found(held: bool, size: float) -> None:
    sensors, inputs = levels(held, size)
    assert sensors == pytest.approx(size * np.array([0.015, 0.44]), rel=0.06)
    assert inputs[0] == pytest.approx(0.48 * size, rel=0.12)
    # What reaches the speed of a load's noise at 1 kHz is small beside the speed sensor's: it is bounded, not measured.
    assert inputs[1] < 1.3 * 0.013 * size


def test_a_dither_that_was_truly_applied_is_no_noise() -> None:
    sensors, inputs = levels(True, 1.0, dithered=True)
    assert sensors == pytest.approx([0.015, 0.44], rel=0.06)
    assert inputs[0] < 0.1 * 0.48


@pytest.mark.parametrize("off", [0.0, 0.2, -0.49, 0.5, 0.9, -2.5, 12.0])
@pytest.mark.parametrize("sd", [0.03, 0.15, 0.4, 3.0])
def test_a_reading_tells_what_the_interval_around_it_does(off: float, sd: float) -> None:
    """Mean and variance of a state given that a noisy reading of it is one number, summed over all that it may be."""
    step, known = 0.7, 0.1**2
    noise = (sd * step) ** 2
    error = off * step
    space = StateSpace(
        np.zeros((0, 3, 9)), np.array([0]), np.array([0, 1, 1]), np.full((1, 1), -1), np.array([step]),
        np.zeros(3, np.bool_), np.zeros((0, 3)), np.zeros(3), np.array([[noise + step**2 / 12]]),
        np.array([known, 0.0, 0.0]),
    )  # fmt: skip
    seen = read(space, np.array([[error]]))

    wide = np.sqrt(known)
    states = np.linspace(-100 * wide, 100 * wide, 400_001)
    above, below = ((error + side * step / 2 - states) / np.sqrt(noise) for side in (1, -1))
    logarithm = norm.logpdf(states, 0, wide) + log_between(below, above)
    largest = float(logarithm.max())
    total, first, second = (
        float(np.trapezoid(states**p * np.exp(logarithm - largest), states)) for p in (0, 1, 2)
    )
    mean, variance = first / total, second / total - (first / total) ** 2
    assert not seen.space.steps.any()
    told = seen.space.noise[0, 0]
    if not np.isfinite(told):
        assert mean == pytest.approx(0, abs=1e-6) and variance == pytest.approx(known, rel=1e-6)
    else:
        assert known / (known + told) * seen.error[0, 0] == pytest.approx(mean, rel=1e-3, abs=1e-6)
        assert known * told / (known + told) == pytest.approx(variance, rel=2e-3)
    density = np.log(total) + largest - np.log(step)
    assert seen.unlikely[0, 0] == pytest.approx(-2 * density - np.log(2 * np.pi), rel=1e-3, abs=2e-3)
    spread_out = np.sqrt(known + noise)
    most = np.log(norm.cdf(step / 2 / spread_out) - norm.cdf(-step / 2 / spread_out)) - np.log(step)
    assert seen.deviance[0, 0] == pytest.approx(2 * (most - density), rel=1e-3, abs=2e-3)


def log_between(below: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Logarithm of the probability of a normal variable between two bounds, whichever tail they are in."""
    turned = below + above > 0
    low, high = np.where(turned, -above, below), np.where(turned, -below, above)
    return np.asarray(norm.logcdf(high) + np.log1p(-np.exp(norm.logcdf(low) - norm.logcdf(high))))


def test_blocks_are_filtered_as_the_whole_is(space: StateSpace) -> None:
    columns = np.random.default_rng(3).standard_normal((SAMPLES, CHANNELS, 4))
    found = list(
        in_blocks(
            space,
            innovations(space, columns[:, :, :1]),
            columns,
            [slice(0, 1), slice(1, 8), slice(8, SAMPLES)],
        )
    )
    assert [len(one) for one in found] == [1, 7, SAMPLES - 8]
    np.testing.assert_allclose(
        np.concatenate(found), innovations(space, columns).white, rtol=1e-9, atol=1e-12
    )


def test_what_has_no_converter_is_read_as_it_is(space: StateSpace) -> None:
    error = np.random.default_rng(2).standard_normal((SAMPLES, CHANNELS))
    seen, filtered = read(space, error), innovations(space, error[:, :, None])
    np.testing.assert_array_equal(seen.error, error)
    np.testing.assert_array_equal(seen.space.noise, space.noise)
    white, there = filtered.white[:, :, 0], np.isfinite(filtered.scale)
    assert seen.deviance == pytest.approx(white**2)
    assert seen.unlikely[there] == pytest.approx((white**2 + 2 * np.log(filtered.scale))[there])
    assert not seen.unlikely[~there].any()


def test_readings_are_filtered_as_what_they_tell_is(space: StateSpace) -> None:
    rng = np.random.default_rng(4)
    coarse = replace(space, steps=rng.uniform(0.5, 2.0, CHANNELS), noise=space.noise + 0.4)
    seen = read(coarse, rng.standard_normal((SAMPLES, CHANNELS)))
    again = innovations(seen.space, seen.error[:, :, None])
    for one, other in zip(vars(seen.filtered).values(), vars(again).values(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("sd", "told"), [(0.0, 0.1), (0.12, 0.12), (0.3, 0.3)])
def test_noise_beneath_the_step_of_a_converter_is_found(sd: float, told: float) -> None:
    """Of a motor that turns slowly through the levels: the noise before the converter, at least a tenth of its step."""
    rng, step = np.random.default_rng(7), 0.8
    time = np.arange(6000) * 0.002
    volts = 100 + 60 * np.sin(time) + 20 * np.sin(7 * time)
    motor = Motor()
    truth = simulate(motor, Inputs(time, volts, 0 * time, np.full(len(time), 20.0)))
    speed = np.round((truth.speed_rad_s + sd * step * rng.standard_normal(len(time))) / step) * step
    current = truth.current_A + 0.02 * rng.standard_normal(len(time))
    channels = {"voltage": volts, "current": current, "speed": speed, "load_torque": 0 * time}
    run = prepare(Recording("coarse.csv", time, channels), MotorFile("plate", motor, PLATE))
    assert run.steps[1] == pytest.approx(step) and not run.steps[0]
    run = replace(run, start={"i": 0.0, "w": 0.0, "theta": 0.0})
    _, shown, _, linear = sensitivities_of(start_model(MotorFile("plate", motor, PLATE), [run]), run, 0, ())
    error = run.measured - shown
    noise = first_noise(run, error, PLATE.torque_Nm, TOLERANCE)
    found, _ = likelier(noise, run, linear, error, run.there, 60)
    assert np.sqrt(found.of_sensors(run)) == pytest.approx([0.02, told * step], rel=0.06)
