"""A contact that comes and goes: spells of more resistance, too short and too irregular for any curve.

While a contact is bad the electrical equation lacks a voltage that goes with the current, always on the side of more
resistance; noise lies on both sides alike. What stands out, stands out from robust fits of the run and of each stretch of
it (Huber 1964, doi:10.1214/aoms/1177703732), so that a model that is a little wrong does not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.model import Model
from motorlens_physics.estimate.run import Run
from motorlens_physics.scenario import time_constants
from motorlens_physics.simulation import Trajectory
from motorlens_workbench.balances import filter_times, lowpass, missing_of
from motorlens_workbench.bend import Bend
from motorlens_workbench.variation import Variation

Array = NDArray[np.float64]

# Samples of a stretch of time that is fitted by itself, and how many stretches there are at most.
STRETCH, MOST = 60, 24
# Filter times for which the voltage must have kept to this share of its effective value: where the motor has just been
# driven elsewhere, what a sensor lags by goes with the current too.
STEADY, KEPT = 10, 0.05
# Share of the effective current from which on a current would show a bad contact.
CARRIES = 0.3
# Standard deviations from which on a sample stands out.
BEYOND = 6.0
# How many spells there must be, how many times as many samples must stand out as on the side of less resistance, and how
# their voltage must go with the current (correlation): spikes of a sensor do not.
LEAST, ONE_SIDED, GOES_WITH = 8, 4.0, 0.65
# Samples of the stretch of time that is shown.
SHOWN = 80
# Bound of Huber's weights, standard deviations, and how often they are renewed.
HUBER, ROUNDS = 1.5, 5


@dataclass(frozen=True)
class Spells(Variation):
    """The armature's resistance while a contact comes and goes.

    Attributes:
        run: name of the recording in which it shows most.
        by: how much more it is then, Ohm.
        share: of the time.
    """

    run: str
    by: float
    share: float


@dataclass(frozen=True)
class _Lacking:
    """What the electrical equation of a run lacks, M samples.

    Attributes:
        run: the run.
        time_s: (M,).
        current_A: (M,).
        voltage_V: (M,) beyond a robust fit of its stretch of time.
        scale_V: (M,) robust standard deviation of its stretch.
        steady: (M,) whether the voltage had been steady.
    """

    run: Run
    time_s: Array
    current_A: Array
    voltage_V: Array
    scale_V: Array
    steady: NDArray[np.bool_]

    @property
    def carrying(self) -> NDArray[np.bool_]:
        """(M,) whether a bad contact would show."""
        flows = np.abs(self.current_A) > CARRIES * np.sqrt(np.mean(self.current_A**2))
        return np.asarray(self.steady & flows)

    @property
    def deviations(self) -> Array:
        """(M,) in standard deviations, positive on the side of more resistance."""
        return self.voltage_V * np.sign(self.current_A) / self.scale_V

    @property
    def spells(self) -> int:
        """How many there are: neighbours that stand out belong together."""
        out = self.carrying & (self.deviations > BEYOND)
        return int(np.sum(out[1:] & ~out[:-1]) + np.sum(out[:1]))


def loose_contact(
    model: Model, runs: Sequence[Run], predictions: Sequence[tuple[Trajectory, Array]]
) -> Bend | None:
    """The resistance against time where a contact comes and goes; None where none does.

    Args:
        model: a fitted model.
        runs: prepared recordings; those without current or speed say nothing, nor do very short ones.
        predictions: of every run, from that model, see `predict`.
    """
    looked = [
        _lacking(model, run, r, *predicted)
        for r, (run, predicted) in enumerate(zip(runs, predictions, strict=True))
        if {"current", "speed"} <= {*run.channels}
    ]
    seen = [one for one in looked if one is not None]
    if not seen:
        return None
    z, current, voltage = (
        np.concatenate([getattr(one, what)[one.carrying] for one in seen])
        for what in ("deviations", "current_A", "voltage_V")
    )
    out = z > BEYOND
    if sum(one.spells for one in seen) < LEAST or np.sum(out) < ONE_SIDED * np.sum(z < -BEYOND):
        return None
    if not np.corrcoef(current[out], voltage[out])[0, 1] > GOES_WITH:
        return None
    most = max(seen, key=lambda one: int(np.sum(one.deviations[one.carrying] > BEYOND)))
    return _shown(most, model, float(np.sum(z[out] ** 2)))


def _lacking(model: Model, run: Run, r: int, trajectory: Trajectory, predicted: Array) -> _Lacking | None:
    tau = filter_times(run, time_constants(model.file.motor))["electrical"]
    time = run.inputs.time_s
    # A voltage that is missing on the side of the drop.
    drop = -missing_of(model, run, r, trajectory, predicted)["electrical"]
    current, speed = (
        lowpass(run.measured[:, run.channels.index(channel)], time, tau) for channel in ("current", "speed")
    )
    step = max(1, round(tau / run.period_s))
    at = np.arange(20 * step, len(time), step)
    at = at[run.valid[at]]
    if len(at) < STRETCH:
        return None
    voltage = lowpass(run.inputs.voltage_V, time, tau)
    moved = np.abs(voltage - np.concatenate([np.full(STEADY * step, voltage[0]), voltage[: -STEADY * step]]))
    steady = moved < KEPT * np.sqrt(np.mean(voltage**2))
    # What the model has a little wrong: over the run as a whole, then a resistance that warms. With more terms, two levels
    # of a current that is steady otherwise would lie on one line.
    terms = np.column_stack([np.ones_like(current), current, speed, np.gradient(current)])
    drop[at] = robust(terms[at], drop[at])[0]
    parts = [np.zeros((0, 3))]
    for stretch in np.array_split(at, max(min(MOST, len(at) // STRETCH), 1)):
        beyond, scale = robust(current[stretch, None], drop[stretch])
        parts.append(np.column_stack([stretch, beyond, np.full(len(stretch), scale)]))
    used, beyond, scales = np.concatenate(parts).T
    at = used.astype(int)
    return _Lacking(run, time[at], current[at], beyond, scales, steady[at])


def robust(terms: Array, y: Array) -> tuple[Array, float]:
    """Residuals (M,) of a robust fit of y (M,) by terms (M, k), and their standard deviation by the median."""
    weights = np.ones(len(y))
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        error = y - terms @ np.linalg.lstsq(terms * root[:, None], y * root, rcond=None)[0]
        scale = 1.4826 * float(np.median(np.abs(error))) + 1e-12 * float(np.max(np.abs(y), initial=1e-300))
        weights = 1 / np.maximum(1.0, np.abs(error) / (HUBER * scale))
    return error, scale


def _shown(seen: _Lacking, model: Model, gain: float) -> Bend:
    kept = seen.carrying
    time, z = seen.time_s[kept], seen.deviations[kept]
    more, sd = (seen.voltage_V / seen.current_A)[kept], (seen.scale_V / np.abs(seen.current_A))[kept]
    spells = z > BEYOND
    # Spells shorter than the filter look smaller than they are.
    by = float(np.quantile(more[spells], 0.75))
    counts = np.convolve(spells, np.ones(min(SHOWN, len(spells))), mode="valid")
    window = slice(int(np.argmax(counts)), int(np.argmax(counts)) + SHOWN)
    unit = model.file.meaning("R_a0").unit
    share = float(np.mean(more > 0.5 * by))
    curve = Spells("R_a0", "electrical", unit, "time", time[window], seen.run.name, by, share)
    excess = (spells.sum() - np.sum(z < -BEYOND)) / np.sqrt(spells.sum())
    return Bend(curve, gain, float(excess), float(np.max(z) ** 2), time[window], more[window], sd[window])
