"""A contact that comes and goes: spells of more resistance, too short and too irregular for any curve.

While a contact is bad the electrical equation lacks a voltage that goes with the current, always on the side of more
resistance; noise lies on both sides alike, and spikes of a sensor do not go with the current. So what robust fits of the run
and of each stretch of it (Huber 1964, doi:10.1214/aoms/1177703732) leave is taken for a mixture of samples without and
samples with one resistance more (expectation maximisation, Dempster, Laird and Rubin 1977,
doi:10.1111/j.2517-6161.1977.tb01600.x). It is a contact where that is likelier than a mixture with anything else that comes
and goes.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from motorlens_physics.estimate.forcing import Forcing
from motorlens_physics.scenario import time_constants
from motorlens_workbench.balances import lowpass, missing_of
from motorlens_workbench.criteria import NEARLY
from motorlens_workbench.hypotheses.hypothesis import Hypothesis
from motorlens_workbench.hypotheses.line import Line

Array = NDArray[np.float64]

# Samples of a stretch of time that is fitted by itself, and how many stretches there are at most.
STRETCH, MOST = 60, 24
# Filter times for which the voltage must have kept to this share of its effective value: where the motor has just been
# driven elsewhere, what a sensor lags by goes with the current too.
STEADY, KEPT = 10, 0.05
# How many spells there must be for it to come and go.
LEAST = 8
# Degrees of freedom of Student's t that what is left follows: a model that is a little wrong has longer tails than noise.
FREEDOM = 4.0
# The fit of a mixture begins at the likeliest of these sizes, in standard deviations, and shares of samples that are other
# than the rest; it ends once a step wins less than this, or after so many, with a share within these.
BEGIN, OFTEN, WINS, STEPS, SHARES = np.geomspace(1.0, 1000.0, 16), (0.1, 0.01, 0.001), 1e-3, 200, (1e-4, 0.5)
# Share of the effective current from which on a bad contact shows, and samples of the stretch of time that is shown.
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
    """What the electrical equation of a run lacks at M moments.

    Attributes:
        line: the run.
        time_s: (M,).
        current_A: (M,).
        voltage_V: (M,) on the side of a drop, beyond a robust fit of its stretch of time.
        scale_V: (M,) robust standard deviation of its stretch.
        steady: (M,) whether the voltage had been steady.
    """

    line: Line
    time_s: Array
    current_A: Array
    voltage_V: Array
    scale_V: Array
    steady: NDArray[np.bool_]


@dataclass(frozen=True)
class _Mixture:
    """Samples of two kinds.

    Attributes:
        wins: logarithm of how many times as likely it is as one kind alone.
        size: by how much the one kind lies beyond the other, in units of its form.
        share: of the samples that do.
        other: (M,) probability of each sample of being one of them.
    """

    wins: float
    size: float
    share: float
    other: Array

    @property
    def spells(self) -> int:
        """How many there are: neighbours belong together."""
        out = self.other > 0.5
        return int(np.sum(out[1:] & ~out[:-1]) + np.sum(out[:1]))


def contacts(lines: Sequence[Line]) -> list[Hypothesis]:
    """A contact, if the electrical equation shows one.

    Recordings without current or speed say nothing, nor do very short ones.
    """
    seen = [lacking for line in lines if (lacking := _lacking(line)) is not None]
    found = [(lacking, bad) for lacking in seen if (bad := _contact(lacking)) is not None]
    if sum(bad.spells for _, bad in found) < LEAST:
        return []
    most, bad = max(found, key=lambda pair: pair[1].wins)
    return [Hypothesis("contact", "unnamed", "electrical", (_shape(most, bad, found),))]


def _lacking(line: Line) -> _Lacking | None:
    model, run = line.model, line.run
    if not {"current", "speed"} <= {*run.channels}:
        return None
    # As short as a derivative of the current may be, there and back: what is slower would take several spells for one.
    tau = 0.5 * max(run.period_s, time_constants(model.file.motor).electrical_s)
    time = run.inputs.time_s
    drop = _back(
        -missing_of(model, run, line.r, line.trajectory, line.predicted, tau)["electrical"], time, tau
    )
    current, speed = (
        _back(lowpass(run.measured[:, run.channels.index(channel)], time, tau), time, tau)
        for channel in ("current", "speed")
    )
    step = max(1, round(2 * tau / run.period_s))
    at = np.arange(20 * step, len(time), step)
    at = at[run.valid[at]]
    if len(at) < STRETCH:
        return None
    voltage = _back(lowpass(run.inputs.voltage_V, time, tau), time, tau)
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
    # Where no current flows, no resistance shows.
    if steady[at].sum() < STRETCH or not current[at][steady[at]].any():
        return None
    return _Lacking(line, time[at], current[at], beyond, scales, steady[at])


def _back(y: Array, time: Array, tau: float) -> Array:
    """(N,) samples through the low-pass once more, against time, so that they are not late."""
    return lowpass(y[::-1], -time[::-1], tau)[::-1]


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


def _contact(seen: _Lacking) -> _Mixture | None:
    """The spells of a run, if they are likelier than none, and than anything else that comes and goes."""
    drop, scale, current = (y[seen.steady] for y in (seen.voltage_V, seen.scale_V, seen.current_A))
    even, way = np.ones_like(current), np.sign(current)
    bad = _mixture(drop, scale, [current])
    # Less resistance, or as often less as more; and a voltage that does not go with the current.
    others = [[-current], [current, -current], [even], [-even], [even, -even], [way], [-way]]
    # Two numbers are fitted: how much, and how often (Schwarz 1978, doi:10.1214/aos/1176344136).
    rival = max(np.log(len(drop)), *(_mixture(drop, scale, forms).wins for forms in others))
    return bad if bad.wins > rival + NEARLY else None


def _mixture(drop: Array, scale: Array, forms: Sequence[Array]) -> _Mixture:
    """Samples (M,) some of which lie beyond the others by a size times one of the forms, each as likely as another."""
    usual = _likelihood(drop, scale)

    def parts(size: float, share: float) -> tuple[Array, Array, Array]:
        each = np.array([_likelihood(drop - size * form, scale) for form in forms])
        apart = np.logaddexp.reduce(each, axis=0)
        there = np.log(share / len(forms)) + apart
        total = np.logaddexp(np.log1p(-share) + usual, there)
        return np.exp(each - apart), np.exp(there - total), total - usual

    sizes = BEGIN / np.sqrt(np.mean((forms[0] / scale) ** 2))
    begins = ((float(size), share) for size in sizes for share in OFTEN)
    size, share = max(begins, key=lambda begin: float(np.sum(parts(*begin)[2])))
    wins = -np.inf
    for _ in range(STEPS):
        which, other, each = parts(size, share)
        before, wins = wins, float(np.sum(each))
        if wins < before + WINS:
            break
        pulls = [
            other * one / (FREEDOM + ((drop - size * form) / scale) ** 2) / scale**2
            for one, form in zip(which, forms, strict=True)
        ]
        weight = sum(float(np.sum(pull * form**2)) for pull, form in zip(pulls, forms, strict=True))
        moment = sum(float(np.sum(pull * form * drop)) for pull, form in zip(pulls, forms, strict=True))
        size = max(moment / weight, 0.0)
        share = float(np.clip(other.mean(), *SHARES))
    return _Mixture(wins, size, share, other)


def _likelihood(error: Array, scale: Array) -> Array:
    """(M,) logarithm of Student's t, but for a constant."""
    return np.asarray(-np.log(scale) - 0.5 * (FREEDOM + 1) * np.log1p((error / scale) ** 2 / FREEDOM))


def _when(seen: _Lacking, bad: _Mixture) -> Array:
    """(M,) probability that the contact is bad, whether the voltage had been steady or not."""
    good = _likelihood(seen.voltage_V, seen.scale_V) + np.log1p(-bad.share)
    there = _likelihood(seen.voltage_V - bad.size * seen.current_A, seen.scale_V) + np.log(bad.share)
    return np.asarray(np.exp(there - np.logaddexp(good, there)))


def _shape(most: _Lacking, bad: _Mixture, found: Sequence[tuple[_Lacking, _Mixture]]) -> Contact:
    # Where hardly a current flows nothing shows.
    kept = most.steady & (np.abs(most.current_A) > CARRIES * np.sqrt(np.mean(most.current_A**2)))
    time, current, spells = most.time_s[kept], most.current_A[kept], _when(most, bad)[kept]
    more, sd = most.voltage_V[kept] / current, most.scale_V[kept] / np.abs(current)
    counts = np.convolve(spells, np.ones(min(SHOWN, len(spells))), mode="valid")
    window = slice(int(np.argmax(counts)), int(np.argmax(counts)) + SHOWN)
    missing = tuple(
        (one.line.r, one.time_s, _when(one, each) * each.size * one.current_A) for one, each in found
    )
    return Contact(
        most.line.run.name, most.line.model.file.meaning("R_a0").unit, missing,
        (time[window], more[window], sd[window]), bad.size, float(np.mean(more > 0.5 * bad.size)),
    )  # fmt: skip
