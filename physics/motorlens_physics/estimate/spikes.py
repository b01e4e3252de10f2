"""Spikes: samples of a channel or of an input that stand alone, as no motor makes or follows them.

A switching edge that a converter catches, a bit that a bus turns over. The model tells them from what a motor does: what is
missing from it goes on in its states, and what drove it shows in what it did.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from motorlens_physics.estimate.innovations import Filtered, disturbances, read
from motorlens_physics.estimate.noise import INPUTS, LOAD, OUTLIER, VOLTAGE
from motorlens_physics.estimate.weighed import Errors

Array = NDArray[np.float64]
Spikes = Mapping[str, NDArray[np.bool_]]

# How often samples are looked for that stand alone, at most.
SIFTED = 12
# By how much less than it stands out a sample of an input may be off, or more, as a share.
AGREES = 0.5
# Instead of nothing, where nothing is told or no noise is there.
LEAST = 1e-300
# So many time constants on, nothing is left of an answer.
ANSWERED = 100.0


def spikes_of_channels(part: Errors) -> Spikes:
    """Channel -> (N,) samples that stand alone: beyond noise, while those beside them are as expected without them.

    What a motor lacks goes on in its states: of what is this far beyond noise so much would be left at the next sample that
    it showed. At a flank the answer may be over sooner; there what is shown bends by more than it errs.

    Args:
        part: a run near the best parameters.
    """
    first = _heard_without(part, np.zeros_like(part.run.there))
    seen, peaks = first, np.zeros_like(part.run.there)
    answers = part.frame.model.file.motor.response_s / part.run.period_s
    window = 1 + 2 * int(min(np.ceil(answers), len(part.error) - 1))
    # One leads the filter astray for as long as the motor answers: the farthest off first.
    for _ in range(SIFTED):
        size = np.abs(seen.white[:, :, 0])
        more = (size > OUTLIER) & (size == maximum_filter1d(np.max(size, axis=1), window)[:, None])
        if not more.any():
            break
        peaks |= more
        seen = _heard_without(part, peaks)
    if seen is first:
        return {}
    calm = ~peaks & (np.abs(seen.white[:, :, 0]) <= OUTLIER)
    out = np.abs(_standing_out(part.error))
    # Along the inputs as recorded: as corrected they may have followed it.
    bends = np.abs(np.diff(part.run.measured - part.error, n=2, axis=0))
    # Of a slow recording nothing remains at the next sample.
    least = OUTLIER * np.exp(min(1 / answers, ANSWERED)) * first.scale[1:-1]
    far = out > np.maximum(bends, least)
    alone = np.pad(peaks[1:-1] & calm[:-2] & calm[2:] & far, ((1, 1), (0, 0)))
    return dict(zip(part.run.channels, alone.T, strict=True))


def spikes_of_inputs(part: Errors) -> Spikes:
    """Voltage and load torque -> (N,) samples that stand out of both beside them, and did not act on the motor.

    What did act is what is expected given all that was measured (auxiliary residuals: de Jong and Penzer 1998,
    doi:10.1080/01621459.1998.10473730).

    Args:
        part: a run near the best parameters.
    """
    alone = {}
    every = read(part.noise.space(part.run, part.linear, part.run.there), part.error)
    seen, (_, expected), _ = disturbances(every.space, every.filtered)
    recorded = part.run.inputs
    # A load brakes: what the torque balance got too little, the load sensor showed too much.
    for which, y, sign in ((VOLTAGE, recorded.voltage_V, 1), (LOAD, recorded.load_torque_Nm, -1)):
        variance, told, out = part.noise.disturbances[which], expected[which] / len(y), _standing_out(y)
        # What noise is expected given all is shrunk by what the channels tell of it; how far it was off, as they tell.
        off = sign * seen[1:-1, which] / max(variance * told, LEAST)
        seen_at_all = np.abs(out) > OUTLIER * max(np.sqrt(variance), 1 / np.sqrt(max(told, LEAST)))
        alone[INPUTS[which]] = np.pad(seen_at_all & (np.abs(out + off) < AGREES * np.abs(out)), 1)
    return alone


def _heard_without(part: Errors, out: NDArray[np.bool_]) -> Filtered:
    return read(part.noise.space(part.run, part.linear, part.run.there & ~out), part.error).filtered


def _standing_out(y: Array) -> Array:
    """(N - 2, ...) by how much each sample of (N, ...) but the first and the last is outside of the two beside it."""
    return np.asarray(y[1:-1] - np.clip(y[1:-1], np.minimum(y[:-2], y[2:]), np.maximum(y[:-2], y[2:])))
