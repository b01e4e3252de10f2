"""Whether a parameter of one motor changed over the dates of its recordings, and how: at once, steadily, or not at all.

A series of estimates with their deviations, beside which each recording may wander by chance. A step at any date and a
steady drift are each tested by their t; that there are several is paid for (Bonferroni), so that the share of histories
without a change in which one is claimed is known. Which of the two it was is a question of their marginal likelihoods, with
the date of a step and the sizes integrated out (sizes by a unit-information prior: Kass and Wasserman 1995,
doi:10.1080/01621459.1995.10476592).
"""

from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp
from scipy.stats import norm
from scipy.stats import t as student

from motorlens_workbench.fleet.levels import solve
from motorlens_workbench.fleet.population import Population

Array = NDArray[np.float64]

# Share of the motors without a change of which one is claimed, all their parameters counted.
FALSE_CHANGES = 0.01
# One kind is believed over the other from this probability.
CLEAR = 0.9
# Fewer recordings show no change that is not their scatter.
FEWEST = 4
# The wander is taken from the whole fleet where it has so many recordings beyond one a motor.
POOLED = 30
_WANDERS = np.concatenate([[0.0], np.geomspace(0.05, 20.0, 40)])


@dataclass(frozen=True)
class Change:
    """A change in a series: "step", "drift", or "change" if these are not told apart.

    Attributes:
        kind: see above.
        at: number of the first recording after the step; of a drift, 0.
        size: of the step, or of the drift from the first recording to the last.
        sd: of the size.
        p: the probability that chance does so much, dates and kinds counted.
        probability: of the kind, given that there is a change.
    """

    kind: str
    at: int
    size: float
    sd: float
    p: float
    probability: float


def change(time: Array, value: Array, sd: Array, wander: float | None = None) -> Change | None:
    """The most telling change in a series; None where it has fewer than `FEWEST` points or no dates.

    Args:
        time: (n,) increasing, in any unit.
        value: (n,) estimates.
        sd: (n,) their standard deviations.
        wander: standard deviation of what recordings differ by besides; None finds it in the series.
    """
    n = len(time)
    if n < FEWEST or not time[-1] > time[0]:
        return None
    drift = (time - time[0]) / (time[-1] - time[0])
    steps = [(k, (np.arange(n) >= k).astype(float)) for k in range(1, n) if time[k] > time[k - 1]]
    fits = [
        ("drift", 0, _fitted(drift, value, sd, wander)),
        *(("step", k, _fitted(x, value, sd, wander)) for k, x in steps),
    ]
    kind, at, best = min(fits, key=lambda fit: fit[2].p)
    logs = {
        "drift": fits[0][2].likelihood,
        "step": float(logsumexp([fit.likelihood for _, _, fit in fits[1:]])) - np.log(len(steps)),
    }
    of_drift = float(1 / (1 + np.exp(np.clip(logs["step"] - logs["drift"], -700, 700))))
    likelier = "drift" if of_drift > 0.5 else "step"
    if likelier != kind:
        kind, at, best = min((fit for fit in fits if fit[0] == likelier), key=lambda fit: fit[2].p)
    probability = max(of_drift, 1 - of_drift)
    p = min(1.0, len(fits) * min(fit.p for _, _, fit in fits))
    return Change(kind if probability >= CLEAR else "change", at, best.size, best.sd, p, probability)


@dataclass(frozen=True)
class _Fitted:
    size: float
    sd: float
    p: float
    likelihood: float


def _fitted(x: Array, y: Array, sd: Array, wander: float | None) -> _Fitted:
    """A level and a multiple of x, at the likeliest wander (restricted, of this model)."""
    n = len(y)
    extra = np.array([wander]) if wander is not None else _WANDERS * float(np.median(sd))
    weight = 1 / (sd**2 + extra[:, None] ** 2)
    # Normal equations of (1, x) for every wander, solved by hand.
    w, wx, wy = weight.sum(axis=1), weight @ x, weight @ y
    determinant = w * (weight @ x**2) - wx**2
    size = (w * (weight @ (x * y)) - wx * wy) / determinant
    rest = np.sum(weight * (y - ((wy - wx * size) / w)[:, None] - size[:, None] * x) ** 2, axis=1)
    likelihood = 0.5 * np.sum(np.log(weight), axis=1) - 0.5 * rest
    best = int(np.argmax(likelihood - 0.5 * np.log(determinant)))
    deviation = float(np.sqrt(w[best] / determinant[best]))
    score = abs(float(size[best])) / deviation
    # A scatter that the series itself has to tell is known by its n - 2 degrees of freedom.
    p = 2 * float(norm.sf(score) if wander is not None else student.sf(score, n - 2))
    return _Fitted(float(size[best]), deviation, p, float(likelihood[best]) - 0.5 * float(np.log(n)))


@dataclass(frozen=True, eq=False)
class Series:
    """A parameter of one motor, by recording: dates, values, deviations, 95 % intervals, and its change if one is real."""

    motor: str
    key: str
    unit: str
    dates: tuple[datetime, ...]
    value: Array
    sd: Array
    low: Array
    high: Array
    change: Change | None


def histories(found: Population) -> tuple[Series, ...]:
    """Of every motor with dated recordings, all parameters that they tell, and candidates by which it differs.

    In the series of one parameter the others are what all recordings of the motor say.
    """
    wide = found.wide
    data, psi = wide.data(found.data, 0.0), wide.padded(found.spreads.psi)
    count = wide.free
    solved = solve(data, wide.padded(np.maximum(found.between, found.known)), psi)
    enough = np.count_nonzero(data.belongs[data.motor]) - data.motors >= POOLED
    out = []
    for m, motor in enumerate(found.motors):
        rows = [r for r in np.flatnonzero(data.motor == m) if found.observations[r].date is not None]
        rows.sort(key=lambda r: found.observations[r].date or datetime.min)
        if len(rows) < FEWEST:
            continue
        extra = [wide.keys.index(d.key) for d in found.differences[m] if d.key not in found.keys]
        asked = [*range(count), *extra]
        dates = tuple(o.date for o in (found.observations[r] for r in rows) if o.date is not None)
        days = np.array([(date - dates[0]).total_seconds() / 86400 for date in dates])
        middle = (
            (found.solved.mean + found.solved.motor[m])
            if found.belongs[m]
            else (solved.mean + solved.motor[m])[:count]
        )
        variance = np.diagonal(solved.motor_covariance[m])[:count] + found.spreads.psi**2
        mine: list[Series] = []
        for k in asked:
            # Parameters and the candidate in question; other candidates stay at their null.
            of = [*range(count), *([k] if k >= count else [])]
            at = np.concatenate([middle, np.zeros(len(of) - count)])
            known = np.concatenate([1 / np.maximum(variance, 1e-12), np.zeros(len(of) - count)])
            place = of.index(k)
            known[place] = 0.0
            told, values, sds = True, [], []
            for r in rows:
                table = wide.information[r][np.ix_(of, of)]
                total = table + np.diag(known)
                total[place, place] += 1e-12 + 1e-9 * table[place, place]
                covariance = np.linalg.inv(total)
                values.append(float(at[place] + (covariance @ (wide.vector[r][of] - table @ at))[place]))
                sds.append(float(np.sqrt(covariance[place, place])))
                told &= sds[-1] < (found.known[k] if k < count else 30.0)
            if not told:
                continue
            phi, sd = np.array(values), np.array(sds)
            pooled = float(psi[k]) if enough else None
            seen = change(days, phi, sd, pooled)
            size = float(wide.scale.size[k])
            # Nothing is shown beyond what is possible; a change is that of the plain series.
            value, low, high = (
                np.clip(wide.scale.centre[k] + size * x, *wide.scale.bounds[:, k])
                for x in (phi, phi - 1.96 * sd, phi + 1.96 * sd)
            )
            if seen is not None:
                seen = Change(seen.kind, seen.at, seen.size * size, seen.sd * size, seen.p, seen.probability)
            unit = wide.file.meaning(wide.keys[k]).unit
            mine.append(Series(motor, wide.keys[k], unit, dates, value, sd * size, low, high, seen))
        # All parameters of a motor are looked at.
        out += [_believed(series, len(mine)) for series in mine]
    return tuple(out)


def _believed(series: Series, tested: int) -> Series:
    seen = series.change
    real = seen is not None and seen.p * tested < FALSE_CHANGES
    return series if real else replace(series, change=None)
