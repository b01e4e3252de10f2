"""The noise under which the errors of a recording are likeliest: its variances, and how long what lasts of it lasts.

The score of every variance comes from the filter run backwards (`innovations.disturbances`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, rfft
from scipy.optimize import minimize_scalar
from scipy.special import chdtri

from motorlens_physics.estimate.innovations import StateSpace, disturbances, read, spread
from motorlens_physics.estimate.noise import LASTS, LOAD, TINY, TORQUE, VOLTAGE, Noise
from motorlens_physics.estimate.run import Run
from motorlens_physics.sensitivity import Linearisation

Array = NDArray[np.float64]

# A torque may be over in so few samples only where the motor follows in as few: elsewhere it would pass for whatever is
# missing.
SHORT, WITHIN_A_SAMPLE = 3.0, 1.0
# Over how many samples coloured noise is correlated: the shortest, the usual, and the longest that is looked at. What lasts
# longer than usual beyond chance is no noise: the errors of a model that lacks something mostly do.
CORRELATED = (3.0, 30.0, 60.0)
# How near the logarithm of that number is sought.
DURATION = 0.1
# Squared autocorrelations that it may leave, over those of as much white noise. `test_estimate_coloured_noise.py` shows both
# sides: at 1.1 noise is refused, and the backlash of a shaft leaves 4.5.
WHITE = 3.3
# Parts of a recording, and the most by which their mean powers may scatter, as a share: of noise less than 0.3, even where a
# ripple comes and goes; of a real motor's missing drop, friction or iron 0.8 and more.
PARTS, UNEVEN = 16, 0.5
# How often coloured noise, or noise that is uneven, may be found where there is none.
CHANCE = 0.01
# Updates of the noise before two durations are compared. A torque as short as a sample is told from the sensors' white noise
# only once both have converged.
ROUGHLY, CONVERGED = 6, 30
# Samples in a stretch of a long recording, and how many stretches the variances are estimated from: as many samples as tell
# a variance within 2 %.
STRETCH, STRETCHES = 1024, 6
PIECE = STRETCH * STRETCHES
# Variances have settled when an update gains less than this in twice the logarithmic likelihood: a twentieth of a standard
# deviation of the least known of them.
ENOUGH = 0.0025
# Any share of what is rough of a measured input may be noise, each as likely as another. On the scale of logarithms, on
# which variances are sought, twice the logarithm of that density rises by so many times the logarithm of the variance.
UNIFORM = 2.0
# An extrapolation takes updates to shorten by this share at the slowest, and goes this far in the logarithm.
SLOWEST, FARTHEST = 0.95, 3.0


def likelier(
    noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_], updates: int
) -> tuple[Noise, float]:
    """Noise under which the errors (N, C) are likelier, and twice their negative logarithmic likelihood.

    What is known beforehand of the inputs' noise (`UNIFORM`) is part of it.

    Of both, samples tell at which the recording does not rest (`Run.rests`).

    Every update raises the likelihood, but nears its end by a constant share: after two, each variance leaps to where that
    would end (Aitken's extrapolation), and comes back if the likelihood there is lower.
    """
    space = noise.space(run, linear, used & ~run.rests[:, None])
    parts = _parts(space, error, noise.group(run))
    path, back, total = [noise], noise, float("inf")
    for _ in range(updates):
        leapt = back is not path[-1] and len(path) == 1
        after, here = _updated(path[-1], parts, run.steps**2 / 12)
        if leapt and here > total:
            path = [back]
            continue
        won, total = total - here, here
        back = after
        path.append(after)
        if won < ENOUGH:
            break
        if len(path) == 3:
            path = [_leap(*path)]
    return back, total


def _updated(
    noise: Noise, parts: Sequence[tuple[StateSpace, Array, NDArray[np.int64]]], converters: Array
) -> tuple[Noise, float]:
    """One step of maximum likelihood from a noise, and twice the negative logarithmic likelihood before it.

    Args:
        noise: which.
        parts: of a run, with the errors of their samples and of which group each is, see `Noise.group`.
        converters: (C,) variance that each channel has besides.
    """
    total, inputs, sensors = (
        0.0,
        np.zeros((2, len(parts[0][0].variance))),
        np.zeros((2, *noise.sensors.shape)),
    )
    for part, error, groups in parts:
        here = replace(
            part,
            variance=np.append(noise.disturbances, part.variance[len(noise.disturbances) :]),
            noise=np.where(np.isfinite(part.noise), noise.sensors.T[groups] + converters, np.inf),
        )
        seen = read(here, error)
        total += float(np.sum(seen.unlikely))
        _, of_inputs, of_channels = disturbances(seen.space, seen.filtered)
        inputs = inputs + of_inputs
        for k in range(sensors.shape[2]):
            sensors[:, :, k] += of_channels[:, groups == k].sum(axis=1)
    # Where the errors do not tell it from the channels' own noise, an input is as noisy as it looks.
    measured = noise.of_measured_inputs
    inputs[0, measured] += UNIFORM / noise.disturbances[measured]
    total -= UNIFORM * float(np.sum(np.log(noise.disturbances[measured] / noise.most[measured])))
    # To the full ratio, not its root: it is a fixed point of both, and nearer.
    ratio = _ratio(inputs[:, : len(noise.disturbances)])
    return noise.within(noise.sensors * _ratio(sensors), noise.disturbances * ratio), total


def _leap(before: Noise, between: Noise, after: Noise) -> Noise:
    """Where three noises end, if each logarithm of a variance goes on by the share by which it went less far than before."""

    def end(x: Array, y: Array, z: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = np.log(y / x), np.log(z / y)
            share = np.where(first != 0, second / first, 0.0)
            more = second * share / (1 - np.clip(share, -1.0, SLOWEST))
        return np.asarray(z * np.exp(np.clip(np.nan_to_num(more), -FARTHEST, FARTHEST)))

    return after.within(
        end(before.sensors, between.sensors, after.sensors),
        end(before.disturbances, between.disturbances, after.disturbances),
    )


def _ratio(score: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(score[1] > 0, score[0] / score[1], 1.0)
    return np.clip(ratio, 0.05, 20.0)


def _parts(
    space: StateSpace, error: Array, groups: NDArray[np.int64]
) -> list[tuple[StateSpace, Array, NDArray[np.int64]]]:
    """What the variances are estimated from: all, or stretches of a long recording."""
    if len(error) <= PIECE:
        return [(space, error, groups)]
    left = _left(space, error)
    begins = np.linspace(0, len(error) - STRETCH, STRETCHES).astype(int).tolist()
    stretches = [slice(begin, begin + STRETCH) for begin in begins]
    return [(_stretch(space, rows, left), error[rows], groups[rows]) for rows in stretches]


def _left(space: StateSpace, error: Array) -> Array:
    """(C,) variance in which what came before a stretch has left the states that the channels show.

    What a state forgets within a stretch may be anywhere within what the errors (N, C) are. What lasts, as a temperature
    does, is where the whole recording says, but for what the disturbances have done.
    """
    states = space.matrices.shape[1]
    own = np.diagonal(space.matrices[:STRETCH, :, :states], axis1=1, axis2=2)
    lasts = np.prod(own, axis=0)[space.shows] ** 2
    anywhere = np.mean(error**2, axis=0)
    return np.asarray((1 - lasts) * anywhere + lasts * np.minimum(anywhere, spread(space)))


def _stretch(space: StateSpace, rows: slice, left: Array) -> StateSpace:
    """The samples of some rows of a state space, with the variance (C,) in which what came before has left the states."""
    start = np.zeros_like(space.start)
    if rows.start:
        start[space.shows] = left
    return replace(
        space, matrices=space.matrices[rows.start : rows.stop - 1], keeps=space.keeps[rows.start : rows.stop - 1],
        noise=space.noise[rows], start=start, jumps=space.jumps[rows.start : rows.stop - 1],
    )  # fmt: skip


def changed_between(
    noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_]
) -> Noise:
    """The noise with inputs that changed at any moment between samples, each if that is likelier; itself if neither is.

    What is seen of a change then tells of the motor only what its moment does not. Asked of a voltage that looks free of
    noise, as a command is: what was measured may change for a sample by what it shows alone. Asked of every load: one that
    brakes is nothing at rest, and all of itself as soon as the rotor turns.

    Args: as of `lasting`.
    """
    command = noise.most[VOLTAGE] <= run.input_step[VOLTAGE] ** 2 / 12 + TINY
    asked = [VOLTAGE, LOAD] if command else [LOAD]
    # Of two that change in the same samples the likelier comes first: beside it the other may be no more than chance.
    while asked:
        ways = {which: noise.at_any_moment(which) for which in asked}
        spaces = {which: way.space(run, linear, used) for which, way in ways.items()}
        # Where the moment is not known, some samples tell nothing: they count on neither side.
        won = {
            which: _won(noise, ways[which], run, linear, error, np.isfinite(space.noise))
            for which, space in spaces.items()
            if space.jumps[:, which].any()
        }
        best = max(won, key=lambda which: won[which][0], default=None)
        if best is None or won[best][0] <= chdtri(1, CHANCE):
            break
        noise = won[best][1]
        asked.remove(best)
    return noise


def _won(
    before: Noise, after: Noise, run: Run, linear: Linearisation, error: Array, counted: NDArray[np.bool_]
) -> tuple[float, Noise]:
    """Twice the gain in logarithmic likelihood from one noise to another, in the samples (N, C) that count, and that one."""
    (_, here), (found, there) = (
        likelier(one, run, linear, error, counted, CONVERGED) for one in (before, after)
    )
    return here - there, found


def lasting(
    noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_], response_s: float
) -> Noise:
    """The noise with the unmeasured torque lasting as long as makes the errors likeliest.

    Args:
        noise: of the run.
        run: the recording.
        linear: the motor linearised along it.
        error: (N, C) of its channels.
        used: (N, C) samples that count.
        response_s: how long the motor takes to follow a torque.
    """
    durations, updates = _of_torque(run, response_s)
    tried = [
        likelier(noise.lasting(samples * run.period_s), run, linear, error, used, updates)
        for samples in (*durations, *LASTS)
    ]
    return min(tried, key=lambda one: one[1])[0]


def _of_torque(run: Run, response_s: float) -> tuple[tuple[float, ...], int]:
    """In how few samples a torque that nobody measured may be over, if in few, and updates that tell it from noise."""
    if response_s < run.period_s:
        return (WITHIN_A_SAMPLE, SHORT), CONVERGED
    return ((SHORT,) if response_s < SHORT * run.period_s else ()), ROUGHLY


def coloured(
    noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_], response_s: float
) -> Noise:
    """The noise with coloured noise of all sensors besides, if that is what the errors are; itself if it is not.

    It must be likelier beyond chance, last no longer than noise does, leave white noise, and be the same throughout: errors
    of a model that lacks something are correlated as well, but for longer, and otherwise at one time than at another.

    Args: as of `lasting`, at parameters near the best: what is wrong with them lasts as well.
    """
    durations, updates = _of_torque(run, response_s)
    # The torque may have stood for noise, or noise for the torque: how long both last is sought together.
    begins = [noise.with_small_torque(run, samples) for samples in (*durations, LASTS[1])]
    cost = min(likelier(one, run, linear, error, used, updates)[1] for one in (noise, *begins))

    def tried(begin: Noise, samples: float, updates: int) -> tuple[Noise, float]:
        near = begin.coloured(run, error, samples).correlated(samples * run.period_s)
        return likelier(near, run, linear, error, used, updates)

    shortest, usual, longest = CORRELATED
    first = [(tried(begin, samples, updates)[1], begin) for begin in begins for samples in (shortest, usual)]
    least, begin = min(first, key=lambda one: one[0])
    if cost - least < chdtri(TORQUE + len(run.channels), CHANCE / len(first)):
        return noise
    # Durations differ by less than a noise still gains that has not converged, and than one gains that goes on from another.
    usually, least = tried(begin, usual, CONVERGED)
    longer = likelier(usually.correlated(longest * run.period_s), run, linear, error, used, CONVERGED)[1]
    if least - longer > chdtri(1, CHANCE):
        # It lasts longer than noise: how long need not be sought.
        return noise
    likeliest = minimize_scalar(
        lambda logarithm: tried(begin, np.exp(logarithm), CONVERGED)[1],
        bounds=(float(np.log(shortest)), float(np.log(longest))),
        method="bounded",
        options={"xatol": DURATION},
    )
    if likeliest.x > np.log(usual) and least - likeliest.fun > chdtri(1, CHANCE):
        return noise
    other, _ = tried(begin, np.exp(likeliest.x), CONVERGED)
    return other if _leaves_noise(other, run, linear, error, used) else noise


def uneven(noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_]) -> Noise:
    """The noise with sensors as noisy as they are at each size of the voltage, if that is likelier; itself if it is not.

    It must be likelier beyond chance, leave white noise, and be the same throughout, as must `coloured`.

    Args: as of `lasting`, at parameters near the best.
    """
    other = noise.uneven(run)
    more = other.sensors.size - noise.sensors.size
    if not more:
        return noise
    (_, before), (found, after) = (
        likelier(one, run, linear, error, used, CONVERGED) for one in (noise, other)
    )
    likely = before - after > chdtri(more, CHANCE)
    return found if likely and _leaves_noise(found, run, linear, error, used) else noise


def _leaves_noise(
    noise: Noise, run: Run, linear: Linearisation, error: Array, used: NDArray[np.bool_]
) -> bool:
    """Whether innovations are white, and as large at one time as at another."""
    left = read(noise.space(run, linear, used), error).filtered.white[:, :, 0]
    powers = np.array([np.mean(part**2) for part in np.array_split(left, PARTS)])
    return bool(_correlation(left) < WHITE and np.std(powers) < UNEVEN * np.mean(powers))


def _correlation(white: Array) -> float:
    """The sum of the squared autocorrelations of innovations (N, C), over that of white noise (Box and Pierce 1970)."""
    samples, lags = len(white), round(max(CORRELATED))
    lagged = irfft(np.abs(rfft(white, 2 * samples, axis=0)) ** 2, axis=0)[: 1 + lags]
    shares = lagged[1:] / np.maximum(lagged[0], TINY)
    return float(np.mean(np.sum(shares**2, axis=0)) * samples / lags)
