"""What is left of colour in the innovations of a run.

The Kalman filter makes white what noise of the inputs and a slow torque leave in all channels. It takes the sensors' own
noise as white; what that leaves of colour in the innovations, an autoregression takes out.

Not of noise that is blue, of which there is least at low frequencies: a count of an encoder that comes too late for one
sample comes in the next, and their sum is as if it had come in time. To believe that, a model would have to be right to as
many digits; and nothing that a model lacks looks so, for it lasts. Blue noise is taken as white, with all its power.
"""

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.noise import Noise
from motorlens_physics.estimate.run import Run
from motorlens_workbench.evidence.whitening import Whitener, fit_whitener
from motorlens_workbench.evidence.whitening import white as without_colour

Array = NDArray[np.float64]

# Smallest deviation of an innovation that is believed, in those that the noise states.
SMALLEST = 1e-3


def coloured(run: Run, white: Array, used: int) -> Whitener:
    """The filter for what is left of colour in innovations (N, C).

    Args:
        run: the recording.
        white: its innovations, in their standard deviations.
        used: parameters already spent on them.
    """
    found = fit_whitener(white, run.valid, np.full(white.shape[1], SMALLEST), used)
    lasts = ~found.blue
    if lasts.all():
        return found
    power = np.maximum(np.sqrt(np.mean(white[run.valid] ** 2, axis=0)), SMALLEST)
    if not lasts.any():
        return without_colour(power)
    return coloured(run, white[:, lasts], used).among(lasts, power)


def gain_of(run: Run, white: Array, whitener: Whitener, noise: Noise, used: int) -> float:
    """Twice the logarithmic likelihood that the filter for the colour of innovations (N, C) wins over none, at least 0.

    It is a measure of what the model of the noise, or the model, does not explain. Nothing is won below the smallest noise
    that is believed. A channel whose readings are coarser than its noise does not count, nor what it foretells of others:
    how often its readings change goes with where the signal lies between two levels, and that lasts.

    Args:
        run: the recording.
        white: its innovations, in their standard deviations.
        whitener: the filter.
        noise: of the recording.
        used: parameters already spent on the innovations.
    """
    found, least = noise.of_sensors(run), np.maximum(noise.floor, run.steps**2 / 12)
    # A mean of equal numbers is rounded.
    fine = (found > least) & ~np.isclose(found, least, atol=0.0)
    if not fine.any():
        return 0.0
    if not fine.all():
        white = white[:, fine]
        whitener = coloured(run, white, used)
    left = whitener(white) * whitener.sigma
    told = run.valid.copy()
    told[: whitener.order] = False
    before, after = (np.maximum(np.mean(y[told] ** 2, axis=0), SMALLEST**2) for y in (white, left))
    return max(float(np.sum(told) * np.sum(np.log(before / after))), 0.0)
