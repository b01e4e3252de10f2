"""What is missing from a model: the whole diagnosis, from prepared recordings to a verdict in words and figures.

Base fit; noise from the residual that nothing explains; a screen of all effects and sensor faults in one pass; refits of
the best and its rivals; again from there, up to three effects; then the question whether it really is that effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.motor_file import MotorFile
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import ModelError
from motorlens_workbench.candidates import Candidate, candidates, curves
from motorlens_workbench.dead_channels import DeadChannel, dead_channels, without
from motorlens_workbench.evidence import Evidence, statistics
from motorlens_workbench.fitting import (
    Fit,
    base_prior,
    fit,
    noise_of,
    plain_noise,
    squares,
    start_model,
)
from motorlens_workbench.input_errors import without_input_errors
from motorlens_workbench.leftover import BALANCES, Bend, leftover
from motorlens_workbench.model import Model, predict
from motorlens_workbench.run import Run, prepare
from motorlens_workbench.screen import (
    Columns,
    all_columns,
    evidence_of,
    unexplained,
    with_priors,
)
from motorlens_workbench.selection import (
    REAL,
    WORTH,
    Progress,
    Test,
    likeness,
    pair,
    refit,
    rivals,
    test_all,
    total,
)

Array = NDArray[np.float64]

MOST = 3
# By how much (logarithm of the error of a channel) another way to take the inputs must be better than the recorded one.
BETTER_WAY = 0.0025
# Share of what has been explained so far that a further effect must explain.
AMONG = 0.003
# 2 log likelihood by which a more involved effect must be better than a simpler one.
AS_GOOD = 6.0


@dataclass(frozen=True)
class Look:
    """The screen from one model.

    Attributes:
        found: the fit it was taken from, with the noise of this screen.
        evidence: all columns, without what errors of the inputs feign.
        recorded: all columns, as recorded.
        left: what the fitted parameters leave.
        tests: every candidate.
        decoy: the best statistic that a decoy reaches.
        noise: (C,) per run, standard deviation of what nothing explains.
        columns: unwhitened, per run.
    """

    found: Fit
    evidence: Evidence
    recorded: Evidence
    left: Evidence
    tests: dict[str, Test]
    decoy: float
    noise: tuple[Array, ...]
    columns: list[Columns]

    @property
    def samples(self) -> float:
        """How many whitened samples there are."""
        return float(self.evidence.samples.sum()) * len(self.found.residuals[0][0])


@dataclass(frozen=True)
class Step:
    """One effect accepted.

    Attributes:
        test: the screen's test of it.
        found: the fit with it.
        gain: fall of the whitened sum of squares, as refitted.
        losses: how much worse each other candidate would be in its place, over the inflation of the winner's test;
            0 for the winner itself.
        alike: squared correlation with each other candidate.
        refits: fits with the rivals that were refitted.
    """

    test: Test
    found: Fit
    gain: float
    losses: dict[str, float]
    alike: dict[str, float]
    refits: dict[str, Fit] = field(default_factory=dict)


@dataclass(frozen=True)
class Finding:
    """All that the diagnosis found out, before it is put in words.

    Attributes:
        runs: prepared recordings.
        base: the fit without any candidate.
        first: the screen from it.
        steps: effects accepted, in order.
        last: the screen from the final model.
        failed: candidates whose refit did not do what the screen promised.
        whole: free curves that explain what the base model lacks, if any is left in the end; the strongest first.
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


def look(found: Fit, runs: Sequence[Run], own: Sequence[type[Effect]] = ()) -> Look:
    """Screen everything from a fitted model."""
    outputs = sorted({channel for run in runs for channel in run.channels})
    inputs = ("voltage", *sorted({q for run in runs for q in run.known}))
    exact: dict[str, float] = {}
    for run in runs:
        exact |= {q: min(limit, exact.get(q, limit)) for q, limit in run.offset_below.items()}
    listed = candidates(found.model.file, outputs, inputs, own, exact)
    trajectories = [predict(found.model, run, r)[0] for r, run in enumerate(runs)]
    free = curves(trajectories, BALANCES)
    columns = all_columns(found, runs, listed, free)
    rest, spent = unexplained(columns, runs, plain_noise(found.residuals, runs), found.prior.keys)
    whiteners = noise_of(rest, runs, spent)
    recorded = evidence_of(columns, runs, whiteners)
    evidence = without_input_errors(recorded, found, runs, whiteners, listed, free, with_decoys=True)
    evidence = with_priors(evidence, found)
    found = replace(found, whiteners=whiteners, error=squares(found.residuals, runs, whiteners))
    left = evidence.given(found.prior.keys)
    tests = test_all(left, listed, found.model)
    noise = tuple(np.sqrt(np.mean(e[run.fresh()] ** 2, axis=0)) for e, run in zip(rest, runs, strict=True))
    recorded = with_priors(recorded, found)
    return Look(found, evidence, recorded, left, tests, decoy_of(left), noise, columns)


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
    runs = tuple(prepare(recording, file) for recording in recordings)
    say("fitting the base parameters")
    base, used = base_fit(file, runs)
    dead = dead_channels(file, base, used)
    if dead:
        say(f"leaving out the {' and the '.join(f'{one.channel} of {one.recording}' for one in dead)}")
        base, used = base_fit(file, without(runs, dead))
    runs = used
    say("screening all effects and sensor faults")
    first = current = look(base, runs, own)
    steps: list[Step] = []
    failed: list[str] = []
    while len(steps) < MOST:
        step, broken = advance(current, runs, say, failed, sum(step.gain for step in steps))
        failed += broken
        if step is None:
            break
        steps.append(step)
        say(f"screening again with {step.test.candidate.name}")
        current = look(step.found, runs, own)
    say("looking at what is left")
    left = leftover(current.found, runs, current.decoy)
    whole = leftover(first.found, runs, first.decoy) if steps and left else left
    return Finding(runs, base, first, tuple(steps), current, tuple(failed), tuple(whole), tuple(left), dead)


def base_fit(file: MotorFile, runs: Sequence[Run]) -> tuple[Fit, tuple[Run, ...]]:
    """The textbook's parameters fitted, and the runs with their inputs as they fit best.

    Whether the voltage was held between samples or ran linearly, and whether what its sensor adds is noise or was truly
    applied, is not written in a recording; the better fit decides.
    """
    prior = base_prior(file, runs)
    quieter = tuple(run.quieter() for run in runs)
    # Parameters fitted to noisy inputs have made up for the noise: each way is judged by a fit of its own as well.
    fits = [fit(start_model(file, taken), taken, prior) for taken in dict.fromkeys((tuple(runs), quieter))]
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
    return fit(replace(model, held=tuple(held)), chosen, prior), tuple(chosen)


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


def decoy_of(left: Evidence, given: Sequence[str] = ()) -> float:
    """The best statistic that a decoy reaches beside some columns."""
    found = dict(zip(left.names, statistics(left, given).tolist(), strict=False))
    return max((value for name, value in found.items() if name.startswith("decoy.")), default=0.0)


def threshold(now: Look, test: Test) -> float:
    """The statistic that counts as real for a candidate: a decoy that explains what it leaves must be far weaker."""
    labels = test.candidate.columns()[test.variant]
    return max(REAL, 2.0 * decoy_of(now.left, labels))


def advance(
    now: Look, runs: Sequence[Run], say: Progress, avoid: Sequence[str], explained: float = 0.0
) -> tuple[Step | None, list[str]]:
    """Accept the candidate that the evidence prefers, if one is real and worth having; else None and what failed.

    `explained` is the gain of what was accepted before: a very small share of it may be that one's imperfection.
    """
    broken: list[str] = []
    tests = {name: test for name, test in now.tests.items() if name not in avoid}
    for _ in range(3):
        worth = max(WORTH * now.samples, AMONG * explained)
        standing = [t for t in tests.values() if t.statistic > REAL and t.gain > worth]
        standing.sort(key=lambda test: -test.statistic)
        standing = [test for test in standing[:8] if test.statistic > threshold(now, test)]
        if not standing:
            return None, broken
        best = max(standing, key=lambda test: test.statistic)
        together = pair(now.left, tests, best)
        if together is not None:
            step = _first_of(now, together, runs, say)
            if step is not None:
                return step, broken
        near = rivals(now.left, tests, best)
        refits: dict[str, Fit] = {}
        for test in near:
            say(f"refitting with {test.candidate.name}")
            tried = refit(now.found, now.evidence, test, runs)
            if tried is not None:
                refits[test.candidate.name] = tried
        good = {
            name: tried
            for name, tried in refits.items()
            if total(now.found) - total(tried) > 0.5 * tests[name].gain
        }
        if good:
            winner = simplest(good, tests)
            return _accept(now, tests, winner, refits), broken
        broken += [test.candidate.name for test in near]
        tests = {name: test for name, test in tests.items() if name not in broken}
    return None, broken


def simplest(good: Mapping[str, Fit], tests: Mapping[str, Test]) -> str:
    """Of the refits that are as good as the best, the one that claims least."""
    best = min(good, key=lambda name: total(good[name]))
    score_of_best = tests[best].score
    assert score_of_best is not None
    level = total(good[best]) + AS_GOOD * score_of_best.inflation
    return min(
        (name for name in good if total(good[name]) <= level),
        key=lambda name: (tests[name].candidate.claims, total(good[name])),
    )


def _first_of(now: Look, together: tuple[Test, Test], runs: Sequence[Run], say: Progress) -> Step | None:
    """Accept the stronger of two candidates that belong together, judged beside the other; None if a refit fails."""
    one, other = together
    beside = now.left.given(other.candidate.columns()[other.variant])
    listed = [test.candidate for test in now.tests.values() if test is not other]
    tests = test_all(beside, listed, now.found.model)
    judged = tests[one.candidate.name]
    if judged.statistic < REAL:
        return None
    say(f"refitting with {one.candidate.name}, beside {other.candidate.name}")
    found = refit(now.found, now.evidence, one, runs)
    if found is None or not total(now.found) - total(found) > 0.3 * one.gain:
        return None
    step = _accept(
        replace(now, left=beside, tests=tests), tests, one.candidate.name, {one.candidate.name: found}
    )
    return step


def _accept(now: Look, tests: dict[str, Test], winner: str, refits: dict[str, Fit]) -> Step:
    chosen = tests[winner]
    assert chosen.score is not None
    found = refits[winner]
    gain = total(now.found) - total(found)
    losses, alike = {winner: 0.0}, {}
    for name, test in now.tests.items():
        if name == winner or test.score is None:
            continue
        alike[name] = likeness(now.left, chosen, test)
        # Twins are as significant as each other; a column of scatter is not a rival however large its gain.
        if not test.allowed or (test.statistic < 0.3 * chosen.statistic and name not in refits):
            continue
        by_screen = chosen.score.gain - test.score.gain
        loss = total(refits[name]) - total(found) if name in refits else by_screen
        losses[name] = max(loss, 0.0) / chosen.score.inflation
    return Step(chosen, found, gain, losses, alike, {k: v for k, v in refits.items() if k != winner})


__all__ = ["Bend", "Candidate", "Finding", "Look", "Model", "Step", "investigate", "look"]
