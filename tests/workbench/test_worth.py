"""What a name explains in recordings of another plant, asked in three ways."""

from pathlib import Path

import pytest
from helpers.hidden import Case, generate_experiment

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.contest.worth import agreement, held_score, worth
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, stand, summed, unlikely_from

MAGNET = {
    "name": "magnet_temperature",
    "size": 0.002,
    "shape": {"magnet_f": 0.7, "magnet_tau": 1067.5},
}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on fifty minutes of heating, in which the magnet loses 0.2 % of its flux a kelvin."""
    folder: Path = tmp_path_factory.mktemp("magnet")
    case = Case(id="magnet", seed=4, motor="gear_12V", kind="none", noise=0.01, small=True)
    path = generate_experiment({"case": case.as_json(), "hidden": [MAGNET]}, "heat_soak", 3000.0, folder)
    file = read_motor_file(case.of_motor().write_datasheet(folder / "motor.toml"))
    return stand(fitted_of(estimate(file, prepare_all([read_recording(path)], file))))


def entered(bare: Standing, name: str) -> tuple[Score, Fitted]:
    """What the screen says of a name, and the model that has it."""
    score = best_of(bare.scores)[name]
    fitted = with_hypothesis(bare.fitted, bare.book.beside(), score)
    assert fitted is not None
    return score, settled(fitted)


@pytest.mark.fit
def test_where_walds_test_says_too_little_the_score_test_says_what_the_likelihood_does(
    bare: Standing,
) -> None:
    score, end = entered(bare, "magnet_temperature")
    rise = bare.unlikely - unlikely_from(bare, end)
    held = held_score(*summed(end), end, score.entry.hypothesis)
    assert held is not None and held.gain / held.scatter < 0.6 * rise
    agreed = agreement(bare, end, bare.fitted, score.entry.hypothesis, rise)
    assert 0.75 * rise < agreed <= rise
    told = worth(bare, score, end)
    assert told.agreed == pytest.approx(agreed, rel=0.02)
    assert told.score is not None and told.score.gain / told.score.scatter == pytest.approx(agreed, rel=0.02)
    # It counts for no more than the likelihood rises.
    assert agreement(bare, end, bare.fitted, score.entry.hypothesis, 5.0) <= 5.0
    assert agreement(bare, end, bare.fitted, score.entry.hypothesis, -5.0) == 0.0


@pytest.mark.fit
@pytest.mark.parametrize("name", ["radiation", "quadratic_drag"])
def test_what_is_not_missing_is_agreed_on_by_no_test(bare: Standing, name: str) -> None:
    """Beside the magnet, that is: from the model that has it."""
    _, magnet = entered(bare, "magnet_temperature")
    here = stand(magnet)
    score, end = entered(here, name)
    rise = here.unlikely - unlikely_from(here, end)
    # A chi-squared variable of one degree of freedom exceeds 10.8 once in a thousand.
    assert agreement(here, end, magnet, score.entry.hypothesis, rise) < 10.8
