"""Channels that show nothing of what they should: a sensor that died or was connected the wrong way round, a loose wire.

The least squares of a whole model would spend its parameters on such a channel, so it is looked for first: the textbook is
fitted to the other channels alone, and what it then says of the one left out is compared with what that one shows. A channel
of which nothing follows, while the others follow the model, has a gain of about zero, one whose wires are swapped a negative
one (Isermann 2006, Fault-Diagnosis Systems, ISBN 978-3-540-24112-6, section 10.1: parity with a model of the process). One
that is sensed without its sign follows the size of what the others demand.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.converter import quantisation_step
from motorlens_physics.estimate.estimate import COARSE, estimate
from motorlens_physics.estimate.fit import NEAR, fit, start_model
from motorlens_physics.estimate.free_run import stirred_by_inputs
from motorlens_physics.estimate.model import sensitivities_of
from motorlens_physics.estimate.points import CLOSE
from motorlens_physics.estimate.prior import base_prior
from motorlens_physics.estimate.run import Run
from motorlens_physics.motor_file import MotorFile
from motorlens_runtime.errors import ModelError

Array = NDArray[np.float64]

# What a winding's temperature will be is not known well enough beforehand to call its sensor dead.
PREDICTABLE = ("current", "speed")
# Share of a channel's variance that the whole model explains, above which nobody would call it dead.
ALIVE = 0.25
# Gain below which, with all its uncertainty, a channel is dead.
DEAD = 0.25
# Share of the other channels' variance that the model must explain, for its word to count against the one left out.
TRUSTED = 0.8
# A channel follows the size of what is predicted if that leaves less than this share of what the prediction itself leaves: a
# dead one follows either a little, by chance, and of a motor that turned one way only both are the same.
WITHOUT_SIGN = 0.8
# What is predicted for the channel must stand out of what the channel shows beside, and be a share of its rated value: the
# little that noise of the inputs demands near standstill is no reason to call a sensor dead.
VISIBLE, SIZEABLE = 0.3, 0.05


@dataclass(frozen=True)
class DeadChannel:
    """A channel that does not follow.

    Attributes:
        run: which recording.
        recording: its name.
        channel: "current" or "speed".
        gain: shown over predicted; over its size, where it is `unsigned`.
        sd: its standard deviation.
        unsigned: whether it shows how large it is, and not which way.
        hung: when it first and last hung, in s; None where it is dead, or reversed, all along.
    """

    run: int
    recording: str
    channel: str
    gain: float
    sd: float
    unsigned: bool = False
    hung: tuple[float, float] | None = None

    @property
    def state(self) -> str:
        """What is wrong with it, in a few words."""
        if self.hung is not None:
            return f"hangs between {self.hung[0]:.6g} and {self.hung[1]:.6g} s"
        if self.unsigned:
            return f"without its sign, gain {self.gain:.2f}"
        return f"{'reversed' if self.gain < -DEAD else 'dead'}, gain {self.gain:.2f}"

    @property
    def name(self) -> str:
        """The fault in the catalogue: a gain of about zero."""
        return f"{self.channel}_sensor_gain"

    @property
    def sentence(self) -> str:
        """For the reader."""
        if self.hung is not None:
            return f"The {self.channel} sensor of {self.recording} {self.state}: these samples were left out."
        if self.unsigned:
            return (
                f"The {self.channel} sensor of {self.recording} shows no sign: it follows the size of the {self.channel} "
                f"that the other channels demand with a gain of {self.gain:.2f} +- {self.sd:.2f}. It was left out of the "
                f"rest; to use it: --column '{self.channel}=NAME*sign(VOLTAGE)'"
            )
        state = "is reversed" if self.gain < -DEAD else "is dead"
        return (
            f"The {self.channel} sensor of {self.recording} {state}: what it shows follows the {self.channel} that the "
            f"other channels demand with a gain of {self.gain:.2f} +- {self.sd:.2f}. It was left out of the rest."
        )


def dead_channels(file: MotorFile, runs: Sequence[Run]) -> tuple[DeadChannel, ...]:
    """Channels whose content the other channels contradict, and which no motor near its file would explain."""
    # Near is enough to see whether a channel follows.
    begin = replace(start_model(file, runs), tolerance=COARSE)
    base = fit(begin, runs, base_prior(file, runs), rounds=NEAR, enough=CLOSE)
    found = []
    for r, run in enumerate(runs):
        found += [
            DeadChannel(r, run.name, channel, 0.0, 0.0, hung=when) for channel, when in run.hung.items()
        ]
        for channel in run.channels:
            if channel not in PREDICTABLE or len(run.channels) < 2:
                continue
            c = run.channels.index(channel)
            shown = run.average(run.measured)[run.fresh(), c]
            if 1 - np.var(base.residuals[r][run.fresh(), c]) / max(float(np.var(shown)), 1e-300) > ALIVE:
                continue
            dead = _judge(file, run, r, channel)
            if dead is not None:
                found.append(dead)
    return tuple(found)


def without(runs: Sequence[Run], dead: Sequence[DeadChannel]) -> tuple[Run, ...]:
    """The runs with their dead channels left out; where a channel hung, its samples are not valid anyway."""
    kept = list(runs)
    for one in dead:
        if one.hung is None:
            kept[one.run] = kept[one.run].without_channel(one.channel)
    return tuple(kept)


def _judge(file: MotorFile, run: Run, r: int, channel: str) -> DeadChannel | None:
    others = run.without_channel(channel)
    try:
        found = estimate(file, [others])
        alone, moved = found.fit, found.runs[0]
        whole = replace(run, inputs=moved.inputs, corrections=moved.corrections)
        _, said, _, linear = sensitivities_of(alone.model, whole, 0, ())
        assert moved.noise is not None
        stirred = stirred_by_inputs(whole, linear, moved.noise)
    except ModelError:
        return None
    fresh = run.fresh()
    for c, name in enumerate(others.channels):
        y = others.average(others.measured)[fresh, c]
        if name in PREDICTABLE and np.var(alone.residuals[0][fresh, c]) > (1 - TRUSTED) * np.var(y):
            return None
    c = run.channels.index(channel)
    x, y = run.average(said)[fresh, c], run.average(run.measured)[fresh, c]
    # Near standstill a prediction is little more than what noise of the inputs stirs up.
    if stirred[c] > (1 - TRUSTED) * np.var(x):
        return None
    size = np.abs(x)
    x, y, size = x - x.mean(), y - y.mean(), size - size.mean()
    rated = {"current": file.rated.current_A, "speed": file.rated.speed_rad_s}[channel]
    if np.std(x) < max(VISIBLE * np.std(y), quantisation_step(run.measured[:, c]), SIZEABLE * rated):
        return None
    (gain, sd, left), (of_size, its_sd, its_left) = _gain(y, x), _gain(y, size)
    # How large a gain has nothing to say: without its current, the size of a motor's current is hardly known.
    if of_size > 2 * its_sd and its_left < WITHOUT_SIGN * left:
        return DeadChannel(r, run.name, channel, of_size, its_sd, unsigned=True)
    dead, reversed_ = abs(gain) + 2 * sd <= DEAD, gain + 2 * sd < -DEAD
    return DeadChannel(r, run.name, channel, gain, sd) if dead or reversed_ else None


def _gain(y: Array, x: Array) -> tuple[float, float, float]:
    """How many times another a signal is, both without their mean, the standard deviation of that, and what is left."""
    square = max(float(x @ x), 1e-300)
    gain = float(x @ y) / square
    left = y - gain * x
    # What is left may be coloured: by blocks, not by samples.
    scores = [float(part_x @ part_y) for part_x, part_y in zip(_blocks(x), _blocks(left), strict=True)]
    return gain, float(np.sqrt(np.sum(np.square(scores)))) / square, float(left @ left)


def _blocks(y: Array) -> list[Array]:
    return np.array_split(y, 32)
