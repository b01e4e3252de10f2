"""What is missing from a model: the whole diagnosis, from prepared recordings to a verdict in words and figures.

Base fit; noise from the residual that nothing explains; a screen of all effects and sensor faults in one pass; refits of
the best and its rivals; again from there, up to three effects; then the question whether it really is that effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.bend import Bend
from motorlens_workbench.contacts import Spells
from motorlens_workbench.dead_channels import DeadChannel, dead_channels, without
from motorlens_workbench.fitting import MEASURED, Fit, base_prior, fit, start_model
from motorlens_workbench.leftover import at_once, leftover
from motorlens_workbench.look import Look, look, swamped, unsettled
from motorlens_workbench.model import predict
from motorlens_workbench.pruning import dispensable, seen_from, simpler
from motorlens_workbench.run import Run, prepare_all
from motorlens_workbench.selection import Progress, cornered
from motorlens_workbench.shaft import followed
from motorlens_workbench.steps import Step, advance, imperfections, in_full, uneven

Array = NDArray[np.float64]

MOST = 3
# By how much (logarithm of the error of a channel) another way to take the inputs must be better than the recorded one.
BETTER_WAY = 0.0025
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
    say("fitting the base parameters")
    base, used = base_fit(file, runs)
    dead = dead_channels(file, base, used)
    if dead:
        say(f"leaving out {', '.join(f'{one.channel} of {one.recording} ({one.state})' for one in dead)}")
        base, used = base_fit(file, without(runs, dead))
    runs = used
    say("screening all effects and sensor faults")
    first = look(base, runs, own)
    if swamped(first) is not None:
        return Finding(runs, base, first, (), first, (), dead=dead)

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


def base_fit(file: MotorFile, runs: Sequence[Run]) -> tuple[Fit, tuple[Run, ...]]:
    """The textbook's parameters fitted, and the runs with their inputs as they fit best.

    Whether the voltage was held between samples or ran linearly, and whether what its sensor adds is noise or was truly
    applied, is not written in a recording; nor is whether a command acted at once. The better fit decides.
    """
    if commanded(file) and not any(run.late for run in runs):
        runs = as_applied(file, runs)
    prior = base_prior(file, runs)
    quieter = tuple(run.quieter() for run in runs)
    # Parameters fitted to noisy inputs have made up for the noise: each way is judged by a fit of its own as well.
    fits = on_all_cores(
        lambda taken: fit(start_model(file, taken), taken, prior), dict.fromkeys((tuple(runs), quieter))
    )
    chosen, held = [], []
    for r, (run, quiet) in enumerate(zip(runs, quieter, strict=True)):
        shown = fits[0].model.held[r]
        ways = [(one, h) for one in dict.fromkeys((run, quiet)) for h in (shown, not shown)]
        errors = np.min([[_error_of(found, one, h, r) for one, h in ways] for found in fits], axis=0)
        # The way as recorded stays unless another is clearly better.
        errors[0] -= BETTER_WAY * len(run.channels)
        slow, fast = errors[:, 0].reshape(-1, 2), errors[:, 1].reshape(-1, 2)
        held.append((shown, not shown)[int(np.argmin(slow.min(axis=0)))])
        smoother = len(slow) > 1 and slow[1].min() < slow[0].min()
        # Smoothing leaves slow errors of its own; what is fast may still tell that the noise was not truly applied.
        noisy = smoother or (len(fast) > 1 and fast[1].min() < fast[0].min())
        rough = replace(run, input_noise=quiet.input_noise) if noisy else run
        chosen.append(quiet if smoother else rough)
    model = fits[-1 if any(run.smooth for run in chosen) else 0].model
    found = fit(replace(model, held=tuple(held)), chosen, prior)
    leans = any(converter.step for run in chosen for converter in run.converters)
    turned = any("phi" in effect.states for effect in file.motor.effects)
    for r, run in enumerate(chosen):
        trajectory, y = predict(found.model, run, r)
        chosen[r] = followed(run.leaning(y) if leans else run, trajectory, y)
    return fit(found.model, chosen, prior) if leans or turned else found, tuple(chosen)


def commanded(file: MotorFile) -> bool:
    """Whether the voltage on record is what the drive was asked for: the motor file says that no sensor of it can lag."""
    known = file.knowledge.get("voltage_sensor_lag.tau")
    return known is not None and known.sd == 0 and known.source.startswith(MEASURED)


def as_applied(file: MotorFile, runs: Sequence[Run]) -> tuple[Run, ...]:
    """The runs, or, if that is clearly better, all with their voltage one sample later: it is one drive."""
    prior = base_prior(file, runs)
    ways = (tuple(runs), tuple(run.later() for run in runs))

    def error(taken: Sequence[Run]) -> float:
        found = fit(start_model(file, taken), taken, prior)
        return sum(
            min(_error_of(found, run, held, r)[0] for held in (False, True)) for r, run in enumerate(taken)
        )

    at_once, late = on_all_cores(error, ways)
    return ways[late < at_once - BETTER_WAY * sum(len(run.channels) for run in runs)]


def _error_of(found: Fit, way: Run, held: bool, r: int) -> tuple[float, float]:
    """Logarithm of the error of a run with its inputs taken this way, and of its change from row to row."""
    # Without the skews, which have made up for the wrong way by half a sample.
    straight = {key: 0.0 for key in found.prior.keys if key.startswith("skew.")}
    model = replace(
        found.model, held=tuple(held if k == r else h for k, h in enumerate(found.model.held))
    ).with_values(straight)
    try:
        residual = way.average(way.measured - predict(model, way, r)[1])[way.fresh()]
    except ModelError:
        return float("inf"), float("inf")
    size = [np.mean(e**2, axis=0) + way.floor**2 for e in (residual, np.diff(residual, axis=0))]
    return float(np.sum(0.5 * np.log(size[0]))), float(np.sum(0.5 * np.log(size[1])))
