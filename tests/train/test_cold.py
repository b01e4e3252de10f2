"""A cold start beside any start: the odds are those of two densities, a cold one is known well, a warm one not missed."""

from dataclasses import replace

import numpy as np
import pytest
from helpers.duty import MELLAH
from scipy.stats import norm

from motorlens_physics.motor_file import Knowledge
from motorlens_train.evaluation.worlds.plant import Constants, run
from motorlens_train.observer.belief import open_resistance
from motorlens_train.observer.cold import CERTAIN, COLD, Track, another_likelier, weighed
from motorlens_train.observer.design import ObserverSettings, observer
from motorlens_train.observer.layout import Layout
from motorlens_train.observer.program import Recorder

pytestmark = pytest.mark.fit

SETTINGS = ObserverSettings(voltage_sd=0.48, current_sd=0.0509)
LAYOUT = Layout(MELLAH, SETTINGS)
MOTOR = Constants()


@pytest.fixture(scope="module")
def watching():
    return observer(MELLAH, SETTINGS)


def mixed(theta, sd, rise=0.0, left=1.0, other_sd=0.0, ran=0.0, reach=0.0, own_sd=0.0):
    """Temperature and its deviation, of the filter's `theta` +- `sd` and a winding that began cold and is now at `rise`."""
    r = Recorder()
    theta_now, variance, track = r.inputs(["theta", "variance", "track"])
    start = weighed(
        LAYOUT,
        Track([r.constant(rise)], track, r.constant(left), r.input("ran")),
        theta_now,
        variance,
        0.0,
        other_sd**2 + own_sd**2,
        own_sd**2,
        reach,
    )
    moves, stated = (float(v) for v in r.program([start.moves, start.thermometer])(theta, sd**2, 0.01, ran))
    return theta + moves, np.sqrt(stated)


def followed(watching, warm_K, seconds=60.0, volts=(0.0, 200.0, 90.0, 160.0), motor=MOTOR):
    """Steps at 500 Hz from a start so warm: what the observer says, and the states."""
    rng, n = np.random.default_rng(4), int(500 * seconds)
    time, voltage = np.arange(n) * 2e-3, np.repeat(volts, n // len(volts))
    states, _ = run(motor, time, voltage, True, np.full(n, 4.0), np.zeros(n), np.array([0.0, 0.0, warm_K]))
    seen, _ = watching.run(
        np.full(n, 2e-3), voltage + 0.5 * rng.standard_normal(n), states[:, 0] + 0.05 * rng.standard_normal(n),
        np.full(n, 20.0),
    )  # fmt: skip
    return dict(zip(watching.outputs, seen.T, strict=True)), states


@pytest.mark.parametrize(("theta", "sd"), [(24.0, 36.0), (3.0, 4.0), (9.0, 3.0), (40.0, 5.0)])
def test_the_share_of_a_cold_start_is_that_of_two_normal_densities(theta, sd):
    found, _ = mixed(theta, sd)
    mean, spread = LAYOUT.start[LAYOUT.at["theta"]], LAYOUT.sd[LAYOUT.at["theta"]]
    # What was measured makes N(mean, spread) an N(theta, sd): how likely it is of a cold winding, over how likely of any.
    factor = norm.pdf(0.0, theta, np.hypot(sd, 0.1)) / norm.pdf(0.0, mean, np.hypot(spread, 0.1))
    cold = COLD * factor / (COLD * factor + 1 - COLD)
    assert found == pytest.approx((1 - cold) * theta, rel=1e-6)


def test_of_a_start_that_was_not_cold_the_filter_alone_speaks():
    temperature, sd = mixed(40.0, 2.0)
    assert temperature == pytest.approx(40.0, abs=1e-6) and sd == pytest.approx(2.0, rel=1e-6)
    assert mixed(40.0, 2.0, other_sd=5.0)[1] == pytest.approx(np.hypot(2.0, 5.0), rel=1e-6)


def test_who_came_late_has_seen_no_cold_start():
    temperature, sd = mixed(24.0, 36.0, ran=1.0)
    assert temperature == pytest.approx(24.0) and sd == pytest.approx(36.0)


def test_before_anything_has_shown_the_interval_holds_both():
    temperature, sd = mixed(24.0, 36.0)
    assert temperature == pytest.approx(12.0)
    assert sd * 1.96 > 24.0 - temperature + 1.6 * 36.0


@pytest.mark.parametrize(
    ("measured", "noise"), [(-4.7, 1.0), (-1.0, 1.0), (0.0, 1.0), (2.0, 1.0), (40.0, 1.0), (5.0, 200.0)]
)
@pytest.mark.parametrize(("ran", "least", "most"), [(0.0, 0.005, 3.5), (1.0, 0.9, 1.1)])
def test_a_start_that_is_nearly_cold_is_likelier_of_another_resistance(measured, noise, ran, least, most):
    place, within = LAYOUT.at["theta"], 25.0
    mean, sd = LAYOUT.start[place], LAYOUT.sd[place]
    share = 1 / (1 + (noise / sd) ** 2)
    r = Recorder()
    ran_or_not = r.input("ran")
    track = Track([r.constant(0.0)], r.constant(0.0), r.constant(1.0), ran_or_not)
    theta, variance = r.constant(mean + share * (measured - mean)), r.constant(share * noise**2)
    found = float(r.program([another_likelier(LAYOUT, track, theta, variance, r.constant(within))])(ran)[0])

    def density(resistances):
        """Of what was measured, the mean over what R_a0 does to the temperature."""
        cold, other = (1 - ran) * COLD, 1 - (1 - ran) * COLD
        of_any = norm.pdf(measured - resistances, mean, np.hypot(sd, noise))
        return np.mean(cold * norm.pdf(measured - resistances, 0.0, noise) + other * of_any)

    # Any start is taken to be evenly likely over that tolerance.
    another, same = density(np.linspace(-within, within, 5001)), density(np.zeros(1))
    assert found == pytest.approx(another / same, rel=0.15)
    assert least < found < most


def test_what_is_certain_widens_as_the_interval_says():
    assert pytest.approx((1 - 0.05 * COLD) / 1.96) == CERTAIN


@pytest.mark.parametrize(("volts", "began_with_A", "expected"), [(160.0, 5.0, 24.0), (160.0, 0.0, 12.0)])
def test_a_current_at_the_first_sample_is_a_motor_that_ran(watching, volts, began_with_A, expected):
    n = 40
    current = np.full(n, began_with_A) if began_with_A else 40.0 * (1 - np.exp(-np.arange(n) * 1e-3 / 9.7e-3))
    seen, _ = watching.run(np.full(n, 1e-3), np.full(n, volts), current, np.full(n, 20.0))
    temperature = seen[10, watching.outputs.index("temperature")]
    assert (abs(temperature - 12.0) < 8.0) == (expected == 12.0) and temperature < 60.0


def test_a_cold_motor_is_known_better_than_its_inrushes_tell(watching):
    seen, states = followed(watching, 0.0)
    error, stated = seen["temperature"] - states[:, 2], np.exp(0.5 * seen["log_temperature"])
    later = slice(15_000, None)  # two steps of the voltage
    assert np.abs(error[later]).max() < 0.3
    assert 0.15 < stated[later].max() < 5.0


@pytest.mark.parametrize("warm_K", [5.0, 60.0])
def test_a_warm_one_is_told(watching, warm_K):
    seen, states = followed(watching, warm_K)
    error, stated = seen["temperature"] - states[:, 2], np.exp(0.5 * seen["log_temperature"])
    later = slice(15_000, None)
    assert np.all(np.abs(error[later]) < 1.96 * stated[later])
    assert np.abs(error[later]).max() < 5.0


@pytest.mark.parametrize("warm_K", [0.0, 40.0])
@pytest.mark.parametrize(("share", "deviations"), [(0.92, 1.96), (1.02, 1.96), (1.08, 1.96), (1.15, 3.0)])
def test_another_resistance_passes_for_a_temperature_and_the_interval_holds_it(
    watching, share, deviations, warm_K
):
    seen, states = followed(watching, warm_K, motor=MOTOR._replace(R=share * MOTOR.R))
    error = seen["temperature"] - states[:, 2]
    later = slice(15_000, None)
    # Off by its share of 1/alpha + theta; what alone is measured, the resistance itself, is right, and said to be.
    assert np.abs(error[later]).max() > 0.8 * abs(share - 1) * 250.0
    assert np.all(np.abs(error[later]) < deviations * np.exp(0.5 * seen["log_temperature"][later]))
    wrong = seen["resistance"] - share * MOTOR.R * (1 + MOTOR.alpha * states[:, 2])
    stated = np.exp(0.5 * seen["log_resistance"])
    assert np.all(np.abs(wrong[later]) < 1.96 * stated[later]) and stated[-1] < 0.05


@pytest.mark.parametrize(
    ("sd", "expected"), [(None, 0.1), (0.35, 0.1), (0.0035, 0.0035 * 3**0.5 / 3.5), (0.0, 0.0)]
)
def test_a_file_that_knows_its_resistance_leaves_less_of_it_open(sd, expected):
    known = {**MELLAH.knowledge, "R_a0": Knowledge(sd)}
    assert open_resistance(Layout(replace(MELLAH, knowledge=known), SETTINGS)) == pytest.approx(expected)


def test_who_is_warm_has_a_thermometer_as_good_as_its_resistance_and_who_is_cold_needs_none():
    temperature, sd = mixed(40.0, 2.0, reach=14.0)
    assert temperature == pytest.approx(40.0) and sd == pytest.approx(2.0 + 14.0, rel=1e-6)
    assert mixed(0.1, 0.1, reach=14.0) == mixed(0.1, 0.1)


def test_a_resistance_that_may_be_another_s_is_reckoned_with_once():
    assert mixed(40.0, 2.0, own_sd=12.0)[1] == pytest.approx(np.hypot(2.0, 12.0), rel=1e-6)
    assert mixed(40.0, 2.0, own_sd=12.0, reach=14.0)[1] == pytest.approx(2.0 + 14.0, rel=1e-6)
