"""A contact that comes and goes: spells of more resistance, too short and too irregular for any curve.

While a contact is bad the electrical equation lacks a voltage that goes with the current, always on the side of more
resistance; noise lies on both sides alike, and spikes of a sensor do not go with the current. So what a robust fit leaves of
that equation (Huber 1964, doi:10.1214/aoms/1177703732) is looked through for spells of one resistance more. They are a
contact where they are likelier than spells of anything else.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.scenario import time_constants
from motorlens_workbench.balances import balances_of, measured_state
from motorlens_workbench.criteria import NEARLY
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line
from motorlens_workbench.hypotheses.spells import Residuals, Spells, level, spells

Array = NDArray[np.float64]

# Windows of a stretch of time whose noise is told by itself, and how many stretches there are at most.
STRETCH, MOST = 60, 24
# How many spells there must be for it to come and go.
LEAST = 8
# Share of the effective current from which on a bad contact shows, and windows of the stretch of time that is shown.
CARRIES, SHOWN = 0.3, 80
# Bound of Huber's weights, standard deviations, and how often they are renewed.
HUBER, ROUNDS = 1.5, 5


@dataclass(frozen=True)
class Contact:
    """The armature's resistance while a contact comes and goes.

    Attributes:
        recording: name of the one in which it shows most.
        unit: of the resistance.
        missing: of each recording in which it shows, by position: times in s, and what the electrical equation lacks then,
            V, 0 where the contact is good, (M,) each.
        shown: part of these samples with the most spells: time in s, resistance beyond the usual, its standard deviation.
        by: how much more the resistance is while the contact is bad, Ohm.
        share: of the time.
    """

    recording: str
    unit: str
    missing: tuple[tuple[int, Array, Array], ...]
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
        for r, time, missing in self.missing:
            if r == line.r:
                voltage = -np.interp(line.trajectory.inputs.time_s, time, missing)
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
    """What the electrical equation of a run lacks in M windows of time.

    Attributes:
        line: the run.
        time_s: (M,) the middle of each.
        current_A: (M,) as measured.
        flows_A: (M,) as simulated: in that which was measured there is noise, which the equation lacks as well.
        residuals: V, on the side of a drop, beyond a robust fit.
    """

    line: Line
    time_s: Array
    current_A: Array
    flows_A: Array
    residuals: Residuals


def contacts(lines: Sequence[Line]) -> list[Hypothesis]:
    """A contact, if the electrical equation shows one.

    Recordings without current say nothing, nor do very short ones.
    """
    seen = [lacking for line in lines if (lacking := _lacking(line)) is not None]
    found = [(lacking, bad) for lacking in seen if (bad := _contact(lacking)) is not None]
    if sum(bad.count for _, bad in found) < LEAST:
        return []
    most, bad = max(found, key=lambda pair: pair[1].wins)
    return [Hypothesis("contact", "unnamed", "electrical", (_shape(most, bad, found),))]


def _lacking(line: Line) -> _Lacking | None:
    run, simulated = line.run, line.trajectory.states
    if "current" not in run.channels:
        return None
    # The voltage as it was measured: what it was corrected by holds what the contact has lost.
    bare = replace(run, corrections=None)
    balance = balances_of(line.model, bare, line.r, line.trajectory, line.predicted)["electrical"]
    current = measured_state(run, line.trajectory, line.predicted, "i")
    # As short as a derivative of the current may be: what is slower would take several spells for one.
    each = max(1, round(time_constants(line.model.file.motor).electrical_s / run.period_s))
    begins = np.arange(1, len(balance) - each, each)
    if len(begins) < STRETCH:
        return None

    def mean(y: Array) -> Array:
        return np.asarray(np.lib.stride_tricks.sliding_window_view(y, each)[begins].mean(axis=1))

    def rate(y: Array) -> Array:
        # From half a sample before a window to half a sample behind it.
        time = run.inputs.time_s
        ends = [
            0.5 * (of[begins + each - 1] + of[begins + each] - of[begins - 1] - of[begins])
            for of in (y, time)
        ]
        return np.asarray(ends[0] / ends[1])

    used = mean(run.valid.astype(float)) == 1
    drop = (mean(balance) - line.trajectory.motor.L * rate(current))[used]
    flows = mean(simulated["i"])[used]
    # What the model has a little wrong, and what a sensor lags by: it goes with the current where the shaft gathers speed.
    wrong = (np.ones_like(current), simulated["i"], simulated["w"])
    terms = np.column_stack([*map(mean, wrong), rate(simulated["i"]), rate(simulated["w"])])[used]
    # Where no current flows, no resistance shows.
    if len(drop) < STRETCH or not flows.any():
        return None
    terms = terms / np.maximum(np.max(np.abs(terms), axis=0), np.finfo(np.float64).tiny)
    beyond = robust(terms, drop)
    stretches = np.array_split(beyond, max(min(MOST, len(beyond) // STRETCH), 1))
    scale = np.concatenate([np.full(len(part), deviation(part, beyond)) for part in stretches])
    residuals = level(Residuals(beyond, scale, terms))
    return _Lacking(line, mean(run.inputs.time_s)[used], mean(current)[used], flows, residuals)


def robust(terms: Array, y: Array) -> Array:
    """Residuals (M,) of a robust fit of y (M,) by terms (M, k)."""
    weights = np.ones(len(y))
    # A current that has long decayed is nothing to divide by.
    terms = np.where(np.abs(terms) < np.finfo(np.float64).tiny, 0.0, terms)
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        error = np.asarray(y - terms @ np.linalg.lstsq(terms * root[:, None], y * root, rcond=None)[0])
        weights = 1 / np.maximum(1.0, np.abs(error) / (HUBER * deviation(error, y)))
    return error


def deviation(error: Array, y: Array) -> float:
    """Standard deviation of errors (M,) by the median; not quite nothing beside what they are the errors of."""
    return 1.4826 * float(np.median(np.abs(error))) + 1e-12 * float(np.max(np.abs(y), initial=1e-300))


def _contact(seen: _Lacking) -> Spells | None:
    """The spells of a run, if they are likelier than none, and than anything else that comes and goes.

    Noise that lasts makes spells on either side likely: then only how far samples lie beyond may tell.
    """
    current = seen.flows_A
    even, way = np.ones_like(current), np.sign(current)
    # Less resistance, or as often less as more; and a voltage that does not go with the current.
    others = [[-current], [current, -current], [even], [-even], [even, -even], [way], [-way]]
    lasting = spells(seen.residuals, [current], lasting=True)
    # Only where they may last is it told how many there are.
    apart = replace(spells(seen.residuals, [current], lasting=False), count=lasting.count)
    # How much and how often are fitted, and for how long (Schwarz 1978, doi:10.1214/aos/1176344136).
    for bad, numbers in ((lasting, 3), (apart, 2)):
        least = bad.wins - NEARLY
        if least > 0.5 * numbers * np.log(len(current)) and all(
            spells(seen.residuals, forms, bad is lasting).wins < least for forms in others
        ):
            return bad
    return None


def _shape(most: _Lacking, bad: Spells, found: Sequence[tuple[_Lacking, Spells]]) -> Contact:
    weights = bad.other * most.current_A / most.residuals.scale**2
    by = float(weights @ bad.values / (weights @ most.current_A))
    # Where hardly a current flows nothing shows.
    kept = np.abs(most.current_A) > CARRIES * np.sqrt(np.mean(most.current_A**2))
    time, current, other = most.time_s[kept], most.current_A[kept], bad.other[kept]
    more, sd = bad.values[kept] / current, most.residuals.scale[kept] / np.abs(current)
    counts = np.convolve(other, np.ones(min(SHOWN, len(other))), mode="valid")
    window = slice(int(np.argmax(counts)), int(np.argmax(counts)) + SHOWN)
    missing = tuple((one.line.r, one.time_s, each.other * each.size * one.flows_A) for one, each in found)
    return Contact(
        most.line.run.name, most.line.model.file.meaning("R_a0").unit, missing,
        (time[window], more[window], sd[window]), by, float(np.mean(bad.other)),
    )  # fmt: skip
