"""A name that has entered a model of recordings by another plant: what stands in its place in the end."""

from pathlib import Path

import pytest
from helpers.hidden import Case, generate_experiment

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.run import prepare_all
from motorlens_physics.motor_file import read_motor_file
from motorlens_physics.recording import read_recording
from motorlens_workbench.contest.exchange import exchanged
from motorlens_workbench.contest.rivals import rivals_of
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, stand

FRICTION_NM = 0.0188
# Without an hour of heating, hysteresis (which also heats) brakes exactly like Coulomb friction.
ALIKE = {"coulomb_friction", "hysteresis_iron_loss"}


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Standing:
    """The textbook on a recording with Coulomb friction."""
    folder: Path = tmp_path_factory.mktemp("friction")
    case = Case(id="friction", seed=4, motor="servo_24V", kind="none", noise=0.01, small=True)
    hidden = [{"name": "coulomb_friction", "size": FRICTION_NM, "shape": {}}]
    path = generate_experiment({"case": case.as_json(), "hidden": hidden}, "no_load_steps", 12.0, folder)
    file = read_motor_file(case.of_motor().write_datasheet(folder / "motor.toml"))
    return stand(fitted_of(estimate(file, prepare_all([read_recording(path)], file))))


def entered(bare: Standing, name: str) -> tuple[Standing, Accepted]:
    """With a name in the model, fitted in full."""
    score = best_of(bare.scores)[name]
    fitted = with_hypothesis(bare.fitted, bare.book.beside(), score)
    assert fitted is not None
    accepted = Accepted(score.entry.hypothesis, score.gain / score.scatter, score.scatter, score.weight)
    return stand(settled(fitted)), accepted


@pytest.mark.fit
@pytest.mark.parametrize("wrong", ["quadratic_drag", "constant_torque"])
def test_what_was_put_in_takes_the_place_of_what_had_entered(bare: Standing, wrong: str) -> None:
    here, one = entered(bare, wrong)
    then, (other,) = exchanged(here, [one], (), lambda text: None)
    assert other.hypothesis.name in ALIKE and then is not here
    assert wrong not in {part for part in then.fitted.model.values() if part.startswith(wrong)}
    assert then.fitted.model.values()[other.hypothesis.key] == pytest.approx(FRICTION_NM, rel=0.1)
    assert then.unlikely < here.unlikely - 20
    # What it was exchanged for has been fitted as well, and is no rival any more.
    assert rivals_of(then, other).probability.get(wrong, 0.0) < 1e-3


@pytest.mark.fit
def test_what_was_put_in_stays_and_nothing_is_counted_against_it_that_is_less_likely(bare: Standing) -> None:
    here, one = entered(bare, "coulomb_friction")
    then, (other,) = exchanged(here, [one], (), lambda text: None)
    assert other.hypothesis.name in ALIKE
    likely = rivals_of(then, other).probability
    assert sum(likely.get(name, 0.0) for name in ALIKE) > 0.95
    assert likely[other.hypothesis.name] >= max(other.instead.values(), default=0.0)
