"""Many worlds in one table: a line for every cell of every factor."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from motorlens_physics.motor_file import MotorFile
from motorlens_runtime.errors import DataError
from motorlens_train.evaluation.worlds.drive import Drive
from motorlens_train.evaluation.worlds.judge import Sensing, Verdict, verdicts
from motorlens_train.evaluation.worlds.plant import Array
from motorlens_train.evaluation.worlds.world import FACTORS

# As many as make some ten in a cell of a factor of six.
WORLDS = 60


def cells_in_worlds(
    sensor: Sensing, file: MotorFile, count: int, seed: int, done: Callable[[int], None] = lambda number: None
) -> list["Cell"]:
    """The table of a sensor in `count` worlds of its motor, drawn from a seed.

    Raises:
        DataError: it has no observer, or the motor has no inductance.
    """
    if sensor.bank.distrust is None:
        raise DataError(
            "worlds are for sensors with an observer inside; this one takes its motor to have started cold: evaluate it on "
            "recordings"
        )
    if file.motor.L <= 0:
        raise DataError(f"{file.name}: worlds need the motor's inductance: set L in its file")
    return cells(list(verdicts(sensor, Drive.of(file), count, seed, done)))


@dataclass(frozen=True)
class Cell:
    """The worlds of one cell of a factor.

    Attributes:
        factor, name: of the cell.
        worlds, wrong: how many, and in how many the sensor is confidently wrong.
        good: share of good samples.
        rms, worst, covered: (2,) each, of speed (rad/s) and rise (K): median and worst rms error, and share of the good
            samples within 1.96 stated deviations; NaN where none is good.
        worst_world: its number.
    """

    factor: str
    name: str
    worlds: int
    wrong: int
    good: float
    rms: Array
    worst: Array
    covered: Array
    worst_world: int

    def document(self) -> dict[str, object]:
        """As JSON; what is not known is null."""

        def numbers(values: Array) -> list[float | None]:
            return [float(f"{v:.3g}") if np.isfinite(v) else None for v in values]

        return {
            "factor": self.factor, "cell": self.name, "worlds": self.worlds, "wrong": self.wrong,
            "good": float(f"{self.good:.3g}"), "rms": numbers(self.rms), "worst": numbers(self.worst),
            "coverage_95": numbers(self.covered), "worst_world": self.worst_world,
        }  # fmt: skip


def cells(verdicts: Sequence[Verdict]) -> list[Cell]:
    """All worlds, then the cells of every factor that have any."""
    groups = [("all", "", list(verdicts))]
    for factor, names in FACTORS.items():
        groups += [(factor, name, [v for v in verdicts if v.world.factors[factor] == name]) for name in names]
    return [_cell(factor, name, part) for factor, name, part in groups if part]


def text(found: Sequence[Cell]) -> str:
    """One line a cell."""
    lines = [
        f"{'factor':<11}{'cell':<12}{'worlds':>7}{'wrong':>6}{'good %':>8}{'rad/s':>8}{'worst':>8}{'K':>8}{'worst':>8}"
        f"{'in 95 %':>9}{'K in 95 %':>10}{'worst world':>14}"
    ]
    for c in found:
        line = f"{c.factor:<11}{c.name:<12}{c.worlds:>7}{c.wrong:>6}{100 * c.good:>8.1f}"
        if np.isfinite(c.rms).all():
            line += (
                f"{c.rms[0]:>8.2g}{c.worst[0]:>8.3g}{c.rms[1]:>8.2g}{c.worst[1]:>8.3g}"
                f"{100 * c.covered[0]:>9.1f}{100 * c.covered[1]:>10.1f}{c.worst_world:>14}"
            )
        lines.append(line)
    return "\n".join(lines)


def _cell(factor: str, name: str, part: Sequence[Verdict]) -> Cell:
    seen = [v for v in part if v.good > 0]
    wrong, good = sum(v.confidently_wrong for v in part), float(np.mean([v.good for v in part]))
    if not seen:
        nothing = np.full(2, np.nan)
        return Cell(factor, name, len(part), wrong, good, nothing, nothing, nothing, part[0].world.seed[-1])
    rms = np.array([v.rms[:2] for v in seen])
    covered = np.average([v.covered[:2] for v in seen], axis=0, weights=[v.good for v in seen])
    worst = max(
        seen, key=lambda v: float(np.nan_to_num(v.wrong).max() + 1e-3 * np.nan_to_num(v.rms[:2]).max())
    )
    return Cell(
        factor,
        name,
        len(part),
        wrong,
        good,
        np.median(rms, axis=0),
        rms.max(0),
        covered,
        worst.world.seed[-1],
    )
