"""Bayes factors of the contest against integrals done numerically, and likelihoods of models against what was simulated."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import gumbel_r

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.model import with_sensor
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.prior import part_prior
from motorlens_physics.motor_file import read_motor_file, with_overrides
from motorlens_physics.recording import Recording
from motorlens_physics.sensor_model import sensor_catalogue
from motorlens_physics.simulation import Inputs, simulate
from motorlens_workbench.contest import contest as contest_module
from motorlens_workbench.contest import worth
from motorlens_workbench.contest.bayes_factor import log_bayes_factor, log_shape
from motorlens_workbench.contest.entering import Step
from motorlens_workbench.contest.needed import needed_weight, needed_without_a_name
from motorlens_workbench.contest.worth import consistent, held_score, told_apart
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.null import Null
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.standing import Residual, unlikely_from

# A load that is not there, measured with noise: how large the sensor's gain is, nothing can tell.
IDLE_NOISE_NM = 0.4


def score(size: float, information: float, *, named: bool = True) -> SimpleNamespace:
    """A single column whose best size, in typical sizes, is known with some information."""
    return SimpleNamespace(
        entry=SimpleNamespace(hypothesis=SimpleNamespace(named=named)),
        gain=size**2 * information,
        information=np.array([[information]]),
        coefficient=np.array([size]),
        width=1,
    )


@pytest.mark.parametrize("size", [0.3, 1.0, 4.0, 30.0])
@pytest.mark.parametrize("information", [100.0, 1e4])
@pytest.mark.parametrize("scatter", [1.0, 5.0])
def test_a_name_is_weighed_by_the_integral_over_cauchys_sizes(size, information, scatter):
    """Laplace's approximation, but for a constant that all names share: half the logarithm of 2 over pi."""
    known = information / scatter
    around = size + np.linspace(-8, 8, 17) / np.sqrt(known)
    exact = quad(
        lambda c: np.exp(-0.5 * known * (c - size) ** 2) / (np.pi * (1 + c**2)),
        around[0], around[-1], points=around[1:-1], limit=200,
    )[0]  # fmt: skip
    told = log_bayes_factor(score(size, information), scatter) - 0.5 * size**2 * known
    assert told + 0.5 * np.log(2 / np.pi) == pytest.approx(np.log(exact), abs=0.12)


def test_of_two_that_explain_as_much_the_one_nearer_its_typical_size_is_likelier():
    gain = 60.0
    told = {size: log_bayes_factor(score(size, gain / size**2), 1.0) for size in (0.05, 1.0, 20.0)}
    assert told[1.0] > told[0.05] + 1 and told[1.0] > told[20.0] + 1


@pytest.mark.parametrize("weaker", ["book", "plain"])
def test_a_name_is_held_by_the_weaker_of_both_ways_to_take_the_noise(monkeypatch, weaker):
    weights = {"book": 30.0, "plain": 40.0, weaker: 7.0}
    told = {book: SimpleNamespace(weight=weight) for book, weight in weights.items()}
    monkeypatch.setattr(worth, "own_score", lambda book, fitted, hypothesis: told[book])
    assert held_score("book", "plain", None, None).weight == 7.0  # type: ignore[arg-type,union-attr]
    told[weaker] = None  # type: ignore[assignment]
    assert held_score("book", "plain", None, None) is None  # type: ignore[arg-type]


def estimated_anew(monkeypatch, equation, times, colour, *steps):
    """Equations about which a contest estimates anew where nothing is beyond chance, each with the names it did so with.

    Args:
        monkeypatch: of the test.
        equation: of the term that explains most.
        times: the error over the noise.
        colour: that is left.
        steps: what that leads to, each time elsewhere in the same model; after them to nothing.
    """
    rest = SimpleNamespace(entry=SimpleNamespace(hypothesis=SimpleNamespace(equation=equation)))
    here = SimpleNamespace(
        rest=rest,
        book=SimpleNamespace(colour=colour),
        times_noise=times,
        challengers=(),
        null=None,
        scores=(),
    )
    asked, led = [], iter([replace(step, standing=here) for step in steps])

    def enter_anew(here, equation, estimated, *rest):
        asked.append((equation, *estimated))
        return next(led, Step())

    monkeypatch.setattr(contest_module, "stand", lambda base, own: here)
    monkeypatch.setattr(contest_module, "enter_anew", enter_anew)
    for name in ("beyond_chance", "promising"):
        monkeypatch.setattr(contest_module, name, lambda *of: [])
    contest_module.contest(SimpleNamespace(runs=[SimpleNamespace(moves=True)]))  # type: ignore[arg-type]
    return asked


@pytest.mark.parametrize(
    ("times", "colour", "tried"), [(4.0, 50.0, []), (4.0, 150.0, ["coupling"]), (5.0, 50.0, ["coupling"])]
)
def test_what_is_correlated_as_no_noise_is_estimated_anew_with_names_before_it_is_called_unknown(
    monkeypatch, times, colour, tried
):
    """Nothing is beyond chance; a blind case showed a magnet that warms, four times the noise off, and was given up."""
    assert estimated_anew(monkeypatch, "coupling", times, colour) == [(equation,) for equation in tried]


def test_no_name_is_estimated_twice_from_the_beginning_beside_the_same_names(monkeypatch):
    """The first attempt shows that the same model fits better elsewhere: where estimates lead does not depend on that."""
    names = ("radiation", "iron_core")
    asked = estimated_anew(monkeypatch, "thermal", 9.0, 0.0, Step(estimated=names))
    assert asked == [("thermal",), ("thermal", *names)]


@pytest.mark.parametrize(
    ("scale", "named", "least", "most"),
    [(0.8, True, 1e-5, 1e-4), (0.8, False, 1e-9, 1e-8), (0.3, True, 1e-5, 1e-4), (0.3, False, 1e-5, 1e-4)],
)
def test_what_is_needed_is_rarer_by_chance_without_a_name_than_with_one(scale, named, least, most):
    """Gumbel's distribution by another's code, no narrower than that of a single test."""
    here = SimpleNamespace(null=Null(6.0, scale))
    needed = needed_weight(here) if named else needed_without_a_name(here, (), colour=0.0)  # type: ignore[arg-type]
    rate = gumbel_r(6.0, max(scale, math.sqrt(6) / math.pi)).sf(needed)
    assert least <= rate <= most


@pytest.mark.long
@pytest.mark.fit
def test_a_motor_that_responds_less_is_no_likelier_for_having_less_of_the_noise_of_its_inputs():
    """Nothing is missing, and the voltage is noisy: 5 % more resistance passes less of that noise on.

    Along its resistance the motor is likeliest within two of the deviations that its own likelihood has there.
    """
    file = read_motor_file("mellah2016")
    rng, time = np.random.default_rng(7), np.arange(6000) * 1e-3
    volts = np.repeat(rng.uniform(60.0, 240.0, 12), 500)
    inputs = Inputs(time, volts, np.full(len(time), 1.0), np.full(len(time), 20.0), held=True)
    true = simulate(file.motor, inputs)
    shown = {
        "voltage": volts + 30.0 * rng.standard_normal(len(time)), "load_torque": inputs.load_torque_Nm,
        "current": true.current_A + 0.005 * rng.standard_normal(len(time)),
        "speed": true.speed_rad_s + 0.05 * rng.standard_normal(len(time)),
    }  # fmt: skip
    base = fitted_of(estimate(file, prepare_all([Recording("noisy", time, shown)], file)))
    more, less = (
        replace(base, model=base.model.with_values({"R_a0": by * base.model.values()["R_a0"]}))
        for by in (1.05, 0.95)
    )

    def lines(fitted):
        return [Line.of(fitted.model, run, r, fitted.prior.keys) for r, run in enumerate(fitted.runs)]

    def itself(fitted):
        return Residual.of(lines(fitted), [line.error for line in lines(fitted)]).unlikely

    here = SimpleNamespace(lines=lines(base))
    assert unlikely_from(here, base) == pytest.approx(itself(base), rel=1e-9)  # type: ignore[arg-type]
    assert itself(more) < itself(base) - 10, "through its own frame the wrong motor looks likelier"

    def course(cost):  # type: ignore[no-untyped-def]
        """Slope and curvature through 5 % less, none and 5 % more: cost = slope x + curvature x^2."""
        above, below = (cost(one) - cost(base) for one in (more, less))
        return 0.5 * (above - below), 0.5 * (above + below)

    slope, curvature = course(lambda fitted: unlikely_from(here, fitted))
    assert curvature > 3 and abs(slope) < 4 * np.sqrt(curvature)
    slope, curvature = course(itself)
    assert slope < -6 * np.sqrt(curvature), "through its own frame it is likeliest far away"


@pytest.mark.fit
def test_a_gain_of_a_noisy_input_is_no_likelier_for_making_its_noise_smaller():
    file = read_motor_file("mellah2016")
    rng, time = np.random.default_rng(5), np.arange(6000) * 1e-3
    volts = np.repeat(rng.uniform(60.0, 240.0, 12), 500)
    inputs = Inputs(time, volts, np.zeros(len(time)), np.full(len(time), 20.0), held=True)
    true = simulate(file.motor, inputs)
    shown = {
        "voltage": volts, "load_torque": IDLE_NOISE_NM * rng.standard_normal(len(time)),
        "current": true.current_A + 0.005 * rng.standard_normal(len(time)),
        "speed": true.speed_rad_s + 0.005 * rng.standard_normal(len(time)),
    }  # fmt: skip
    base = fitted_of(estimate(file, prepare_all([Recording("idle", time, shown)], file)))
    here = SimpleNamespace(
        lines=[Line.of(base.model, run, r, base.prior.keys) for r, run in enumerate(base.runs)]
    )
    gain = replace(sensor_catalogue()["load_torque_sensor_gain"], gain=1.5)
    with_gain = replace(base, model=with_sensor(base.model, gain))
    one, other = (unlikely_from(here, fitted) for fitted in (base, with_gain))  # type: ignore[arg-type]
    # Were the noise two thirds as large, this would be thousands.
    assert abs(one - other) < 0.02 * len(time)


def test_a_win_is_as_consistent_as_blocks_of_time_agree_on_it():
    rng = np.random.default_rng(6)
    won = 1.0 + rng.standard_normal(64)
    pairs, fours = won.reshape(-1, 2).sum(axis=1), won.reshape(-1, 4).sum(axis=1)
    ratios = [won.sum() ** 2 / (len(part) * np.var(part, ddof=1)) for part in (won, pairs, fours)]
    assert consistent(won, 1e9) == pytest.approx(min(ratios))
    assert consistent(won, 5.0) == 5.0, "never more than the likelihood rises"
    assert consistent(-won, 1e9) == 0.0


def test_what_noise_alone_tells_apart_counts_as_its_likelihood_does_and_one_block_counts_for_little():
    """Errors of unit variance beside shifts of a deviation: each block's likelihood ratio in closed form."""
    rng = np.random.default_rng(8)
    shift = 0.5
    counted, whole = [], []
    for _ in range(200):
        errors = shift + rng.standard_normal((64, 4))
        won = np.sum(errors**2 - (errors - shift) ** 2, axis=1)
        counted.append(told_apart(won))
        whole.append(0.5 * won.sum())
    assert 0.8 < np.mean(counted) / np.mean(whole) <= 1.0, "the least of three ratios is no larger"
    # All of it in one block of 64, however much: the squared ratio is 1, that of pairs and fours a little less.
    for much in (10.0, 1000.0):
        assert told_apart(np.r_[much, np.zeros(63)]) == pytest.approx(2.0, rel=0.01)
    assert told_apart(np.r_[-1000.0, np.zeros(63)]) == 0.0


def test_a_shape_is_as_likely_beforehand_as_its_parameters_are():
    file = with_overrides(read_motor_file("mellah2016"), {"dead_time.V_dt": 1.0})
    prior = part_prior(file, "dead_time")
    moved = {"dead_time.i_r": 2.0, "dead_time.m": -1.0}
    file = file.with_values({key: prior.centre[key] + n * prior.sd[key] for key, n in moved.items()})
    fitted = SimpleNamespace(model=SimpleNamespace(values=file.values), prior=prior)
    one = SimpleNamespace(name="dead_time", key="dead_time.V_dt")
    assert log_shape(one, fitted) == pytest.approx(-0.5 * (2.0**2 + 1.0**2))  # type: ignore[arg-type]


def test_chance_wins_no_more_often_than_its_level():
    """Of two models as good as each other one is consistently likelier, at 1 %, in no more than 1 %."""
    rng = np.random.default_rng(7)
    told = np.array([consistent(rng.standard_normal(64), 1e9) for _ in range(4000)])
    assert np.mean(told > 6.635) < 0.01
