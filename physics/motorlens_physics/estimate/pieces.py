"""Pieces of long recordings: what a few thousand samples tell is sought in as many, and the rest is looked at in the end.

How inputs ran between samples, delays, the noise and the parameters that act within seconds show in any lively piece. From
there, all samples are a few steps away.
"""

from collections.abc import Sequence
from dataclasses import replace

from motorlens_physics.estimate.fit import start_model
from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.prior import Prior, nuisance_prior
from motorlens_physics.estimate.run import Run

# Recordings longer than this share of a piece are cut.
LONGER = 1.5


def pieces_of(model: Model, runs: Sequence[Run], rows: int) -> tuple[Model, tuple[Run, ...]]:
    """The liveliest piece of each run of many more than `rows` samples, and the model starting there; others as they are."""
    pieces = tuple(
        run.part(run.liveliest(rows, model.file.motor), model.file)
        if len(run.measured) > LONGER * rows
        else run
        for run in runs
    )
    return starting_as(model, start_model(model.file, pieces), cut(runs, pieces)), pieces


def cut(runs: Sequence[Run], pieces: Sequence[Run]) -> list[bool]:
    """Which runs have more samples than their piece."""
    return [len(piece.measured) < len(run.measured) for run, piece in zip(runs, pieces, strict=True)]


def starting_as(found: Model, begin: Model, which: Sequence[bool]) -> Model:
    """A model of which some runs start as in another."""
    own = [
        {**one, **{name: y for name, y in first.items() if name.startswith("initial.")}} if other else one
        for one, first, other in zip(found.own, begin.own, which, strict=True)
    ]
    return replace(found, own=tuple(own))


def prior_of(prior: Prior, model: Model, pieces: Sequence[Run], which: Sequence[bool]) -> Prior:
    """What is known of pieces of runs: as of the runs, but for where those that were cut start."""
    own = nuisance_prior(model.file, pieces)
    starts = [
        key
        for key in own.keys
        if key in prior.sd and key.startswith("initial.") and which[int(key.partition("@")[2])]
    ]
    return prior.joined(own.only(starts))


def as_found(run: Run, piece: Run) -> Run:
    """A run with its channels moved, its inputs held and its speed taken as those of its piece."""
    for channel, samples in piece.late.items():
        run = run.delayed(channel, samples - run.late.get(channel, 0))
    return run.holding(piece.inputs.hold).showing(piece.mean_speed)
