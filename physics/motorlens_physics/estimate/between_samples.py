"""How the inputs of a recording ran between its samples: held by a drive, or linearly, each of its own.

Also whether all channels come a sample earlier or later, which looks much alike. The way is chosen that makes the recording
likeliest, beside inputs that have lost their noise, less what the noise that they have kept adds: to the errors and, where
it lasts, to the sensitivities (Fuller 1987, Measurement Error Models, doi:10.1002/9780470316665). Along the inputs as
recorded that way looks likelier which averages more of their noise, whichever is true: the noise is independent of what
drove the motor, not of what was recorded (Carroll, Ruppert, Stefanski and Crainiceanu 2006, Measurement Error in Nonlinear
Models, doi:10.1201/9781420010138, chapter 2).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.fit import inverse
from motorlens_physics.estimate.innovations import in_blocks
from motorlens_physics.estimate.model import Model, response_to_inputs, sensitivities_of
from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.points import moved_on, needed
from motorlens_physics.estimate.prior import Prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.weighed import Errors, Weighed, noise_left, without_noise
from motorlens_runtime.errors import ModelError

Array = NDArray[np.float64]

# Of what tells any combination of parameters no more than this share is taken out as that of noise: with all of it taken out
# nothing would be left to divide by. `test_estimate_coloured_noise.py` shows that less (0.5) would leave a bias.
MOST_OF_NOISE = 0.9


class End(NamedTuple):
    """Where one step leads.

    Attributes:
        cost: twice the negative logarithmic likelihood there, with what is known beforehand.
        step: (k,) of the prior's keys.
        left: what noise that inputs have kept adds to the innovations, as it may be.
    """

    cost: float
    step: Array
    left: Array


class Seen(NamedTuple):
    """A run beside its inputs without noise.

    Attributes:
        errors: of it.
        left: (N, C) what noise that the inputs have kept adds to what is shown, as it may be.
        kept: (N, C, k) what such noise adds to the sensitivities, where it lasts.
    """

    errors: Errors
    left: Array
    kept: Array

    def left_white(self) -> Array:
        """(N, C) what it adds to the innovations."""
        seen = self.errors.read
        (white,) = in_blocks(seen.space, seen.filtered, self.left[:, :, None], [slice(0, len(self.left))])
        return white[:, :, 0]


class Quiet(NamedTuple):
    """Inputs of a run without noise.

    Attributes:
        corrections: (N, 2) of voltage and load torque.
        left: (N, 2) what they have kept of the noise, as it may be.
    """

    corrections: Array
    left: Array


def as_they_ran(point: Weighed, prior: Prior) -> tuple[tuple[Run, ...], ...]:
    """The runs with inputs that held between samples, or not, as is likeliest; and, if that is likelier, with all a sample
    later or earlier, or with a speed that is the mean since the sample before.

    A run that stays as it was is the same object.

    Args:
        point: near the best parameters of one way.
        prior: the free parameters.

    Returns:
        the runs as they are likeliest with no channel moved and the speed at its sample; with channels moved; and with a
        mean speed. The last two only where that is likelier beyond chance, else as the one before. Where a speed is a mean
        and stays one, it is one in all three.
    """
    ways = [_ways_of(point, prior, r) for r in range(len(point.parts))]
    return tuple(zip(*ways, strict=True))


def _ways_of(point: Weighed, prior: Prior, r: int) -> tuple[Run, Run, Run]:
    """One run as it is likeliest with its channels as they are, with all moved, and with a mean."""
    part, inflation = point.parts[r], point.tempered().inflation
    quiet, ambient = _quiet(part.run, part.noise), part.run.inputs.hold[2]
    # One that was computed from an angle is a mean, whatever else fits.
    least = part.run.from_angle
    shows = (False, True) if "speed" in part.run.channels and not least else (least,)
    ends = {
        (mean, held, moved): end
        for mean in shows
        for held in (False, True)
        for moved, end in _ends(
            point, prior, r, quiet, (held, held, ambient), (-1, 0, 1), mean=mean, straight=True
        ).items()
    }
    if not np.isfinite([end.cost for end in ends.values()]).any():
        return part.run, part.run, part.run
    held = min((False, True), key=lambda held: ends[least, held, 0].cost)
    load = held
    # That inputs did not run alike is one thing more.
    if "load_torque" in part.run.known:
        alike, other = (
            _ends(point, prior, r, quiet, (held, one, ambient), (0,), mean=least, straight=False)[0]
            for one in (held, not held)
        )
        load = not held if _won(alike, other, inflation) > needed(1) else held
    still = part.run.holding((held, load, ambient)).showing(False)

    def likeliest(shows_mean: bool) -> Run | None:
        """With its channels moved, or a mean; None if that is not likelier beyond chance."""
        ways = [way for way in ends if way[0] == shows_mean]
        way = min(ways, key=lambda way: ends[way].cost, default=(least, held, 0))
        # That all is late, or a speed a mean, is one thing more than how inputs ran.
        tried = len(ends) if shows_mean else len(ways)
        if _won(ends[least, held, 0], ends[way], inflation) <= needed(tried):
            return None
        mean, holds, late = way
        # A mean is half a sample late, which brings any speed nearer that is late by more.
        if mean and not least and min(end.cost for end in alone()) < ends[way].cost:
            return None
        return _moved(part.run.holding((holds, holds, ambient)).showing(mean), late)

    def alone() -> Iterator[End]:
        """The speed alone a sample later or earlier."""
        for holds in (False, True):
            hold = (holds, holds, ambient)
            yield from _ends(
                point, prior, r, quiet, hold, (-1, 1), mean=False, straight=True, alone="speed"
            ).values()

    moved, counted = likeliest(least) or still, None if least else likeliest(True)
    if counted is not None and part.run.mean_speed:
        return counted, counted, counted
    return still, moved, counted or moved


def gained_without_noise(point: Weighed, other: Weighed, prior: Prior) -> float:
    """Twice the gain in logarithmic likelihood from one point to another of the same runs, whose inputs ran otherwise.

    Beside inputs that have lost their noise, and in the mean under the noise of the one and of the other.
    """
    won, inflation = [], point.tempered().inflation
    for like in (point, other):
        quiet = [_quiet(part.run, part.noise) for part in like.parts]
        before, after = (_end_under(like, quiet, here, prior) for here in (point, other))
        won.append(_won(before, after, inflation))
    return float(np.mean(won))


def _end_under(like: Weighed, quiet: Sequence[Quiet], point: Weighed, prior: Prior) -> End:
    """Where a point leads under the noise of another one of the same runs, which has its channels elsewhere."""
    parts: list[Seen] = []
    for r, (own, part) in enumerate(zip(point.parts, like.parts, strict=True)):
        moves = tuple(own.run.late.get(c, 0) - part.run.late.get(c, 0) for c in own.run.channels)
        parts += _seen(point.model, own.run, r, part, quiet[r], prior, own.mine, [moves])
    return _at_best(point.model, parts, prior)


def _won(here: End, other: End, inflation: float) -> float:
    """Twice the gain in logarithmic likelihood from one end to another, as far as noise that inputs have kept lets it be.

    That noise scatters half the gain. The mean of logistic curves that scatter so is nearly another one (MacKay 1992, The
    Evidence Framework Applied to Classification Networks, doi:10.1162/neco.1992.4.5.720).
    """
    scatter = np.pi / 8 * float(np.sum((other.left - here.left) ** 2)) / inflation
    return (here.cost - other.cost) / inflation / float(np.sqrt(1.0 + scatter))


def otherwise(point: Weighed, prior: Prior) -> tuple[tuple[float, ...], Array]:
    """What is left open by how inputs ran where a recording does not tell it.

    A smooth drive that holds and one that runs linearly half a sample later are nearly the same, but for the parameters.

    Args:
        point: the best parameters.
        prior: the free parameters.

    Returns:
        per run, the probability that voltage or load torque ran otherwise than at the point.
        (k, k) covariance of `prior.keys` to be added: by how much each way leads elsewhere, one step away, as likely as it
        is.
    """
    inflation = point.tempered().inflation
    chances, spread = [], np.zeros((len(prior.keys), len(prior.keys)))
    for r, part in enumerate(point.parts):
        voltage, load, ambient = point.model.held[r]
        ways = {(voltage, load), (not voltage, not load)}
        if "load_torque" in part.run.known:
            ways |= {(not voltage, load), (voltage, not load)}
        quiet = _quiet(part.run, part.noise)
        mean = part.run.mean_speed
        ends = {
            way: _ends(point, prior, r, quiet, (*way, ambient), (0,), mean=mean, straight=False)[0]
            for way in ways
        }
        here = ends.pop((voltage, load))
        # What cannot be simulated is compared with nothing.
        able = {way: end for way, end in ends.items() if np.isfinite([here.cost, end.cost]).all()}
        odds = [float(np.exp(0.5 * min(_won(here, end, inflation), 0.0))) for end in able.values()]
        total = 1.0 + sum(odds)
        chances.append(1.0 - 1.0 / total)
        for odd, end in zip(odds, able.values(), strict=True):
            # Beside inputs without noise parameters may be elsewhere whichever way inputs ran: that is not what is open.
            apart = end.step - here.step
            spread += odd / total * np.outer(apart, apart)
    return tuple(chances), spread


def _quiet(run: Run, noise: Noise) -> Quiet:
    quiet = without_noise(run, noise)
    # One draw stands for the mean, the same for every way.
    left = noise_left(quiet, noise, np.random.default_rng(0))
    return Quiet(np.zeros_like(left) if quiet.corrections is None else quiet.corrections, left)


def _moved(run: Run, samples: int) -> Run:
    for channel in run.channels:
        run = run if channel == "temperature" else run.delayed(channel, samples)
    return run


def _ends(
    point: Weighed,
    prior: Prior,
    r: int,
    quiet: Quiet,
    hold: tuple[bool, bool, bool],
    late: Sequence[int],
    *,
    mean: bool,
    straight: bool,
    alone: str | None = None,
) -> dict[int, End]:
    """Where a run leads whose inputs ran this way and whose speed is a mean or not, by how many samples all was late,
    or one channel alone.

    Without skews (`straight`), which would make up for a voltage that ran otherwise. A way that cannot be simulated costs
    infinitely much.
    """
    part = point.parts[r]
    mine = tuple(k for k in part.mine if not (straight and prior.keys[k].startswith("skew.")))
    none = {f"{name}@{r}": 0.0 for name in point.model.own[r] if straight and name.startswith("skew.")}
    held = tuple(hold if k == r else h for k, h in enumerate(point.model.held))
    model = replace(point.model, held=held).with_values(none)
    late_too = {alone} if alone else set(part.run.channels) - {"temperature"}
    moves = [tuple(samples if c in late_too else 0 for c in part.run.channels) for samples in late]
    try:
        run = part.run.holding(hold).showing(mean)
        seen = _seen(model, run, r, part, quiet, prior, mine, moves)
    except ModelError:
        return dict.fromkeys(late, End(np.inf, np.zeros(len(prior.keys)), np.zeros(1)))
    return {samples: _at_best(model, [one], prior) for samples, one in zip(late, seen, strict=True)}


def _seen(
    model: Model,
    run: Run,
    r: int,
    like: Errors,
    quiet: Quiet,
    prior: Prior,
    mine: tuple[int, ...],
    moves: Sequence[tuple[int, ...]],
) -> list[Seen]:
    """A run beside its inputs without noise, under the noise of `like`, as what is shown moves by so many samples to it."""
    keys = [prior.keys[k] for k in mine]
    _, shown, columns, linear = sensitivities_of(model, run.corrected(quiet.corrections), r, keys)
    left, kept = response_to_inputs(model, run, r, linear, *quiet.left.T), np.zeros_like(columns)
    if any(lasting.sd for lasting in like.noise.lasting_of_inputs(run)):
        # Smoothing leaves next to nothing of white noise, and most of noise that lasts: sensitivities hold that as well.
        _, _, more, _ = sensitivities_of(model, run.corrected(quiet.corrections + quiet.left), r, keys)
        kept = more - columns
    # The same samples count in all.
    used = like.run.there.copy()
    used[[0, -1]] = False
    return [
        Seen(
            replace(
                like,
                columns=moved_on(columns, by),
                mine=mine,
                used=used,
                error=like.run.measured - moved_on(shown, by),
            ),
            moved_on(left, by),
            moved_on(kept, by),
        )
        for by in moves
    ]


def _at_best(model: Model, seen: Sequence[Seen], prior: Prior) -> End:
    """The best parameters of runs, one step away."""
    point, values = Weighed(model, tuple(one.errors for one in seen), len(prior.keys)), model.values()
    width = prior.width(values)
    gram, score = point.normal()
    gram, score = gram + np.diag(width**-2.0), score + prior.pull(values) / width
    if any(one.kept.any() for one in seen):
        # Noise that both have kept, sensitivities and errors, is in the products of the one with the other.
        drawn = tuple(replace(one.errors, columns=one.kept, error=one.left) for one in seen)
        of_noise, bias = replace(point, parts=drawn).normal()
        most = float(np.max(np.linalg.eigvals(inverse(gram) @ of_noise).real))
        share = min(1.0, MOST_OF_NOISE / most) if most > 0 else 1.0
        gram, score = gram - share * of_noise, score + share * bias
    step = np.asarray(np.linalg.lstsq(gram, score, rcond=1e-12)[0])
    left = np.concatenate([one.left_white().ravel() for one in seen])
    cost = point.cost + prior.penalty(values) - float(score @ step) - float(left @ left)
    return End(cost, step, left)
