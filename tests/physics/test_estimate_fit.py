"""The minimiser alone, on problems whose minimum is known."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pytest

from motorlens_physics.estimate.fit import minimise
from motorlens_physics.estimate.prior import Prior

FREE = 1e6


@dataclass(frozen=True)
class Line:
    """Errors 3 - x and 1 - 2 x of one parameter (best at x = 1), and a cost that `seen` adds to every point."""

    x: float
    seen: float = 0.0

    @property
    def model(self) -> "Line":
        return self

    def values(self) -> dict[str, float]:
        return {"x": self.x}

    def with_values(self, values: Mapping[str, float]) -> "Line":
        return replace(self, x=values["x"])

    @property
    def cost(self) -> float:
        return (3 - self.x) ** 2 + (1 - 2 * self.x) ** 2 + self.seen

    def cost_in(self, other: "Line") -> float:
        return self.cost

    def products_in(self, other: "Line") -> tuple[np.ndarray, float]:
        errors, others = ((3 - one.x, 1 - 2 * one.x) for one in (self, other))
        overlap = errors[0] * others[0] + errors[1] * others[1]
        return np.array([errors[0] + 2 * errors[1]]), overlap + other.seen

    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[5.0]]), np.array([(3 - self.x) + 2 * (1 - 2 * self.x)])


def test_what_is_found_between_steps_is_no_reason_to_refuse_one() -> None:
    # From x = 4 the cost falls by 45; what is found there costs 100, at every point, as soon as it is looked at anew.
    prior = Prior({"x": 0.0}, {"x": 1e6}, {"x": (-1e9, 1e9)})
    tried: list[float] = []

    def at(line: Line) -> Line:
        tried.append(line.x)
        return Line(line.x, seen=100.0)

    end, _, left = minimise(
        Line(4.0),
        prior,
        at,
        rounds=5,
        enough=0.01,
        anew=lambda line: Line(line.x, seen=100.0),  # type: ignore[arg-type]
    )
    assert end.x == pytest.approx(1.0, abs=1e-4) and left < 0.01
    # Not only a shorter one, but the same step again.
    assert tried[0] == pytest.approx(1.0, abs=1e-4) and tried[2] == pytest.approx(1.0, abs=1e-4)


@dataclass(frozen=True)
class Valley:
    """Rosenbrock's valley (1960, doi:10.1093/comjnl/3.3.175), a hundred times as steep: errors 100 (y - x^2) and 1 - x."""

    x: float
    y: float

    @property
    def model(self) -> "Valley":
        return self

    def values(self) -> dict[str, float]:
        return {"x": self.x, "y": self.y}

    def with_values(self, values: Mapping[str, float]) -> "Valley":
        return Valley(**values)

    @property
    def errors(self) -> np.ndarray:
        return np.array([100 * (self.y - self.x**2), 1 - self.x])

    @property
    def columns(self) -> np.ndarray:
        return np.array([[200 * self.x, -100.0], [1.0, 0.0]])

    @property
    def cost(self) -> float:
        return float(self.errors @ self.errors)

    def cost_in(self, other: "Valley") -> float:
        return self.cost

    def products_in(self, other: "Valley") -> tuple[np.ndarray, float]:
        return other.columns.T @ self.errors, float(other.errors @ self.errors)

    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        return self.columns.T @ self.columns, self.columns.T @ self.errors


def test_a_step_that_is_refused_turns_into_the_valley() -> None:
    # Damping alone needs more than seventy points to follow the valley from its usual start.
    prior = Prior(dict.fromkeys("xy", 0.0), dict.fromkeys("xy", FREE), dict.fromkeys("xy", (-FREE, FREE)))
    tried: list[Valley] = []

    def at(valley: Valley) -> Valley:
        tried.append(valley)
        return valley

    end, _, left = minimise(Valley(-1.2, 1.0), prior, at, rounds=100, enough=1e-3)  # type: ignore[arg-type]
    assert left < 1e-3
    assert (end.x, end.y) == pytest.approx((1.0, 1.0), abs=1e-4)
    assert len(tried) < 20


def test_nothing_that_can_only_be_positive_falls_to_its_bound_in_one_step() -> None:
    # From x = 1 the linear step towards the errors' minimum at 1/4 would lead to -2.
    prior = Prior({"x": 1.0}, {"x": FREE}, {"x": (1e-9, FREE)})
    tried: list[float] = []

    def at(one: Reciprocal) -> Reciprocal:
        tried.append(one.x)
        return one

    end, _, _ = minimise(Reciprocal(1.0), prior, at, rounds=20, enough=1e-3)  # type: ignore[arg-type]
    assert 0.09 < min(tried) < 0.11
    assert end.x == pytest.approx(0.25, rel=1e-3)


@dataclass(frozen=True)
class Reciprocal:
    """One error 4 - 1 / x."""

    x: float

    @property
    def model(self) -> "Reciprocal":
        return self

    def values(self) -> dict[str, float]:
        return {"x": self.x}

    def with_values(self, values: Mapping[str, float]) -> "Reciprocal":
        return Reciprocal(**values)

    @property
    def cost(self) -> float:
        return (4 - 1 / self.x) ** 2

    def cost_in(self, other: "Reciprocal") -> float:
        return self.cost

    def products_in(self, other: "Reciprocal") -> tuple[np.ndarray, float]:
        return np.array([-(4 - 1 / self.x) / other.x**2]), (4 - 1 / self.x) * (4 - 1 / other.x)

    def normal(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([[self.x**-4.0]]), np.array([-(4 - 1 / self.x) * self.x**-2.0])
