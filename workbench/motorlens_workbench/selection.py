"""Which candidates the evidence speaks for: tests, rivals, refits with the true nonlinear effect, forward choice.

Forward steps of at most three. Each takes the candidate with the best robust statistic and its rivals, refits the whole
model with each of them, and keeps the best; then everything is screened again from the new model. Base parameters are
always fitted along.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.fit import Fit, fit
from motorlens_physics.estimate.model import Model, parts_of, with_effect, with_sensor
from motorlens_physics.estimate.prior import RELATIVE_SD, Prior, part_prior, start_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.sensor_model import SensorModel
from motorlens_runtime.errors import ModelError
from motorlens_workbench.candidates import Candidate, shaped
from motorlens_workbench.evidence import Evidence, Score, score, similarity

Array = NDArray[np.float64]

# The statistic that counts as real, about p = 1e-6 for one test: a hundred candidates and shapes are tried, and the noise
# model is an estimate.
REAL = 26.0
# The statistic from which a candidate is accepted: a little more, for the luckiest of a hundred recordings with nothing
# missing reaches what counts as real for one.
ACCEPTED = 29.0
# Share of the whitened sum of squares below which an effect is not worth having.
WORTH = 1e-3


# Shapes from which on their usual scatter counts.
MANY = 5
# Standard deviations from which on a bound is far from what was known: a rough guess of the friction is not, one of ke is.
FAR_OFF = 1.5
# Times the typical size from which on the largest that an effect may have is no natural limit, as the whole of a share is.
FAR_LARGER = 3.0
# What claims more than this (see `Candidate.claims`) can pass for much that it is not: it is tried only where a textbook
# that ended in a corner shows that nothing simpler will do.
MOST_CLAIMS = 5
# See `fit`: for small steps.
NEAREST = 0.1
# Times the typical size that an effect, and a sensor's fault, may plausibly have.
PLAUSIBLE = {"effect": 40.0, "sensor": 12.0}


@dataclass(frozen=True)
class Test:
    """A candidate's best shape against what is left.

    Attributes:
        candidate: what was tested.
        variant: which shape.
        score: the robust score test; None if the columns are copies of what the model has.
        size: of the switch, away from its null, in its unit; the amplitude for a sine and a cosine.
        allowed: whether that size is within the parameter's bounds.
        typical: typical size, same unit.
    """

    candidate: Candidate
    variant: int
    score: Score | None
    size: float
    allowed: bool
    typical: float

    @property
    def statistic(self) -> float:
        """The robust statistic; 0 where nothing can be said or the sign is impossible."""
        return self.score.statistic if self.score and self.allowed else 0.0

    @property
    def gain(self) -> float:
        """Fall of the whitened sum of squares."""
        return self.score.gain if self.score and self.allowed else 0.0

    @property
    def involved(self) -> bool:
        """Whether it claims so much that simpler ones go first."""
        return self.candidate.claims > MOST_CLAIMS

    def detectable(self, samples: float) -> float:
        """The smallest size that would be called real and worth having, in the switch's unit."""
        if self.score is None:
            return float("inf")
        needed = max(ACCEPTED * self.score.inflation, WORTH * samples)
        return abs(self.typical) * float(np.sqrt(needed / max(self.score.information[0, 0], 1e-300)))


def test_all(left: Evidence, listed: Sequence[Candidate], model: Model) -> dict[str, Test]:
    """Every candidate with the shape that fits best, by name."""
    found = {}
    for candidate in listed:
        best: Test | None = None
        typical = candidate.typical(model.file)
        scores = [score(left, labels) for labels in candidate.columns()]
        # The best of many shapes must not be the one whose scatter happens to be least.
        usual = usual_scatter(left, candidate, scores) if len(scores) >= MANY else 1.0
        for v, tested in enumerate(scores):
            if tested and tested.inflation < usual:
                tested = tested.inflated(usual)
            test = _sized(candidate, v, tested, typical)
            if best is None or (test.statistic, _information(test)) > (best.statistic, _information(best)):
                best = test
        assert best is not None
        found[candidate.name] = best
    return found


def usual_scatter(left: Evidence, candidate: Candidate, scores: Sequence[Score | None]) -> float:
    """Median inflation of a candidate's shapes.

    Other numbers of periods a revolution exclude each other: wrong ones scatter for the right one's sake, and count in what
    the best leaves. Neighbours on a grid of shapes scatter alike.
    """
    known = {v: tested for v, tested in enumerate(scores) if tested}
    if not known:
        return 1.0
    best = max(known, key=lambda v: known[v].statistic)
    shapes = candidate.columns()
    if len(shapes[best]) > 1:
        own = left.of_columns([label for labels in shapes for label in labels])
        beyond = own.explained_by(shapes[best], known[best].coefficient)
        known = {v: tested for v in known if (tested := score(beyond, shapes[v]))}
    return float(np.median([tested.inflation for tested in known.values()] or [1.0]))


def _information(test: Test) -> float:
    return float(test.score.information[0, 0]) if test.score else 0.0


def _sized(candidate: Candidate, v: int, tested: Score | None, typical: float) -> Test:
    if tested is None:
        return Test(candidate, v, None, 0.0, True, typical)
    switch = candidate.variants[v][0].switch()
    assert switch is not None and switch.null is not None
    if len(tested.coefficient) > 1:
        return Test(
            candidate, v, tested, abs(typical) * float(np.hypot(*tested.coefficient[:2])), True, typical
        )
    size = float(tested.coefficient[0]) * typical
    low, high = switch.bounds
    # A hair beyond a bound is noise, not a wrong sign.
    slack = 2 * abs(typical) * float(np.sqrt(tested.covariance[0, 0]))
    within = low - slack <= switch.null + size <= high + slack
    # A size far beyond what such an effect can have is the mark of a column that hardly differs from a base parameter's.
    plausible = abs(size) < min(PLAUSIBLE[candidate.kind] * abs(typical), candidate.most) + slack
    return Test(candidate, v, tested, size, within and plausible, typical)


def rivals(left: Evidence, tests: dict[str, Test], best: Test, most: int = 5) -> list[Test]:
    """The best candidate and those that explain nearly as much of the same thing, the strongest first."""
    near = []
    for test in tests.values():
        if test.statistic <= 0 or test is best:
            continue
        if test.statistic > 0.7 * best.statistic or (
            test.statistic > 0.5 * best.statistic and likeness(left, best, test) > 0.5
        ):
            near.append(test)
        elif (test.gain > 0.3 * best.gain and likeness(left, best, test) > 0.7) or (
            test.gain > best.gain and test.statistic > 0.3 * best.statistic
        ):
            # Nearly a copy, or more of what is missing, less evenly: which scatters less before the fit says little.
            near.append(test)
    near.sort(key=lambda test: -test.statistic)
    return [best, *near[: most - 1]]


def pair(left: Evidence, tests: dict[str, Test], best: Test) -> tuple[Test, Test] | None:
    """The two candidates that together explain far more than the best alone, the stronger first; None if none do.

    One wrong candidate can imitate two right ones by halves, and a search that takes one at a time would start with it.
    """
    assert best.score is not None
    able = [t for t in tests.values() if t.score and len(t.score.names) == 1 and t.score.inflation < 1e4]
    labels = [t.candidate.columns()[t.variant][0] for t in able]
    at = left.index(labels)
    total = left.total
    inner, right = total[np.ix_(at, at)], total[at, -1]
    power = np.diagonal(inner)
    determinant = np.outer(power, power) - inner**2
    apart = determinant > 0.03 * np.outer(power, power)
    safe = np.where(apart, determinant, 1.0)
    # Coefficient of the row's candidate beside the column's, and their joint gain.
    size = (right[:, None] * power[None, :] - right[None, :] * inner) / safe
    gain = np.where(apart, size * right[:, None] + size.T * right[None, :], 0.0)
    believed = np.array([[possible(t, float(c)) for c in row] for t, row in zip(able, size, strict=True)])
    gain = np.where(believed & believed.T, gain, 0.0)
    a, b = np.unravel_index(int(np.argmax(gain)), gain.shape)
    needed = max(2 * REAL * best.score.inflation, 0.1 * best.score.gain)
    if gain[a, b] - best.score.gain < needed:
        return None
    one, other = able[int(a)], able[int(b)]
    return (one, other) if one.statistic >= other.statistic else (other, one)


def possible(test: Test, coefficient: float) -> bool:
    """Whether a candidate may have a size, given in typical ones."""
    switch = test.candidate.variants[test.variant][0].switch()
    assert switch is not None and switch.null is not None
    size = coefficient * test.typical
    return (
        switch.bounds[0] <= switch.null + size <= switch.bounds[1]
        and abs(coefficient) < PLAUSIBLE[test.candidate.kind] / 2
        and abs(size) < test.candidate.most
    )


def likeness(left: Evidence, one: Test, other: Test) -> float:
    """Squared correlation of two candidates' columns (the largest, where they have several)."""
    labels = [*one.candidate.columns()[one.variant], *other.candidate.columns()[other.variant]]
    split = len(one.candidate.columns()[one.variant])
    return float(np.max(similarity(left, labels)[:split, split:]))


def with_candidate(found: Fit, evidence: Evidence, test: Test) -> tuple[Model, Prior]:
    """The model with a candidate added at the size that the linearised problem gives, base parameters moved along."""
    candidate = test.candidate
    labels = candidate.columns()[test.variant]
    keys = found.prior.keys
    solution, _ = evidence.solve([*keys, *labels])
    parts = candidate.variants[test.variant]
    switch = parts[0].switch()
    assert switch is not None and switch.null is not None
    sizes = solution[len(keys) :] * test.typical
    if len(labels) == 2:
        # sin(N phi + p) = sin(N phi) cos p + cos(N phi) sin p
        amplitude, phase = float(np.hypot(*sizes)), float(np.arctan2(sizes[1], sizes[0]))
        effect = parts[0]
        assert isinstance(effect, Effect)
        part = shaped(effect, **{switch.name: switch.null + amplitude, effect.with_role("phase"): phase})
    else:
        low, high = switch.bounds
        # Not quite at null, where the shape would be undetermined.
        size = sizes[0] if abs(sizes[0]) > 1e-3 * abs(test.typical) else 1e-3 * test.typical
        part = shaped(parts[0], **{switch.name: float(np.clip(switch.null + size, low, high))})
    values = found.model.values()
    moved = {
        key: float(
            np.clip(values[key] + move * found.prior.sd[key], *_inner(found.prior.bounds[key], values[key]))
        )
        for key, move in zip(keys, solution[: len(keys)], strict=True)
    }
    add = with_sensor if isinstance(part, SensorModel) else with_effect
    model = add(found.model, part)
    prior = found.prior.joined(part_prior(model.file, candidate.name)).joined(
        start_prior(model, candidate.name)
    )
    return model.with_values(moved), prior


def _inner(bounds: tuple[float, float], value: float) -> tuple[float, float]:
    # A linear step never takes more than nine tenths of the way to zero.
    low = max(bounds[0], 0.1 * value) if value > 0 and bounds[0] >= 0 else bounds[0]
    return low, bounds[1]


def refit(found: Fit, evidence: Evidence, test: Test, runs: Sequence[Run], rounds: int = 12) -> Fit | None:
    """The whole model fitted again with the candidate in it; None if no start can be simulated.

    It starts where the linearised problem ends, then from the fit as it is. A fit that ended in a corner made up for what is
    missing with values that are far off: from there, what was known beforehand is tried first, the candidate at its typical
    size, and the best of all starts counts. So it does where a fit lost its way.
    """
    linear, prior = with_candidate(found, evidence, test)
    part = next(part for part in parts_of(linear.file) if part.name() == test.candidate.name)
    add = with_sensor if isinstance(part, SensorModel) else with_effect
    starts = [linear, add(found.model, part)]  # type: ignore[arg-type]
    lost = cornered(found)
    if lost:
        known = found.model.with_values(found.prior.centre)
        starts.insert(0, add(known, test.candidate.variants[test.variant][0]))  # type: ignore[arg-type]
    best: Fit | None = None
    for start in starts:
        best = _better(best, start, runs, prior, found, rounds)
        if not lost and best is not None and total(found) - total(best) > 0.8 * test.gain:
            break
    if lost or (best is not None and total(found) - total(best) > 0.5 * test.gain and not _flat(best, test)):
        return best
    # Large steps come far, but may lose their way; so may the shape that the screen prefers.
    best = _better(best, linear, runs, prior, found, rounds, NEAREST)
    typical = replace(test, variant=len(test.candidate.variants) // 2)
    return _better(best, with_candidate(found, evidence, typical)[0], runs, prior, found, rounds, NEAREST)


def _flat(found: Fit, test: Test) -> bool:
    """Whether a scale of the candidate ended at its bound, where the fit has no slope to come back by."""
    values, bounds = found.model.values(), found.prior.bounds
    own = [key for key in found.prior.keys if key.startswith(f"{test.candidate.name}.")]
    return any(bounds[key][0] > 0 and values[key] in bounds[key] for key in own)


def _better(
    best: Fit | None,
    start: Model,
    runs: Sequence[Run],
    prior: Prior,
    found: Fit,
    rounds: int,
    nearest: float = 0.0,
) -> Fit | None:
    """The best fit so far, or the one from another start; None if neither can be simulated."""
    try:
        tried = fit(start, runs, prior, found.whiteners, rounds=rounds, nearest=nearest)
    except ModelError:
        return best
    return tried if best is None or total(tried) < total(best) else best


def cornered(found: Fit) -> bool:
    """Whether a parameter was driven to a bound far from what was known, or an effect or a fault to the largest it may be.

    The model follows only with values that no motor has, and what is read from them means little.
    """
    values, prior = found.model.values(), found.prior
    if any(
        values[key] in bounds and abs(values[key] - prior.centre[key]) > FAR_OFF * prior.sd[key]
        for key, bounds in prior.bounds.items()
        if key in RELATIVE_SD
    ):
        return True
    file = found.model.file
    for part in parts_of(file):
        switch = part.switch()
        if switch is None or switch.null is None:
            continue
        key = f"{part.name()}.{switch.name}"
        if key not in prior.keys:
            continue
        size = values[key]
        usual = abs(switch.typical(file.rated) - switch.null)
        if size in switch.bounds and abs(size - switch.null) > FAR_LARGER * usual:
            return True
    return False


def total(found: Fit) -> float:
    """Whitened sum of squares and priors."""
    return found.error + found.penalty


Progress = Callable[[str], None]
__all__ = ["Effect", "Progress", "Test", "likeness", "refit", "rivals", "test_all", "total", "with_candidate"]
