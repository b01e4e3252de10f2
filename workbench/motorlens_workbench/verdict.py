"""From a finding to a verdict: what is missing, how sure that is, and what the recordings cannot tell.

An effect is named only if nothing else explains the same as well (else a group), and if nothing is left that a free curve
would explain much better (else it is unknown, and the shape of what is missing is shown).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorlens_physics.estimate.delays import delays_of
from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.prior import RELATIVE_SD
from motorlens_workbench.bend import Bend
from motorlens_workbench.contacts import Spells
from motorlens_workbench.diagnosis import INSTEAD, MOST, Finding
from motorlens_workbench.evidence import own_score
from motorlens_workbench.leftover import SHARP
from motorlens_workbench.look import Look, unsettled
from motorlens_workbench.selection import REAL, WORTH, Test, cornered
from motorlens_workbench.steps import TOLD_APART, Step

# Share of the accepted gain by which rivals may differ through what the model leaves out (noise on inputs, discretisation).
IMPERFECT = 0.004
# Two columns as alike as this are one.
SAME = 0.9995
GROUP = 6
# A free curve this much better than what was named says that the name is wrong: share of the accepted gain; less is enough
# of one against the travel since the last reversal, which sampling and smoothing do not feign, with a knot this many times
# real by itself.
BETTER, BETTER_BY_TRAVEL, BEYOND_DOUBT = 0.125, 0.02, 4.0
# Share of the whitened sum of squares that a curve must explain where nothing was named: without a name, more is asked, less
# of one with a knot that makes it sharp.
UNNAMED, UNNAMED_SHARP = 8e-3, 2.5e-3
# How many times as much it must explain where a converter's steps are coarse beside its noise: their error goes with the
# signals too.
COARSE = 2.0
# How many times as wide as scatter between blocks says the interval of a fitted size is: beside it stands what the model
# leaves out (another rounding of the same effect, errors of the noise model). Measured on the benchmark's development cases.
LEFT_OUT = 1.4
# Standard deviations from the motor file from which on a fitted parameter of the textbook is pointed out.
FAR_FROM_FILE = 4.0
# What BETTER is where as many effects as may be were named already.
AFTER_ALL = 0.05


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        kind: "named", "group", "unknown", "sensor_fault", "adequate" or "not_testable".
        chosen: effects and sensor faults accepted.
        groups: for each of them, all that the recordings cannot tell from it, itself first.
        equation: which balance fails; None where none does.
        probability: of every candidate, that it is what is missing.
        shape: the missing term as a free curve, for "unknown".
        untold: what the recordings cannot tell, sentences.
    """

    kind: str
    chosen: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    equation: str | None
    probability: Mapping[str, float]
    shape: Bend | None
    untold: tuple[str, ...]


def settle(found: Finding) -> Verdict:
    """Decide."""
    verdict = _of_the_living(found)
    return _with_the_dead(verdict, found) if found.dead else verdict


def _with_the_dead(verdict: Verdict, found: Finding) -> Verdict:
    """A dead sensor comes before all that its recordings may say beside."""
    names = tuple(dict.fromkeys(one.name for one in found.dead))
    others = tuple(name for name in verdict.chosen if name not in names)
    groups = tuple(group for group in verdict.groups if group[0] in others)
    return replace(
        verdict,
        kind="sensor_fault",
        chosen=(*names, *others),
        groups=(*((name,) for name in names), *groups),
        equation=verdict.equation or found.dead[0].channel,
        probability={**verdict.probability, **dict.fromkeys(names, 0.99)},
        shape=None,
    )


def _of_the_living(found: Finding) -> Verdict:
    chosen = tuple(step.test.candidate.name for step in found.steps)
    groups = tuple(group_of(step, chosen) for step in found.steps)
    bend = structure(found)
    probability = probabilities(found, unknown=bend is not None)
    untold = tuple(limits(found))
    if bend is not None:
        shape = found.whole[0] if found.whole and not isinstance(bend.curve, Spells) else bend
        return Verdict("unknown", (), (), shape.curve.equation, probability, shape, untold)
    if not chosen:
        blind = not any(_detectable(found.last, test) for test in found.last.tests.values())
        return Verdict("not_testable" if blind else "adequate", (), (), None, probability, None, untold)
    first = found.steps[0].test.candidate
    if any(len(group) > 1 for group in groups):
        kind = "group"
    elif all(step.test.candidate.kind == "sensor" for step in found.steps):
        kind = "sensor_fault"
    else:
        kind = "named"
    return Verdict(kind, chosen, groups, first.equation, probability, None, untold)


def group_of(step: Step, chosen: Sequence[str]) -> tuple[str, ...]:
    """What the recordings cannot tell from an accepted effect, itself first, the likelier before the less likely.

    What was accepted beside it stands for itself.
    """
    winner = step.test.candidate.name
    assert step.test.score is not None
    limit = TOLD_APART + IMPERFECT * step.gain / step.test.score.inflation
    near = {
        name: loss
        for name, loss in step.losses.items()
        if name not in chosen and (loss < limit or step.alike.get(name, 0.0) > SAME)
    }
    return (winner, *sorted(near, key=lambda name: near[name]))[:GROUP]


def structure(found: Finding) -> Bend | None:
    """The free curve that shows that something unnamed is left; None if what is left is noise."""
    gain = sum(step.gain for step in found.steps)
    share = AFTER_ALL if len(found.steps) == MOST else BETTER
    if found.steps and found.whole:
        instead = len(found.steps) > 1 and found.left and found.whole[0].gain > INSTEAD * gain
        if instead or cornered(found.last.found) or unsettled(found.first, found.last, found.runs):
            return found.whole[0]
    coarse = COARSE if any(run.coarse for run in found.runs) else 1.0
    for bend in found.left:
        if isinstance(bend.curve, Spells):
            return bend
        unnamed = UNNAMED_SHARP if bend.best > SHARP[2] * REAL else UNNAMED
        worth = coarse * (WORTH if found.steps else unnamed) * found.last.samples
        by_travel = bend.curve.against == "travel" and bend.best > BEYOND_DOUBT * REAL
        least = BETTER_BY_TRAVEL if by_travel else share
        if bend.gain > max(worth, least * gain):
            return bend
    return None


def probabilities(found: Finding, unknown: bool) -> dict[str, float]:
    """Of every candidate that it is (one of) what is missing; those of one step share what the step is worth."""
    stated = {name: 0.0 for name in found.first.tests}
    for step in found.steps:
        assert step.test.score is not None
        limit = 2.0 + IMPERFECT * step.gain / step.test.score.inflation / 4
        weights = {name: float(np.exp(-0.5 * loss / limit)) for name, loss in step.losses.items()}
        for name, alike in step.alike.items():
            if alike > SAME and name in weights:
                weights[name] = max(weights[name], 0.8)
        real = 1 - min(1.0, step.test.score.p * len(found.first.tests))
        for name, weight in weights.items():
            stated[name] = max(stated.get(name, 0.0), real * weight / sum(weights.values()))
    doubt = 0.1 if unknown else 0.97
    return {name: doubt * p for name, p in stated.items()}


def _detectable(now: Look, test: Test) -> bool:
    """Whether three times the typical size would have been seen."""
    return test.detectable(now.samples) < 3 * abs(test.typical)


def limits(found: Finding) -> list[str]:
    """What the recordings cannot tell, in words."""
    said = [one.sentence for one in found.dead]
    said += [delay.sentence for delay in delays_of(found.base, found.runs)]
    channels = {channel for run in found.runs for channel in run.channels}
    known = {quantity for run in found.runs for quantity in run.known}
    if "temperature" not in channels:
        said.append(
            "Temperature was not measured: the thermal equation is not tested, and the winding's resistance drifts freely."
        )
    if "current" not in channels:
        said.append("Current was not measured: a voltage drop and a friction torque can look alike.")
    if "speed" not in channels:
        said.append("Speed was not measured: mechanical effects are seen only through the current.")
    if "load_torque" not in known:
        said.append(
            "The load torque was not measured: the shaft is taken as free, and a load passes for a constant torque "
            "or, if it brakes, for friction."
        )
    if "ambient" not in known and "temperature" in channels:
        said.append(
            "The ambient temperature was not measured: an offset of the temperature sensor cannot be told from it."
        )
    blind = [name for name, test in found.last.tests.items() if not _detectable(found.last, test)]
    if blind:
        said.append(
            "Not even three times the typical size would have been seen of: " + ", ".join(sorted(blind)) + "."
        )
    for name in found.failed:
        said.append(
            f"The screen points at {name}, but the model fitted with it does not follow: it stands for something else."
        )
    return [*said, *far_off(found.last.found)]


def far_off(found: Fit) -> list[str]:
    """Parameters of the textbook that were fitted far from the motor file, a sentence each."""
    values, prior, file = found.model.values(), found.prior, found.model.file
    said = []
    for key in RELATIVE_SD:
        if key not in prior.keys:
            continue
        known, unit = prior.centre[key], file.meaning(key).unit
        deviations = (values[key] - known) / prior.sd[key]
        if abs(deviations) > FAR_FROM_FILE:
            said.append(
                f"{key} is fitted {abs(deviations):.1f} standard deviations from the motor file, {values[key]:.4g} {unit} "
                f"for {known:.4g}: the file is off, or this makes up for a sensor's error, for noise of an input, or for "
                "what is missing."
            )
    return said


def sizes(found: Finding, name: str) -> dict[str, dict[str, object]]:
    """Parameters of an accepted effect with standard deviation and unit; of another candidate what the screen says."""
    for one in found.dead:
        if one.name == name:
            return {"gain": {"value": one.gain, "sd": one.sd, "unit": "1"}}
    for step in found.steps:
        if step.test.candidate.name != name:
            continue
        file = found.last.found.model.file
        return {
            key.rpartition(".")[2]: dict(
                zip(("value", "sd"), measured(found.last, key), strict=True), unit=file.meaning(key).unit
            )
            for key in found.last.found.prior.keys
            if key.startswith(f"{name}.")
        }
    test = found.first.tests.get(name) or found.last.tests.get(name)
    if test is None or test.score is None:
        return {}
    switch = test.candidate.variants[test.variant][0].switch()
    assert switch is not None and switch.null is not None
    sd = abs(test.typical) * float(np.sqrt(test.score.covariance[0, 0]))
    return {switch.name: {"value": switch.null + test.size, "sd": sd, "unit": switch.unit}}


def measured(now: Look, key: str) -> tuple[float, float]:
    """A fitted parameter and its standard deviation: scatter between blocks, half the bias of input errors, `LEFT_OUT`."""
    prior = now.found.prior
    tested = own_score(now.evidence, prior.keys, key)
    value, unit = now.found.model.values()[key], prior.sd[key]
    if tested is None:
        return value, unit
    return value, LEFT_OUT * unit * float(
        np.hypot(np.sqrt(tested.covariance[0, 0]), 0.5 * tested.coefficient[0])
    )
