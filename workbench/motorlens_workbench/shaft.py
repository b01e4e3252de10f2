"""Where the shaft stood: what goes with its angle is drowned if the angle is a simulated one, which drifts by whole teeth.

Where no angle was recorded it is the integral of the speed, and the speed is the simulated one and what of the measured
error is not its sensor's noise: a measured speed alone would let the noise walk away with the angle.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.simulation import Trajectory
from motorlens_workbench.denoise import smoothed
from motorlens_workbench.run import STATE_OF, Run, Shaft

Array = NDArray[np.float64]


def followed(run: Run, trajectory: Trajectory, shown: Array) -> Run:
    """The run with its shaft followed along a simulation; itself if its angle is anybody's guess.

    Args:
        run: prepared recording.
        trajectory: simulated, N samples.
        shown: (N, C) what the sensors would show of it.
    """
    if not run.turns or ("speed" not in run.channels and run.angle is None):
        return run
    state = dict(trajectory.states)
    for k, channel in enumerate(run.channels):
        state[STATE_OF[channel]] = trajectory.states[STATE_OF[channel]] + smoothed(
            run.measured[:, k] - shown[:, k]
        )
    w, time = state["w"], run.inputs.time_s
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(time))])
    return replace(run, shaft=Shaft(turned if run.angle is None else run.angle, w, state["i"]))
