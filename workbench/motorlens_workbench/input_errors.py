"""What errors of the measured inputs feign: their noise drives the simulation, but it did not drive the motor."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.threads import on_all_cores
from motorlens_workbench.candidates import Candidate
from motorlens_workbench.evidence import Evidence
from motorlens_workbench.fitting import Fit, Prior
from motorlens_workbench.model import Model, predict
from motorlens_workbench.run import Run
from motorlens_workbench.screen import Addition, Columns, columns_of, products_with
from motorlens_workbench.whitening import Whitener

Array = NDArray[np.float64]


def without_input_errors(
    evidence: Evidence,
    found: Fit,
    runs: Sequence[Run],
    whiteners: Sequence[Whitener],
    listed: Sequence[Candidate],
    free: Sequence[Addition],
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
    free: Sequence[Addition],
    with_decoys: bool,
) -> Array:
    """(2, B, m) products of every column with the residual that errors of the inputs alone would leave, drawn twice.

    Those errors drive the simulation but not the motor, and are in residual and columns alike (errors in variables). The
    present model is taken for the truth and its inputs are disturbed as much again: simulation extrapolation after Cook and
    Stefanski (1994), doi:10.1080/01621459.1994.10476871. What is odd in the errors is no bias; there remain the even part of
    the columns times the even part of the residual, and odd times odd. The residual is simulated for the errors and for the
    same the other way, which tells its parts apart. The many columns are simulated one way only: the mean of both draws
    stands for their even part, half their difference for the odd part of either, less that of the other, which goes
    with nothing in the one's residual.
    """
    truths = [run.average(predict(model, run, r)[1]) for r, run in enumerate(runs)]

    def disturbed(draw: int) -> tuple[list[Columns], list[Array], list[Array]]:
        """Columns, and the even and the odd part of the residual, of each run."""
        columns, even, odd = [], [], []
        for r, (run, truth) in enumerate(zip(runs, truths, strict=True)):
            there, back = (run.stirred(draw, sign) for sign in (1.0, -1.0))
            one = columns_of(model, there, r, prior.keys, prior.sd, listed, free, with_decoys)
            plus = truth + one.residual - there.average(there.measured)
            minus = truth - back.average(predict(model, back, r)[1])
            columns.append(one)
            even.append((plus + minus) / 2)
            odd.append((plus - minus) / 2)
        return columns, even, odd

    (first, *of_first), (second, *of_second) = on_all_cores(disturbed, range(2))
    even, odd = (
        [np.stack(pair, axis=-1) for pair in zip(*both, strict=True)]
        for both in zip(of_first, of_second, strict=True)
    )
    for one, other in zip(first, second, strict=True):
        # In place, for a table may fill hundreds of megabytes: their mean, and half their difference.
        other.table[:] -= one.table
        other.table[:] *= -0.5
        one.table[:] -= other.table
    of_mean = products_with(first, even, runs, whiteners)
    of_half = products_with(second, odd, runs, whiteners)
    return np.moveaxis(of_mean + of_half * [2.0, -2.0], -1, 0)
