"""What a name loses by all that it had to say: against Laplace's approximation by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motorlens_workbench.contest.bayes_factor import log_occam_of, log_occam_of_shape
from motorlens_workbench.criteria import CRITERIA

# A size of 3 deviations that is a third of the typical one, and a phase known to a fifth of what was known before.
SIZE, SIZE_SD, TYPICAL = 0.1, 0.1 / 3, 0.3
PHASE, PHASE_SD, KNOWN, CENTRE = 1.5, 0.2, 1.0, 0.5


def model_with(values: dict[str, float], sd: list[float]) -> Any:
    keys = tuple(values)
    prior = SimpleNamespace(
        keys=keys, sd=dict.fromkeys(keys, KNOWN), centre={key: CENTRE for key in keys if key.endswith(".p")}
    )
    file = SimpleNamespace(meaning=lambda key: SimpleNamespace(null=0.0))
    model = SimpleNamespace(values=lambda: values, file=file)
    return SimpleNamespace(model=model, prior=prior, covariance=np.diag(np.square(sd)))


def name(shapes: int) -> Any:
    return SimpleNamespace(name="cog", key="cog.A", typical=TYPICAL, shapes=(None,) * shapes)


def loses(ratio: float) -> float:
    """Of a parameter known so many times as well as before, blocks of time believed as little as names are ranked by."""
    return -0.5 * np.log1p(ratio**2 / CRITERIA.tempered)


def test_a_name_without_a_shape_pays_for_the_search_alone() -> None:
    fitted = model_with({"b": 1.0, "cog.A": SIZE}, [0.1, SIZE_SD])
    assert log_occam_of_shape(name(1), fitted) == 0.0
    assert log_occam_of_shape(name(20), fitted) == pytest.approx(-np.log(20))


def test_a_phase_is_paid_for_as_far_as_it_is_known_and_from_where_it_was_expected() -> None:
    fitted = model_with({"b": 1.0, "cog.A": SIZE, "cog.p": PHASE}, [0.1, SIZE_SD, PHASE_SD])
    shape = loses(KNOWN / PHASE_SD) - 0.5 * ((PHASE - CENTRE) / KNOWN) ** 2
    assert log_occam_of_shape(name(5), fitted) == pytest.approx(shape - np.log(5))
    size = loses(TYPICAL / SIZE_SD) - np.log1p((SIZE / TYPICAL) ** 2)
    assert log_occam_of(name(5), fitted) == pytest.approx(size + shape)
