"""Whether the motor is the file's, from what discrepancies show: Bayes factors, intervals, and every number that decides."""

from types import SimpleNamespace

import numpy as np
import pytest
from helpers.duty import MELLAH
from scipy.stats import multivariate_normal

from motorlens_physics.effect import catalogue
from motorlens_train.observer import belief
from motorlens_train.observer.layout import PAIRS, Layout, ObserverSettings
from motorlens_train.observer.program import Recorder

LAYOUT = Layout(MELLAH, ObserverSettings(voltage_sd=0.48, current_sd=0.0509))
STILL = {"fine_voltage": 1e9, "fine_current": 1e9, "log_level": 0.0, "slope": 7.0}


def doubted(inertia=(0.0, 0.0), inductance=(0.0, 0.0), drop=(0.0, 0.0), theta=20.0):
    """Log odds against the file's motor and grown sd of speed and temperature, for (estimate, information) of each."""
    r = Recorder()
    given = {"inertia": inertia, "inductance": inductance, "drop": drop}
    names = [*STILL, *(f"{k}_{n}" for k in given for n in ("score", "information")), "theta", "nothing"]
    values = dict(zip(names, r.inputs(names), strict=True))
    states = [r.constant(0.0)] * len(LAYOUT.states)
    known = {k: (states, values[f"{k}_information"], values[f"{k}_score"]) for k in given}
    x = [200.0, values["theta"], 0.0]
    nothing = values["nothing"]
    known["hold"] = (states, nothing, nothing)
    against, grown, _ = belief.doubt(
        LAYOUT, known, dict.fromkeys(PAIRS, nothing), nothing, values, [r.constant(200.0), x[1], r.constant(0.0)],
        r.constant(3.5),
    )  # fmt: skip
    program = r.program([against, grown["w"], grown["theta"]])
    numbers = [*STILL.values(), *(v for b, i in given.values() for v in (b * i, i)), theta, 0.0]
    log_odds, *variances = (float(v) for v in program(*numbers))
    return SimpleNamespace(
        odds=np.exp(log_odds), speed=np.sqrt(variances[0]), temperature=np.sqrt(variances[1])
    )


def told(slopes, errors):
    """Score and information of discrepancies with `slopes` (N, k) from `errors` (N,) of unit variance."""
    return slopes.T @ errors, slopes.T @ slopes


def recorded(of, shown):
    """What `of` says of a recorded `Shown`: score (2,), information (2, 2)."""
    r = Recorder()
    s, t, a, d, c = r.inputs(["s", "t", "a", "d", "c"])
    (score, information) = shown
    program = r.program([of(belief.Shown((s, t), (a, d), c))])
    return float(program(*score, information[0, 0], information[1, 1], information[0, 1])[0])


@pytest.mark.parametrize("b", [(0.0, 0.0), (0.004, -0.01), (0.05, 0.03)])
def test_the_weight_is_the_ratio_of_two_normal_densities(b):
    rng, slack, spread = np.random.default_rng(5), (0.002**2, 0.005**2), (0.13**2, 0.06**2)
    slopes = rng.standard_normal((6, 2)) * (30.0, 20.0) + 25.0
    errors = slopes @ b + rng.standard_normal(6)
    far, near = (
        multivariate_normal.logpdf(errors, cov=np.eye(6) + slopes @ np.diag(wide) @ slopes.T)
        for wide in (spread, slack)
    )
    found = recorded(lambda shown: shown.weight(slack, spread), told(slopes, errors))
    assert found == pytest.approx(far - near, rel=1e-9)


def test_what_remains_of_two_discrepancies_is_their_posterior_at_a_ninth_of_the_windows():
    rng, spread, moves = np.random.default_rng(6), (0.13**2, 0.06**2), np.array([40.0, -25.0])
    slopes = rng.standard_normal((9, 2)) * 20.0 + 15.0
    score, information = told(slopes, slopes @ (0.02, -0.01))
    found = recorded(lambda shown: shown.remaining(spread, tuple(moves)), (score, information))
    C = np.linalg.inv(information / 9 + np.linalg.inv(np.diag(spread)))
    assert found == pytest.approx(3 * (moves @ C @ moves + (moves @ C @ score / 9) ** 2), rel=1e-9)


@pytest.mark.parametrize("hold", [-0.5, 0.5])
def test_another_motor_that_passes_for_another_hold_is_weighed_as_if_the_hold_had_been_sought_with_it(hold):
    """Against the joint density over how the voltage runs, good to a tenth of a step, inertia and inductance."""
    rng, spread = np.random.default_rng(7), np.array([0.13**2, 0.06**2])
    # The inertia does nearly what the hold does.
    along = rng.standard_normal(40)
    slopes = np.column_stack(
        [90.0 * along, 700.0 * along + 20 * rng.standard_normal(40), rng.standard_normal(40)]
    )
    errors = slopes @ (hold, 0.05, 0.03) + rng.standard_normal(40)
    # As the filter finds the hold: for the file's motor.
    found = slopes[:, 0] @ errors / (slopes[:, 0] @ slopes[:, 0])
    score, information = told(slopes, errors - found * slopes[:, 0])
    r = Recorder()
    pairs = dict(
        zip(PAIRS, (information[0, 0], information[0, 1], information[0, 2], information[1, 2]), strict=True)
    )
    names = ["s", "t", "a", "d", "hold_found", "told", *PAIRS]
    values = dict(zip(names, r.inputs(names), strict=True))
    shown = belief.Shown((values["s"], values["t"]), (values["a"], values["d"]), values["motor"])
    freed = belief.unmasked(shown, values, values["hold_found"], values["told"])
    program = r.program([freed.weight((0.0, 0.0), tuple(spread))])
    mine = float(
        program(*score[1:], information[1, 1], information[2, 2], found, information[0, 0], *pairs.values())[
            0
        ]
    )
    about = errors - np.sign(found) * 0.5 * slopes[:, 0]
    near = np.eye(40) + 0.1**2 * np.outer(slopes[:, 0], slopes[:, 0])
    far = near + slopes[:, 1:] @ np.diag(spread) @ slopes[:, 1:].T
    true = multivariate_normal.logpdf(about, cov=far) - multivariate_normal.logpdf(about, cov=near)
    assert mine == pytest.approx(true, abs=0.05)
    assert true > 5.0  # it is another motor


@pytest.mark.parametrize("prior", [0.125, 0.5])
@pytest.mark.parametrize("probability", [0.001, 0.01, 0.04, 0.1, 0.3, 1.0])
def test_intervals_leave_out_no_more_than_they_say(probability, prior):
    r = Recorder()
    wider = float(r.program([belief.widened(1.0 / r.input("p"), prior)])(probability)[0])
    # An even spread of half width 1, there with this probability: what lies beyond so many deviations of it.
    beyond = [probability * max(0.0, 1.0 - reach * wider) for reach in (1.96, 4.0)]
    assert beyond[0] <= 0.05 * prior + 1e-12 and beyond[1] <= 0.0005 + 1e-12
    # And one of the two is used up.
    assert beyond[0] == pytest.approx(0.05 * prior) or beyond[1] == pytest.approx(0.0005)


def test_what_is_too_unlikely_to_matter_widens_nothing():
    r = Recorder()
    assert float(r.program([belief.widened(1.0 / r.input("p"), 0.125)])(0.0004)[0]) == 0.0


def test_spreads_are_those_of_a_maker_s_tolerance_and_of_the_catalogue():
    rng = np.random.default_rng(0)
    J, ke, L = rng.uniform(0.9, 1.1, (3, 200_000))
    assert belief.SPREAD["inertia"] == pytest.approx(np.std(np.log(J / ke**2)), rel=0.01)
    assert belief.SPREAD["inductance"] == pytest.approx(np.std(np.log(L)), rel=0.01)
    # A hundredth of the rated voltage: the typical drop of the catalogue.
    typical = catalogue()["brush_voltage_drop"].typical(MELLAH.rated).V_b
    assert belief.DROP * MELLAH.rated.voltage_V == pytest.approx(typical)


def test_before_anything_has_shown_the_file_s_motor_is_three_times_as_likely_as_the_others():
    nothing = doubted()
    assert nothing.odds == pytest.approx(1 / 3)
    # Evenly within 10 %: 95 % of them reach to 0.95 of 20 rad/s, at 1.96 deviations.
    # As likely a drop of up to 4.2 V, all of which a steady motor takes for speed.
    largest = 3**0.5 * belief.DROP * MELLAH.rated.voltage_V / MELLAH.motor.ke
    assert nothing.speed == pytest.approx(0.95 * np.hypot(20.0, largest) / 1.96, rel=1e-6)
    assert nothing.temperature == pytest.approx(0.95 * 27.0 / 1.96, rel=1e-6)


def test_a_motor_that_is_shown_to_be_the_file_s_is_believed_and_its_intervals_are_narrow():
    shown = doubted((0.0, 1 / 0.0005**2), (0.0, 1 / 0.005**2), (0.0, 1 / 0.01**2))
    assert shown.odds < 0.01
    assert shown.temperature < 0.3


@pytest.mark.parametrize(
    ("name", "accepted", "refused"),
    [("inertia", 0.006, 0.008), ("inductance", 0.010, 0.016), ("drop", 0.14, 0.19)],
)
def test_from_what_size_on_a_discrepancy_that_is_known_well_is_another_motor(name, accepted, refused):
    information = {"inertia": 1e9, "inductance": 1e9, "drop": 1e6}[name]
    assert doubted(**{name: (accepted, information)}).odds < 1.0
    assert doubted(**{name: (refused, information)}).odds > 1.0


def test_a_drop_that_is_shown_not_to_be_there_widens_by_what_may_remain_of_it():
    """Half as well known, twice as wide; and never by the largest drop there is once it is known better."""
    widths = [doubted((0.0, 1e9), (0.0, 1e9), (0.0, 1 / sd**2)).speed for sd in (0.1, 0.2)]
    largest = 3**0.5 * belief.DROP * MELLAH.rated.voltage_V / MELLAH.motor.ke
    assert 0.0 < widths[0] < widths[1] < 0.1 * largest


@pytest.mark.parametrize(("rise", "good"), [(-19.0, True), (-21.0, False), (249.0, True), (251.0, False)])
def test_what_no_winding_can_be_is_not_believed(rise, good):
    assert (doubted(theta=rise).odds < 1.0) == good
