"""One effect accepted after another: the candidate that the evidence prefers, fitted in full, and what could replace it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from motorlens_physics.estimate.fit import Fit, plain_noise
from motorlens_physics.estimate.run import Run
from motorlens_physics.threads import on_all_cores
from motorlens_workbench.bend import Bend
from motorlens_workbench.candidates import Candidate
from motorlens_workbench.evidence import own_score
from motorlens_workbench.look import Look, decoy_of
from motorlens_workbench.screen import all_columns, errors_by_block, evidence_of, held_out_rmse, with_priors
from motorlens_workbench.selection import (
    ACCEPTED,
    REAL,
    WORTH,
    Progress,
    Test,
    cornered,
    likeness,
    pair,
    refit,
    rivals,
    test_all,
    total,
)

# Share of what has been explained so far that a further effect must explain.
AMONG = 0.003
# A rival whose loss (2 log likelihood over inflation) is below this cannot be told apart.
TOLD_APART = 14.0
# Squared correlation from which on a candidate is nearly a copy, and the share of the other's gain that mends its shape.
NEAR, MENDS = 0.9, 0.1
# How many times what stands out, and what share of the squared error, a candidate must explain to be looked at though it is
# uneven, and how many are.
MASKED, STRONG, MOST_MASKED = 4.0, 0.02, 4
# Share of what a free curve would explain that an effect must explain to be taken for it.
MOSTLY = 0.7
# 2 log likelihood by which a more involved effect must be better than a simpler one.
AS_GOOD = 6.0
# Standard deviations by which it must be better if its errors scatter.
SURE = 2.0


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
        rivals: the screen's tests of these.
    """

    test: Test
    found: Fit
    gain: float
    losses: dict[str, float]
    alike: dict[str, float]
    refits: dict[str, Fit] = field(default_factory=dict)
    rivals: dict[str, Test] = field(default_factory=dict)


def imperfections(steps: Sequence[Step], now: Look) -> list[str]:
    """Candidates that only mend the shape of what was accepted: as good in its place, and worth little beside it.

    A voltage drop that is rounded off more widely than the catalogue's is one effect, not the difference of two.
    """
    return [
        name
        for step in steps
        for name, alike in step.alike.items()
        if (alike > NEAR or step.losses.get(name, float("inf")) < TOLD_APART)
        and name in now.tests
        and now.tests[name].gain < MENDS * step.gain
    ]


def threshold(now: Look, test: Test) -> float:
    """The statistic that counts as real for a candidate: a decoy that explains what it leaves must be far weaker."""
    labels = test.candidate.columns()[test.variant]
    return max(ACCEPTED, 2.0 * decoy_of(now.left, labels))


def likely(test: Test, tried: int) -> bool:
    """Whether a test is rather not chance, of so many tried: if few blocks of time bear it, its scatter is hardly known."""
    return test.score is not None and test.score.p * tried < 0.5


def among(steps: Sequence[Step], candidate: Candidate) -> float:
    """The gain below which a candidate may be the imperfection of what was accepted before.

    Of what shows in the same channels, that is: heat shows in the temperature alone.
    """
    return AMONG * sum(step.gain for step in steps if step.test.candidate.warms == candidate.warms)


def advance(
    now: Look, runs: Sequence[Run], say: Progress, avoid: Sequence[str], steps: Sequence[Step] = ()
) -> tuple[Step | None, list[str]]:
    """Accept the candidate that the evidence prefers, if one is real and worth having; else None and what failed.

    Args:
        now: the screen from where the search stands.
        runs: prepared recordings.
        say: told what is done.
        avoid: candidates that are not to be tried.
        steps: what was accepted before.
    """
    broken: list[str] = []
    tests = _simple(now, avoid)
    for _ in range(3):
        worth = WORTH * now.samples
        standing = [
            t
            for t in tests.values()
            if t.statistic > ACCEPTED and t.gain > max(worth, among(steps, t.candidate))
        ]
        standing.sort(key=lambda test: -test.statistic)
        standing = [t for t in standing[:8] if t.statistic > threshold(now, t) and likely(t, len(now.tests))]
        known = max((test.gain for test in standing), default=worth)
        step = _unmasked(now, tests, max(known, STRONG / MASKED * now.samples), runs, say)
        if step is not None:
            return step, broken
        if not standing:
            return None, broken
        best = max(standing, key=lambda test: test.statistic)
        together = pair(now.left, tests, best)
        if together is not None:
            step = _first_of(now, together, runs, say)
            if step is not None:
                return step, broken
        near = rivals(now.left, tests, best)
        say(f"refitting with {', '.join(test.candidate.name for test in near)}")
        tries = on_all_cores(lambda test: refit(now.found, now.evidence, test, runs), near)
        refits = {test.candidate.name: tried for test, tried in zip(near, tries, strict=True) if tried}
        good = {
            name: tried
            for name, tried in refits.items()
            if total(now.found) - total(tried) > max(0.5 * tests[name].gain, REAL)
            and likely(tests[name], len(now.tests))
        }
        if good:
            winner = simplest(good, tests, runs)
            return _accept(now, tests, winner, refits, runs), broken
        broken += [test.candidate.name for test in near]
        tests = {name: test for name, test in tests.items() if name not in broken}
    return None, broken


def uneven(now: Look, avoid: Sequence[str], runs: Sequence[Run], say: Progress) -> Step | None:
    """Where a curve without a name is left: a candidate that would explain it, though unevenly. None if none holds."""
    return _unmasked(now, _simple(now, avoid), WORTH * now.samples, runs, say)


def _simple(now: Look, avoid: Sequence[str]) -> dict[str, Test]:
    return {name: test for name, test in now.tests.items() if name not in avoid and not test.involved}


def in_full(now: Look, than: Sequence[Step], left: Bend, runs: Sequence[Run], say: Progress) -> Step | None:
    """Of all effects of an equation, each fitted in full, the best that does better than all steps taken; None if none does.

    Where the model without any of them ended in a corner, or an effect is far from linear, the screen from there sees little
    of what is missing: that no effect of the catalogue explains it takes a fit with each to say. Better is what leaves less
    on blocks of time held out, is real as seen from the model that has it, and explains most of what the curve would.

    Args:
        now: the screen without any of them.
        than: the steps taken.
        left: the free curve that shows what is missing.
        runs: prepared recordings.
        say: told what is done.
    """
    equation = left.curve.equation
    # From a corner, a curve explains what no effect has to.
    enough = WORTH * now.samples if cornered(now.found) else max(MOSTLY * left.gain, WORTH * now.samples)
    tests = {
        name: test
        for name, test in now.tests.items()
        if test.candidate.kind == "effect" and test.candidate.equation == equation and test.score
    }
    say(f"refitting with every effect of the {equation} equation")
    tries = on_all_cores(lambda test: refit(now.found, now.evidence, test, runs), list(tests.values()))
    refits = {step.test.candidate.name: step.found for step in than[:1]}
    least = left_out(than[-1].found if than else now.found, runs)
    seen, winner = dict(now.tests), None
    for (name, test), tried in zip(tests.items(), tries, strict=True):
        even = evenness(tried, test, runs) if tried else None
        if tried is None or even is None:
            continue
        # From a corner, neither its size nor what it resembles means much; the fit says.
        refits[name], seen[name] = tried, replace(test, allowed=True)
        gain, error = total(now.found) - total(tried), left_out(tried, runs)
        if error < least and gain / even > threshold(now, test) and gain > enough:
            assert test.score is not None
            winner, least = replace(test, score=test.score.inflated(even), allowed=True), error
    if winner is None:
        return None
    name = winner.candidate.name
    step = _accept(replace(now, tests=seen), {**seen, name: winner}, name, refits, runs)
    return replace(step, alike={other: alike for other, alike in step.alike.items() if other not in refits})


def left_out(found: Fit, runs: Sequence[Run]) -> float:
    """Logarithm of the error on blocks of time held out, summed over the channels.

    Least squares, for it is squares that are compared: what makes noise white makes slow errors small.
    """
    plain = replace(found, whiteners=plain_noise(found.residuals, runs))
    columns = all_columns(plain, runs, (), (), with_decoys=False)
    evidence = with_priors(evidence_of(columns, runs, plain.whiteners), plain)
    return sum(math.log(error) for error in held_out_rmse(plain, runs, columns, evidence).values())


def _unmasked(
    now: Look, tests: dict[str, Test], known: float, runs: Sequence[Run], say: Progress
) -> Step | None:
    """Accept a candidate that would explain far more than any that stands out, though unevenly: None if none holds.

    A strong effect that changes what the motor does (friction that brings it to rest) is not linear: seen from a model
    without it, its column fits in some blocks and not in others, and scatter hides it. Fitted in full it must be even.
    """
    masked = [
        test
        for test in tests.values()
        if test.gain > MASKED * max(known, REAL) and test.statistic <= threshold(now, test)
    ]
    masked.sort(key=lambda test: -test.gain)
    masked = masked[:MOST_MASKED]
    if masked:
        say(f"refitting with {', '.join(test.candidate.name for test in masked)}")
    tries = on_all_cores(lambda test: refit(now.found, now.evidence, test, runs, rounds=8), masked)
    refits, seen = {}, dict(tests)
    for test, tried in zip(masked, tries, strict=True):
        name = test.candidate.name
        if tried is None or not total(now.found) - total(tried) > 0.5 * test.gain:
            continue
        even = evenness(tried, test, runs)
        assert test.score is not None
        if even is not None and (total(now.found) - total(tried)) / even > threshold(now, test):
            refits[name], seen[name] = tried, replace(test, score=test.score.inflated(even))
    if not refits:
        return None
    return _accept(
        replace(now, tests={**now.tests, **seen}), seen, simplest(refits, seen, runs), refits, runs
    )


def evenness(found: Fit, test: Test, runs: Sequence[Run]) -> float | None:
    """Scatter between blocks of an effect's size, seen from the model that has it, over what noise would give."""
    columns = all_columns(found, runs, (), (), with_decoys=False)
    evidence = with_priors(evidence_of(columns, runs, found.whiteners), found)
    tested = own_score(evidence, found.prior.keys, test.candidate.key)
    return tested.inflation if tested else None


def simplest(good: Mapping[str, Fit], tests: Mapping[str, Test], runs: Sequence[Run]) -> str:
    """Of the refits that are as good as the best, the one that claims least.

    As good is what differs by little, or by no more than the scatter between blocks of time lets it (Vuong 1989,
    doi:10.2307/1912557).
    """
    best = min(good, key=lambda name: total(good[name]))
    inflation = inflation_of(tests[best])
    return min(
        (name for name in good if as_good(good[name], good[best], inflation, runs)),
        key=lambda name: (tests[name].candidate.claims, total(good[name])),
    )


def inflation_of(test: Test) -> float:
    """Scatter of a candidate's test between blocks of time."""
    assert test.score is not None
    return test.score.inflation


def as_good(one: Fit, best: Fit, inflation: float, runs: Sequence[Run]) -> bool:
    """Whether a fit is worse than the best by no more than chance, or than what the scatter between blocks lets it be."""
    worse, scatter = compared(one, best, runs)
    return worse <= max(AS_GOOD, min(AS_GOOD * inflation, SURE * scatter))


def compared(one: Fit, other: Fit, runs: Sequence[Run]) -> tuple[float, float]:
    """By how much a fit is worse than another, and the standard deviation of that by its scatter between blocks of time."""
    apart = errors_by_block(one, runs) - errors_by_block(other, runs)
    return total(one) - total(other), float(np.sqrt(np.sum((apart - apart.mean()) ** 2)))


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
    alone = {one.candidate.name: found}
    return _accept(replace(now, left=beside, tests=tests), tests, one.candidate.name, alone, runs)


def _accept(
    now: Look, tests: dict[str, Test], winner: str, refits: dict[str, Fit], runs: Sequence[Run]
) -> Step:
    chosen = tests[winner]
    assert chosen.score is not None
    found = refits[winner]
    gain = total(now.found) - total(found)
    losses, alike = {winner: 0.0}, {}
    for name, test in now.tests.items():
        if name == winner or test.score is None or (test.involved and name not in refits):
            continue
        alike[name] = likeness(now.left, chosen, test)
        # Twins are as significant as each other; a column of scatter is not a rival however large its gain.
        if not test.allowed or (test.statistic < 0.3 * chosen.statistic and name not in refits):
            continue
        inflation = chosen.score.inflation
        if name in refits:
            loss, scatter = compared(refits[name], found, runs)
            # A difference d of white noise has the variance 4 d.
            inflation = min(inflation, max(1.0, scatter**2 / (4 * loss))) if loss > 0 else inflation
        else:
            loss = chosen.score.gain - test.score.gain
        losses[name] = max(loss, 0.0) / inflation
    others = {name: tried for name, tried in refits.items() if name != winner}
    return Step(chosen, found, gain, losses, alike, others, {name: now.tests[name] for name in others})
