"""What is missing from a model: prepare, estimate, hold the contest; `verdict` and `experiments` take it from there."""

from collections.abc import Sequence
from dataclasses import dataclass

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.prepare import prepare_all
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_workbench.contest.contest import Outcome, contest
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.hypotheses.dead_channels import DeadChannel, dead_channels, without
from motorlens_workbench.telling import Progress


@dataclass(frozen=True)
class Finding:
    """All that the diagnosis found out, before it is put in words.

    Attributes:
        base: the estimate without any hypothesis.
        outcome: of the contest.
        dead: channels that follow nothing, left out of all the rest.
    """

    base: Estimate
    outcome: Outcome
    dead: tuple[DeadChannel, ...] = ()

    @property
    def runs(self) -> tuple[Run, ...]:
        """The recordings, with delays taken out."""
        return self.outcome.last.fitted.runs


def diagnose(
    file: MotorFile,
    recordings: Sequence[Recording],
    own: Sequence[type[Effect]] = (),
    say: Progress = lambda text: None,
) -> Finding:
    """Look for what is missing from a motor file.

    Args:
        file: the motor.
        recordings: of one motor.
        own: effects from outside the catalogue.
        say: told what is being done.

    Raises:
        DataError: a recording that cannot be used.
        ModelError: the model cannot be simulated at all.
    """
    runs = prepare_all(recordings, file)
    dead = dead_channels(file, runs)
    if dead:
        say(f"leaving out {', '.join(f'{one.channel} of {one.recording} ({one.state})' for one in dead)}")
    say("estimating the motor")
    base = estimate(file, [run.without_coarse() for run in without(runs, dead)])
    return Finding(base, contest(fitted_of(base), own, say), dead)


def fitted_of(found: Estimate) -> Fitted:
    """Where a contest begins."""
    fit = found.fit
    # How likely it is, is told where it stands.
    return Fitted(fit.model, fit.prior, found.runs, float("inf"), fit.covariance)
