"""Adding effects to a motor file, and the ladder of held-out error that shows what each effect so far was worth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.estimate import Estimate, estimate
from motorlens_physics.estimate.free_run import free_runs
from motorlens_physics.estimate.model import parts_of
from motorlens_physics.estimate.prepare import prepare_all, prepare_to_fit
from motorlens_physics.estimate.prior import FITTED, base_prior, held_to, nuisance_prior
from motorlens_physics.estimate.report import findings
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import Knowledge, MotorFile, Stated
from motorlens_physics.recording import Recording
from motorlens_runtime.errors import DataError
from motorlens_workbench.contest.entering import from_the_beginning
from motorlens_workbench.contest.needed import needed_weight
from motorlens_workbench.contest.worth import own_score, worth
from motorlens_workbench.diagnose import fitted_of
from motorlens_workbench.evidence.held_out import held_out, held_out_errors
from motorlens_workbench.evidence.ledger import Ledger, Lens, ledger
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Fitted
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.refit import settled, with_hypothesis, without_hypothesis
from motorlens_workbench.standing import Standing, stand, under
from motorlens_workbench.telling import Progress
from motorlens_workbench.verdict import seen_named

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rung:
    """One model of the ladder.

    Attributes:
        added: what distinguishes it from the rung below; "" for the lowest.
        file: fitted.
        held_out: RMSE of each channel on blocks of time held out.
        judged: RMSE of each channel on recordings that were not fitted, run freely, see `judged`; empty without any.
        said: what the fit says of its parameters, sentences, see `Findings`.
    """

    added: str
    file: MotorFile
    held_out: Mapping[str, float]
    judged: Mapping[str, float]
    said: tuple[str, ...]


@dataclass(frozen=True)
class Ladder:
    """What adding or removing did.

    Attributes:
        rungs: the lowest first.
        new: how many of them are of this step.
        noise_floor: RMSE of each channel that the noise alone would leave.
        statistic: the least weight of what was added, beside all else.
        supported: whether the data support the step.
        why: if not.
    """

    rungs: tuple[Rung, ...]
    new: int
    noise_floor: Mapping[str, float]
    statistic: float
    supported: bool
    why: str


def add(
    file: MotorFile,
    names: Sequence[str],
    recordings: Sequence[Recording],
    judge: Sequence[Recording] = (),
    own: Sequence[type[Effect]] = (),
    say: Progress = lambda text: None,
    differing: Sequence[str] = (),
) -> Ladder:
    """Fit the motor file with effects or sensor faults added, one after the other; refit everything.

    Each is judged beside all others: of two that are missing, one alone may explain too little that agrees.

    Args:
        file: the motor as known.
        names: what to add.
        recordings: to fit to.
        judge: to judge by.
        own: effects from outside the catalogue.
        say: told what is being done.
        differing: parameters that each motor of `judge` has of its own, see `judged`.

    Raises:
        DataError: an effect is in the file already, is named twice, or there is none of that name for these recordings.
    """
    for k, name in enumerate(names):
        if name in names[:k]:
            raise DataError(f"{name} is named twice")
        if any(part.name() == name for part in parts_of(file)):
            raise DataError(f"{name} is in the motor file already; --remove takes it out")
    runs = prepare_to_fit(recordings, file)
    rungs = []
    lower = _stripped(file)
    before = [part.name() for part in parts_of(file) if not _imposed(file, part.name())]
    for k in range(len(before)):
        say(f"fitting {'the textbook alone' if k == 0 else 'with ' + before[k - 1]}")
        rungs.append(
            _rung(before[k - 1] if k else "", _with(lower, file, before[:k]), runs, judge, differing)[0]
        )
    say("fitting the motor file as it is")
    rung, base = _rung(before[-1] if before else "", file, runs, judge, differing)
    rungs.append(rung)
    say(f"weighing {' and '.join(names)}")
    here = first = stand(fitted_of(base), own)
    for name in names:
        _seen(first, name)
    added: list[Score] = []
    for k, name in enumerate(names):
        score = _seen(here, name)
        say(f"fitting with {name}")
        fitted, beside = under(here, [run.noise for run in here.fitted.runs if run.noise])
        found = with_hypothesis(fitted, beside, score)
        if found is None:
            why = f"no model with {name} could be simulated"
            return Ladder(tuple(rungs), k, here.floor, score.weight, False, why)
        end = settled(found)
        here = stand(from_the_beginning(here, end, score) or end, own)
        added.append(score)
        # As the file that is written would be estimated: so will the next addition find it.
        reached = fitted_of(estimate(here.fitted.model.file, runs, here.fitted.prior))
        rungs.append(_described(name, reached, *_book(reached), judge, recordings, differing))
    say(f"judging {' and '.join(names)}")
    told = [_beside_the_others(here, score, first if len(added) == 1 else None) for score in added]
    least, (weight, needed) = min(zip(names, told, strict=True), key=lambda known: known[1][0] - known[1][1])
    bottom, top = rungs[-1 - len(names)].held_out, rungs[-1].held_out
    # Channels are traded by the logarithm of their error: what one loses, another must more than win.
    better = sum(float(np.log(top[c] / bottom[c])) for c in top) < 0
    why = ""
    if weight < needed:
        what = least.replace("_", " ") if len(names) > 1 else "it"
        why = f"what {what} explains is within chance (weight {weight:.3g}, needed {needed:.3g})"
    elif not better:
        why = "the error on blocks held out does not fall"
    return Ladder(tuple(rungs), len(names), here.floor, weight, not why, why)


def _seen(here: Standing, name: str) -> Score:
    """What a look at a model says of a name.

    Raises:
        DataError: nothing.
    """
    seen = seen_named(here)
    if name not in seen:
        raise DataError(
            f"{name}: no such effect or sensor fault for these recordings, or a copy of what base parameters do; "
            f"known: {', '.join(sorted(seen))}"
        )
    return seen[name]


def _beside_the_others(then: Standing, score: Score, lacking: Standing | None) -> tuple[float, float]:
    """How heavy a name is in a model that has it, and how heavy it must be.

    As a diagnosis judges it, or by Wald's test beside the colour of the noise, if that says more: a diagnosis chooses among
    hundreds, and takes the weaker of two ways to see the noise; here one was chosen.

    Args:
        then: where the model stands that has all that was added.
        score: of the name.
        lacking: where the model without it stands; None is the same model with the name taken out.
    """
    if lacking is None:
        without = without_hypothesis(then.fitted, score.name)
        if without is None:
            return 0.0, float("inf")
        lacking = stand(settled(without), then.own)
    told, seen = worth(lacking, score, then.fitted), own_score(then.book, then.fitted, score.entry.hypothesis)
    judged = told.score.weight if told.score else 0.0, told.needed
    wald = seen.weight if seen else 0.0, needed_weight(lacking)
    return max(judged, wald, key=lambda known: known[0] - known[1])


def remove(
    file: MotorFile,
    names: Sequence[str],
    recordings: Sequence[Recording],
    judge: Sequence[Recording] = (),
    say: Progress = lambda text: None,
    differing: Sequence[str] = (),
) -> Ladder:
    """Fit the motor file without some effects or sensor models.

    Raises:
        DataError: the file has one of them not.
    """
    for name in names:
        if not any(part.name() == name for part in parts_of(file)):
            raise DataError(f"{name} is not in the motor file")
    runs = prepare_to_fit(recordings, file)
    say("fitting the motor file as it is")
    with_it, better = _rung(" and ".join(names), file, runs, judge, differing)
    effects = tuple(effect for effect in file.motor.effects if effect.name() not in names)
    without = replace(
        file,
        motor=replace(file.motor, effects=effects),
        sensors=tuple(sensor for sensor in file.sensors if sensor.name() not in names),
    )
    say(f"fitting without {' and '.join(names)}")
    rung, _ = _rung(f"without {' and '.join(names)}", without, runs, judge, differing)
    # The floor is that of the better model: what the other lacks is no noise.
    return Ladder((with_it, rung), 1, stand(fitted_of(better)).floor, 0.0, True, "")


def _imposed(file: MotorFile, name: str) -> bool:
    """Whether a part belongs to how the motor is driven, see `driven`, not to what is being learnt."""
    return any(key.startswith(f"{name}.") and known.sd == 0 for key, known in file.knowledge.items())


def _stripped(file: MotorFile) -> MotorFile:
    return _with(file, file, ())


def _with(lower: MotorFile, file: MotorFile, names: Sequence[str]) -> MotorFile:
    names = [part.name() for part in parts_of(file) if part.name() in names or _imposed(file, part.name())]
    effects = tuple(effect for effect in file.motor.effects if effect.name() in names)
    sensors = tuple(sensor for sensor in file.sensors if sensor.name() in names)
    return replace(lower, motor=replace(lower.motor, effects=effects), sensors=sensors)


def _rung(
    added: str, file: MotorFile, runs: Sequence[Run], judge: Sequence[Recording], differing: Sequence[str]
) -> tuple[Rung, Estimate]:
    base = estimate(file, runs)
    fitted = fitted_of(base)
    book, lines = _book(fitted)
    return _described(added, fitted, book, lines, judge, (), differing), base


def _book(fitted: Fitted) -> tuple[Ledger, list[Line]]:
    """The sums of the fitted parameters alone."""
    lines = [Line.of(fitted.model, run, r, fitted.prior.keys) for r, run in enumerate(fitted.runs)]
    noises = []
    for run in fitted.runs:
        assert run.noise is not None
        noises.append(run.noise)
    return ledger(lines, Lens(noises), fitted.prior, ()), lines


def _described(
    added: str,
    fitted: Fitted,
    book: Ledger,
    lines: Sequence[Line],
    judge: Sequence[Recording],
    fitted_to: Sequence[Recording],
    differing: Sequence[str],
) -> Rung:
    source = FITTED + ", ".join(recording.name for recording in fitted_to)
    names = frozenset(run.name for run in fitted.runs)
    spread = dict(
        zip(fitted.prior.keys, np.sqrt(np.maximum(np.diagonal(fitted.covariance), 0)).tolist(), strict=True)
    )
    file, known = fitted.model.file, {}
    for key in file.values():
        if key in spread:
            # Of the file that was fitted; its values have moved.
            kept = Stated(fitted.prior.centre[key], fitted.prior.sd[key], held_to(file, key, names).source)
            known[key] = Knowledge(spread[key], source, prior=kept)
    file = file.with_values({}, known)
    said = findings(fitted.fit).in_short
    return Rung(added, file, held_out(book, lines), judged(file, judge, differing), said)


def judged(
    file: MotorFile, recordings: Sequence[Recording], differing: Sequence[str] = ()
) -> dict[str, float]:
    """RMSE of each channel of free runs over whole recordings, as `compare` states it.

    Nothing of the motor is fitted, unless motors of one make differ in some parameters: those are then fitted to each
    recording, and the error is that of its blocks of time which they were not fitted to. What was added keeps the size
    it was learnt with.

    Args:
        file: the motor.
        recordings: to judge by.
        differing: parameters of the motor file, by key.

    Raises:
        DataError: the motor file has no such parameter.
    """
    squares: dict[str, list[Array]] = {}
    for recording in recordings:
        if differing:
            runs = prepare_to_fit([recording], file)
            prior = base_prior(file, runs)
            unknown = [key for key in differing if key not in prior.sd]
            if unknown:
                known = ", ".join(key for key in prior.keys if "@" not in key)
                raise DataError(f"{', '.join(unknown)}: no such parameter of the motor file; known: {known}")
            found = estimate(file, runs, prior.only(differing).joined(nuisance_prior(file, runs)))
            error = held_out_errors(*_book(fitted_of(found)))[0][found.runs[0].valid]
            channels = found.runs[0].channels
        else:
            beside = free_runs(file, prepare_all([recording], file))[1][0]
            error, channels = beside.error[beside.run.valid], beside.run.channels
        for c, channel in enumerate(channels):
            squares.setdefault(channel, []).append(error[:, c] ** 2)
    return {channel: float(np.sqrt(np.mean(np.concatenate(parts)))) for channel, parts in squares.items()}
