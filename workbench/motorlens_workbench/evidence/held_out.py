"""The error on blocks of time that the parameters were not fitted to, and what noise alone would leave."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from motorlens_physics.estimate.free_run import floor_of
from motorlens_physics.estimate.model import Model, predict
from motorlens_physics.estimate.run import Run
from motorlens_physics.sensitivity import INITIAL
from motorlens_workbench.evidence.ledger import Ledger
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

FOLDS = 6
# A direction of the parameters of which the other folds tell less than this share of what all do is told by one nearly
# alone. They tell nothing of what one block shows, half of what two blocks of different folds do, and five sixths of what
# all show alike: any share between nothing and a half tells the first from the others.
TOLD = 0.1


def held_out_errors(book: Ledger, lines: Sequence[Line]) -> list[Array]:
    """(N, C) of each run, the error on each block of time with parameters that were not fitted to it.

    The blocks of a fold are spread evenly over the recordings, so that each fold sees every operating region; the fitted
    parameters are solved again, linearised, without each fold in turn. What is told by one fold nearly alone stays, see
    `TOLD`: an inertia by the only start from rest. So does where a run started, which its first block tells.
    """
    moving = [k for k, key in enumerate(book.keys) if not key.startswith(INITIAL)]
    errors = [line.error.copy() for line in lines]
    folds = np.arange(len(book.blocks)) % FOLDS
    for fold in range(FOLDS):
        kept = book.base[folds != fold].sum(axis=0)
        known = np.eye(len(moving))
        gram, full = (of[np.ix_(moving, moving)] + known for of in (kept, book.base.sum(axis=0)))
        moves = dict(zip(moving, _moves(gram, full, kept[moving, -1] + book.pull[moving]), strict=True))
        for (r, rows), where in zip(book.blocks, folds, strict=True):
            if where != fold:
                continue
            steps = [moves.get(book.keys.index(key), 0.0) * book.unit[key] for key in lines[r].keys]
            errors[r][rows] -= lines[r].own[rows] @ np.array(steps)
    return errors


def _moves(gram: Array, full: Array, gradient: Array) -> Array:
    """Where parameters (k,) go without a fold, along what the others tell.

    Args:
        gram: information (k, k) of the other folds, with what is known beforehand.
        full: the same of all.
        gradient: (k,) of the others.

    >>> _moves(np.diag([5.0, 0.1]), np.diag([6.0, 6.0]), np.array([10.0, 10.0]))
    array([2., 0.])
    """
    scale = np.sqrt(np.diagonal(full))
    shares, along = eigh(gram / np.outer(scale, scale), full / np.outer(scale, scale))
    told = shares >= TOLD
    into = (along.T @ (gradient / scale))[told] / shares[told]
    return np.asarray(along[:, told] @ into / scale)


def held_out(book: Ledger, lines: Sequence[Line]) -> dict[str, float]:
    """RMSE of each channel on blocks of time that the parameters were not fitted to."""
    return _rmse([line.run for line in lines], held_out_errors(book, lines))


def fitted_errors(model: Model, runs: Sequence[Run]) -> dict[str, float]:
    """RMSE of each channel over runs, the model simulated freely along the inputs as measured.

    Raises:
        ModelError: it cannot be simulated.
    """
    along = [predict(model, replace(run, corrections=None), r)[1] for r, run in enumerate(runs)]
    return _rmse(runs, [run.measured - shown for run, shown in zip(runs, along, strict=True)])


def _rmse(runs: Sequence[Run], errors: Sequence[Array]) -> dict[str, float]:
    """Of each channel over runs, from errors (N, C) of each."""
    squares: dict[str, list[Array]] = {}
    for run, error in zip(runs, errors, strict=True):
        for c, channel in enumerate(run.channels):
            squares.setdefault(channel, []).append(error[run.there[:, c], c] ** 2)
    return {channel: float(np.sqrt(np.mean(np.concatenate(parts)))) for channel, parts in squares.items()}


def pooled_floor(uncorrected: Sequence[Line]) -> dict[str, float]:
    """The floor of each channel over runs along their inputs as measured, see `free_run.floor_of`."""
    squares: dict[str, list[tuple[float, int]]] = {}
    for line in uncorrected:
        run = line.run
        floors = floor_of(run, line.linear, run.measured - line.predicted)
        for channel, floor in zip(run.channels, floors, strict=True):
            squares.setdefault(channel, []).append((float(floor**2), len(run.measured)))
    return {
        channel: float(np.sqrt(sum(s * n for s, n in parts) / sum(n for _, n in parts)))
        for channel, parts in squares.items()
    }


def times_noise(book: Ledger, lines: Sequence[Line], floor: Mapping[str, float]) -> float:
    """The worst channel's error on blocks held out, over its noise, which is no smaller than is believed of a recording."""
    noise = _believed(lines, floor)
    return max(error / noise[channel] for channel, error in held_out(book, lines).items())


def by_run(book: Ledger, lines: Sequence[Line], floor: Mapping[str, float]) -> Array:
    """(R,) the share that each run has of the squared errors on blocks held out, over the noise of their channels."""
    noise = _believed(lines, floor)
    squares = [
        sum(
            float(np.sum(error[line.run.there[:, c], c] ** 2)) / noise[channel] ** 2
            for c, channel in enumerate(line.run.channels)
        )
        for line, error in zip(lines, held_out_errors(book, lines), strict=True)
    ]
    return np.asarray(squares) / max(sum(squares), 1e-300)


def _believed(lines: Sequence[Line], floor: Mapping[str, float]) -> dict[str, float]:
    """The noise of each channel, no smaller than is believed of a recording."""
    noise = dict(floor)
    for run in (line.run for line in lines):
        if run.noise is not None:
            believed = zip(run.channels, np.sqrt(run.noise.floor + run.steps**2 / 12).tolist(), strict=True)
            noise |= {channel: max(noise[channel], least) for channel, least in believed}
    return noise
