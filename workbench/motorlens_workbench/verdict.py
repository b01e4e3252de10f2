"""From the outcome of a contest to a verdict: what is missing, how sure that is, and what the recordings cannot tell."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit

from motorlens_physics.estimate.delays import delays_of
from motorlens_physics.estimate.fit import Fit
from motorlens_physics.estimate.notes import notes_of
from motorlens_physics.estimate.prior import RELATIVE_SD
from motorlens_physics.estimate.report import findings
from motorlens_physics.estimate.run import UNIT_OF
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.needed import follows, leaves_noise, needed_weight
from motorlens_workbench.contest.rivals import Rivals
from motorlens_workbench.contest.worth import own_doubt, own_score
from motorlens_workbench.criteria import CRITERIA, INTERVAL
from motorlens_workbench.diagnose import Finding
from motorlens_workbench.evidence.held_out import by_run, fitted_errors, times_noise
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.evidence.unmeasured_torque import UnmeasuredTorque, unmeasured_torque
from motorlens_workbench.fitted import Accepted
from motorlens_workbench.hypotheses.courses import TEXTBOOK
from motorlens_workbench.hypotheses.effects import equation_of
from motorlens_workbench.standing import Standing

# Names in a group that anybody would read.
GROUP = 6


@dataclass(frozen=True)
class Verdict:
    """The answer.

    Attributes:
        kind: "named", "group", "unknown", "sensor_fault", "adequate" or "not_testable".
        chosen: effects and sensor faults that hold.
        groups: for each of them, all that the recordings cannot tell from it, itself first.
        equation: which balance fails; None where none does.
        probability: of every hypothesis, that it is what is missing.
        shape: the term without a name that remains; None if none does.
        torque: what nobody measured of the shaft, where that explains more of what is left than any such term.
        contradicted: parameters that are far from the motor file, where nothing else is missing: one of the two is wrong; or
            without the names `instead`, which they make up for; or at the edge of what is possible, see `impossible`.
        impossible: whether a parameter of the textbook ends at the edge of what is possible: of a motor that cannot be, no
            name is told, and no shape or torque.
        instead: of the chosen ones, those for which nothing speaks but that.
        beside: what acts on the shaft though no more than that shows, a sentence; "" if nothing does.
        untold: what the recordings cannot tell, sentences.
    """

    kind: str
    chosen: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    equation: str | None
    probability: Mapping[str, float]
    shape: Score | None
    torque: UnmeasuredTorque | None
    contradicted: tuple[str, ...]
    instead: tuple[str, ...]
    impossible: bool
    beside: str
    untold: tuple[str, ...]


def settle(found: Finding) -> Verdict:
    """Decide."""
    outcome = found.outcome
    judged = findings(_as_fit(found))
    edges = tuple(key for key in judged.at_bound if key in RELATIVE_SD)
    held = [
        (one, rivals)
        for one, rivals in zip(outcome.accepted, outcome.rivals, strict=True)
        if not edges and _holds(found, one)
    ]
    groups = _groups([rivals for _, rivals in held], _names(found))
    instead = [one for one, _ in held if one.made_up_for]
    by_themselves = [
        (one, group) for (one, _), group in zip(held, groups, strict=True) if not one.made_up_for
    ]
    told = _told(found, [one for one, _ in held])
    kind, equation = _kind(found, by_themselves, told)
    probability = dict.fromkeys(_names(found), 0.0)
    for one, rivals in held:
        # Or the motor file is wrong.
        likelier = float(expit(one.than_file))
        for name, share in rivals.probability.items():
            if name in probability:
                probability[name] = max(probability[name], likelier * share)
    dead = tuple(dict.fromkeys(one.name for one in found.dead))
    probability |= dict.fromkeys(dead, 1.0)
    chosen = (*dead, *(one.hypothesis.name for one, _ in held if one.hypothesis.name not in dead))
    groups = [*((name,) for name in dead), *(group for group in groups if group[0] not in dead)]
    shape = (outcome.unnamed or told.rest) if kind == "unknown" else None
    seen = unmeasured_torque(told) if kind in ("adequate", "unknown") and outcome.unnamed is None else None
    # Unless what is left is correlated beside such a torque too.
    torque = seen if kind == "unknown" and seen is not None and seen.won > told.book.colour else None
    if torque is not None:
        shape, equation = None, "mechanical"
    # It is nothing that a motor lacks, but it is said.
    beside = (
        _beside(found, seen) if kind == "adequate" and seen is not None and seen.won > CRITERIA.white else ""
    )
    contradicted: tuple[str, ...] = ()
    if kind != "unknown" and not dead:
        contradicted = tuple(dict.fromkeys(key for one in outcome.accepted for key in one.made_up_for))
    if kind == "adequate" and not contradicted:
        contradicted = tuple(judged.far)
    if edges and not dead:
        contradicted, shape, torque, beside = edges, None, None, ""
    if contradicted:
        # What is missing may be just what a parameter makes up for: then nothing shows but where that has gone.
        kind, equation = "unknown", _equation_of(found, contradicted[0])
    return Verdict(
        kind,
        chosen,
        tuple(groups),
        equation,
        probability,
        shape,
        torque,
        contradicted,
        tuple(one.hypothesis.name for one in instead),
        bool(edges),
        beside,
        tuple(limits(found, [one for one, _ in held], {*chosen, *sum(groups, ())})),
    )


def _beside(found: Finding, torque: UnmeasuredTorque) -> str:
    if any("load_torque" in run.known for run in found.runs):
        return (
            f"A torque acts on the shaft beside the load that was measured, {torque.size}: as a load does that its sensor "
            "misses, or friction that changes."
        )
    return f"A torque that nobody measured acts on the shaft, {torque.size}: as a load does."


def _groups(rivals: Sequence[Rivals], names: Collection[str]) -> list[tuple[str, ...]]:
    """The groups of the names that hold; what could stand in more than one place stands where it is likeliest."""

    def place(name: str) -> int:
        own = next((k for k, one in enumerate(rivals) if one.name == name), None)
        likely = [one.probability.get(name, 0.0) for one in rivals]
        return likely.index(max(likely)) if own is None else own

    return [
        tuple(name for name in one.group if name in names and place(name) == k)[:GROUP]
        for k, one in enumerate(rivals)
    ]


def _kind(
    found: Finding, held: Sequence[tuple[Accepted, tuple[str, ...]]], told: Standing
) -> tuple[str, str | None]:
    """The kind of an answer and where something is missing.

    Args:
        found: by the contest.
        held: the names that hold by themselves, and their groups.
        told: see `_told`.
    """
    unnamed, last = found.outcome.unnamed, found.outcome.last
    if found.dead:
        return "sensor_fault", found.dead[0].channel
    if unnamed is not None:
        return "unknown", unnamed.entry.hypothesis.equation
    if not held:
        if not any(run.moves for run in found.runs):
            return "not_testable", None
        if told.rest is not None and not leaves_noise(told):
            return "unknown", told.rest.entry.hypothesis.equation
        blind = all(detectable(found, score) > 3 for score in seen_named(found.outcome.last).values())
        return ("not_testable" if blind else "adequate"), None
    if last.rest is not None and _no_more_than_a_part(found, [one for one, _ in held]):
        return "unknown", last.rest.entry.hypothesis.equation
    if any(len(group) > 1 for _, group in held):
        kind = "group"
    elif all(one.hypothesis.kind == "sensor" for one, _ in held):
        kind = "sensor_fault"
    else:
        kind = "named"
    return kind, held[0][0].hypothesis.equation


def _told(found: Finding, held: Sequence[Accepted]) -> Standing:
    """The model that is told: where none of the names that entered holds, it has none, and leaves what they explained."""
    outcome = found.outcome
    return outcome.last if held or not outcome.accepted else outcome.first


def _no_more_than_a_part(found: Finding, names: Sequence[Accepted]) -> bool:
    """Whether names have explained less of what is missing than what remains: of the errors, or as colour of the noise."""
    first, last = found.outcome.first, found.outcome.last
    if leaves_noise(last):
        return False
    before, after = (times_noise(one.book, one.lines, last.floor) ** 2 - 1 for one in (first, last))
    return last.book.colour > _won(names) or (not follows(last) and after > before - after)


def _won(accepted: Sequence[Accepted]) -> float:
    """What names have won of the likelihood, as it is told of colour: twice the logarithm."""
    return sum(one.gain * one.scatter for one in accepted)


def _equation_of(found: Finding, key: str) -> str | None:
    """Where a parameter of the motor stands, the textbook's or an effect's; None of one of a sensor."""
    if key in TEXTBOOK:
        return TEXTBOOK[key][0]
    effect = found.outcome.last.fitted.model.file.motor.effect(key.partition(".")[0])
    return equation_of(type(effect)) if effect is not None else None


def _names(found: Finding) -> list[str]:
    return list(dict.fromkeys([*seen_named(found.outcome.first), *seen_named(found.outcome.last),
                               *(one.hypothesis.name for one in found.outcome.accepted)]))  # fmt: skip


def seen_named(here: Standing) -> dict[str, Score]:
    """The best shape of every hypothesis with a name, possible or not."""
    best: dict[str, Score] = {}
    for score in here.scores:
        if score.entry.hypothesis.named and (
            score.name not in best or score.weight > best[score.name].weight
        ):
            best[score.name] = score
    return best


def in_its_place(found: Finding, name: str) -> Score | None:
    """A name that was not accepted in the place of the one that it could stand for; None if it is in no group.

    What the first screen says of it is bent by all else that was missing then.
    """
    groups = [rivals for rivals in found.outcome.rivals if name in rivals.group[1:]]
    likeliest = max(groups, key=lambda rivals: rivals.probability[name], default=None)
    return likeliest.scores.get(name) if likeliest else None


def _holds(found: Finding, one: Accepted) -> bool:
    """Whether the interval of its size is away from null; its other parameters, which mean nothing there, are not varied.

    Of an effect that is told only as a product of two parameters, neither has a deviation that says so; where there is only
    one, it does.
    """
    last = found.outcome.last
    seen = own_score(last.plain, last.fitted, one.hypothesis)
    told = seen.gain / (seen.scatter + own_doubt(last, seen, one.hypothesis)) if seen else 0.0
    only_size = len(_own_parameters(found, one)) == 1
    return max(told, one.agreed) > INTERVAL**2 and (not only_size or _told_alone(found, one))


def detectable(found: Finding, score: Score) -> float:
    """The smallest size that would have been seen, in units of its columns."""
    last = found.outcome.last
    return score.detectable(needed_weight(last)) if last.null else float("inf")


def _told_alone(found: Finding, one: Accepted) -> bool:
    """Whether the deviation of its size, its other parameters varied with it, says as much as that it is there."""
    value, sd = measured(found, one)
    null = found.outcome.last.fitted.model.file.meaning(one.hypothesis.key).null or 0.0
    return abs(value - null) > INTERVAL * sd


def _only_together(one: Accepted, parameters: Sequence[str]) -> str:
    return (
        f"{one.hypothesis.name} is there beyond chance, but its parameters ({', '.join(parameters)}) are told only "
        "together: each may be near nothing."
    )


def told_together(found: Finding, one: Accepted) -> list[str]:
    """The parameters of an accepted hypothesis of which recordings tell only all together; none where its size is told."""
    own = _own_parameters(found, one)
    return own if len(own) > 1 and not _told_alone(found, one) else []


def _own_parameters(found: Finding, one: Accepted) -> list[str]:
    """The names of the free parameters of an accepted hypothesis."""
    begin = f"{one.hypothesis.name}."
    keys = found.outcome.last.fitted.prior.keys
    return [key.removeprefix(begin) for key in keys if key.startswith(begin)]


def _refused(found: Finding, name: str) -> str:
    """A name that the screen points at and that does not hold, with what it does to the errors."""
    try:
        without, with_it = found.outcome.attempts[name]
        before, after = (fitted_errors(one.model, one.runs) for one in (without, with_it))
    except (KeyError, ModelError):
        return f"The screen points at {name}, but no model could be fitted with it: it stands for something else."
    changes = " and ".join(
        f"the error of {channel} goes from {error:.3g} to {after[channel]:.3g} {UNIT_OF[channel]}"
        for channel, error in before.items()
    )
    # The table's errors are those of the whole contest, from the model of the motor file on.
    others = [
        one.hypothesis.name for one in found.outcome.accepted if one.hypothesis.key in without.prior.keys
    ]
    beside = f" beside {' and '.join(others)}" if others else ""
    why = "is no more than chance may do, or one stretch of time does not agree with another on it"
    seen = seen_named(found.outcome.first).get(name)
    if seen is not None and not with_it.allows(hypothesis := seen.entry.hypothesis):
        size, unit = with_it.model.values()[hypothesis.key], with_it.model.file.meaning(hypothesis.key).unit
        why = f"takes {size:.3g} {unit}, {abs(with_it.multiple(hypothesis)):.0f} times its typical size"
    fitted = f"The screen points at {name}. Fitted with it{beside}, {changes}"
    return f"{fitted}; but that {why}, so it may stand for something else."


def limits(found: Finding, held: Sequence[Accepted], offered: Collection[str]) -> list[str]:
    """What the recordings cannot tell, in words; of each name at most one thing.

    Args:
        found: by the contest.
        held: names that stand.
        offered: these and what they cannot be told from: the verdict speaks of them.
    """
    said = [one.sentence for one in found.dead]
    said += notes_of(found.runs)
    lags = [times for name, times in found.outcome.judged.items() if name.endswith("_sensor_lag")]
    refused_lag = bool(lags) and max(lags) < 1.0
    said += [
        replace(delay, lag_refused=refused_lag).sentence for delay in delays_of(_as_fit(found), found.runs)
    ]
    channels = {channel for run in found.runs for channel in (*run.channels, *run.imposed)}
    known = {quantity for run in found.runs for quantity in run.known}
    if "temperature" not in channels:
        said.append(
            "Temperature was not measured: the thermal equation is not tested, and the winding's resistance drifts freely."
        )
    if "current" not in channels:
        said.append("Current was not measured: a voltage drop and a friction torque can look alike.")
    if "speed" not in channels:
        said.append("Speed was not measured: mechanical effects are seen only through the current.")
    if not any(run.load_known for run in found.runs):
        said.append(
            "The load torque was not measured: the shaft is taken as free, and a load passes for a constant torque "
            "or, if it brakes, for friction."
        )
    if "ambient" not in known and "temperature" in channels:
        said.append(
            "The ambient temperature was not measured: an offset of the temperature sensor cannot be told from it."
        )
    refused = [
        name
        for name in dict.fromkeys(found.outcome.refused)
        if name not in offered and not name.endswith("changes at once")
    ]
    unspoken = {
        name: score
        for name, score in seen_named(found.outcome.last).items()
        if name not in (*offered, *refused)
    }
    blind = sorted(name for name, score in unspoken.items() if detectable(found, score) > 3)
    if blind:
        said.append(
            "Not even three times the typical size, or the largest that it can have, would have been seen of: "
            + ", ".join(blind)
            + "."
        )
    told = _told(found, held)
    times = told.times_noise
    why = "noise that lasts, a torque that nobody measured, or something"
    if times > CRITERIA.follows:
        said.append(
            f"The model is {times:.3g} times the noise off on what it was not fitted to: {why} that no hypothesis explains."
        )
        shares = by_run(told.book, told.lines, told.floor)
        if len(shares) > 1 and shares.max() > 0.5:
            worst = found.runs[int(np.argmax(shares))].name
            said.append(f"Most of that, {shares.max():.0%} of the squares, is in {worst}.")
    elif told.book.colour > CRITERIA.white:
        said.append(
            f"What the model leaves is correlated as no noise of the sensors is: {why} that is not named here."
        )
    said += [_only_together(one, names) for one in held if (names := told_together(found, one))]
    said += [
        f"Without {one.hypothesis.name}, {sentence}." for one in held for sentence in one.made_up_for.values()
    ]
    said += [_refused(found, name) for name in refused]
    return [*said, *findings(_as_fit(found)).in_short]


def _as_fit(found: Finding) -> Fit:
    """The final model with its deviations, scatter between blocks of time as in the estimate it began with."""
    base, last = found.base.fit, found.outcome.last.fitted
    return replace(base, model=last.model, prior=last.prior, covariance=last.covariance)


def measured(found: Finding, one: Accepted) -> tuple[float, float]:
    """The size of an accepted hypothesis and its standard deviation, scatter between blocks of time included."""
    return of_key(found, one, one.hypothesis.key)


def of_key(found: Finding, one: Accepted, key: str) -> tuple[float, float]:
    """A parameter of an accepted hypothesis and its standard deviation."""
    last = found.outcome.last
    keys = list(last.fitted.prior.keys)
    # The fit's covariance takes the noise as white: so does what it scatters by.
    seen = own_score(last.plain, last.fitted, one.hypothesis)
    scatter = seen.scatter + own_doubt(last, seen, one.hypothesis) if seen else one.scatter
    variance = float(last.fitted.covariance[keys.index(key), keys.index(key)])
    value, sd = last.fitted.model.values()[key], float(np.sqrt(max(variance, 0.0) * scatter))
    if key == one.hypothesis.key and one.agreed > 0:
        # Where sensitivities change on the way to null they say less than the fit without it does.
        null = last.fitted.model.file.meaning(key).null or 0.0
        sd = min(sd, abs(value - null) / float(np.sqrt(one.agreed)))
    return value, sd


def sizes(found: Finding, name: str) -> dict[str, dict[str, object]]:
    """Parameters of an accepted hypothesis with standard deviation and unit.

    Of another what it would be in the place of one that it could stand for, or what the first screen says.
    """
    for dead in found.dead:
        if dead.name == name:
            return {"gain": {"value": dead.gain, "sd": dead.sd, "unit": "1"}}
    for one in found.outcome.accepted:
        if one.hypothesis.name == name:
            fitted = found.outcome.last.fitted
            return {
                key.rpartition(".")[2]: dict(
                    zip(("value", "sd"), of_key(found, one, key), strict=True),
                    unit=fitted.model.file.meaning(key).unit,
                )
                for key in fitted.prior.keys
                if key.startswith(f"{name}.")
            }
    first, last = seen_named(found.outcome.first), seen_named(found.outcome.last)
    score = in_its_place(found, name) or first.get(name) or last.get(name)
    if score is None:
        return {}
    hypothesis = score.entry.hypothesis
    switch, meaning = hypothesis.key.rpartition(".")[2], meaning_of(score)
    sd = abs(hypothesis.typical) * float(np.sqrt(score.covariance[0, 0]))
    size = hypothesis.typical * float(score.coefficient[0])
    if len(score.coefficient) > 1:
        size = abs(hypothesis.typical) * float(np.hypot(*score.coefficient[:2]))
    return {switch: {"value": (meaning.null or 0.0) + size, "sd": sd, "unit": meaning.unit}}


def meaning_of(score: Score):  # type: ignore[no-untyped-def]
    """The parameter that is the size of a hypothesis with a name."""
    shape = score.entry.shape
    part = shape.parts[0] if hasattr(shape, "parts") else shape.sensor  # type: ignore[attr-defined]
    return part.switch()
