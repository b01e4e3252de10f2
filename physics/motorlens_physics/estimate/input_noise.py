"""How much of what looks like noise of a measured input is noise: as much as the errors follow.

A rough voltage may be rough at the motor too (a dither, a ripple), or in its sensor alone. What its sensor alone shows
drives the simulation and did not drive the motor, so that the errors hold minus the motor's response to it. How large the
errors are tells of that only where they are larger than what the channels' own noise might be; that they follow what is
seen of the input tells of it always: the share of the input's roughness that is noise is the coefficient of that response
in them (errors in variables, see `estimate`; scatter between blocks of time as of White 1980, doi:10.2307/1912934).
"""

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.conditions import Terminal
from motorlens_physics.estimate.model import Model, response_to_inputs
from motorlens_physics.estimate.run import Run
from motorlens_physics.estimate.signals import smoothed
from motorlens_physics.sensitivity import Linearisation

Array = NDArray[np.float64]

# Samples in a row that may share their errors.
PIECE = 50
# By how many deviations less a share is believed.
DEVIATIONS = 2.0
# Share of itself by which a column is held to nothing: what the others imitate is not divided among them.
RIDGE = 1e-6


def least_noise(
    model: Model,
    run: Run,
    r: int,
    linear: Linearisation,
    error: Array,
    columns: Array,
    used: NDArray[np.bool_],
) -> Array:
    """(2,) least variance of what is rough of voltage (V^2) and load torque ((N m)^2) that is noise of their sensors.

    Second differences of errors are regressed on those of the motor's response to the inputs' roughness, beside all that a
    change of the parameters would do; blocks of time tell the scatter.

    Args:
        model: along which noise of the inputs shows.
        run: the recording.
        r: its position.
        linear: the motor linearised along it.
        error: (N, C) beside the inputs as recorded.
        columns: (N, C, k) sensitivities to the parameters.
        used: (N, C) samples that count.
    """
    least = np.zeros(2)
    inputs = (run.inputs.voltage_V, run.inputs.load_torque_Nm)
    rough = [u - smoothed(u, step) for u, step in zip(inputs, run.input_step, strict=True)]
    rough[1] = rough[1] * ("load_torque" in run.known)
    if run.inputs.terminal is not None:
        # What the sensor shows of terminals that nothing drives drives no simulation.
        rough[0] = rough[0] * (run.inputs.terminal == Terminal.DRIVEN)
    there = [which for which in range(2) if np.any(rough[which])]
    if not there:
        return least
    nothing = np.zeros(len(error))
    responses = [
        -response_to_inputs(model, run, r, linear, *(rough[q] if q == which else nothing for q in range(2)))
        for which in there
    ]
    table = np.concatenate([np.stack(responses, axis=2), columns, error[:, :, None]], axis=2)
    second = np.diff(table, 2, axis=0)
    second[~(used[2:] & used[1:-1] & used[:-2])] = 0.0
    # Every channel in units of its own error.
    size = np.sqrt(np.mean(second[:, :, -1] ** 2, axis=0))
    second /= np.where(size > 0, size, np.inf)[:, None]
    x, y = second[:, :, :-1].reshape(-1, second.shape[2] - 1), second[:, :, -1].ravel()
    gram = x.T @ x
    power = np.diagonal(gram)
    inverse = np.linalg.pinv(gram + np.diag(RIDGE * power + (power == 0)), hermitian=True)
    told = inverse @ (x.T @ y)
    scores = x * (y - x @ told)[:, None]
    pieces = np.add.reduceat(scores, np.arange(0, len(scores), PIECE * second.shape[1]), axis=0)
    sd = np.sqrt(np.diagonal(inverse @ (pieces.T @ pieces) @ inverse))
    share = np.clip(told - DEVIATIONS * sd, 0.0, 1.0)[: len(there)]
    # Of white noise, second differences have six times its variance; of what lasts, next to nothing.
    least[there] = share * [np.mean(np.diff(rough[which], 2) ** 2) / 6 for which in there]
    return least
