"""A sensor's answers against the truth, world by world and by the cells of every factor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from helpers.worlds.world import FACTORS, Array, Recorded, World

OUTPUTS = ("speed", "temperature", "resistance")
# Confidently wrong: by more than so many stated deviations and more than this, in more than a hundredth of the good samples.
DEVIATIONS, SIZES, SHARE = 4.0, np.array([0.5, 1.0, 0.014]), 0.01


@dataclass(frozen=True)
class Verdict:
    """One world, over the samples that count: share that is good; of those: rms and largest error, share within 1.96 stated
    deviations, share confidently wrong, by output (3,) each (NaN where none is good)."""

    world: World
    good: float
    rms: Array
    largest: Array
    covered: Array
    wrong: Array

    @property
    def confidently_wrong(self) -> bool:
        """Whether it says good and is wrong."""
        return bool((np.nan_to_num(self.wrong) > SHARE).any())


def verdict(world: World, recorded: Recorded, rows: Array, values: Array, sds: Array, good: Array) -> Verdict:
    """Judge answers (M, 3) with their deviations at some rows of a recording; `good` (M,) is whether the quality says so."""
    counted = recorded.counted[rows]
    error = np.abs(values - recorded.truth[rows])
    kept = counted & good
    if not kept.any():
        nothing = np.full(3, np.nan)
        return Verdict(world, 0.0, nothing, nothing, nothing, nothing)
    e, s = error[kept], sds[kept]
    wrong = ((e > DEVIATIONS * s) & (e > SIZES)) | ~np.isfinite(e)
    return Verdict(
        world, float(kept.sum() / counted.sum()), np.sqrt((e**2).mean(0)), e.max(0), (e <= 1.96 * s).mean(0), wrong.mean(0)
    )  # fmt: skip


def table(verdicts: Sequence[Verdict]) -> str:
    """One line a cell: worlds, how many are confidently wrong, share of good samples, median and worst errors, cover."""
    head = (
        f"{'factor':<11}{'cell':<12}{'worlds':>7}{'wrong':>6}{'good %':>8}{'rad/s':>8}{'worst':>8}{'K':>8}{'worst':>8}"
        f"{'in 95 %':>9}{'K in 95 %':>10}{'worst world':>14}"
    )
    lines = [head]
    for factor, cells in {"all": ("",), **FACTORS}.items():
        for cell in cells:
            part = [v for v in verdicts if factor == "all" or v.world.factors[factor] == cell]
            if part:
                lines.append(f"{factor:<11}{cell:<12}" + _cells(part))
    return "\n".join(lines)


def _cells(part: Sequence[Verdict]) -> str:
    seen = [v for v in part if v.good > 0]
    wrong = sum(v.confidently_wrong for v in part)
    good = 100 * np.mean([v.good for v in part])
    text = f"{len(part):>7}{wrong:>6}{good:>8.1f}"
    if not seen:
        return text
    rms = np.array([v.rms for v in seen])
    weights = np.array([v.good for v in seen])
    covered = 100 * np.average([v.covered for v in seen], axis=0, weights=weights)
    worst = max(seen, key=lambda v: float(v.wrong.max() + 1e-3 * v.rms[1]))
    return text + (
        f"{np.median(rms[:, 0]):>8.2g}{rms[:, 0].max():>8.3g}{np.median(rms[:, 1]):>8.2g}{rms[:, 1].max():>8.3g}"
        f"{covered[0]:>9.1f}{covered[1]:>10.1f}{worst.world.seed[-1]:>14}"
    )
