"""What is missing from a model: the whole diagnosis, from prepared recordings to a verdict in words and figures.

Base fit; noise from the residual that nothing explains; a screen of all effects and sensor faults in one pass; refits of
the best and its rivals; again from there, up to three effects; then the question whether it really is that effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.estimate import estimate
from motorlens_physics.estimate.fit import Fit, fit
from motorlens_physics.estimate.model import predict
from motorlens_physics.estimate.run import Run, prepare_all
from motorlens_physics.estimate.shaft import followed
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_workbench.bend import Bend
from motorlens_workbench.contacts import Spells
from motorlens_workbench.dead_channels import DeadChannel, dead_channels, without
from motorlens_workbench.leftover import at_once, leftover
from motorlens_workbench.look import Look, look, unsettled
from motorlens_workbench.pruning import dispensable, seen_from, simpler
from motorlens_workbench.selection import Progress, cornered
from motorlens_workbench.steps import Step, advance, imperfections, in_full, uneven

Array = NDArray[np.float64]

MOST = 3
# What a single curve may explain from the start, over all that was named.
INSTEAD = 1.25


@dataclass(frozen=True)
class Finding:
    """All that the diagnosis found out, before it is put in words.

    Attributes:
        runs: prepared recordings.
        base: the fit without any candidate.
        first: the screen from it.
        steps: effects accepted, in order.
        last: the screen from the final model.
        failed: candidates whose refit did not do what the screen promised, or that others made needless.
        whole: free curves that explain what the base model lacks, if anything is left in the end; the strongest first.
        left: free curves that explain what the final model lacks.
        dead: channels that follow nothing, left out of all the rest.
    """

    runs: tuple[Run, ...]
    base: Fit
    first: Look
    steps: tuple[Step, ...]
    last: Look
    failed: tuple[str, ...]
    whole: tuple[Bend, ...] = ()
    left: tuple[Bend, ...] = ()
    dead: tuple[DeadChannel, ...] = ()


def investigate(
    file: MotorFile,
    recordings: Sequence[Recording],
    own: Sequence[type[Effect]] = (),
    say: Progress = lambda text: None,
) -> Finding:
    """Fit, screen, accept up to three effects.

    Raises:
        DataError: a recording that cannot be used.
        ModelError: the model cannot be simulated at all.
    """
    runs = prepare_all(recordings, file)
    dead = dead_channels(file, runs)
    if dead:
        say(f"leaving out {', '.join(f'{one.channel} of {one.recording} ({one.state})' for one in dead)}")
    say("fitting the base parameters")
    base, runs = base_fit(file, without(runs, dead))
    say("screening all effects and sensor faults")
    first = look(base, runs, own)

    def onward(steps: list[Step]) -> tuple[list[Step], Look, list[str], list[Bend], list[Bend]]:
        now = first
        if steps:
            say(f"screening again with {steps[-1].test.candidate.name}")
            now = look(steps[-1].found, runs, own)
        steps, now, failed = _forward(steps, now, runs, own, say)
        return steps, now, failed, *_left(first, steps, now, runs, say)

    steps, current, failed, left, whole = onward([])
    named = not any(isinstance(bend.curve, Spells) for bend in left)
    step = uneven(current, failed, runs, say) if left and named and len(steps) < MOST else None
    if step is not None:
        steps, current, failed, left, whole = onward([*steps, step])
    # Where the textbook alone could not follow, the search may have begun in the wrong place; where nothing was named though
    # something is left, the effect may be too far from linear to be seen from there.
    astray = bool(whole) and named and (cornered(base) or not steps)
    step = in_full(first, steps, whole[0], runs, say) if astray else None
    if step is not None:
        steps, current, failed, left, whole = onward([step])
    return Finding(runs, base, first, tuple(steps), current, tuple(failed), tuple(whole), tuple(left), dead)


def _forward(
    steps: list[Step], current: Look, runs: Sequence[Run], own: Sequence[type[Effect]], say: Progress
) -> tuple[list[Step], Look, list[str]]:
    """Accept one effect after another from where the search stands: the steps, the last screen, what failed."""
    failed: list[str] = []
    while len(steps) < MOST:
        avoid = [*failed, *imperfections(steps, current)]
        step, broken = advance(current, runs, say, avoid, steps)
        failed += broken
        if step is None:
            break
        steps.append(step)
        say(f"screening again with {step.test.candidate.name}")
        current = look(step.found, runs, own)
        while (spare := dispensable(steps, current, runs)) is not None:
            needless, found = spare
            name = needless.test.candidate.name
            say(f"screening again without {name}")
            failed.append(name)
            steps = [one for one in steps if one is not needless]
            steps[-1] = replace(steps[-1], gain=steps[-1].gain + needless.gain)
            current = look(found, runs, own)
    if (swap := simpler(steps, current, runs)) is not None:
        former, step = swap
        say(f"screening again with {step.test.candidate.name} for {former.test.candidate.name}")
        steps = [step if one is former else one for one in steps]
        current = look(step.found, runs, own)
    return [seen_from(step, current) for step in steps], current, failed


def _left(
    first: Look, steps: Sequence[Step], current: Look, runs: Sequence[Run], say: Progress
) -> tuple[list[Bend], list[Bend]]:
    """Free curves that explain what the final model lacks, and, if anything is left, what the first one lacked."""
    say("looking at what is left")
    left = leftover(current.found, runs, current.decoy)
    if steps and (left or cornered(current.found) or unsettled(first, current, runs)):
        return left, leftover(first.found, runs, first.decoy)
    if steps and (sudden := at_once(first, runs)):
        # What changed at once passes for what changed slowly in between, and leaves little.
        if sudden[0].gain > INSTEAD * sum(step.gain for step in steps):
            return sudden, sudden
    return left, left


def base_fit(
    file: MotorFile, runs: Sequence[Run], say: Progress = lambda text: None
) -> tuple[Fit, tuple[Run, ...]]:
    """The motor fitted, and the runs with their inputs as they truly were, as far as the fit knows."""
    found = estimate(file, runs, progress=say)
    leans = any(converter.step for run in runs for converter in run.converters)
    turned = any(effect.turns() for effect in file.motor.effects)
    followed_runs = []
    for r, run in enumerate(found.runs):
        trajectory, y = predict(found.fit.model, run, r)
        followed_runs.append(followed(run.leaning(y) if leans else run, trajectory, y))
    if leans or turned:
        found = estimate(file, followed_runs, begin=found.fit.model)
        followed_runs = list(found.runs)
    # All that is missing shall be in what is left, a slow torque too: along the same inputs, without one.
    return fit(found.fit.model, followed_runs, found.fit.prior), tuple(followed_runs)
