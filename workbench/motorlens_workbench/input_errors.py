"""What errors of the measured inputs feign: their noise drives the simulation, but it did not drive the motor."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.simulation import cores
from motorlens_workbench.candidates import Candidate
from motorlens_workbench.evidence import Evidence
from motorlens_workbench.fitting import Fit, Prior
from motorlens_workbench.model import Model, predict
from motorlens_workbench.run import Run
from motorlens_workbench.screen import Free, columns_of, products_with_residual
from motorlens_workbench.whitening import Whitener

Array = NDArray[np.float64]

# How often the inputs are disturbed, each time both ways, to see what that alone would feign.
DRAWS = 2


def without_input_errors(
    evidence: Evidence,
    found: Fit,
    runs: Sequence[Run],
    whiteners: Sequence[Whitener],
    listed: Sequence[Candidate],
    free: Sequence[Free],
    with_decoys: bool,
) -> Evidence:
    """The evidence without what errors of the measured inputs put into it; itself if there are none worth a thought."""
    if not any(run.disturbed for run in runs):
        return evidence
    return evidence.less(feigned(found.model, found.prior, runs, whiteners, listed, free, with_decoys))


def feigned(
    model: Model,
    prior: Prior,
    runs: Sequence[Run],
    whiteners: Sequence[Whitener],
    listed: Sequence[Candidate],
    free: Sequence[Free],
    with_decoys: bool,
) -> Array:
    """(DRAWS, B, M) products of every column with the residual that errors of the measured inputs alone would leave.

    Those errors drive the simulation but not the motor, and are in residual and columns alike (errors in variables). The
    present model is taken for the truth and its inputs are disturbed as much again: simulation extrapolation after Cook and
    Stefanski (1994), doi:10.1080/01621459.1994.10476871, to first order. Each is taken both ways, so that what is
    odd in it, which is no bias, cancels.
    """
    truths = [run.average(predict(model, run, r)[1]) for r, run in enumerate(runs)]

    def disturbed(which: tuple[int, float]) -> Array:
        moved = [run.stirred(*which) for run in runs]
        columns = []
        for r, (truth, other) in enumerate(zip(truths, moved, strict=True)):
            one = columns_of(model, other, r, prior.keys, prior.sd, listed, free, with_decoys)
            one.residual[:] += truth - other.average(other.measured)
            columns.append(one)
        return products_with_residual(columns, moved, whiteners)

    draws = [(draw, sign) for draw in range(DRAWS) for sign in (1.0, -1.0)]
    with ThreadPoolExecutor(cores()) as pool:
        found = np.array(list(pool.map(disturbed, draws)))
    return np.asarray(found.reshape(DRAWS, 2, *found.shape[1:]).mean(axis=1))
