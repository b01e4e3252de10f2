"""How much of a network's correction of an observer is kept: what cycles it was not trained on bear out."""

import numpy as np

from motorlens_train.build import _share, _steady_share


def cycles(count, slope, seed=0):
    """Guesses and targets of cycles, one output: the guess times `slope` of that cycle, plus noise."""
    rng = np.random.default_rng(seed)
    guess = [0.5 * rng.standard_normal((400, 1)) for _ in range(count)]
    return [s * g + 0.1 * rng.standard_normal((400, 1)) for g, s in zip(guess, slope, strict=True)], guess


def test_a_guess_that_every_cycle_bears_out_is_kept():
    assert _share(*cycles(6, [1.0] * 6))[0] > 0.95
    assert abs(_share(*cycles(6, [0.5] * 6))[0] - 0.5) < 0.05


def test_a_guess_that_one_cycle_bears_out_and_another_contradicts_is_not():
    assert _share(*cycles(3, [1.0, 0.0, -0.5]))[0] == 0.0
    assert _share(*cycles(6, [-1.0] * 6))[0] == 0.0


def test_of_a_guess_that_holds_here_and_there_less_is_kept_than_least_squares_would():
    y, guess = cycles(4, [1.0, 1.0, 0.0, 1.0])
    kept = _share(y, guess)[0]
    assert 0.2 < kept < 0.6  # least squares: 0.75


def test_a_constant_error_of_many_deviations_is_made_good_and_one_that_changes_sign_is_not():
    rng = np.random.default_rng(1)
    y = 15.0 + 3.0 * rng.standard_normal((500, 1))
    y[:50] = rng.standard_normal((50, 1))  # small before the motor is warm
    assert _steady_share(y, np.full_like(y, 15.0))[0] > 0.9
    assert _steady_share(y, np.full_like(y, -15.0))[0] == 0.0
    assert 0.4 < _steady_share(y, np.full_like(y, 30.0))[0] < 0.6
