"""Models near their best parameters, on a recording of another plant that has friction."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.textbook import textbook_on

from motorlens_physics.estimate.weighed import Weighed
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.refit import begun, may_be_likelier, nearly

FRICTION = {"name": "coulomb_friction", "size": 0.005, "shape": {}}


@pytest.mark.fit
def test_a_model_may_be_likelier_by_its_own_noise_or_by_the_errors_that_it_leaves(tmp_path: Path) -> None:
    """Compared under the noise of one of them alone, the better one would win or lose by a noise that is absurd."""
    here = textbook_on(tmp_path, "servo_24V", [FRICTION], "no_load_steps", 3.0)
    prior, score = here.fitted.prior, best_of(here.scores)["coulomb_friction"]
    begin = begun(here.fitted, score)
    full, without, there = begin.prior, nearly(here.fitted), nearly(begin)
    assert without is not None and there is not None
    assert may_be_likelier(without, there, prior, full) and not may_be_likelier(there, without, full, prior)
    assert may_be_likelier(_quieter(there, 1e-4), without, full, prior)
    # What its noise has been led to is no reason to leave a model that explains more.
    assert may_be_likelier(without, _quieter(there, 1e-4), prior, full)
    assert not may_be_likelier(without, _quieter(without, 1e-4), prior, prior)


def _quieter(point: Weighed, share: float) -> Weighed:
    """A model as it is, under a share of the variance that its channels' noise has."""
    parts = [
        replace(part, noise=replace(part.noise, sensors=share * part.noise.sensors)) for part in point.parts
    ]
    return replace(point, parts=tuple(parts))
