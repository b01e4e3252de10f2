"""A contact that comes and goes: spells of more resistance, too short and too irregular for any curve.

While a contact is bad the electrical equation lacks a voltage that goes with the current, always on the side of more
resistance; noise lies on both sides alike. What stands out, stands out from robust fits of the run and of each stretch of
it (Huber 1964, doi:10.1214/aoms/1177703732), so that a model that is a little wrong does not matter.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.estimate.run import Run
from motorlens_physics.scenario import time_constants
from motorlens_workbench.balances import filter_times, lowpass, missing_of
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

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
class Contact:
    """The armature's resistance while a contact comes and goes.

    Attributes:
        run: position of the recording in which it shows.
        recording: its name.
        unit: of the resistance.
        time_s: (M,) when the contact was looked at.
        missing_V: (M,) what the electrical equation lacks then, 0 where the contact is good.
        shown: part of these samples with the most spells: time in s, resistance beyond the usual, its standard deviation.
        by: how much more the resistance is while the contact is bad, Ohm.
        share: of the time.
    """

    run: int
    recording: str
    unit: str
    time_s: Array
    missing_V: Array
    shown: tuple[Array, Array, Array]
    by: float
    share: float
    term: str = "R_a0"
    equation: str = "electrical"
    against: str = "time"

    @property
    def width(self) -> int:
        """How many columns it has."""
        return 1

    def columns(self, line: Line) -> Array:
        """(N, C, 1) what the voltage that is lost in the contact would change."""
        voltage = np.zeros(len(line.error))
        if line.r == self.run:
            voltage = -np.interp(line.trajectory.inputs.time_s, self.time_s, self.missing_V)
        still = np.zeros(len(voltage))
        return line.of_forcing(Forcing(voltage, still, still))

    def limits(self) -> tuple[float, float]:
        """Of the coefficient."""
        return 0.0, 2.0

    def values(self, coefficient: Array, covariance: Array) -> tuple[Array, Array, Array]:
        """Time in s, resistance beyond the usual, and its standard deviation, where there are most spells."""
        return self.shown


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


def contacts(lines: Sequence[Line]) -> list[Hypothesis]:
    """A contact in each recording in which the electrical equation shows one.

    Recordings without current or speed say nothing, nor do very short ones.
    """
    seen = [(line, _lacking(line)) for line in lines if {"current", "speed"} <= {*line.run.channels}]
    listed = []
    for line, lacking in seen:
        if lacking is None or lacking.spells < LEAST:
            continue
        z, here = lacking.deviations, lacking.carrying
        out = here & (z > BEYOND)
        if out.sum() < ONE_SIDED * max(int(np.sum(here & (z < -BEYOND))), 1):
            continue
        drop, current = lacking.voltage_V[out], lacking.current_A[out]
        if np.corrcoef(drop, current)[0, 1] < GOES_WITH:
            continue
        shape = _shape(lacking, line)
        name = f"contact of {line.run.name}"
        listed.append(Hypothesis(name, "unnamed", "electrical", (shape,)))
    return listed


def _lacking(line: Line) -> _Lacking | None:
    model, run = line.model, line.run
    tau = filter_times(run, time_constants(model.file.motor))["electrical"]
    time = run.inputs.time_s
    # A voltage that is missing on the side of the drop.
    drop = -missing_of(model, run, line.r, line.trajectory, line.predicted)["electrical"]
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
    # What a filter leaves of a current long after it has ended is nothing to divide by.
    terms = np.where(np.abs(terms) < np.finfo(np.float64).tiny, 0.0, terms)
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        error = y - terms @ np.linalg.lstsq(terms * root[:, None], y * root, rcond=None)[0]
        scale = 1.4826 * float(np.median(np.abs(error))) + 1e-12 * float(np.max(np.abs(y), initial=1e-300))
        weights = 1 / np.maximum(1.0, np.abs(error) / (HUBER * scale))
    return error, scale


def _shape(seen: _Lacking, line: Line) -> Contact:
    kept = seen.carrying
    time, z = seen.time_s[kept], seen.deviations[kept]
    more, sd = (seen.voltage_V / seen.current_A)[kept], (seen.scale_V / np.abs(seen.current_A))[kept]
    spells = z > BEYOND
    # Spells shorter than the filter look smaller than they are.
    by = float(np.quantile(more[spells], 0.75))
    counts = np.convolve(spells, np.ones(min(SHOWN, len(spells))), mode="valid")
    window = slice(int(np.argmax(counts)), int(np.argmax(counts)) + SHOWN)
    missing = np.where(seen.carrying & (seen.deviations > BEYOND), seen.voltage_V, 0.0)
    return Contact(
        line.r, seen.run.name, line.model.file.meaning("R_a0").unit, seen.time_s, missing,
        (time[window], more[window], sd[window]), by, float(np.mean(more > 0.5 * by)),
    )  # fmt: skip
