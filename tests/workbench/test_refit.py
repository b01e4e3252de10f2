"""Models near their best parameters, on a recording of another plant that has friction."""

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.textbook import textbook_on

from motorlens_physics.estimate.weighed import Weighed
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.refit import begun, likelier, nearly

FRICTION = {"name": "coulomb_friction", "size": 0.005, "shape": {}}


@pytest.mark.fit
def test_of_two_models_each_is_as_likely_as_its_own_noise_says(tmp_path: Path) -> None:
    """Compared under the noise of one of them, the better one would win even where its own noise is absurd."""
    here = textbook_on(tmp_path, "servo_24V", [FRICTION], "no_load_steps", 3.0)
    prior, score = here.fitted.prior, best_of(here.scores)["coulomb_friction"]
    without, there = nearly(here.fitted), nearly(begun(here.fitted, score))
    assert without is not None and there is not None
    assert likelier(without, there, prior) and not likelier(there, without, prior)
    absurd = _quieter(there, 1e-4)
    assert likelier(absurd, without, prior) and not likelier(without, absurd, prior)


def _quieter(point: Weighed, share: float) -> Weighed:
    """A model as it is, under a share of the variance that its channels' noise has."""
    parts = [
        replace(part, noise=replace(part.noise, sensors=share * part.noise.sensors)) for part in point.parts
    ]
    return replace(point, parts=tuple(parts))
