"""How a recording is timed: how its inputs ran between its samples, and which of its channels are late.

`between_samples` and `delays` see from one point what another timing seems to win. Here each is fitted in full, and stays
only where that holds. So is the motor that its file states, where a fit has ended far from it: what is late may have led it
there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from motorlens_physics.estimate.between_samples import as_they_ran, gained_without_noise
from motorlens_physics.estimate.delays import LONGEST, likeliest_lag, nearer, realigned
from motorlens_physics.estimate.fit import NEAR, Fit, fit, inverse, white
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.pieces import as_found, cut, starting_as
from motorlens_physics.estimate.points import at, begun, from_noise, gained, minimised, needed
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.report import FAR
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Weighed
from motorlens_runtime.errors import ModelError

# How often channels that are late are looked for again.
REALIGNED = 4
# How near to the minimum a rough fit ends, in standard deviations of the result.
ROUGHLY = 1.0


def moved(point: Weighed, prior: Prior, progress: Callable[[str], None]) -> Weighed:
    """The point with channels moved whose skew has come to a sample, as long as that makes the recording likelier.

    However little likelier: a skew, and a sample with what is left of it, are the same delay, and nothing more is fitted.
    """
    for _ in range(REALIGNED):
        other = realigned(point, prior)
        if other is point:
            break
        other, _, _ = minimised(other, prior, progress, outliers=False)
        if gained(point, other, prior) <= 0:
            break
        point = other
    return point


@dataclass(frozen=True)
class Timing:
    """What is needed to look for another timing of runs.

    Attributes:
        begin: the model as it is before anything is known.
        wide: the same, of the pieces that delays are looked for in.
        longer: these pieces.
        prior: of the runs.
        progress: told what goes on.
        noises: of the runs, once they are known; None where each fit finds them anew.
    """

    begin: Model
    wide: Model
    longer: Sequence[Run]
    prior: Prior
    progress: Callable[[str], None]
    noises: Sequence[Noise] | None = None

    @property
    def straight(self) -> Prior:
        """Without skews, which would make up for inputs that ran otherwise between their samples."""
        return self.prior.only([key for key in self.prior.keys if not key.startswith("skew.")])

    def near(self, model: Model, runs: Sequence[Run]) -> Weighed:
        """The point near the best parameters of runs, from a model."""
        return self._from(self._rough(model, runs), runs)

    def likeliest(self, point: Weighed, *, free: bool) -> Weighed:
        """The point with the likeliest timing; how inputs ran stays as it is unless it is `free`."""
        # Each way is judged one step away: from where another has led, how inputs ran is asked again.
        on_time: Weighed | None = None
        for _ in range(REALIGNED):
            ran = self._as_they_ran(point) if free else point
            if ran is on_time:
                break
            other = self._later(ran)
            if other is point:
                break
            point, on_time = other, other if other is ran else None
        return moved(point, self.prior, self.progress)

    def under_its_noise(self, point: Weighed, model: Model, runs: Sequence[Run], *, free: bool) -> Weighed:
        """The point, or a likelier one whose timing is asked from the beginning under the noise that is known there.

        Noise that lasts passes for another timing as long as it is taken to be white.
        """
        known = replace(self, noises=[part.noise for part in point.parts])
        try:
            other = known.likeliest(known.near(model, runs), free=free)
            return other if gained_without_noise(point, other, self.prior) > 0 else point
        except ModelError:
            return point

    def held_at_file(self, point: Weighed) -> Weighed:
        """The point, or a likelier one that a fit reaches which began with what is far from the motor file held there.

        A motor that is wrong in much may fit as well, and from there no step leads back.
        """
        values = point.model.values()
        penalties = zip(self.prior.keys, self.prior.penalties(values), strict=True)
        far = {key for key, penalty in penalties if not {".", "@"} & set(key) and penalty >= FAR**2}
        if not far:
            return point
        rest = self.prior.only([key for key in self.prior.keys if key not in far])
        runs = [replace(run, corrections=None) for run in point.runs]
        start = replace(self.begin, held=point.model.held)
        try:
            rough = fit(start, runs, replace(self, prior=rest).straight, rounds=NEAR, enough=ROUGHLY)
            near, _, _ = minimised(begun(rough.model, runs, rest), rest, self.progress, outliers=False)
            other = moved(self._minimised(at(near.model, near, self.prior)), self.prior, self.progress)
            return other if gained(point, other, self.prior) > 0 else point
        except ModelError:
            # The motor of the file cannot be simulated as it was driven.
            return point

    def _as_they_ran(self, point: Weighed) -> Weighed:
        # That inputs hold looks as if all were late by a part of a sample, and is asked first.
        still, moved, mean = as_they_ran(point, self.prior)
        held = self._if_they_ran_so(point, still)
        if held is not point:
            return held
        later = point if moved == still else self._if_they_ran_so(point, moved)
        # That all came late, and that a speed is a mean, may look alike from here.
        counted = point if mean == moved else self._if_they_ran_so(point, mean)
        if later is point or counted is point:
            return counted if later is point else later
        return counted if gained_without_noise(later, counted, self.prior) > needed(1) else later

    def _if_they_ran_so(self, point: Weighed, runs: tuple[Run, ...]) -> Weighed:
        """Where runs lead whose inputs ran otherwise; the point if they are the same, or that is not likelier."""
        if all(one is run for one, run in zip(runs, point.runs, strict=True)):
            return point
        none = {key: 0.0 for key in self.prior.keys if key.startswith("skew.")}
        held = tuple(run.inputs.hold for run in runs)
        more = any(
            dict(a.late) != dict(b.late) or a.mean_speed > b.mean_speed
            for a, b in zip(runs, point.runs, strict=True)
        )
        try:
            # Parameters fitted to inputs that ran otherwise have made up for it, and may lead astray.
            on, afresh = (
                self._rough(replace(start, held=held), runs)
                for start in (point.model.with_values(none), self.begin)
            )
            other = self._from(on, runs)
            if not same(on, afresh):
                another = self._from(afresh, runs)
                other = another if gained_without_noise(other, another, self.prior) > needed(1) else other
            won = gained_without_noise(point, other, self.prior)
        except ModelError:
            # Inputs that lead where no motor can be simulated did not run so.
            return point
        return other if won > (needed(1) if more else 0.0) else point

    def _later(self, point: Weighed) -> Weighed:
        """With the channel moved that is late beyond chance, if any is."""
        few, seen = cut(self.longer, point.runs), point
        if any(few):
            longer = [as_found(run, piece) for run, piece in zip(self.longer, point.runs, strict=True)]
            noises = [part.noise for part in point.parts]
            seen = from_noise(starting_as(point.model, self.wide, few), longer, noises, self.prior)
        lag = likeliest_lag(seen, self.prior)
        if lag is not None:
            later = [
                run.delayed(lag.channel, lag.samples) if r == lag.r else run
                for r, run in enumerate(point.runs)
            ]
            return self._if_it_holds(point, later, lag.tried)
        farther = self._farther(point) if point.scatters else None
        return point if farther is None else self._if_it_holds(point, *farther)

    def _if_it_holds(self, point: Weighed, runs: Sequence[Run], tried: int) -> Weighed:
        """Where runs lead whose channels were moved, the best of so many tried; the point if that is not likelier."""
        along = tuple(replace(run, corrections=None) for run in runs)
        # What is late has bent the fit: it begins anew without it, and where that ends must hold the promise.
        start = replace(self.begin, held=point.model.held)
        along, rough = nearer(
            along, fit(start, along, self.straight, rounds=NEAR, enough=ROUGHLY), self.straight
        )
        other = self._minimised(self._begun(rough.model, along))
        return other if gained(point, other, self.prior) > needed(tried) else point

    def _farther(self, point: Weighed) -> tuple[Sequence[Run], int] | None:
        """All runs with a channel moved as far as makes least squares likeliest, and how many ways were tried; or None.

        Another motor may make up for most of a delay, and one step away from that nothing shows. So each delay is fitted,
        twice as long as the one before, as long as that is likelier.
        """
        start = replace(self.begin, held=point.model.held)
        still = [replace(run, corrections=None) for run in point.runs]
        first = fit(start, still, self.straight, rounds=NEAR, enough=ROUGHLY)
        begun_at = likeliest = white(first, still)
        best, tried = still, 0
        for channel in sorted({c for run in still for c in run.channels if c != "temperature"}):
            samples, model, last = 2, first.model, begun_at
            while samples <= LONGEST * min(len(run.measured) for run in still):
                moved = [run.delayed(channel, samples) if channel in run.channels else run for run in still]
                found = fit(model, moved, self.straight, rounds=NEAR, enough=ROUGHLY)
                here, tried = white(found, moved), tried + 1
                if here >= last:
                    break
                if here < likeliest:
                    best, likeliest = moved, here
                samples, model, last = 2 * samples, found.model, here
        return None if best is still else (best, tried)

    def _rough(self, model: Model, runs: Sequence[Run]) -> Fit:
        along = [replace(run, corrections=None) for run in runs]
        return fit(model, along, self.straight, rounds=NEAR, enough=ROUGHLY)

    def _from(self, rough: Fit, runs: Sequence[Run]) -> Weighed:
        return self._minimised(self._begun(rough.model, [replace(run, corrections=None) for run in runs]))

    def _begun(self, model: Model, runs: Sequence[Run]) -> Weighed:
        if self.noises is None:
            return begun(model, runs, self.prior)
        return from_noise(model, runs, self.noises, self.prior)

    def _minimised(self, point: Weighed) -> Weighed:
        # While parameters are wrong, a large error is theirs, and every sample counts.
        return minimised(point, self.prior, self.progress, outliers=False)[0]


def same(one: Fit, other: Fit) -> bool:
    """Whether two rough fits of the same runs have ended about the same minimum: each near one, and no farther apart."""
    keys = one.prior.keys
    here, there = one.model.values(), other.model.values()
    apart = np.array([there[key] - here[key] for key in keys])
    farthest = max(one.left, other.left)
    return farthest < ROUGHLY and float(apart @ inverse(one.covariance) @ apart) < (2 * ROUGHLY) ** 2
