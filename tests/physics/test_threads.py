"""Work on all cores, beside the same work done one item after the other."""

import threading
from contextvars import ContextVar
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import LIMIT_S

from motorlens_physics import threads
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.scenario import measure, perform, scenarios
from motorlens_physics.threads import on_all_cores

MOTOR = Path(__file__).resolve().parents[2] / "models/motors/mellah2016.toml"
SET: ContextVar[int] = ContextVar("set", default=0)


@pytest.fixture(autouse=True)
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "cores", lambda: 2)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)


def test_both_cores_work_at_the_same_time() -> None:
    both = threading.Barrier(2)
    assert sorted(on_all_cores(lambda item: (both.wait(timeout=LIMIT_S), item)[1], [1, 2])) == [1, 2]


@pytest.mark.parametrize(("items", "beside"), [(1, 2), (2, 1), (5, 1)])
def test_work_within_work_is_spread_only_where_a_core_is_idle(items: int, beside: int) -> None:
    def inner(item: int) -> int:
        return threading.get_ident()

    def outer(item: int) -> int:
        return len({threading.get_ident(), *on_all_cores(inner, range(2))} - {threading.get_ident()})

    # An item alone is done where it is asked for, and what is within it on threads of its own.
    assert all((others > 0) == (beside == 2) for others in on_all_cores(outer, range(items)))


@pytest.mark.parametrize(
    ("said", "beside"), [("1", False), ("2", True), ("64", True), ("0", True), ("many", True)]
)
def test_the_user_may_have_fewer_threads(monkeypatch: pytest.MonkeyPatch, said: str, beside: bool) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", said)
    others = set(on_all_cores(lambda item: threading.get_ident(), range(4))) - {threading.get_ident()}
    assert bool(others) == beside and len(others) <= 2


def test_the_context_is_the_callers_and_stays_as_it_was() -> None:
    SET.set(7)
    assert on_all_cores(lambda item: (SET.get(), SET.set(item))[0], [1, 2, 3]) == [7, 7, 7]
    assert SET.get() == 7


@pytest.mark.parametrize("items", [[0], [0, 1], [3, 0, 0]])
def test_the_first_error_is_raised(items: list[int]) -> None:
    with pytest.raises(ZeroDivisionError, match="division"):
        on_all_cores(lambda item: 1 / item, items)


@pytest.mark.fit
def test_threads_change_no_bit_of_an_estimate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two recordings at the same time, or one after the other, as the workers of these tests do."""
    file = read_motor_file(MOTOR)
    noise = {"voltage": 0.5, "current": 0.05, "speed": 0.5}
    shown = [
        measure(perform(file, scenarios()[name](10.0, 0.01), rng), (), noise, rng)
        for name, rng in (
            ("no_load_steps", np.random.default_rng(1)),
            ("load_steps", np.random.default_rng(2)),
        )
    ]
    found = []
    for said in ("2", "1"):
        monkeypatch.setenv("OMP_NUM_THREADS", said)
        found.append(estimate(file, prepare_all(shown, file)).fit)
    assert found[0].model.values() == found[1].model.values()
    assert np.array_equal(found[0].covariance, found[1].covariance)
