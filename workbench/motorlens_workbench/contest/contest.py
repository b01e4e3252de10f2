"""The contest: which hypotheses belong into the model. Adding, dropping and exchanging one are the same comparison.

Every hypothesis, with a name or without, is weighed by what it explains of the evidence (Bayes factors under one
scatter), the best with a name are fitted in full, and the best of all enters if it is beyond what the largest of all
would be by chance (`evidence.null`). What has entered is weighed again beside whatever enters later. Where something
is left beside a name, another is tried in its place with a further one (`instead`). Where nothing else shows, a parameter
far from the motor file may stand for a name (`far_from_file`). At the end every name is compared with all that could stand
in its place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from motorlens_physics.effect import Effect
from motorlens_workbench.contest.bayes_factor import simplest
from motorlens_workbench.contest.entering import (
    Attempt,
    enter,
    enter_anew,
    enter_for_delays,
    enter_unseen,
    heaviest,
)
from motorlens_workbench.contest.exchange import exchanged
from motorlens_workbench.contest.far_from_file import enter_for_file
from motorlens_workbench.contest.instead import enter_instead
from motorlens_workbench.contest.needed import (
    beyond_chance,
    follows,
    leaves_noise,
    needed_weight,
    promising,
    unseen,
)
from motorlens_workbench.contest.rivals import Rivals, rivals_of
from motorlens_workbench.contest.together import enter_two
from motorlens_workbench.contest.worth import agreement, held_score
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Accepted, Fitted
from motorlens_workbench.refit import settled, without_hypothesis
from motorlens_workbench.standing import Standing, residual_of, stand, unlikely_from
from motorlens_workbench.telling import Progress

# Effects that are looked for at most.
EFFECTS = 3


@dataclass(frozen=True)
class Outcome:
    """How the contest ended.

    Attributes:
        first: where it began.
        last: where it ended.
        accepted: in the order in which they entered.
        rivals: of each of these.
        unnamed: the term without a name that is beyond chance, and that no name explains; None if none is.
        refused: names that the screen points at, but that do not hold when fitted, or only at a size that they cannot have.
        judged: the heaviest that every name fitted in full was, in multiples of the weight that is needed.
        attempts: the model in which each name that did not hold was tried, and the same with it.
    """

    first: Standing
    last: Standing
    accepted: tuple[Accepted, ...]
    rivals: tuple[Rivals, ...]
    unnamed: Score | None
    refused: tuple[str, ...]
    judged: Mapping[str, float]
    attempts: Mapping[str, Attempt]


def contest(base: Fitted, own: Sequence[type[Effect]] = (), say: Progress = lambda text: None) -> Outcome:
    """Hold it.

    Raises:
        ModelError: the base cannot be simulated.
    """
    say("weighing every effect, sensor fault and free term")
    first = here = stand(base, own)
    if not any(run.moves for run in base.runs):
        return Outcome(first, first, (), (), None, (), {}, {})
    step = enter_for_delays(here, own, say)
    here, judged, attempts = step.standing or here, step.judged, step.attempts
    accepted: list[Accepted] = [step.accepted] if step.accepted is not None else []
    refused: list[str] = []
    estimated: list[str] = []
    pointed: dict[str, None] = {}
    nameless: tuple[Standing, list[Accepted]] | None = None
    # How many have entered, and how many had when it was asked what delays stand for.
    entered = asked = 0
    # What entered may leave again beside what came later: it must not go on for ever.
    while len(accepted) < EFFECTS and entered < 2 * EFFECTS:
        challengers = beyond_chance(here, accepted, refused)
        able = promising(here, refused)
        sticking = [] if challengers or able or here.null is None else unseen(here, refused)
        # Beside names that stand, what is correlated may be a torque that nobody measured, or coloured noise.
        enough = follows(here) if accepted else leaves_noise(here)
        silent = not challengers and not able and not sticking and (here.rest is None or enough)
        if silent and entered == asked:
            break
        pointed |= dict.fromkeys(one.name for one in challengers)
        if nameless is None and any(not one.named for one in challengers):
            nameless = here, list(accepted)
        if silent:
            # What was missing may have hidden of which sensor a delay is the lag.
            step, asked = enter_for_delays(here, own, say), entered
        elif challengers or able:
            step = enter(here, challengers, able, refused, estimated, own, say)
        elif sticking:
            step = enter_unseen(here, sticking, own, say)
        else:
            assert here.rest is not None
            step = enter_anew(here, here.rest.entry.hypothesis.equation, estimated, own, say)
        refused += step.refused
        estimated += step.estimated
        judged, attempts = heaviest((judged, attempts), (step.judged, step.attempts))
        if step.standing is not None:
            here, refused, entered = step.standing, [], entered + 1
            if step.accepted is not None:
                # Only beside another name do estimates from the beginning lead elsewhere.
                estimated = []
                accepted.append(step.accepted)
                here, accepted = _needed(here, accepted, own, say)
        elif not (step.refused or step.estimated):
            break
    if not accepted and not follows(here):
        here, accepted = enter_two(here, attempts, own, say) or (here, accepted)
    if 0 < len(accepted) < EFFECTS and (_remains(here, accepted, refused) or not follows(here)):
        found = enter_instead(here, accepted, own, say)
        here, accepted = _needed(*found, own, say) if found else (here, accepted)
    if _remains(here, accepted, refused):
        if nameless is not None and _imitate(nameless[0], here):
            here, accepted = nameless
    elif follows(here) if accepted else leaves_noise(here):
        here, accepted = _for_file(here, accepted, say)
    here, accepted = exchanged(here, accepted, own, say)
    # It is told beside what stands in the end.
    remains = _remains(here, accepted, refused)
    unnamed = simplest([one for one in here.challengers if not one.named]).score if remains else None
    rivals = tuple(rivals_of(here, one) for one in accepted)
    disproved = dict.fromkeys(name for name in refused if name in pointed) | dict.fromkeys(
        name
        for name in too_large(first, judged, attempts)
        if name not in {one.hypothesis.name for one in accepted}
    )
    return Outcome(first, here, tuple(accepted), rivals, unnamed, tuple(disproved), judged, attempts)


def too_large(here: Standing, judged: Mapping[str, float], attempts: Mapping[str, Attempt]) -> list[str]:
    """Names that would be beyond chance, at a size that they cannot have."""
    known = {score.name: score.entry.hypothesis for score in here.scores}
    beyond = [name for name in attempts if judged[name] >= 1.0 and name in known]
    return [name for name in beyond if not attempts[name][1].allows(known[name])]


def _for_file(here: Standing, accepted: list[Accepted], say: Progress) -> tuple[Standing, list[Accepted]]:
    """With what parameters may make up for that are far from the motor file, where nothing else shows."""
    while len(accepted) < EFFECTS:
        step = enter_for_file(here, say)
        if step.standing is None or step.accepted is None:
            break
        here, accepted = step.standing, [*accepted, step.accepted]
    return here, accepted


def _remains(here: Standing, accepted: Sequence[Accepted], refused: Sequence[str]) -> bool:
    """Whether a term without a name is beyond chance."""
    return any(not one.named for one in beyond_chance(here, accepted, refused))


def _imitate(nameless: Standing, here: Standing) -> bool:
    """Whether names that entered since explain less than blocks of time agree on of what remains: they may be part of it."""
    rest = (min(one.won, one.gain / one.score.scatter) for one in here.challengers if not one.named)
    return nameless.unlikely - unlikely_from(nameless, here.fitted) < max(rest, default=0.0)


def _needed(
    here: Standing, accepted: list[Accepted], own: Sequence[type[Effect]], say: Progress
) -> tuple[Standing, list[Accepted]]:
    """Without what is no longer needed beside what entered later."""
    for one in accepted[:-1]:
        others = [other for other in accepted if other is not one]
        # At its null it does nothing, whatever a size on the side where it cannot be would explain.
        nothing = here.fitted.multiple(one.hypothesis) == 0.0
        score = None if nothing else held_score(here.book, here.plain, here.fitted, one.hypothesis)
        if not nothing and (score is None or here.null is None or score.weight >= needed_weight(here)):
            continue
        fitted = without_hypothesis(here.fitted, one.hypothesis.name)
        if fitted is None:
            continue
        without = settled(fitted)
        left = residual_of(here, without)
        rise = left.unlikely - here.residual.unlikely
        agreed = agreement(here.residual.likelier_by_block(left), without, one.hypothesis, rise)
        if score is None or score.or_at_least(agreed).weight < needed_weight(here):
            say(f"without {one.hypothesis.name.replace('_', ' ')}")
            # Beside one less, another may be needed, or may not.
            return _needed(stand(without, own), others, own, say)
    return here, accepted
