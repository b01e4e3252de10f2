"""The minimiser alone, on problems whose minimum is known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from motorlens_physics.estimate.fit import foretold, minimise
from motorlens_physics.estimate.prior import Prior

FREE = 1e6
Array = np.ndarray


@dataclass(frozen=True)
class Problem:
    """Errors of a few parameters, and a cost that `seen` adds to every point; also the model of its parameters."""

    of: Callable[[Array], Array]
    at: tuple[float, ...]
    seen: float = 0.0

    @property
    def model(self) -> "Problem":
        return self

    def values(self) -> dict[str, float]:
        return dict(zip("xyz", self.at, strict=False))

    def with_values(self, values: Mapping[str, float]) -> "Problem":
        return replace(self, at=tuple(values.values()))

    @property
    def errors(self) -> Array:
        return self.of(np.array(self.at))

    @property
    def columns(self) -> Array:
        return -np.atleast_2d(approx_fprime(np.array(self.at), self.of, 1e-7))

    @property
    def cost(self) -> float:
        return float(self.errors @ self.errors) + self.seen

    def cost_in(self, other: "Problem") -> float:
        return self.cost

    def products_in(self, other: "Problem") -> tuple[Array, float]:
        return other.columns.T @ self.errors, float(other.errors @ self.errors) + other.seen

    def normal(self) -> tuple[Array, Array]:
        return self.columns.T @ self.columns, self.columns.T @ self.errors


def prior_of(*bounds: tuple[float, float]) -> Prior:
    """Parameters of which nothing else is known."""
    keys = "xyz"[: len(bounds)]
    return Prior(dict.fromkeys(keys, 1.0), dict.fromkeys(keys, FREE), dict(zip(keys, bounds, strict=True)))


def searched(
    begin: Problem, prior: Prior, *, seen: float = 0.0, shown: Callable[[Problem], Problem] | None = None
) -> tuple[Problem, float, list[Problem]]:
    """Where a search ends, how far from the minimum, and the points that were looked at; all but the first cost `seen`."""
    tried: list[Problem] = []

    def at(problem: Problem) -> Problem:
        tried.append(replace(problem, seen=seen))
        return tried[-1]

    end, _, left = minimise(
        begin,
        prior,
        at,  # type: ignore[arg-type]
        at if shown is None else shown,  # type: ignore[arg-type]
        rounds=100,
        enough=1e-3,
        anew=lambda point: replace(point, seen=seen),
    )
    return end, left, tried


@pytest.mark.parametrize(("bounds", "least"), [((-FREE, FREE), 5.0), ((2.0, FREE), 10.0)])
def test_the_cost_at_the_minimum_of_a_linear_problem_is_foretold_from_anywhere(
    bounds: tuple[float, float], least: float
) -> None:
    # (3 - x)^2 + (1 - 2 x)^2 = 5 (x - 1)^2 + 5.
    line = Problem(lambda at: np.array([3 - at[0], 1 - 2 * at[0]]), (4.0,))
    assert line.cost == pytest.approx(50.0)
    assert foretold(line, prior_of(bounds)) == pytest.approx(least, rel=1e-5)


@pytest.mark.parametrize(
    ("fixed", "least"),
    [({"y": 0.0}, 1.71), ({"y": -1.0}, 0.8), ({"x": 2.0}, 0.19), ({"x": 1.0, "y": 1.0}, 5.6)],
)
def test_the_cost_of_a_linear_problem_is_foretold_with_some_parameters_where_they_stay(
    fixed: dict[str, float], least: float
) -> None:
    # With d = (3 - x, -3 - y) it costs d_x^2 + 1.8 d_x d_y + d_y^2: 0.19 d_y^2 where x is the best beside y, 0.3 beside 0;
    # beside -1 that would be 1.2, which is beyond its bound.
    root = np.linalg.cholesky(np.array([[1.0, 0.9], [0.9, 1.0]])).T
    plane = Problem(lambda at: root @ (np.array([3.0, -3.0]) - at), (0.5, 0.7))
    assert foretold(plane, prior_of((-1.0, 1.0), (-FREE, FREE)), fixed) == pytest.approx(least, rel=1e-5)


def test_what_is_found_between_steps_is_no_reason_to_refuse_one() -> None:
    # From x = 4 the cost falls by 45; what is found there costs 100, at every point, as soon as it is looked at anew.
    line = Problem(lambda at: np.array([3 - at[0], 1 - 2 * at[0]]), (4.0,))
    end, left, tried = searched(line, prior_of((-FREE, FREE)), seen=100.0)
    assert end.at[0] == pytest.approx(1.0, abs=1e-4) and left < 0.01
    # Not only shorter ones, but the same step again, before any that is damped.
    assert [tried[k].at[0] for k in (0, 3)] == pytest.approx([1.0, 1.0], abs=1e-4)


def test_a_step_that_is_refused_turns_into_the_valley() -> None:
    # Rosenbrock's (1960, doi:10.1093/comjnl/3.3.175), from its usual start, a hundred times as steep. Damping alone needs
    # more than seventy points to follow it.
    valley = Problem(lambda at: np.array([100 * (at[1] - at[0] ** 2), 1 - at[0]]), (-1.2, 1.0))
    end, left, tried = searched(valley, prior_of((-FREE, FREE), (-FREE, FREE)))
    assert left < 1e-3
    assert end.at == pytest.approx((1.0, 1.0), abs=1e-4)
    assert len(tried) < 20


@pytest.mark.parametrize(
    ("errors", "begin", "best", "most"),
    [
        # What cools at rest and what a fan adds to it are told well together, in their product.
        (lambda at: np.array([1000 * (at[0] * at[1] - 1), at[0] - 10]), (0.1, 10.0), (10.0, 0.1), 300),
        (lambda at: np.array([100 * (at[1] - at[0] ** 3), 1 - at[0]]), (-3.0, -27.0), (1.0, 1.0), 300),
    ],
    ids=["product", "cubic"],
)
def test_a_long_valley_is_followed_without_trying_what_has_just_been_refused(
    errors: Callable[[Array], Array], begin: tuple[float, float], best: tuple[float, float], most: int
) -> None:
    """With damping ten times less after every step that was taken, 399 and 499 points are looked at, the last in vain."""
    valley = Problem(errors, begin)
    end, left, tried = searched(valley, prior_of((-FREE, FREE), (-FREE, FREE)))
    assert left < 1e-3
    assert end.at == pytest.approx(best, rel=1e-4)
    assert len(tried) < most


def test_once_a_step_is_refused_sensitivities_are_asked_for_only_where_the_next_one_costs_less() -> None:
    # Newton's steps towards the root of an arc tangent lead farther and farther away from beyond 1.39.
    far = Problem(np.arctan, (8.0,))
    prior, glances = prior_of((-FREE, FREE)), []

    def shown(problem: Problem) -> Problem:
        glances.append(problem)
        return problem

    end, left, looked = searched(far, prior, shown=shown)
    same, also, every = searched(far, prior)
    # The way is the same, and fewer of its points are looked at in full, none of them twice.
    assert (end.at, left) == (same.at, also) and left < 1e-3
    assert len(set(looked)) == len(looked) < len(set(every)) == len({*looked, *glances})
    # Where a step has led that is not refused, nothing else is asked.
    line = Problem(lambda at: np.array([3 - at[0], 1 - 2 * at[0]]), (4.0,))
    glances.clear()
    assert searched(line, prior, shown=shown)[0].at == pytest.approx((1.0,), abs=1e-4)
    assert not glances


def test_nothing_that_can_only_be_positive_falls_to_its_bound_in_one_step() -> None:
    # From x = 1 the linear step towards the errors' minimum at 1/4 would lead to -2.
    reciprocal = Problem(lambda at: 4 - 1 / at, (1.0,))
    end, _, tried = searched(reciprocal, prior_of((1e-9, FREE)))
    assert 0.09 < min(one.at[0] for one in tried) < 0.11
    assert end.at[0] == pytest.approx(0.25, rel=1e-3)


def test_a_bound_that_is_passed_on_the_way_does_not_hold_what_ends_within_it() -> None:
    # Without bounds the best is (3, -3), beyond both. At y = 0 it is x = 3 - 0.9 * 3: x ends well within its own.
    root = np.linalg.cholesky(np.array([[1.0, 0.9], [0.9, 1.0]])).T
    plane = Problem(lambda at: root @ (np.array([3.0, -3.0]) - at), (0.5, 0.5))
    end, left, _ = searched(plane, prior_of((-1.0, 1.0), (0.0, 1.0)))
    assert end.at == pytest.approx((0.3, 0.0), abs=1e-4) and left < 1e-3
