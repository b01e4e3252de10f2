"""Whether the winding began at ambient temperature: a second hypothesis of the start, weighed by what the current shows.

The filter takes any start for possible and reads the temperature off the inrush. Most motors start cold, and for a cold
start the thermal model alone knows the temperature better than any inrush tells it. So the winding that began at ambient
temperature is followed beside the filter, by the same equations, uncorrected; and the two are mixed by their posterior
probabilities. The density of the filter's temperature at the cold one, after and before what was measured, is the Bayes
factor (Savage and Dickey; Verdinelli and Wasserman 1995, doi:10.1080/01621459.1995.10476554).

A warm start, or a motor that ran before the sensor did, is shown by the first inrush, and the filter stands alone. Its only
thermometer is then the resistance, and 1 % of R_a0 passes for 2.5 K: the temperature, and nothing else, is as unsure as the
motor file is of R_a0. A cold start, whose resistance is the file's, needs no such thermometer; one whose resistance is not
passes for a start from somewhere near ambient temperature, of which few are, and tells that the motor may be another.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from motorlens_train.observer.algebra import exponential
from motorlens_train.observer.belief import MOST, ONE_IN_TWENTY, exponent, widened
from motorlens_train.observer.layout import TRACK, Layout
from motorlens_train.observer.program import Recorder, Value

# Probability of a cold start, before anything has shown: nobody knows.
COLD = 0.5
# Of the rated current: what a motor at rest does not draw.
FLOWING = 0.05
# `widened` of what is certain.
CERTAIN = (1 - ONE_IN_TWENTY[0] * COLD) / ONE_IN_TWENTY[1]


@dataclass(frozen=True)
class Track:
    """A winding that began at ambient temperature: `rises` of the winding and of what heats along with it (K), the
    `variance` of the first (K^2), how much of another start would be `left` by now (1 at the start), and whether the motor
    `ran` when the first sample was taken."""

    rises: list[Any]
    variance: Any
    left: Any
    ran: Any


def track_of(layout: Layout, r: Recorder) -> Track:
    """From the stored state, whose zeros are a start."""
    *rises, variance, gone, ran = r.inputs([f"cold_{k}" for k in range(len(layout.slow) + TRACK)])
    return Track(rises, variance, 1.0 - gone, ran)


def stored(track: Track) -> list[Any]:
    """The inverse of `track_of`."""
    return [*track.rises, track.variance, 1.0 - track.left, track.ran]


def followed(
    layout: Layout, r: Recorder, track: Track, x: Sequence[Any], rates: Sequence[Any], A: Sequence[Sequence[Any]],
    window: Mapping[str, Value], mean: Any, square: Any, unseen: Any, first: Any,
) -> Track:  # fmt: skip
    """The track after a window.

    Args:
        layout, r: the observer's.
        track: before the window.
        x, rates, A: states of the filter, their rates and Jacobian at the window's `mean` current.
        window: the full window.
        mean, square: of the current, A and A^2.
        unseen: variance that a gap adds, K^2.
        first: 1 in the first window of all.
    """
    T, w, theta = window["time"], layout.at["w"], layout.at["theta"]
    apart = {k: rise - x[k] for k, rise in zip(layout.slow, track.rises, strict=True)}
    # What is seen is w + R i / ke: with the temperature goes the speed.
    apart[w] = -(mean * layout.per_kelvin(x) * (1 / layout.motor.ke)) * apart[theta]
    rises = []
    for k, rise in zip(layout.slow, track.rises, strict=True):
        rate = rates[k]
        for j, distance in apart.items():
            rate = rate + A[k][j] * distance
        if k == theta:
            # The copper heats by the mean square of the current, not by the square of its mean.
            hot = [rise if j == theta else value for j, value in enumerate(x)]
            rate = rate + layout.resistance(r, hot) * (square - mean * mean) / layout.motor.H
        most = layout.rated.rise_K
        rises.append((rise + exponential(A[k][k], T)[1] * rate).max(-most).min(4 * most))
    kept, _ = exponential(A[theta][theta], T)
    # Who finds a current at once has come late. One sample may be noise, and in the first window a start may have begun.
    flowing = window["current_start"].abs().min(mean.abs())
    limit = FLOWING * layout.rated.current_A + 3 * layout.i_sd
    ran = track.ran.max(first * (limit <= flowing))
    return Track(rises, track.variance * kept * kept + walked(layout, T) + unseen, track.left * kept, ran)


def walked(layout: Layout, T: Any) -> Any:
    """Variance that T seconds add to a winding's temperature beyond its model, K^2."""
    return T.min(3600.0) * layout.settings.thermal_walk**2


@dataclass(frozen=True)
class Start:
    """What follows for the temperature: by how much it `moves` from the filter's, K, its `variance`, K^2, and that with the
    `thermometer`'s own: of a temperature that is read off the resistance, and of nothing else."""

    moves: Any
    variance: Any
    thermometer: Any


def another_likelier(layout: Layout, track: Track, theta: Any, variance: Any, within: Any) -> Any:
    """By how many times what the filter found of the temperature is likelier of a motor whose R_a0 is anywhere within a
    maker's tolerance than of the file's motor, both started cold or not: of any other start it tells nothing. Without a cold
    start that fits, the file's had such a one: it is never refuted by this alone.

    Args:
        layout, track, theta, variance: as for `weighed`.
        within: what that tolerance does to the temperature, either way, K.
    """
    place = layout.at["theta"]
    mean, before, after = _densities(layout, track, variance)
    apart = track.rises[0] - theta
    # An even density, blurred by what is not known, over the one of any start; both at ambient temperature.
    level = (
        math.sqrt(math.pi / 2)
        * math.exp(0.5 * (layout.start[place] / layout.sd[place]) ** 2)
        * COLD
        / (1 - COLD)
    )
    blurred = (before / (within * within + after * (math.pi / 2))).sqrt() * level
    other = track.ran.select(0.0, (apart.abs() <= within).select(blurred, 0.0))
    return (other + 1.0) / (_cold(track, apart, after, mean, before) + 1.0)


def _densities(layout: Layout, track: Track, variance: Any, unknown: Any = 0.0) -> tuple[Any, Any, Any]:
    """Where any start would have led to by now, from the cold one, K; the variance of that, and of the filter's temperature
    from the cold one, K^2."""
    place = layout.at["theta"]
    mean, spread = layout.start[place] * track.left, layout.sd[place] * track.left
    return mean, spread * spread + track.variance + unknown, variance + track.variance


def _cold(track: Track, x: Any, variance: Any, y: Any, other: Any) -> Any:
    """Odds of a cold start from its Bayes factor, the density N(0, `variance`) at x over N(0, `other`) at y: none of a motor
    that ran."""
    logarithm = track.ran.select(-2 * MOST, y * y / other - x * x / variance) * 0.5
    return (other / variance).sqrt() * exponent(logarithm) * (COLD / (1 - COLD))


def weighed(
    layout: Layout, track: Track, theta: Any, variance: Any, unknown: Any, other: Any, own: Any, reach: Any
) -> Start:  # fmt: skip
    """The two hypotheses mixed.

    Args:
        layout: the observer's.
        track: the winding that began cold.
        theta, variance: the filter's temperature, K, and its variance where the motor is the file's, K^2.
        unknown: what of that variance no measurement reduces, K^2.
        other: what the variance is more because the motor may be another, K^2. Which start it was is judged by the file's
            motor: of another, the temperature says nothing.
        own: what of `other` is there because R_a0 may be another, K^2.
        reach: of a temperature that is read off the resistance, where R_a0 alone is not the file's: a deviation, K, whose
            95 % interval holds as much of its even spread. Takes the place of `own`.
    """
    mean, before, after = _densities(layout, track, variance, unknown)
    apart = track.rises[0] - theta
    # Densities of the filter's temperature at the cold one.
    odds = _cold(track, apart, after, mean, before)
    every = odds + 1.0
    warm = 1.0 / every
    cold = odds * warm
    moves = cold * apart
    distance = apart.abs()
    # An interval about the mixture's mean holds each hypothesis as far as its probability asks for.
    near = (track.variance.sqrt() + warm * distance) * widened(every / odds, COLD)
    beyond = (variance + other).sqrt() + cold * distance
    far = beyond * widened(every, COLD)
    widest = near.max(far) * (1 / CERTAIN)
    # Of a resistance that is not the file's nothing tells but a cold start that shows the file's: until any other start is
    # twenty times less likely than before, the interval holds it.
    left_out = ONE_IN_TWENTY[0] * COLD
    held = (variance + other - own).sqrt() + cold * distance
    most = widest.max((held + reach) * ((1.0 - every * left_out) * (1 / (1 - left_out))))
    return Start(moves, widest * widest, most * most)
