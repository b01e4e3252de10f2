"""Innovations of a linearised motor: what is new in every sample, given all samples before it.

The errors of a simulated motor are not white. Noise on a measured input drives the simulation but did not drive the motor,
and a torque that nobody measured drove the motor but not the simulation: both reach every channel through the motor. Along
a trajectory the motor is a linear system x' = Phi x + Gamma f, so the errors are the output of a state-space model whose
disturbances f and sensor noises are white, and its Kalman filter turns them into innovations that are white (Kailath 1968,
doi:10.1109/TAC.1968.1099025). The same filter, applied to sensitivities, makes least squares efficient. The filter run
backwards gives the disturbances themselves (de Jong 1988, doi:10.1093/biomet/75.3.594), and with them the exact score of
every variance (Koopman and Shephard 1992, doi:10.1093/biomet/79.4.823).

What a converter shows is no number but an interval: the truth lies within half a step of the reading. `read` puts in its
place what says as much, near the errors as they are: a reading and a noise of it that have the same score and the same
information, and so leave the state where the mean and the variance of the truth within the interval are (Curry 1970,
Estimation and Control with Quantized Measurements, MIT Press). A signal that stays between two levels then tells no more
than that, however long it stays, unless disturbances move it. The state is taken to be normal, not uniform, after every
reading: each that is the same again then cuts off tails that are not there, and the state seems nearer to the middle of the
interval than is known. That is a fault which remains (`test_estimate_converter.py`, a current that stays at one reading).

The state of the filter is the motor's n states, one value for every input (the error of its latest sample) and one for
every slow disturbance. Measured channels are taken in one by one, so that no matrix is inverted and a missing sample
is left out.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate import kalman
from motorlens_physics.estimate.rows import lanes

Array = NDArray[np.float64]

# A row of states has as many at least: for the few recordings whose inputs have no noise it is not worth seconds to compile
# the filter for a shorter one.
SHORTEST = 8
# What a filter that reads nothing writes.
NOTHING = np.zeros((0, 0))


@dataclass(frozen=True)
class StateSpace:
    """A motor along a trajectory, with what disturbs it.

    Attributes:
        matrices: (N - 1, n, n + 6) Phi and the Gammas of `sensitivity.Linearisation`.
        shows: (C,) the state that each channel shows.
        balances: (D,) the balance (0 voltage, 1 torque, 2 heat) that each disturbance enters; -1 is none.
        drifts: (C, T) disturbances that each channel shows besides its state, as they are; -1 is none.
        steps: (C,) least significant bit of each channel's converter; 0 is none, or that it was `read`.
        holds: (D,) whether a disturbance holds from its sample to the next, or runs linearly.
        keeps: (N - 1, D) share of a disturbance that remains at the next sample; 0 is white.
        variance: (D,) of a disturbance, stationary.
        noise: (N, C) variance of the sensors' white noise, their converters' included; infinite where nothing was measured.
        start: (n,) variance of the motor's states at the first sample beside what is fitted.
        jumps: (N - 1, 2) standard deviation of what the voltage (V) and the load (N m) may have lacked at either end of a
            sample, because they changed somewhere in it; (0, 0) where none did.
    """

    matrices: Array
    shows: NDArray[np.int64]
    balances: NDArray[np.int64]
    drifts: NDArray[np.int64]
    steps: Array
    holds: NDArray[np.bool_]
    keeps: Array
    variance: Array
    noise: Array
    start: Array
    jumps: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Filtered:
    """What the Kalman filter leaves.

    Attributes:
        white: (N, C, m) innovations of m columns, in units of their standard deviation; 0 where nothing was measured.
        scale: (N, C) that standard deviation, infinite where nothing was measured.
        gain: (N, C, s) of each channel in its turn, of states and of the disturbances that are looked at, see `_acting`.
    """

    white: Array
    scale: Array
    gain: Array


@dataclass(frozen=True)
class Read:
    """Errors as converters let them be told.

    Attributes:
        space: with the noise that readings have near these errors, and no converter.
        error: (N, C) with readings that say as much as the intervals do.
        filtered: their innovations, one column.
        deviance: (N, C) twice the logarithm by which each sample would be likelier if it showed just what is expected.
        unlikely: (N, C) twice the negative logarithmic likelihood of each sample, but for a constant; 0 where nothing was
            measured.
    """

    space: StateSpace
    error: Array
    filtered: Filtered
    deviance: Array
    unlikely: Array


@dataclass(frozen=True)
class Sums:
    """Sums over white columns z (rows, k) and white errors e (rows,).

    Attributes:
        gram: (k, k) of z'z.
        scores: (B, k) of z'e, over each block of time.
        squares: of e'e.
    """

    gram: Array
    scores: Array
    squares: float


def innovations(space: StateSpace, columns: Array) -> Filtered:
    """Filter columns (N, C, m), such as errors of all channels."""
    first = _filtered(space, np.array(columns[:, :, 0]), np.zeros(columns.shape[1]))
    if columns.shape[2] == 1:
        return first
    (white,) = in_blocks(space, first, columns, [slice(0, len(columns))])
    return replace(first, white=white)


def in_blocks(space: StateSpace, known: Filtered, columns: Array, blocks: Iterable[slice]) -> Iterator[Array]:
    """The innovations of columns (N, C, m), (len, C, m) of each block of samples, one after another from the first on.

    Of a filter that has been through these samples, scales and gains are `known`: they are the same for all columns.
    """
    space, _ = _acting(space)
    _assert_gains_of(space, known)
    states = np.zeros((known.gain.shape[2], columns.shape[2]))
    for rows in blocks:
        white = np.empty((rows.stop - rows.start, *columns.shape[1:]))
        kalman.forward_again(
            *_sizes(space), space.matrices, space.shows, space.drifts, space.balances, space.holds, space.keeps,
            known.scale, known.gain, rows.start, states, np.ascontiguousarray(columns[rows]), white,
        )  # fmt: skip
        yield white


def read(space: StateSpace, error: Array) -> Read:
    """What readings (N, C) less what is expected of them tell, sample by sample."""
    error, noise = np.array(error, order="C"), space.noise.copy()
    deviance, unlikely = np.zeros(error.shape), np.zeros(error.shape)
    filtered = _filtered(replace(space, noise=noise), error, space.steps, deviance, unlikely)
    told = replace(space, noise=noise, steps=np.zeros(len(space.steps)))
    return Read(told, error, filtered, deviance, unlikely)


def sums(space: StateSpace, known: Filtered, columns: Array, blocks: int) -> Sums:
    """What least squares needs of innovations of columns (N, C, k), beside those `known` of the errors; none is kept."""
    samples, _, count = columns.shape
    edges = np.unique(np.linspace(0, samples, min(blocks, samples) + 1).astype(int))
    parts = [slice(first, last) for first, last in pairwise(edges.tolist())]
    gram, scores = np.zeros((count, count)), np.empty((len(parts), count))
    for block, white in enumerate(in_blocks(space, known, columns, parts)):
        flat = white.reshape(-1, count)
        gram += flat.T @ flat
        scores[block] = known.white[parts[block]].reshape(-1) @ flat
    return Sums(gram, scores, float(np.sum(known.white**2)))


def spread(space: StateSpace) -> Array:
    """(C,) mean variance that the disturbances bring about in what the channels show, beside the sensors' white noise."""
    power = np.zeros(len(space.shows))
    space, _ = _acting(space)
    kalman.spread(
        *_sizes(space), space.matrices, space.jumps, space.shows, space.drifts, space.balances, space.holds,
        space.keeps, space.variance, _at_first(space), power,
    )  # fmt: skip
    return power


def _sizes(space: StateSpace) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """As long as the motor has states, and as the filter has: tuples, whose length the compiler knows."""
    return (0.0,) * len(space.start), (0.0,) * (len(space.start) + len(space.variance))


def _assert_gains_of(space: StateSpace, filtered: Filtered) -> None:
    """Gains must be of the disturbances that act: machine code would read on past their end."""
    assert filtered.gain.shape == (*space.noise.shape, len(space.start) + len(space.variance))


def _at_first(space: StateSpace) -> Array:
    """(s, s) covariance of states and disturbances at the first sample."""
    return np.diag(np.concatenate([space.start, space.variance]))


def _filtered(
    space: StateSpace, column: Array, steps: Array, deviance: Array = NOTHING, unlikely: Array = NOTHING
) -> Filtered:
    """Filter a column (N, C); with `steps` it is read, and it and the others are written."""
    space, _ = _acting(space)
    own, every = _sizes(space)
    white, scale, gain = np.empty(column.shape), np.empty(column.shape), np.zeros((*column.shape, len(every)))
    kalman.forward(
        own, every, space.matrices, space.jumps, space.shows, space.drifts, space.balances, space.holds, space.keeps,
        space.variance, space.noise, _at_first(space), column, white, scale, gain, steps, deviance, unlikely,
    )  # fmt: skip
    return Filtered(white[:, :, None], scale, gain)


def disturbances(space: StateSpace, filtered: Filtered) -> tuple[Array, Array, Array]:
    """Look back from the end: the disturbances, and the scores of all variances, from the first column.

    Returns:
        (N, D) expected disturbance at each sample given all samples.
        (2, D): sums over the samples of the squared score and of its expectation, per disturbance; zero where it has none.
        (2, N, C): the same of each channel at each sample. A variance times the root of the ratio of the two is the next
        step of its maximum-likelihood estimate, which never falls (Zhou, Hu, Zhou and Lange 2019,
        doi:10.1080/10618600.2018.1529601).
    """
    every = len(space.balances)
    space, acting = _acting(space)
    _assert_gains_of(space, filtered)
    seen, of_inputs, of_channels = (
        np.zeros((len(space.noise), len(space.variance))), np.zeros((2, len(space.variance))),
        np.zeros((2, *space.noise.shape)),
    )  # fmt: skip
    kalman.backward(
        *_sizes(space), space.matrices, space.shows, space.drifts, space.balances, space.holds,
        space.keeps, space.variance,
        np.ascontiguousarray(filtered.white[:, :, 0]), filtered.scale, filtered.gain, seen, of_inputs, of_channels,
    )  # fmt: skip
    return _among(seen, acting, every), _among(of_inputs, acting, every), of_channels


def _acting(space: StateSpace) -> tuple[StateSpace, NDArray[np.int64]]:
    """With the disturbances that act, for others cost as much, and their positions.

    After them as many that are silent as fill up a row of states, see `rows`: so the compiler knows how many there are.
    """
    acting = np.flatnonzero(space.variance)
    silent = len(lanes(max(len(space.start) + len(acting), SHORTEST))) - len(space.start) - len(acting)
    # The last stands for -1: none.
    now_at = np.full(len(space.variance) + 1, -1)
    now_at[acting] = np.arange(len(acting))
    used, samples = len(acting) + silent, len(space.keeps)
    keeps, variance = np.zeros((samples, used)), np.zeros(used)
    keeps[:, : len(acting)], variance[: len(acting)] = space.keeps[:, acting], space.variance[acting]
    fewer = replace(
        space,
        balances=np.append(space.balances[acting], np.full(silent, -1)),
        drifts=now_at[space.drifts],
        holds=np.append(space.holds[acting], np.full(silent, True)),
        keeps=keeps,
        variance=variance,
    )
    return fewer, acting


def _among(found: Array, acting: NDArray[np.int64], every: int) -> Array:
    """What was found of the acting disturbances (..., A) among all of them (..., D), zero for the others."""
    among = np.zeros((*found.shape[:-1], every))
    among[..., acting] = found[..., : len(acting)]
    return among


def share_that_remains(time_s: Array, lasts_s: Array) -> Array:
    """(N - 1, D) `keeps` of disturbances that forget within `lasts_s` (D,) seconds; 0 s is white."""
    steps, keeps = np.diff(time_s), np.zeros((len(time_s) - 1, len(lasts_s)))
    for d in np.flatnonzero(lasts_s > 0):
        keeps[:, d] = np.exp(-steps / lasts_s[d])
    return keeps
