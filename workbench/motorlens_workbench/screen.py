"""One pass over the runs: every base parameter, candidate, free curve and decoy as whitened columns, summed by blocks.

A column of the evidence is the change of all measured channels per typical size of its candidate (a free curve's per unit of
its balance), so that sizes read off it are in typical sizes.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.effect import Effect
from motorlens_physics.estimate.fit import Fit, usable
from motorlens_physics.estimate.forcing import Forcing, forcing
from motorlens_physics.estimate.model import (
    TOLERANCE,
    Model,
    error_of,
    inputs_of,
    motor_of,
    sensitivities_of,
    shown,
    start_of,
    through_sensors,
    with_sensor,
)
from motorlens_physics.estimate.noise import VOLTAGE
from motorlens_physics.estimate.run import STATE_OF, Run
from motorlens_physics.estimate.whitening import Whitener
from motorlens_physics.sensitivity import INITIAL, Linearisation, linearise
from motorlens_physics.sensor_model import SensorModel
from motorlens_physics.simulation import Trajectory
from motorlens_physics.threads import on_all_cores
from motorlens_workbench.candidates import Candidate, decoys
from motorlens_workbench.evidence import RESIDUAL, Evidence, statistics

Array = NDArray[np.float64]


class Addition(Protocol):
    """What adds to the balances, as columns: a free curve, the course of a parameter, a part of an effect."""

    def columns(self) -> list[str]:
        """Names of the columns, k of them."""

    def forcing(self, trajectory: Trajectory) -> Forcing:
        """What a unit of each adds to the balances along a trajectory, (N, k) each."""


BLOCKS = 64
# Columns carried at once, so that memory stays small on long recordings.
CHUNK = 48


@dataclass(frozen=True)
class Columns:
    """Unwhitened columns of one run, averaged rows.

    Attributes:
        names: of the columns.
        table: (rows, C, m + 1), the residual last.
    """

    names: tuple[str, ...]
    table: Array

    @property
    def values(self) -> Array:
        """(rows, C, m)."""
        return self.table[:, :, :-1]

    @property
    def residual(self) -> Array:
        """(rows, C)."""
        return self.table[:, :, -1]


@dataclass(frozen=True)
class Line:
    """The linearised problem of one run: its trajectory and how forcings show in the measured channels."""

    model: Model
    run: Run
    r: int
    trajectory: Trajectory
    respond: Callable[..., Array]

    @classmethod
    def of(cls, model: Model, run: Run, r: int) -> "Line":
        """Linearise the model along a run."""
        trajectory, linearisation = linearise(
            motor_of(model, run),
            inputs_of(model, run, r),
            start_of(model, r),
            tolerance=TOLERANCE,
            smooth=True,
        )
        return cls.along(model, run, r, trajectory, linearisation)

    @classmethod
    def along(
        cls, model: Model, run: Run, r: int, trajectory: Trajectory, linearisation: Linearisation
    ) -> "Line":
        """The problem of a model that was linearised already."""
        if run.shaft is not None:
            # Forcings of the shaft angle follow the known one, which does not drift.
            trajectory = replace(trajectory, states={**trajectory.states, "phi": run.shaft["phi"]})

        def respond(
            voltage: Array, torque: Array, heat: Array, *, held: bool | tuple[bool, bool, bool] = False
        ) -> Array:
            states = linearisation.respond(voltage_V=voltage, torque_Nm=torque, heat_W=heat, held=held)
            stacked = np.stack([states[STATE_OF[channel]] for channel in run.channels], axis=1)
            return run.average(through_sensors(model, run, stacked))

        return cls(model, run, r, trajectory, respond)

    def of_forcings(self, forcings: Sequence[Forcing]) -> Array:
        """(rows, C, m) responses to m forcings."""
        if not forcings:
            return np.zeros((len(self.run), len(self.run.channels), 0))
        return self.respond(
            np.column_stack([f.voltage for f in forcings]),
            np.column_stack([f.torque for f in forcings]),
            np.column_stack([f.heat for f in forcings]),
        )

    def of_effect(self, effects: Sequence[Effect]) -> Array:
        """(rows, C, m) what effects at their present sizes would change."""
        nothing = np.zeros(len(self.trajectory.inputs.time_s))
        return self.of_forcings(
            [
                forcing(effect, self.trajectory)
                if self.run.turns or not effect.turns()
                else Forcing(nothing, nothing, nothing)
                for effect in effects
            ]
        )

    def of_sensor(self, sensor: SensorModel) -> Array:
        """(rows, C) what a fault of this size would change."""
        run, model = self.run, self.model
        if sensor.channel in run.channels:
            y = np.column_stack([self.trajectory.states[STATE_OF[c]] for c in run.channels])
            if "temperature" in run.channels:
                y[:, run.channels.index("temperature")] += self.trajectory.inputs.ambient_C
            before = shown(model, run, self.r, y)
            return run.average(shown(with_sensor(model, sensor), run, self.r, y) - before)
        there = inputs_of(with_sensor(model, sensor), run, self.r)
        here = self.trajectory.inputs
        still = np.zeros((len(here.time_s), 1))
        return self.respond(
            (there.voltage_V - here.voltage_V)[:, None],
            (here.load_torque_Nm - there.load_torque_Nm)[:, None],
            still,
            held=here.hold,
        )[:, :, 0]

    def of_curve(self, curve: Addition) -> Array:
        """(rows, C, k) responses to the hat functions of a free curve."""
        added = curve.forcing(self.trajectory)
        return self.respond(added.voltage, added.torque, added.heat)


def columns_of(
    model: Model,
    run: Run,
    r: int,
    keys: Sequence[str],
    scales: Mapping[str, float],
    listed: Sequence[Candidate],
    free_curves: Sequence[Addition],
    with_decoys: bool = True,
) -> Columns:
    """All columns of one run.

    Args:
        model: linearised about.
        run: prepared recording.
        r: its position.
        keys: parameters of the model, base and accepted.
        scales: unit of each key's column, such as its prior's standard deviation.
        listed: candidates.
        free_curves: free curves.
        with_decoys: whether to add decoys.
    """
    mine = [key for key in keys if "@" not in key or key.endswith(f"@{r}")]
    trajectory, y, derivative, linearisation = sensitivities_of(model, run, r, mine)
    line = Line.along(model, run, r, trajectory, linearisation)
    sensors = [candidate for candidate in listed if candidate.kind == "sensor"]
    effects = {
        label: part
        for candidate in listed
        for variant, labels in zip(candidate.variants, candidate.columns(), strict=True)
        for part, label in zip(variant, labels, strict=True)
        if isinstance(part, Effect)
    }
    false = decoys(line.trajectory) if with_decoys else {}
    names = [*keys, *effects, *(candidate.columns()[0][0] for candidate in sensors)]
    names += [label for curve in free_curves for label in curve.columns()]
    names += false
    shape = (len(run), len(run.channels))
    own = np.zeros((*shape, len(keys)))
    own[:, :, [keys.index(key) for key in mine]] = run.average(derivative) * [scales[key] for key in mine]
    parts = [own, *(line.of_effect(chunk) for chunk in _chunks(list(effects.values())))]
    for candidate in sensors:
        sensor = candidate.variants[0][0]
        assert isinstance(sensor, SensorModel)
        seen = sensor.channel in (*run.channels, "voltage", *run.known)
        parts.append((line.of_sensor(sensor) if seen else np.zeros(shape))[:, :, None])
    parts += [line.of_curve(curve) for curve in free_curves]
    error = error_of(model, run, r, run.measured - y, linearisation)
    parts += [line.of_forcings(list(false.values())), run.average(error)[:, :, None]]
    return Columns(tuple(names), np.concatenate(parts, axis=2))


def _chunks(effects: list[Effect]) -> Iterator[list[Effect]]:
    for k in range(0, len(effects), CHUNK):
        yield effects[k : k + CHUNK]


def layout(runs: Sequence[Run], whiteners: Sequence[Whitener]) -> list[tuple[int, slice]]:
    """The blocks of time: which run, which of its averaged rows."""
    total = sum(len(run) for run in runs)
    found = []
    for r, (run, whitener) in enumerate(zip(runs, whiteners, strict=True)):
        rows = len(run)
        wanted = max(round(BLOCKS * rows / total), 24)
        length = max(-(-rows // wanted), 2 * whitener.order + 8)
        found += [(r, slice(start, min(start + length, rows))) for start in range(0, rows, length)]
    return found


def evidence_of(columns: Sequence[Columns], runs: Sequence[Run], whiteners: Sequence[Whitener]) -> Evidence:
    """Whiten all columns and sum their products by blocks of time."""
    names = columns[0].names
    blocks, samples = [], []
    noise = np.zeros(len(names) + 1)
    for r, (one, run, whitener) in enumerate(zip(columns, runs, whiteners, strict=True)):
        kept = usable(run, whitener)
        # Noise of the inputs is in what changes from sample to sample.
        rough = np.sum(np.diff(one.table, axis=0) ** 2, axis=0) / 2
        noise += noise_share(run) * np.sum(rough / whitener.sigma[:, None] ** 2, axis=0)
        pieces = [rows for k, rows in layout(runs, whiteners) if k == r]
        for rows, part in zip(pieces, whitener.pieces(one.table, pieces), strict=True):
            flat = part[kept[rows]].reshape(-1, len(names) + 1)
            blocks.append(flat.T @ flat)
            samples.append(float(kept[rows].sum()))
    return replace(Evidence.of(names, np.array(blocks), np.array(samples)), noise=noise)


# The share of an input's noise that its corrections are taken to leave; not derived, chosen between 0.25, where a kept case
# with nothing missing was called faulty, and 1, where a wrong scale of a sensor was not named.
LEFT = 0.5


def noise_share(run: Run) -> float:
    """The share of what a run's voltage changes from sample to sample that is noise of its sensor.

    Columns are taken along the voltage as it was measured, corrected as well as can be, and hold as much of that noise.
    """
    if run.noise is None:
        return 0.0
    changes = float(np.mean(np.diff(run.inputs.voltage_V) ** 2))
    return min(LEFT * 2 * float(run.noise.disturbances[VOLTAGE]) / max(changes, 1e-300), 1.0)


# How many columns the noise model may first take out, and the statistic that entitles a column to it.
TAKEN_OUT, ENTITLED = 10, 20.0


def unexplained(
    columns: Sequence[Columns], runs: Sequence[Run], plain: Sequence[Whitener], base: Sequence[str]
) -> tuple[list[Array], int]:
    """Residuals that neither the base parameters nor the strongest few columns explain, and how many were spent.

    The noise is taken from here: from the base residual, a missing effect would hide in the noise model. Taking out every
    column there is would take the slow part of the noise along, and the noise model would then believe that there is none.
    """
    evidence = evidence_of(columns, runs, plain)
    left = evidence.given(base)
    strongest: list[str] = []
    for _ in range(TAKEN_OUT):
        tests = statistics(left, strongest)
        best = int(np.argmax(tests))
        if not tests[best] > ENTITLED:
            break
        strongest.append(left.names[best])
    spent = [*base, *strongest]
    at = evidence.index(spent)
    coefficient, _ = evidence.solve(spent)
    return [one.residual - one.values[:, :, at] @ coefficient for one in columns], len(spent)


def all_columns(
    found: Fit,
    runs: Sequence[Run],
    listed: Sequence[Candidate],
    free_curves: Sequence[Addition],
    with_decoys: bool = True,
) -> list[Columns]:
    """The columns of every run in one pass."""
    scales = dict(found.prior.sd)

    def of_run(r: int) -> Columns:
        return columns_of(found.model, runs[r], r, found.prior.keys, scales, listed, free_curves, with_decoys)

    return on_all_cores(of_run, range(len(runs)))


def errors_by_block(found: Fit, runs: Sequence[Run]) -> Array:
    """(B,) whitened squared error of each block of time."""
    white = []
    for run, whitener, residual in zip(runs, found.whiteners, found.residuals, strict=True):
        z = whitener(residual)
        z[~usable(run, whitener)] = 0.0
        white.append(np.sum(z**2, axis=1))
    return np.array([white[r][rows].sum() for r, rows in layout(runs, found.whiteners)])


def with_priors(evidence: Evidence, found: Fit) -> Evidence:
    """Add the priors of the fitted parameters, in units of their standard deviation."""
    values = found.model.values()
    centre = {key: (found.prior.centre[key] - values[key]) / width for key, width in found.prior.sd.items()}
    return evidence.with_prior(centre, {key: 1.0 for key in found.prior.keys})


def held_out_errors(
    found: Fit, runs: Sequence[Run], columns: Sequence[Columns], evidence: Evidence, folds: int = 6
) -> list[Array]:
    """Per run (rows, C), the error on each block of time with parameters that were not fitted to it.

    The blocks of a fold are spread evenly over the recordings, so that each fold sees every operating region; the fitted
    parameters are solved again, linearised, without each fold in turn.
    """
    keys = found.prior.keys
    blocks = layout(runs, found.whiteners)
    # Where a run started is told by its first block alone, and stays.
    moving = [key for key in keys if not key.startswith(INITIAL)]
    at = [keys.index(key) for key in moving]
    errors = [one.residual.copy() for one in columns]
    for fold in range(folds):
        kept = np.array([k >= len(blocks) or k % folds != fold for k in range(len(evidence.blocks))])
        part = replace(evidence, blocks=evidence.blocks[kept], samples=evidence.samples[kept])
        move, _ = part.solve(moving)
        for r, rows in (block for k, block in enumerate(blocks) if k % folds == fold):
            errors[r][rows] -= columns[r].values[rows][:, :, at] @ move
    return errors


def held_out_rmse(
    found: Fit, runs: Sequence[Run], columns: Sequence[Columns], evidence: Evidence, folds: int = 6
) -> dict[str, float]:
    """RMSE of each channel on blocks of time that the parameters were not fitted to, see `held_out_errors`."""
    squares: dict[str, list[Array]] = {}
    for run, error in zip(runs, held_out_errors(found, runs, columns, evidence, folds), strict=True):
        for c, channel in enumerate(run.channels):
            squares.setdefault(channel, []).append(error[run.fresh(), c] ** 2)
    return {channel: float(np.sqrt(np.mean(np.concatenate(parts)))) for channel, parts in squares.items()}


__all__ = [
    "RESIDUAL",
    "Columns",
    "Line",
    "all_columns",
    "evidence_of",
    "held_out_rmse",
    "layout",
    "unexplained",
    "with_priors",
]
