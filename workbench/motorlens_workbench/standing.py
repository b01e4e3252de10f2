"""Where a contest stands: a fitted model, the runs about it, and what the recordings say of every hypothesis from there."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.innovations import read
from motorlens_physics.estimate.model import error_of, predict
from motorlens_physics.estimate.noise import UNEXPLAINED, Noise
from motorlens_physics.estimate.noise_likelihood import likelier
from motorlens_physics.estimate.points import moved_on
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.threads import on_all_cores
from motorlens_runtime.errors import ModelError
from motorlens_workbench.evidence.held_out import pooled_floor, times_noise
from motorlens_workbench.evidence.ledger import Beside, Ledger, Lens, layout, ledger, ledgers
from motorlens_workbench.evidence.look import Look, looks
from motorlens_workbench.evidence.null import Null, null_of
from motorlens_workbench.evidence.score import Score
from motorlens_workbench.fitted import Challenger, Fitted
from motorlens_workbench.hypotheses.courses import parameters_of
from motorlens_workbench.hypotheses.everything import everything
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.refit import refit

Array = NDArray[np.float64]

# Hypotheses of a look, with a name and without, of which the doubt is told, and that are weighed with a noise of their own.
DOUBTED, STRONGEST = 15, 5
# Updates of the noise that a model leaves, at most: models are compared by the likelihood of the likeliest noise of each.
THOROUGHLY = 60
# Share of the largest torque that could be left unmeasured below which there is none.
NEGLIGIBLE = 1e-8
# Signs are flipped with this seed: the same recordings get the same answer.
SEED = 1993


@dataclass(frozen=True)
class Residual:
    """What a model leaves, as noise of its own.

    Attributes:
        unlikely_samples: (N,) of each run, twice the negative logarithmic likelihood of each sample.
        blocks: of time, as of a ledger.
        noises: of each run, the likeliest.
    """

    unlikely_samples: tuple[Array, ...]
    blocks: tuple[tuple[int, slice], ...]
    noises: tuple[Noise, ...]

    @classmethod
    def of(
        cls, lines: Sequence[Line], rests: Iterable[Array], no_more_than: Sequence[Noise] | None = None
    ) -> "Residual":
        """Of what is left (N, C) of each run.

        Args:
            lines: the runs.
            rests: what is left of them.
            no_more_than: how much of what is unexplained there may be, for each run; None: as much as there is.
        """
        begins = [noise_of(line) for line in lines]
        if no_more_than is not None:
            begins = [_pinned(noise, most) for noise, most in zip(begins, no_more_than, strict=True)]
        each = [(line, begin, rest) for line, begin, rest in zip(lines, begins, rests, strict=True)]
        noises = tuple(likeliest_noise(begin, line, rest) for line, begin, rest in each)
        samples = (
            unlikely_samples(line, noise, rest) for (line, _, rest), noise in zip(each, noises, strict=True)
        )
        return cls(tuple(samples), layout(lines), noises)

    @property
    def unlikely(self) -> float:
        """Of all samples together."""
        return sum(float(np.sum(samples)) for samples in self.unlikely_samples)

    def likelier_by_block(self, other: "Residual") -> Array:
        """(B,) by how much it is likelier than what another model leaves, in each block of time."""
        one, two = self.unlikely_samples, other.unlikely_samples
        return np.array([float(np.sum(two[r][rows] - one[r][rows])) for r, rows in self.blocks])


@dataclass(frozen=True)
class Standing:
    """A fitted model and all that may be missing from it, looked at when it is first asked for.

    What is missing from the model must not hide in its noise. A torque that nobody measured, and colour of the sensors'
    noise, are rivals of every hypothesis: all are looked at with them and without, and the heaviest of both looks are
    weighed again under the noise that each of them would leave.

    Attributes:
        fitted: the model.
        own: effects from outside the catalogue.
        lines: the runs about the model.
        uncorrected: the runs about the model, along their inputs as measured.
    """

    fitted: Fitted
    own: tuple[type[Effect], ...]
    lines: tuple[Line, ...]
    uncorrected: tuple[Line, ...]

    @cached_property
    def noises(self) -> tuple[Noise, ...]:
        """Of each run, as the fit found it."""
        return tuple(noise_of(line) for line in self.lines)

    @cached_property
    def lenses(self) -> tuple[Lens, Lens]:
        """The noise of the model, and none of an unmeasured torque, of coloured noise and of colour."""
        quiet = tuple(of_instruments(line) for line in self.lines)
        return Lens(self.noises), Lens(quiet, plain=True)

    @cached_property
    def looks(self) -> tuple[Look, Look]:
        """Through each lens, at all that may be missing."""
        listed, constants = everything(self.lines, self.own), _constants(self.lines)
        here, bare = looks(self.lines, self.lenses, self.fitted.prior, listed, constants)
        return here, bare

    @property
    def look(self) -> Look:
        """Under the noise of the model."""
        return self.looks[0]

    @property
    def book(self) -> Ledger:
        """The sums."""
        return self.look.book

    @property
    def scores(self) -> tuple[Score, ...]:
        """Every shape of every hypothesis."""
        return self.look.scores

    @cached_property
    def plain(self) -> Ledger:
        """Sums of the fitted parameters alone with the sensors' noise taken as white, as the fit took it."""
        return ledger(self.lines, Lens(self.noises, plain=True), self.fitted.prior, ())

    @cached_property
    def null(self) -> Null | None:
        """Of the largest weight; None where nothing can be tested."""
        return null_of([score for score in self.scores if score.possible], np.random.default_rng(SEED))

    @cached_property
    def residual(self) -> Residual:
        """What the model leaves."""
        return Residual.of(self.lines, [line.error for line in self.lines])

    @cached_property
    def unlikely(self) -> float:
        """Twice the negative logarithmic likelihood of what the model leaves, as noise of its own."""
        # The parameters alone may do better than where the fit has ended.
        alone = looks(self.lines, self.lenses, self.fitted.prior, (), {})
        able = (self.residual, *(Residual.of(self.lines, look.rests(None)) for look in alone))
        return min(residual.unlikely for residual in able)

    @cached_property
    def floor(self) -> dict[str, float]:
        """Standard deviation of the error that a perfect model would leave, of each channel."""
        return pooled_floor(self.uncorrected)

    @cached_property
    def times_noise(self) -> float:
        """The worst channel's error on blocks held out, over its noise."""
        return times_noise(self.book, self.lines, self.floor)

    @cached_property
    def challengers(self) -> tuple[Challenger, ...]:
        """The heaviest hypotheses, the heaviest first."""
        if self.null is None:
            return ()
        heaviest = _strongest(self.looks, self.uncorrected, self.fitted.prior, self.null.mode)
        weighed = on_all_cores(
            lambda one: _challenger(*one, self.noises, self.fitted.prior, self.unlikely), heaviest
        )
        return tuple(sorted([one for one in weighed if one is not None], key=lambda one: -one.weight))

    @property
    def rest(self) -> Score | None:
        """The term without a name that explains most beside its scatter; None without any."""
        free = [score for score in self.scores if score.possible and not score.entry.hypothesis.named]
        return max(free, key=lambda score: score.weight, default=None)


def stand(fitted: Fitted, own: Sequence[type[Effect]] = ()) -> Standing:
    """Where a fitted model stands.

    Raises:
        ModelError: the model cannot be simulated.
    """
    plain = (replace(run, corrections=None) for run in fitted.runs)
    return Standing(fitted, tuple(own), _lines(fitted, fitted.runs), _lines(fitted, plain))


def _lines(fitted: Fitted, runs: Iterable[Run]) -> tuple[Line, ...]:
    return tuple(Line.of(fitted.model, run, r, fitted.prior.keys) for r, run in enumerate(runs))


def under(here: Standing, noises: Sequence[Noise]) -> tuple[Fitted, Beside]:
    """The model fitted again under other noise, and the sums of its parameters about where it was.

    Raises:
        ModelError: it leads where nothing can be simulated.
    """
    # The same run where it is the same noise: then nothing is fitted twice.
    runs = tuple(
        run if noise is run.noise else replace(run, noise=noise)
        for run, noise in zip(here.fitted.runs, noises, strict=True)
    )
    fitted = refit(here.fitted.model, here.fitted.prior, runs)
    if fitted is None:
        raise ModelError("the model cannot be fitted under this noise")
    return fitted, ledger(here.lines, Lens(noises), here.fitted.prior, ()).beside()


def summed(fitted: Fitted, hypotheses: Sequence[Hypothesis] = ()) -> tuple[Ledger, Ledger]:
    """The sums of a model's fitted parameters, beside the colour of the noise and with the sensors' noise as white.

    Args:
        fitted: the model.
        hypotheses: summed besides.

    Raises:
        ModelError: the model cannot be simulated.
    """
    lines = _lines(fitted, fitted.runs)
    noises = [noise_of(line) for line in lines]
    coloured, white = ledgers(lines, (Lens(noises), Lens(noises, plain=True)), fitted.prior, hypotheses)
    return coloured, white


def residual_of(here: Standing, fitted: Fitted, no_more_than: Sequence[Noise] | None = None) -> Residual:
    """What another model leaves, with no more of what is unexplained than some noise has, see `Residual.of`.

    The noise of the inputs goes through the motor that stands, not through the other: or a motor that responds less would
    have less of it, and be preferred.

    Raises:
        ModelError: the model cannot be simulated.
    """
    return Residual.of(here.lines, _left_by(here, fitted), no_more_than)


def unlikely_from(here: Standing, fitted: Fitted) -> float:
    """How unlikely what another model leaves is, as `Standing.unlikely`, see `residual_of`.

    Raises:
        ModelError: the model cannot be simulated.
    """
    return residual_of(here, fitted).unlikely


def likeliest_noise(noise: Noise, line: Line, rest: Array) -> Noise:
    """The noise under which what is left (N, C) is likeliest, from another."""
    return likelier(noise, line.run, line.linear, rest, line.run.there, THOROUGHLY)[0]


def unlikely_samples(line: Line, noise: Noise, rest: Array) -> Array:
    """(N,) how unlikely each sample of what is left (N, C) is under a noise: twice the negative logarithm."""
    seen = read(noise.space(line.run, line.linear, line.run.there), rest)
    return np.asarray(np.sum(np.where(line.run.rests[:, None], seen.deviance, seen.unlikely), axis=1))


def _left_by(here: Standing, fitted: Fitted) -> list[Array]:
    """(N, C) of each run: what a model leaves, the noise of the inputs as it goes through the motor that stands."""
    rests = []
    for line, other in zip(here.lines, fitted.runs, strict=True):
        # Its channels may have been moved otherwise: compared is what was measured when the run's were.
        run = replace(other, corrections=line.run.corrections).holding(fitted.model.held[line.r])
        moved = tuple(run.late.get(c, 0) - line.run.late.get(c, 0) for c in run.channels)
        _, shown = predict(fitted.model, run, line.r)
        left = moved_on(run.measured - shown, moved)
        rests.append(error_of(line.model, line.run, line.r, left, line.linear))
    return rests


def of_instruments(line: Line) -> Noise:
    """The noise of a run if no torque was left unmeasured, and no noise lasts."""
    return likeliest_without(line, UNEXPLAINED)


def likeliest_without(line: Line, which: slice) -> Noise:
    """The likeliest noise of a run that has none of these disturbances."""
    noise = noise_of(line)
    most = noise.most.copy()
    most[which] *= NEGLIGIBLE
    pinned = replace(noise, most=most, disturbances=np.minimum(noise.disturbances, most))
    return likeliest_noise(pinned, line, line.error)


def _strongest(
    looks: Sequence[Look], uncorrected: Sequence[Line], prior: Prior, least: float
) -> list[tuple[Look, Score]]:
    """The heaviest hypotheses of each look, once each, of those that are not what chance does every time."""
    strongest: dict[str, tuple[Look, Score]] = {}
    for seen in looks:
        able = _heaviest([score for score in seen.best().values() if score.weight > least], DOUBTED)
        for score in _heaviest(seen.doubted(able, uncorrected, prior), STRONGEST):
            if score.name not in strongest or score.weight > strongest[score.name][1].weight:
                strongest[score.name] = (seen, score)
    return list(strongest.values())


def _heaviest(scores: Sequence[Score], count: int) -> list[Score]:
    """The heaviest scores with a name, and as many without one."""
    ranked = sorted(scores, key=lambda score: -score.weight)
    named = [score for score in ranked if score.entry.hypothesis.named]
    return named[:count] + [score for score in ranked if not score.entry.hypothesis.named][:count]


def _challenger(
    seen: Look, score: Score, noises: Sequence[Noise], prior: Prior, unlikely: float
) -> Challenger | None:
    """A hypothesis of a look under the noise that its best size leaves; None where that leaves nothing of it."""
    rests = seen.rests(score)
    found = [
        likeliest_noise(noise, line, rest)
        for line, noise, rest in zip(seen.lines, noises, rests, strict=True)
    ]
    likely = [no_more_than(noise, other) for noise, other in zip(noises, found, strict=True)]
    book, (entry,) = seen.entries([score], seen.lines, Lens(likely, rests), prior)
    again = book.beside().score(entry)
    if again is None or not again.possible:
        return None
    own = replace(again, entry=replace(entry, hypothesis=score.entry.hypothesis)).doubted(score.doubt)
    each = zip(seen.lines, found, rests, strict=True)
    won = unlikely - sum(float(np.sum(unlikely_samples(line, noise, rest))) for line, noise, rest in each)
    if not own.entry.hypothesis.named:
        # Under a noise of its own a term may seem to win what it has lost by parting with a likelier noise. What a name wins
        # is told when it is fitted in full: far from null the linearised problem leaves more than the name does.
        own = own.winning(won)
    return Challenger(own, tuple(likely), book.colour, won)


def no_more_than(noise: Noise, other: Noise) -> Noise:
    """A noise with no more unmeasured torque, and coloured noise, than another."""
    disturbances = noise.disturbances.copy()
    disturbances[UNEXPLAINED] = np.minimum(disturbances[UNEXPLAINED], other.disturbances[UNEXPLAINED])
    return replace(noise, disturbances=disturbances)


def _pinned(noise: Noise, other: Noise) -> Noise:
    """A noise that never gets more of what is unexplained than another has."""
    quiet, most = no_more_than(noise, other), noise.most.copy()
    most[UNEXPLAINED] = np.minimum(most[UNEXPLAINED], other.disturbances[UNEXPLAINED])
    return replace(quiet, most=most)


def noise_of(line: Line) -> Noise:
    """The noise that a fit found in a run.

    Raises:
        ModelError: no fit has looked for it.
    """
    if line.run.noise is None:
        raise ModelError(f"{line.run.name}: no noise was found in it")
    return line.run.noise


def _constants(lines: Sequence[Line]) -> dict[str, str]:
    """Parameters that cannot have changed at once unless something is missing, and the equation of each."""
    channels = sorted({channel for line in lines for channel in line.run.channels})
    loaded = any(line.run.load_known for line in lines)
    every = parameters_of(lines[0].model.file, channels)
    return {key: equation for key, (equation, _) in every.items() if loaded or equation != "mechanical"}
