"""Where the shaft stood: what goes with its angle is drowned if the angle is a simulated one, which drifts by whole teeth.

Where no angle was recorded it is the integral of the speed, and the speed is the simulated one and as much of the measured
error as is not its sensor's noise: the noise of a measured speed would walk away with the angle.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.signals import noise_sd, smoothed
from motorlens_physics.simulation import Trajectory

Array = NDArray[np.float64]

# Samples in a piece whose mean tells slow errors from noise, and how much louder than noise's the means must be.
PIECE, LOUDER = 256, 2.0
# A shaft slower than this share of its largest speed stands.
STANDS = 0.01
# Share of a period over which what goes with the angle is no more than a constant and a slope, as a spring's torque is.
BENDS = 0.25


def followed(run: Run, trajectory: Trajectory, shown: Array) -> Run:
    """The run with its shaft followed along a simulation; itself if its angle was recorded, or is anybody's guess.

    Args:
        run: prepared recording.
        trajectory: simulated, N samples.
        shown: (N, C) what the sensors would show of it.
    """
    if not run.turns or run.angle is not None or "speed" not in run.channels:
        return run
    k = run.channels.index("speed")
    error = run.measured[:, k] - shown[:, k]
    w, time = trajectory.speed_rad_s + lasting_share(error) * smoothed(error), run.inputs.time_s
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(time))])
    return replace(run, shaft=turned)


def lasting_share(error: Array) -> float:
    """How much of the slow part of an error (N,) to follow: none if white noise would leave as much, all if far less.

    >>> rng = np.random.default_rng(0)
    >>> noise, slow = rng.standard_normal(10_000), np.sin(np.arange(10_000) / 1000)
    >>> lasting_share(noise), round(lasting_share(noise + slow), 2)
    (0.0, 0.98)
    """
    pieces = len(error) // PIECE
    if pieces < 4:
        return 1.0
    means = error[: pieces * PIECE].reshape(pieces, PIECE).mean(axis=1)
    of_noise = noise_sd(error) ** 2 / PIECE
    return float(np.clip(1 - LOUDER * of_noise / max(float(np.mean(means**2)), 1e-300), 0.0, 1.0))


def turning(angle: Array, speed_rad_s: Array, period: float) -> NDArray[np.bool_]:
    """(N,) whether the shaft turns a whole period, rad, the same way both before a sample and after it.

    >>> angle = np.array([0.0, 1.0, 2.0, 3.0, 3.0, 2.0])
    >>> turning(angle, np.array([1.0, 1.0, 1.0, 1.0, -1.0, -1.0]), 1.0).tolist()
    [False, True, True, False, False, False]
    """
    least = STANDS * float(np.max(np.abs(speed_rad_s), initial=1e-12))
    way = np.where(np.abs(speed_rad_s) > least, np.sign(speed_rad_s), 0.0)
    ends = np.concatenate([np.flatnonzero(way[1:] != way[:-1]), [len(way) - 1]])
    begins = np.concatenate([[0], ends[:-1] + 1])
    passage = np.searchsorted(ends, np.arange(len(way)))
    before, after = np.abs(angle - angle[begins[passage]]), np.abs(angle[ends[passage]] - angle)
    return np.asarray((way != 0) & (before >= period) & (after >= period))


def swinging(angle: Array, turns: NDArray[np.bool_], period: float) -> NDArray[np.bool_]:
    """(N,) whether a shaft moves that mostly goes to and fro over a part of a period, as a joint or a pendulum does.

    Args:
        angle: (N,) of the shaft, rad.
        turns: (N,) where it turns whole periods, see `turning`.
        period: rad.

    >>> angle, never = np.array([0.0, 1.0, 2.0, 2.0, 2.0, 1.0, 0.0]), np.zeros(7, dtype=bool)
    >>> swinging(angle, never, 6.0).tolist()
    [True, True, True, False, True, True, True]
    >>> bool(swinging(angle, ~never, 1.9).any()), bool(swinging(angle, never, 9.0).any())
    (False, False)
    """
    speed = np.abs(np.gradient(angle))
    moves = speed > STANDS * np.max(speed)
    seldom = 2 * np.sum(turns & moves) < np.sum(moves)
    return np.asarray(moves & seldom & bool(np.ptp(angle) >= BENDS * period))
