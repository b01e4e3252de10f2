"""What a first look at a recording shows that has no name: before every name is fitted, which takes thirty times as long.

That no name which imitates it takes its place is asked in `test_diagnose`, and of the blind cases outside the catalogue.
"""

from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_workbench.contest.bayes_factor import simplest
from motorlens_workbench.contest.needed import beyond_chance
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.standing import stand


def nameless(file: MotorFile, recording: Recording) -> Score | None:
    """The simplest term without a name, where one is beyond chance and explains more than any name does; else None."""
    here = stand(fitted_of(estimate(file, prepare_all([recording], file))))
    beyond = beyond_chance(here, [], [])
    if not beyond or max(beyond, key=lambda one: one.gain).named:
        return None
    return simplest([one for one in here.challengers if not one.named]).score
