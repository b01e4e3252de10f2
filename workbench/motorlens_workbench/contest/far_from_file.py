"""A name that a parameter makes up for, where nothing shows of it but how far from the motor file that parameter has gone.

Recordings do not tell an effect from a textbook parameter that acts as it does: a loss that grows with speed from viscous
friction, radiation from conduction. Only the motor file does, as far as it is right. So it is taken at its word about
what is far from it; each name that shows then is fitted, and how likely that is, is compared with how likely it is that
the file is wrong. Errors of what a file states follow Student's t, as everywhere in a contest.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace

from motorlens_physics.estimate.report import findings
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.contest.bayes_factor import log_bayes_factor, log_occam_of
from motorlens_workbench.contest.entering import REFITTED, Step
from motorlens_workbench.contest.needed import needed_weight
from motorlens_workbench.contest.worth import own_doubt, own_score
from motorlens_workbench.criteria import INTERVAL
from motorlens_workbench.evidence.look import best_of
from motorlens_workbench.evidence.score import log_chance
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.refit import settled, with_hypothesis
from motorlens_workbench.standing import Standing, residual_of, stand
from motorlens_workbench.telling import Progress


def enter_for_file(here: Standing, say: Progress) -> Step:
    """The likeliest name that brings back what is far from the motor file, if it is likelier than that the file is wrong."""
    far = far_from_file(here.fitted) if here.null is not None else {}
    if not far:
        return Step()
    judged = [_judged(here, far, *one) for one in _fitted(here, far, say)]
    able = [known for known in judged if known is not None]
    if not able:
        return Step()
    accepted, there = max(able, key=lambda known: known[0].than_file)
    beside = {
        one.hypothesis.name: one.than_file - accepted.than_file for one, _ in able if one is not accepted
    }
    return Step(there, replace(accepted, beside=beside))


def far_from_file(fitted: Fitted) -> Mapping[str, str]:
    """Parameters that are far from the motor file, and what every command says of each, see `report.findings`."""
    return findings(fitted.fit).far


def _fitted(here: Standing, far: Collection[str], say: Progress) -> list[tuple[Hypothesis, Fitted]]:
    """Names that are beyond chance from here with the file at its word, the likeliest few, and the model with each."""
    beside = replace(here.book, trusted=frozenset(far)).beside()
    named = [entry for entry in here.book.entries if entry.hypothesis.named]
    needed = needed_weight(here)
    able = [one for one in best_of(beside.scores(named)).values() if one.weight >= needed]
    tried = sorted(able, key=lambda one: -log_bayes_factor(one, one.scatter))[:REFITTED]
    if tried:
        say(
            f"fitting with {', '.join(one.name.replace('_', ' ') for one in tried)}, which {', '.join(far)} may make up for"
        )
    ends = on_all_cores(lambda one: _settled(with_hypothesis(here.fitted, beside, one)), tried)
    return [(one.entry.hypothesis, end) for one, end in zip(tried, ends, strict=True) if end is not None]


def _judged(
    here: Standing, far: Mapping[str, str], hypothesis: Hypothesis, end: Fitted
) -> tuple[Accepted, Standing] | None:
    """A name as it enters; None if it leaves parameters far, may be nothing, or is less likely than a wrong file."""
    if not end.allows(hypothesis) or set(far) & set(far_from_file(end)):
        return None
    try:
        there = stand(end, here.own)
        won = here.residual.unlikely - residual_of(here, end).unlikely
        seen = own_score(there.plain, end, hypothesis)
    except ModelError:
        return None
    doubted = won + here.fitted.unlikely_beforehand - end.unlikely_beforehand
    than_file = 0.5 * doubted + log_occam_of(hypothesis, end)
    # What it wins with the file at its word.
    gain = won + here.fitted.pulled - end.pulled
    weight = -log_chance(max(gain, 0.0), 1)
    if seen is None or weight < needed_weight(here) or than_file <= 0:
        return None
    scatter = seen.scatter + own_doubt(there, seen, hypothesis)
    if min(seen.gain, _squared_size(hypothesis, end)) <= INTERVAL**2 * scatter:
        return None
    return Accepted(hypothesis, gain, seen.scatter, weight, made_up_for=far, than_file=than_file), there


def _squared_size(hypothesis: Hypothesis, fitted: Fitted) -> float:
    """Of a name in a model, in squared standard deviations."""
    at = fitted.prior.keys.index(hypothesis.key)
    size = fitted.multiple(hypothesis) * hypothesis.typical
    return float(size**2 / max(fitted.covariance[at, at], 1e-300))


def _settled(fitted: Fitted | None) -> Fitted | None:
    try:
        return None if fitted is None else settled(fitted)
    except ModelError:
        return None
